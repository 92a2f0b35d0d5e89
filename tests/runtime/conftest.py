"""Where the processes of these tests work."""

import tempfile

import pytest

from handctl.hand.load import load_hand
from tests.runtime.processes import BUS, LONG, SCALE, SHORT, end, scaled, start_hand, write_homed


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder to work in, a short one for sockets."""
    with tempfile.TemporaryDirectory(prefix="h-") as short:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short)
        monkeypatch.chdir(tmp_path)
        (tmp_path / "short.toml").write_text(SHORT)
        (tmp_path / "long.toml").write_text(LONG)
        yield tmp_path


@pytest.fixture
def processes():
    """Processes to be ended, whatever happens."""
    running = []
    yield running
    for process in reversed(running):
        end(process)


@pytest.fixture
def scale(request, slower):
    """Words for time as it passes for the hand; a module may have a ``SCALE`` of its own."""
    return scaled(getattr(request.module, "SCALE", SCALE) * slower)


@pytest.fixture
def hand(place, processes, scale):
    """A slowed simulated hand on the bus, and its truth."""
    processes.append(start_hand(place / "hand.truth", "--hand", "jamia", *scale))
    return place / "hand.truth"


@pytest.fixture
def calibrated(place):
    """Words for a hand that starts homed: nothing to tare, nothing to zero."""
    write_homed(place / "c.toml", load_hand("jamia"))
    return ("--hand", "jamia", "--bus", BUS, "--calibration", "c.toml")
