"""A controller that is killed at a random instant: its log ends with its last tick, and the drives let go alone."""

import os
import random
import socket
import tempfile
import threading
import time

import numpy as np
import pytest

from handctl.hand.description import load_hand
from handctl.log.reader import RunLog
from handctl.report.truth import read_truth
from handctl.runtime.places import local_bus_path
from tests.runtime.processes import BUS, end, start_hand, start_handctl
from tests.runtime.test_process import LONG, write_calibration

pytestmark = pytest.mark.realtime
TIMES = 100 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 8
SCALE = 0.7
SYNC, RECORD = 0x080, 72
WATCHDOG_S = 0.05
LETTING_GO_S = 0.3
"""Time for the springs to open the fingers once the drives have no torque."""


class Listener:
    """Another node on the bus: the counts of all SYNCs that the host sent."""

    def __init__(self):
        self.counts = []
        self.link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.link.connect(str(local_bus_path(BUS.partition(":")[2])))
        self.thread = threading.Thread(target=self.listen, daemon=True)
        self.thread.start()

    def listen(self):
        held = b""
        while data := self.link.recv(1 << 16):
            held += data
            whole = len(held) // RECORD * RECORD
            for at in range(0, whole, RECORD):
                if int.from_bytes(held[at : at + 4], "little") == SYNC:
                    self.counts.append(held[at + 8])
            held = held[whole:]

    @property
    def seen(self):
        return len(self.counts)


@pytest.fixture
def place(tmp_path, monkeypatch):
    with tempfile.TemporaryDirectory(prefix="h-") as short:
        monkeypatch.setenv("HANDCTL_RUN_DIR", short)
        monkeypatch.chdir(tmp_path)
        (tmp_path / "long.toml").write_text(LONG)
        write_calibration(tmp_path / "c.toml", load_hand("jamia"))
        yield tmp_path


def whole_log(path):
    """The log once its recorder has ended."""
    until = time.monotonic() + 10.0
    while True:
        with RunLog(path) as run:
            if not run.warning or time.monotonic() > until:
                return run.warning
        time.sleep(0.05)


def logged_syncs(path):
    """The counts of the SYNCs of all ticks of a log."""
    with RunLog(path) as run:
        return [frame.data[0] for tick in run.ticks() for frame in tick.frames if frame.can_id == SYNC]


def kill_one(place, number, delay_s):
    """Kill a run some time after its first SYNC; when [ns, scaled], the SYNCs on the bus, and its log."""
    listener = Listener()
    log = place / f"{number}.mcap"
    words = ("--hand", "jamia", "--bus", BUS, "--calibration", "c.toml", "--task", "long.toml", "--log", str(log))
    process = start_handctl("run", *words, "--json", "--time-scale", str(SCALE))
    try:
        until = time.monotonic() + 60.0
        while not listener.seen:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < until
            time.sleep(0.001)
        time.sleep(delay_s)
        assert process.poll() is None, process.communicate()
    finally:
        process.kill()
        process.wait()
    killed_ns = int(time.monotonic_ns() * SCALE)
    process.communicate()
    time.sleep((WATCHDOG_S + LETTING_GO_S) / SCALE)
    assert not whole_log(log)
    return killed_ns, listener.counts, log


def tensions_after(truth_file, killed_ns):
    """Largest true tension when the controller died, and when the drives should have let go [N]."""
    truth = read_truth(truth_file)
    tensions = truth.values[:, [i for i, name in enumerate(truth.columns) if name.startswith("tension/")]].max(axis=1)
    at = np.searchsorted(truth.t_ns, killed_ns)
    gone = np.searchsorted(truth.t_ns, killed_ns + int((WATCHDOG_S + LETTING_GO_S) * 1e9))
    return tensions[at], tensions[min(gone, len(tensions) - 1)]


def test_the_log_has_every_tick_and_the_drives_let_go(place):
    """The tick in progress, whose SYNC is out already, is the only one that may be missing."""
    chance = random.Random(20261121)
    pulling = ticks = 0
    for number in range(TIMES):
        file = place / f"{number}.truth"
        simulated = start_hand(file, "--hand", "jamia", "--time-scale", str(SCALE))
        try:
            killed_ns, counts, log = kill_one(place, number, chance.uniform(0.0, 2.5))
        finally:
            end(simulated)
        logged = logged_syncs(log)
        assert len(counts) - len(logged) in (0, 1), f"kill {number}"
        assert logged == counts[: len(logged)], f"kill {number}"
        ticks += len(counts)
        log.unlink()
        before, after = tensions_after(file, killed_ns)
        pulling += before > 8.0
        assert after < 5.0
    assert pulling >= TIMES // 5, "some were killed while they pulled"
    assert ticks > 100 * TIMES
