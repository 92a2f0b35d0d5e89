"""The whole of it on real SocketCAN: ``handctl run`` commissions a hand and grasps a cylinder, two processes apart."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.vcan.inside.conftest import TIME_SCALE

HANDCTL = Path(sys.executable).with_name("handctl")
TASK = Path(__file__).with_name("short_grasp.toml")
DIGITS = {"index", "middle", "ring", "thumb"}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("simulator", [["--scene", "cylinder"]], indirect=True, ids=["cylinder"])
@pytest.mark.usefixtures("simulator")
def test_a_run_grasps_holds_and_lets_go(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    words = ["run", "--hand", "jamia", "--bus", "socketcan:vcan0", "--task", str(TASK), "--time-scale", str(TIME_SCALE)]
    files = ["--json", "--log", str(log), "--calibration", str(tmp_path / "jamia.calibration.toml")]
    ran = subprocess.run([HANDCTL, *words, *files], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    result = json.loads(ran.stdout)
    assert result["failure"] == ""
    assert result["log_complete"]
    assert log.stat().st_size == result["log_bytes"]
    assert result["ticks"] > 4 * result["rate_hz"]  # seconds of the task
    assert result["frames_rx"] > 4 * result["ticks"]  # a reply of each motor, and the tensions
    assert result["frames_lost"] < 0.01 * result["frames_rx"]
    assert result["tension_hold_error_n"] < 2.0
    assert result["object_motion_mm"] < 5.0
    assert set(result["contact_force_n"]) == DIGITS
    assert min(result["contact_force_n"].values()) > 1.0
