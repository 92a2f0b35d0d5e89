"""Provide a simulated hand at half the speed of real time to tests with LeRobot's robots and scripts."""

import tempfile

import pytest

from handctl.hand.hand_loading import load_hand
from tests.runtime.processes import (
    end_process,
    make_time_scale_options,
    start_hand,
    write_homed_calibration,
)

TIME_SCALE = 0.5
"""Simulated time that passes per second of real time."""


@pytest.fixture
def work_folder(tmp_path, monkeypatch):
    """Change to an empty folder.

    Put Unix sockets into a separate folder with a short path, because the path of a Unix socket
    must be short.
    """
    with tempfile.TemporaryDirectory(prefix="h-") as short_folder:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short_folder)
        monkeypatch.setenv("HF_HUB_OFFLINE", "1")
        monkeypatch.chdir(tmp_path)
        write_homed_calibration(tmp_path / "c.toml", load_hand("jamia"))
        yield tmp_path


@pytest.fixture
def robot_options(work_folder):
    """Start a simulated hand at half the speed of real time, and yield the options of a controller for this hand."""
    scale = make_time_scale_options(TIME_SCALE)
    process = start_hand(work_folder / "hand.truth", "--hand", "jamia", "--scene", "none", *scale)
    yield ["--calibration", "c.toml", "--log", "run.mcap", *scale]
    end_process(process)
