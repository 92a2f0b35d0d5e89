"""Working folder, simulated hand and calibration for the processes of these tests."""

import tempfile

import pytest

from handctl.hand.load import load_hand
from tests.runtime.processes import BUS, LONG, SCALE, SHORT, end, scaled, start_hand, write_homed


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Change to an empty folder, with sockets in a folder that has a short path."""
    with tempfile.TemporaryDirectory(prefix="h-") as short:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short)
        monkeypatch.chdir(tmp_path)
        (tmp_path / "short.toml").write_text(SHORT)
        (tmp_path / "long.toml").write_text(LONG)
        yield tmp_path


@pytest.fixture
def processes():
    """Return a list of processes that are ended after the test."""
    running = []
    yield running
    for process in reversed(running):
        end(process)


@pytest.fixture
def scale(request, slower):
    """Return the options for the time scale. A module may set its own ``SCALE``."""
    return scaled(getattr(request.module, "SCALE", SCALE) * slower)


@pytest.fixture
def hand(place, processes, scale):
    """Start a slowed simulated hand on the bus and return its truth file."""
    processes.append(start_hand(place / "hand.truth", "--hand", "jamia", *scale))
    return place / "hand.truth"


@pytest.fixture
def calibrated(place):
    """Return the options for a hand that starts homed, with its calibration."""
    write_homed(place / "c.toml", load_hand("jamia"))
    return ("--hand", "jamia", "--bus", BUS, "--calibration", "c.toml")
