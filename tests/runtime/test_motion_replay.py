"""Test ``handctl replay drive`` in real time.

The command ``replay drive`` repeats a recorded grasp on a simulated hand in another process.
"""

import json
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.runtime.mailbox import StatusWatcher
from tests.replay.grasp_repetition import mean_angle_differences, mean_held_tensions
from tests.replay.short_runs import CYLINDER_SCENE
from tests.runtime.processes import (
    LOCAL_BUS,
    end_process,
    process_result,
    run_handctl,
    start_hand,
    start_handctl,
    wait_for_phase,
    write_homed_calibration,
)

pytestmark = [pytest.mark.realtime, pytest.mark.alone]
GOLDEN_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap"


@pytest.fixture
def work_folder(work_folder):
    (work_folder / "scene.toml").write_text(CYLINDER_SCENE.format(friction=0.5))
    write_homed_calibration(work_folder / "c.toml", load_hand("jamia"))
    return work_folder


def test_a_golden_grasp_repeats_on_the_local_bus(work_folder, time_scale_options):
    simulated_hand_process = start_hand(
        work_folder / "x.truth", "--hand", "jamia", "--scene", "scene.toml", *time_scale_options
    )
    try:
        words = (
            "--hand",
            "jamia",
            "--bus",
            LOCAL_BUS,
            "--calibration",
            "c.toml",
            *time_scale_options,
        )
        done = run_handctl(
            "replay", "drive", str(GOLDEN_LOG), *words, "--log", "again.mcap", "--json"
        )
    finally:
        end_process(simulated_hand_process)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    # At the first contact, the joints of a digit do not yield at the same moment in both runs. At
    # the first contact, the joint angles of the two runs differ by 2.7 deg, and by more after a
    # late tick. Because of the different moments of contact, the test limits only the RMS
    # difference of each joint, and the difference of the mean angle of each digit.
    single = 6.0
    assert {name for name, row in result["joint_deg"].items() if row["peak"] > single} == set()
    assert max(row["rms"] for row in result["joint_deg"].values()) < 1.0, (
        "as in lockstep, tests/replay/test_drive.py"
    )
    with RunLog(GOLDEN_LOG) as original_log, RunLog(work_folder / "again.mcap") as replayed_log:
        angle_differences = mean_angle_differences(original_log, replayed_log)
        assert np.percentile(angle_differences, 99, axis=0).max() < 1.0
        assert angle_differences.max() < 2.0, "a digit may leave the object one tick late"
        original_tensions, replayed_tensions = mean_held_tensions(original_log, replayed_log)
    np.testing.assert_allclose(replayed_tensions, original_tensions, rtol=0.05)


def test_an_interrupted_replay_reports_its_progress(work_folder, time_scale_options):
    simulated_hand_process = start_hand(
        work_folder / "x.truth", "--hand", "jamia", "--scene", "scene.toml", *time_scale_options
    )
    words = (
        "--hand",
        "jamia",
        "--bus",
        LOCAL_BUS,
        "--calibration",
        "c.toml",
        *time_scale_options,
        "--log",
        "half.mcap",
        "--json",
    )
    try:
        replay_process = start_handctl("replay", "drive", str(GOLDEN_LOG), *words)
        watcher = StatusWatcher(LOCAL_BUS)
        wait_for_phase("playback", watcher, replay_process)
        time.sleep(0.6)
        replay_process.send_signal(signal.SIGINT)
        code, result, err = process_result(replay_process)
        watcher.close()
    finally:
        end_process(simulated_hand_process)
    assert code == 1
    assert f"stopped: {result['driven_s']:.2f} of {result['seconds']:.2f} s were driven" in err
    assert result["complete"] is False
    assert 0 < result["driven_s"] < 0.8 * result["seconds"]
    assert result["log"] == "half.mcap"
    assert max(row["rms"] for row in result["tendon_N"].values()) < 2.0
