"""A golden grasp driven again on real SocketCAN: the same angles and the same tensions."""

import datetime
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.commission import write_calibration
from handctl.controller.calibration import Calibration, TendonCalibration
from handctl.hand.description import load_hand
from handctl.log.reader import RunLog
from handctl.replay.drive import stretch
from tests.replay.runs import SCENE

HANDCTL = Path(sys.executable).with_name("handctl")
GOLDEN = Path(__file__).parents[3] / "logs" / "golden" / "jamia-grasp.mcap"
RATE_HZ, SLOWER = 200, 0.05
"""That of the log, and half the speed of the other tests: the guest's core is shared with all that the host does, and
a pause of four ticks ends a run, as it should."""
SETTLED_S = 0.4
SCENE_FILE = Path("/dev/shm/drive-scene.toml")
SIMULATED = ["--homed", "--scene", str(SCENE_FILE), "--time-scale", str(SLOWER)]


@pytest.fixture(scope="module", autouse=True)
def scene() -> None:
    SCENE_FILE.write_text(SCENE.format(friction=0.5))


def while_held(log: RunLog, start_s: float, begin_s: float, end_s: float) -> np.ndarray:
    """Mean tensions (N,) between two times after the start of what is repeated [N]."""
    at = (log.times >= start_s + begin_s) & (log.times <= start_s + end_s)
    return np.asarray(log.field("tension")[at].mean(axis=0))


def _nothing_to_tare(path: Path) -> None:
    """Calibration of a hand that starts homed."""
    hand, made = load_hand("jamia"), datetime.datetime.now(datetime.UTC)
    nothing = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    tendons = dict.fromkeys(hand.tendon_names, nothing)
    made_with = Calibration(hand="jamia", identity=hand.identity, made=made.isoformat(), tendon=tendons)
    write_calibration(path, made_with)


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("simulator", [SIMULATED], indirect=True, ids=["grasp"])
@pytest.mark.usefixtures("scene", "simulator")
def test_a_golden_grasp_repeats_on_vcan(tmp_path: Path) -> None:
    _nothing_to_tare(tmp_path / "c.toml")
    words = ["--bus", "socketcan:vcan0", "--rate", str(RATE_HZ), "--time-scale", str(SLOWER)]
    files = ["--calibration", str(tmp_path / "c.toml"), "--log", str(tmp_path / "again.mcap")]
    command = [str(HANDCTL), "replay", "drive", str(GOLDEN), *words, *files, "--json"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    found = json.loads(ran.stdout)
    angles = {name: row["rms"] for name, row in found["joint_deg"].items()}
    with RunLog(GOLDEN) as before, RunLog(tmp_path / "again.mcap") as after:
        starts = {change.name: change.t_ns * 1e-9 for change in before.phases}
        began, _ = stretch(before)
        held = (starts["hold"] + SETTLED_S - began, starts["release"] - began)
        again = next(change.t_ns * 1e-9 for change in after.phases if change.name == "playback")
        old, new = while_held(before, began, *held), while_held(after, again, *held)
    print(f"worst joint {max(angles.values()):.2f} deg rms, worst tension {100 * abs(new / old - 1).max():.1f} % apart")
    assert max(angles.values()) < 1.0, angles  # peaks: the guest's clocks slip under load
    np.testing.assert_allclose(new, old, rtol=0.05)
