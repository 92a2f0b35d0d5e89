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
from tests.vcan.inside.conftest import TIME_SCALE

HANDCTL = Path(sys.executable).with_name("handctl")
GOLDEN = Path(__file__).parents[3] / "logs" / "golden" / "jamia-grasp.mcap"
SETTLED_S = 0.4
SCENE_FILE = Path("/dev/shm/drive-scene.toml")


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
@pytest.mark.parametrize("simulator", [["--homed", "--scene", str(SCENE_FILE)]], indirect=True, ids=["grasp"])
@pytest.mark.usefixtures("scene", "simulator")
def test_a_golden_grasp_repeats_on_vcan(tmp_path: Path) -> None:
    _nothing_to_tare(tmp_path / "c.toml")
    words = ["--bus", "socketcan:vcan0", "--time-scale", str(TIME_SCALE), "--calibration", str(tmp_path / "c.toml")]
    command = [str(HANDCTL), "replay", "drive", str(GOLDEN), *words, "--log", str(tmp_path / "again.mcap"), "--json"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    found = json.loads(ran.stdout)
    assert max(row["rms"] for row in found["joint_deg"].values()) < 1.0  # peaks: the guest's clocks slip under load
    with RunLog(GOLDEN) as before, RunLog(tmp_path / "again.mcap") as after:
        starts = {change.name: change.t_ns * 1e-9 for change in before.phases}
        began, _ = stretch(before)
        held = (starts["hold"] + SETTLED_S - began, starts["release"] - began)
        again = next(change.t_ns * 1e-9 for change in after.phases if change.name == "playback")
        np.testing.assert_allclose(while_held(after, again, *held), while_held(before, began, *held), rtol=0.05)
