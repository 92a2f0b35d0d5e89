"""Kill or stop controllers at random times.

After the end of a controller, the drives remove the torque within their watchdog time, and all logs
are complete.
"""

import multiprocessing
import os

import pytest

from tests.runtime.killed_controllers import disturb_controllers_in_batches, summary_of_kills

pytestmark = [pytest.mark.realtime, pytest.mark.alone]
CONTROLLER_COUNT = 500 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 8
TIME_SCALE = 0.7


def all_batches(controller_count, seed, time_scale):
    """Kill or stop ``controller_count`` controllers, and return the verdict on each run."""
    return [
        run
        for batch in disturb_controllers_in_batches(controller_count, seed, time_scale)
        for run in batch
    ]


@pytest.mark.timeout(300 + 15 * CONTROLLER_COUNT)
def test_drives_remove_torque_and_logs_end_with_the_last_tick(time_scale_of_attempt):
    # A controller locks all its memory. To need less memory, the controllers of this test are forks
    # of a small process instead of the large process of all tests.
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        runs = pool.apply(
            all_batches, (CONTROLLER_COUNT, 20261121, TIME_SCALE * time_scale_of_attempt)
        )
    assert [run for run in runs if not run.torque_ended_in_time] == [], (
        "torque is left after the drives' watchdog"
    )
    assert [run for run in runs if not run.has_complete_log] == [], (
        "a log lacks the last ticks that were on the bus"
    )
    assert max(run.remaining_tension_N for run in runs) < 5.0, summary_of_kills(runs)
    assert sum(run.had_motor_torque for run in runs) >= CONTROLLER_COUNT // 2, (
        "most runs are disturbed while a motor makes torque"
    )
    assert sum(run.was_taut for run in runs) >= CONTROLLER_COUNT // 5, (
        "some runs are disturbed while a tendon is taut"
    )
