"""Provide a working folder, a simulated hand and a calibration as fixtures for tests that start processes."""

import tempfile

import pytest

from handctl.hand.hand_loading import load_hand
from tests.runtime.processes import (
    LOCAL_BUS,
    LONG_TASK,
    SHORT_TASK,
    TIME_SCALE,
    end_process,
    make_time_scale_options,
    start_hand,
    write_homed_calibration,
)


@pytest.fixture
def work_folder(tmp_path, monkeypatch):
    """Change to a folder that contains only two task files.

    The Unix sockets of the processes are in another folder, because the path of a Unix socket must
    be short.
    """
    with tempfile.TemporaryDirectory(prefix="h-") as short_folder:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short_folder)
        monkeypatch.chdir(tmp_path)
        (tmp_path / "short.toml").write_text(SHORT_TASK)
        (tmp_path / "long.toml").write_text(LONG_TASK)
        yield tmp_path


@pytest.fixture
def started_processes():
    """Return a list to which a test adds its processes.

    After the test, end all processes in the list.
    """
    running = []
    yield running
    for process in reversed(running):
        end_process(process)


@pytest.fixture
def time_scale_options(request, time_scale_of_attempt):
    """Return the command-line options for the time scale of a test.

    A test module can define its own ``TIME_SCALE``.
    """
    return make_time_scale_options(
        getattr(request.module, "TIME_SCALE", TIME_SCALE) * time_scale_of_attempt
    )


@pytest.fixture
def hand_truth_file(work_folder, started_processes, time_scale_options):
    """Start a simulated hand with the time scale of the test, and return the path of its truth file."""
    started_processes.append(
        start_hand(work_folder / "hand.truth", "--hand", "jamia", *time_scale_options)
    )
    return work_folder / "hand.truth"


@pytest.fixture
def calibration_options(work_folder):
    """Write a calibration of the simulated hand, and return the command-line options for a controller of the hand."""
    write_homed_calibration(work_folder / "c.toml", load_hand("jamia"))
    return ("--hand", "jamia", "--bus", LOCAL_BUS, "--calibration", "c.toml")
