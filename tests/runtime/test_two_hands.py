"""Two hands on one machine: two controllers and two simulators run side by side without interference."""

import pytest

from handctl.hand.hand_loading import load_hand
from handctl.runtime.mailbox import StatusWatcher
from tests.runtime.processes import (
    modes_of_complete_log,
    process_result,
    run_handctl,
    start_hand,
    start_handctl,
    wait_for_phase,
    write_homed_calibration,
)

pytestmark = [pytest.mark.realtime, pytest.mark.alone, pytest.mark.nightly]
HAND_SIDES = ("left", "right")
RATE_OPTION = ("--rate", "100")
"""Command-line options for a low control rate.

The control rate is low because four real-time processes share the processors.
"""
TIME_SCALE = 0.5


def test_a_stop_of_one_hand_leaves_the_other_moving(
    work_folder, started_processes, time_scale_options
):
    write_homed_calibration(work_folder / "c.toml", load_hand("jamia"))
    buses = [f"local:{side}" for side in HAND_SIDES]
    runs = []
    for side, bus in zip(HAND_SIDES, buses, strict=True):
        started_processes.append(
            start_hand(
                work_folder / f"{side}.truth", "--hand", "jamia", *time_scale_options, bus=bus
            )
        )
        words = (
            "--calibration",
            "c.toml",
            "--task",
            "long.toml",
            "--json",
            "--log",
            f"{side}.mcap",
            *RATE_OPTION,
            *time_scale_options,
        )
        runs.append(start_handctl("run", "--hand", "jamia", "--bus", bus, *words))
        started_processes.append(runs[-1])
    watchers = [StatusWatcher(bus) for bus in buses]
    try:
        for watcher, run in zip(watchers, runs, strict=True):
            wait_for_phase("stay", watcher, run)
        stop_result = run_handctl("stop", "--bus", buses[0])
        assert stop_result.returncode == 0, stop_result.stderr
        code, result, err = process_result(runs[0])
        assert (code, result["failure"]) == (0, ""), err
        # When the first hand is stopped, the second hand still holds its own goal.
        assert runs[1].poll() is None
        wait_for_phase("stay", watchers[1], runs[1])
    finally:
        for watcher in watchers:
            watcher.close()
    assert run_handctl("stop", "--bus", buses[1]).returncode == 0
    code, result, err = process_result(runs[1])
    assert (code, result["failure"]) == (0, ""), err
    for side in HAND_SIDES:
        assert modes_of_complete_log(work_folder / f"{side}.mcap")[-1] == "DISARM -> DONE"
