"""Test ``handctl demo`` in real and scaled time.

In the tests of ``handctl demo``, simulator and controller share one clock.
"""

import os
from pathlib import Path

import pytest

from handctl.log.read.reader import RunLog
from tests.runtime.processes import modes_of_complete_log, process_result, start_handctl

pytestmark = [pytest.mark.realtime, pytest.mark.alone]

FAST_DEMO_OPTIONS = (
    "--task",
    "short.toml",
    "--scene",
    "none",
    "--log",
    "run.mcap",
    "--time-scale",
    "16",
    "--json",
)
"""Command-line options of a demo with a time scale that is too fast for any machine."""


def test_the_clock_of_the_demo_pauses_on_a_slow_machine(work_folder, started_processes):
    started_processes.append(start_handctl("demo", *FAST_DEMO_OPTIONS))
    code, result, err = process_result(started_processes.pop())
    assert code == 0, err
    assert result["failure"] == ""
    assert result["time_scale"] == 16.0
    assert (result["missed"], result["frames_late"], result["frames_lost"]) == (0, 0, 0)
    assert max(result["tracking_rmse_deg"].values()) < 1.0
    assert result["clock_pauses"] > 0
    modes_of_complete_log(work_folder / "run.mcap")
    # Reproduce a defect: each demo left its truth file of 10 MB in the run folder, although the
    # demo had copied the file. The run folder is possibly a file system in memory.
    assert result["truth"] == "run.truth"
    assert not list(Path(os.environ["HANDCTL_RUN_DIR"]).rglob("*.truth"))
    with RunLog(work_folder / "run.mcap") as log:
        assert int(log.end["clock_pauses"]) == result["clock_pauses"]
        assert float(log.end["clock_paused_ms"]) == pytest.approx(
            1e3 * result["clock_paused_s"], abs=0.1
        )


def test_a_strict_clock_does_not_pause(work_folder, started_processes):
    started_processes.append(start_handctl("demo", "--strict-clock", *FAST_DEMO_OPTIONS))
    code, _, err = process_result(started_processes.pop())
    assert code == 1, err
