"""On real SocketCAN, a hand repeats a recorded grasp with the angles and tensions of the record."""

import datetime
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handctl.core.calibration import Calibration, TendonCalibration
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.session.calibration import write_calibration
from tests.replay.grasp_repetition import mean_angle_differences, mean_held_tensions
from tests.replay.short_runs import CYLINDER_SCENE

HANDCTL_COMMAND = Path(sys.executable).with_name("handctl")
GOLDEN_LOG = Path(__file__).parents[3] / "logs" / "golden" / "jamia-grasp.mcap"
RATE_HZ, SLOW_TIME_SCALE = 200, 0.03
"""Control rate [Hz] and time scale of the test.

Simulated time is slower in this test than in other tests. A pause of four ticks ends a run, and the
guest system can pause because the host does other work on the same core.
"""
SCENE_FILE = Path("/dev/shm/drive-scene.toml")
SIMULATOR_OPTIONS = ["--homed", "--scene", str(SCENE_FILE), "--time-scale", str(SLOW_TIME_SCALE)]


@pytest.fixture(scope="module", autouse=True)
def scene_file() -> None:
    SCENE_FILE.write_text(CYLINDER_SCENE.format(friction=0.5))


def _write_homed_calibration(calibration_file: Path) -> None:
    """Write the calibration of a simulated hand that starts with known motor zeros."""
    hand, made_at = load_hand("jamia"), datetime.datetime.now(datetime.UTC)
    tendon_calibration = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    calibration_by_tendon = dict.fromkeys(hand.tendon_names, tendon_calibration)
    calibration = Calibration(
        hand="jamia", identity=hand.identity, made=made_at.isoformat(), tendon=calibration_by_tendon
    )
    write_calibration(calibration_file, calibration)


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("simulator", [SIMULATOR_OPTIONS], indirect=True, ids=["grasp"])
@pytest.mark.usefixtures("scene_file", "simulator")
def test_a_golden_grasp_repeats_on_vcan(tmp_path: Path) -> None:
    _write_homed_calibration(tmp_path / "c.toml")
    words = [
        "--bus",
        "socketcan:vcan0",
        "--rate",
        str(RATE_HZ),
        "--time-scale",
        str(SLOW_TIME_SCALE),
    ]
    files = ["--calibration", str(tmp_path / "c.toml"), "--log", str(tmp_path / "again.mcap")]
    command = [str(HANDCTL_COMMAND), "replay", "drive", str(GOLDEN_LOG), *words, *files, "--json"]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr + process.stdout
    result = json.loads(process.stdout)
    angles = {name: row["rms"] for name, row in result["joint_deg"].items()}
    with RunLog(GOLDEN_LOG) as original_log, RunLog(tmp_path / "again.mcap") as replayed_log:
        apart, (recorded_tensions, repeated_tensions) = (
            mean_angle_differences(original_log, replayed_log),
            mean_held_tensions(original_log, replayed_log),
        )
    summary = f"mean angles of the digits {apart.max():.2f} deg at most, joints {max(angles.values()):.2f} deg rms, "
    print(
        summary
        + f"tensions {100 * abs(repeated_tensions / recorded_tensions - 1).max():.1f} % apart"
    )
    assert max(angles.values()) < 1.0, angles
    assert np.sqrt((apart**2).mean(axis=0)).max() < 1.0, (
        summary
    )  # single peaks of the differences do not count, because the clocks of the guest system jump
    np.testing.assert_allclose(repeated_tensions, recorded_tensions, rtol=0.05)
