"""One controller after the other, each killed or stopped at a random instant beside a simulated hand that lives on.

A controller is a process of its own, forked from this one so that nothing has to be imported again; its recorder and
the simulator are processes as in any run. What became of the drives is read from the simulator's truth.
"""

import json
import os
import random
import signal
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from handctl.controller.bus_load import bus_loads
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.hand.load import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.calibration import load_calibration
from handctl.programs.grasp import TaskProgram
from handctl.report.truth import Truth, read_truth
from handctl.runtime.paths import faults_path, local_bus_path, run_dir
from handctl.session.plan import Plan, bus_specs
from handctl.session.run import make_controller, run_live
from handctl.session.tasks import load_task
from tests.runtime.processes import BUS, LONG, end, scaled, start_hand, write_homed

SYNC, RECORD = 0x080, 72
RATE_HZ = 500.0
WATCHDOG_MS = 50.0
"""What the hand file sets for the drives; after it and the decay of the current no torque may be left."""
DECAY_MS, LEAST_N_M, PULLS_N = 4.0, 1e-3, 8.0
LETTING_GO_S = 0.3
LATEST_S = 1.8
"""A run is disturbed at most so long after its first SYNC: while it arms, bends its fingers and holds them bent."""
PATIENCE_S = 60.0


class Killed(NamedTuple):
    """What one disturbed run left behind.

    Attributes:
        how: signal. before_ns, after_ns: between which it struck, on the simulator's clock.
        slipped_ns: time in which the simulator, drives and all, did not run from then on.
        heard: counts of the SYNCs on the bus. told: of those in the log.
        warning: what is wrong with the log as a file.
    """

    how: signal.Signals
    before_ns: int
    after_ns: int
    slipped_ns: int
    heard: bytes
    told: bytes
    warning: str


class Judged(NamedTuple):
    """One disturbed run before the truth.

    Attributes:
        run: it. pulled: whether a rope was under tension when it struck.
        driven: whether a motor made torque then. off_ms: until none did, from the instant before the signal.
        late_ms: the same, from the instant after it. tension: largest when the fingers have had time to open [N].
    """

    run: Killed
    pulled: bool
    driven: bool
    off_ms: float
    late_ms: float
    tension: float

    @property
    def safe(self) -> bool:
        """Whether the drives let go within their watchdog."""
        return self.late_ms <= WATCHDOG_MS + DECAY_MS

    @property
    def whole(self) -> bool:
        """Whether the log has every tick that was on the bus, but for one whose SYNC had just been sent."""
        heard, told = self.run.heard, self.run.told
        return not self.run.warning and len(heard) - len(told) in (0, 1) and heard.startswith(told)


class Range:
    """Where it is done: a simulator, and what every controller begins with."""

    def __init__(self, folder: Path, scale: float) -> None:
        self.folder, self.scale = folder, scale
        hand = load_hand("jamia")
        task, calibration = folder / "long.toml", folder / "c.toml"
        task.write_text(LONG)
        write_homed(calibration, hand)
        load = tuple(one.at(RATE_HZ) for one in bus_loads(hand))
        self.plan = Plan(hand, Gains(), RATE_HZ, load, bus_specs(hand, [BUS]), time_scale=scale, clear=True)
        self.controller: Controller = make_controller(
            self.plan, TaskProgram(load_task(task)), load_calibration(calibration, hand), arm_at_once=True
        )
        self.truth = folder / "hand.truth"
        self.simulator = start_hand(self.truth, "--hand", "jamia", *scaled(scale))

    def now_ns(self) -> tuple[int, int]:
        """The simulator's time, and how much of it nothing happened in."""
        own = run_dir() / f"kills-{os.getpid()}"
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
            asking.bind(str(own))
            asking.settimeout(PATIENCE_S)
            asking.sendto(b'{"list": true}', str(faults_path(BUS)))
            answer = json.loads(asking.recv(1 << 16))
        own.unlink()
        return int(answer["t_ns"]), int(answer["slip_ns"])

    def start(self, log: Path) -> int:
        """Fork a controller; its process number."""
        child = os.fork()
        if child:
            return child
        code = 70
        try:
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, 1)
            os.dup2(nothing, 2)
            code = int(run_live(self.plan, self.controller, log).exit)
        finally:
            os._exit(code)

    def disturb(self, number: int, how: signal.Signals, delay_s: float) -> Killed:
        """Start a controller and strike some time [s] after its first SYNC."""
        log = self.folder / f"{number}.mcap"
        with Listener() as listener:
            child = self.start(log)
            try:
                listener.until_heard(child)
                listener.wait(delay_s / self.scale)
                before_ns, slip_ns = self.now_ns()
                os.kill(child, how)
                after_ns, _ = self.now_ns()
                listener.wait((WATCHDOG_MS * 1e-3 + LETTING_GO_S) / self.scale)
                slipped_ns = self.now_ns()[1] - slip_ns
                if how == signal.SIGSTOP:
                    os.kill(child, signal.SIGCONT)
                ended(child, listener)
            finally:
                with suppress(ProcessLookupError, ChildProcessError):
                    os.kill(child, signal.SIGKILL)
                    os.waitpid(child, 0)
            listener.wait(0.0)
        warning, logged = whole(log)
        log.unlink()
        return Killed(how, before_ns, after_ns, slipped_ns, bytes(listener.heard), logged, warning)

    def judged(self, runs: list[Killed]) -> list[Judged]:
        """Hold the runs against the truth of the simulator, which has ended."""
        truth = read_truth(self.truth)
        return [judge(truth, run) for run in runs]


class Listener:
    """Another node on the bus: the counts of all SYNCs that the host sent."""

    def __init__(self) -> None:
        self.heard, self.held = bytearray(), b""

    def __enter__(self) -> "Listener":
        self.link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.link.connect(str(local_bus_path(BUS.partition(":")[2])))
        self.link.setblocking(False)
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()

    def wait(self, seconds: float) -> None:
        """Wait, and take in what comes, so that nothing is lost on the way here."""
        until = time.monotonic() + seconds
        while True:
            self._take()
            left = until - time.monotonic()
            if left <= 0.0:
                return
            time.sleep(min(left, 0.02))

    def _take(self) -> None:
        with suppress(BlockingIOError):
            while data := self.link.recv(1 << 18):
                self.held += data
        whole_ones = len(self.held) // RECORD * RECORD
        for at in range(0, whole_ones, RECORD):
            if int.from_bytes(self.held[at : at + 4], "little") == SYNC:
                self.heard.append(self.held[at + 8])
        self.held = self.held[whole_ones:]

    def until_heard(self, child: int) -> None:
        """Wait for the first SYNC of a controller."""
        until = time.monotonic() + PATIENCE_S
        while not self.heard:
            assert os.waitpid(child, os.WNOHANG) == (0, 0), "the controller ended by itself"
            assert time.monotonic() < until, "no SYNC"
            self.wait(0.004)


def ended(child: int, listener: Listener) -> None:
    """Wait for a process that must end by itself; ask it to, if it does not."""
    until = time.monotonic() + 3.0
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        if time.monotonic() > until:
            os.kill(child, signal.SIGTERM)
            until += PATIENCE_S
        listener.wait(0.02)


def whole(path: Path) -> tuple[str, bytes]:
    """What is wrong with a log once its recorder has ended, and the counts of the SYNCs of its ticks."""
    until = time.monotonic() + 20.0
    while True:
        with RunLog(path) as log:
            if not log.warning or time.monotonic() > until:
                frames = (frame for tick in log.ticks() for frame in tick.frames)
                return log.warning, bytes(frame.data[0] for frame in frames if frame.can_id == SYNC)
        time.sleep(0.05)


def judge(truth: Truth, run: Killed) -> Judged:
    """What the drives did."""
    torque = truth.values[:, [i for i, name in enumerate(truth.columns) if name.startswith("torque/")]]
    tension = truth.values[:, [i for i, name in enumerate(truth.columns) if name.startswith("tension/")]]
    begin = np.searchsorted(truth.t_ns, run.before_ns)
    over = np.searchsorted(truth.t_ns, run.after_ns + run.slipped_ns + int(LETTING_GO_S * 1e9))
    driven = np.flatnonzero(np.abs(torque[begin:over]).max(axis=1) > LEAST_N_M)
    last_ns = int(truth.t_ns[begin + driven[-1]]) - run.slipped_ns if len(driven) else run.before_ns
    return Judged(
        run,
        pulled=bool(tension[begin].max() > PULLS_N),
        driven=bool(np.abs(torque[begin]).max() > LEAST_N_M),
        off_ms=(last_ns - run.before_ns) * 1e-6,
        late_ms=(last_ns - run.after_ns) * 1e-6,
        tension=float(tension[min(over, len(tension) - 1)].max()),
    )


def kills(folder: Path, times: int, seed: int, scale: float) -> list[Judged]:
    """Disturb so many controllers, killed and stopped in turn, beside one simulator."""
    chance, place = random.Random(seed), Range(folder, scale)
    runs: list[Killed] = []
    try:
        for number in range(times):
            how = signal.SIGKILL if number % 2 == 0 else signal.SIGSTOP
            runs.append(place.disturb(number, how, chance.uniform(0.0, LATEST_S)))
    finally:
        end(place.simulator)
    return place.judged(runs)


BATCH = 25
"""Controllers beside one simulator; then its truth is read and thrown away."""


def batches(times: int, seed: int, scale: float) -> Iterator[list[Judged]]:
    """Disturb so many controllers, some beside each simulator."""
    for first in range(0, times, BATCH):
        with tempfile.TemporaryDirectory(prefix="h-") as folder:
            os.environ["HANDCTL_RUN_DIR"] = folder
            yield kills(Path(folder), min(BATCH, times - first), seed + first, scale)


def told(found: list[Judged]) -> str:
    """A line about all of them."""
    safe, whole_ones = sum(one.safe for one in found), sum(one.whole for one in found)
    pulled, driven = sum(one.pulled for one in found), sum(one.driven for one in found)
    worst, tension = max(one.off_ms for one in found), max(one.tension for one in found)
    return (
        f"{len(found)} controllers: {safe} times without torque in time, at most {worst:.1f} ms after the signal; "
        f"{whole_ones} logs whole; {driven} struck under torque, {pulled} while a rope was taut; "
        f"at most {tension:.1f} N left 0.3 s later"
    )
