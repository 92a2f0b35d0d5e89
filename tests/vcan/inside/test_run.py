"""Test a whole run on real SocketCAN.

``handctl run`` grasps a cylinder with a simulated hand in another process.

In a nightly test run, the hand is commissioned before its run. In all other test runs, the hand is
not commissioned, but starts with known motor zeros and a new calibration. The test slows the clock
of the run, so that a commissioning of 7 s takes 45 s in the guest system.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from handctl.hand.hand_loading import load_hand
from tests.runtime.processes import (
    HOMED_HAND_OPTIONS,
    make_time_scale_options,
    write_homed_calibration,
)
from tests.vcan.inside.conftest import STALL_FAULTS, TIME_SCALE, run_simulator

HANDCTL_COMMAND = Path(sys.executable).with_name("handctl")
SHORT_TASK_FILE = Path(__file__).with_name("short_grasp.toml")
DIGIT_NAMES = {"index", "middle", "ring", "thumb"}
TIME_SCALE_BY_ATTEMPT = (TIME_SCALE, 0.5 * TIME_SCALE, 0.25 * TIME_SCALE)
"""Time scale of each attempt to complete the run.

With a smaller time scale, an interruption of the guest system takes less simulated time. A defect
has the same effect at any time scale.
"""
NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"


def run_handctl(work_folder: Path, time_scale: float) -> subprocess.CompletedProcess[str]:
    """Run ``handctl run`` with a new simulator and a time scale, and return the ended process."""
    calibration = work_folder / "jamia.calibration.toml"
    if not NIGHTLY:
        write_homed_calibration(calibration, load_hand("jamia"))
    words = [
        "run",
        "--hand",
        "jamia",
        "--bus",
        "socketcan:vcan0",
        "--task",
        str(SHORT_TASK_FILE),
        *make_time_scale_options(time_scale),
    ]
    files = ["--json", "--log", str(work_folder / "run.mcap"), "--calibration", str(calibration)]
    options = ["--scene", "cylinder", *(() if NIGHTLY else HOMED_HAND_OPTIONS)]
    with run_simulator(*options, stderr_file=work_folder / "simulator", time_scale=time_scale):
        return subprocess.run(
            [HANDCTL_COMMAND, *words, *files],
            cwd=work_folder,
            capture_output=True,
            text=True,
            check=False,
        )


def run_until_undisturbed(work_folder: Path) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Repeat ``handctl run`` until a run is successful, and return the successful run and its folder.

    If the load of the machine stops a run, the next attempt has a smaller time scale. If a run fails
    for another reason, the test fails.
    """
    for number, time_scale in enumerate(TIME_SCALE_BY_ATTEMPT):
        run_folder = work_folder / str(number)
        run_folder.mkdir()
        result = run_handctl(run_folder, time_scale)
        if result.returncode == 0:
            break
        simulator = (run_folder / "simulator").read_text()
        is_undisturbed = "slips=0" in simulator and not any(
            row in result.stderr for row in STALL_FAULTS
        )
        assert not is_undisturbed, result.stderr + result.stdout + simulator
    assert result.returncode == 0, result.stderr + result.stdout
    return result, run_folder


@pytest.mark.timeout(900)
def test_a_run_grasps_holds_and_releases(tmp_path: Path) -> None:
    process, run_folder = run_until_undisturbed(tmp_path)
    log = run_folder / "run.mcap"
    result = json.loads(process.stdout)
    assert result["failure"] == ""
    assert result["log_complete"]
    assert log.stat().st_size == result["log_bytes"]
    assert result["ticks"] > 4 * result["rate_hz"]  # the run was longer than four seconds
    # four motors and the load cells reply in each tick
    assert result["frames_rx"] > 4 * result["ticks"]
    assert result["frames_lost"] < 0.01 * result["frames_rx"]
    assert result["tension_hold_error_n"] < 2.0
    assert result["object_motion_mm"] < 5.0
    assert set(result["contact_force_n"]) == DIGIT_NAMES
    assert min(result["contact_force_n"].values()) > 1.0
