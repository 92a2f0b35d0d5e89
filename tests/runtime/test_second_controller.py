"""If a controller already runs on a bus, a second controller does not start and prints one error line.

The controller that already runs on the bus continues to run.
"""

import time

import pytest

from handctl.hand.hand_loading import load_hand
from tests.runtime.killed_controllers import SyncListener, read_sync_records
from tests.runtime.processes import (
    LOCAL_BUS,
    end_process,
    run_handctl,
    start_hand,
    start_handctl,
    write_homed_calibration,
)

pytestmark = pytest.mark.realtime
RUN_OPTIONS = (
    "--hand",
    "jamia",
    "--bus",
    LOCAL_BUS,
    "--calibration",
    "c.toml",
    "--task",
    "long.toml",
    "--json",
)


def test_a_second_controller_is_refused_and_the_first_goes_on(work_folder, time_scale_options):
    write_homed_calibration(work_folder / "c.toml", load_hand("jamia"))
    simulated_hand_process = start_hand(
        work_folder / "hand.truth", "--hand", "jamia", *time_scale_options
    )
    first_process = start_handctl("run", *RUN_OPTIONS, "--log", "first.mcap", *time_scale_options)
    try:
        with SyncListener() as listener:
            until = time.monotonic() + 60.0
            while not listener.syncs:
                assert first_process.poll() is None, first_process.communicate()
                assert time.monotonic() < until
                listener.listen(0.01)
            second_process_result = run_handctl(
                "run", *RUN_OPTIONS, "--log", "second.mcap", *time_scale_options
            )
            assert second_process_result.returncode == 1
            assert "another controller runs here" in second_process_result.stderr
            assert second_process_result.stderr.count("\n") == 1
            listener.listen(0.0)
            sync_count_before = len(listener.syncs)
            listener.listen(0.5)
            assert first_process.poll() is None
            assert len(listener.syncs) > sync_count_before, "the first controller still sends"
        first_process.terminate()
        assert first_process.wait(30.0) == 0
    finally:
        end_process(first_process)
        end_process(simulated_hand_process)
    assert read_sync_records(work_folder / "first.mcap")[0] == ""
    assert not (work_folder / "second.mcap").exists()
