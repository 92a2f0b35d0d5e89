"""The fixed-rate loop: wait, drain, tick, send, record. The same loop in real time and in lockstep.

No catching up: a deadline that was missed is skipped, the tick number jumps, and the tick itself judges that. This
module holds the only broad ``except`` of the project: whatever goes wrong inside a tick, the drives are told to let go,
and asked whether they did, before the error travels on.
"""

import gc
import signal
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from types import FrameType
from typing import Generic, Protocol, TypeVar

from handctl.core.types import IoEvent, Mode, TickIn, TickOut
from handctl.drives.frame import Frame
from handctl.drives.records import Frames, frames_of, joined
from handctl.errors import REMOVE_POWER, PowerError
from handctl.handlers import handling
from handctl.runtime.clock import Clock
from handctl.runtime.mailbox import CUT, STOP

S = TypeVar("S")

Tick = Callable[[S, TickIn], tuple[S, TickOut]]
"""The pure function of one tick."""


CUT_TRIES, CUT_PAUSE_S = 20, 1e-3
"""How often the last cut is sent to an interface that refuses it, and the pause between: a frame takes 0.1 ms."""

CONFIRM_NS = 500_000_000
"""How long drives are asked after an error whether they are off; a heartbeat may come every 100 ms."""

KEPT = 1 << 18
"""Ticks whose lateness is kept in memory: 2 MiB, however long a run is; its memory may be locked."""


class LoopBus(Protocol):
    """What the loop asks of a bus; see ``runtime.buses.contract``."""

    def drain(self) -> Frames: ...
    def send(self, frames: Sequence[Frame]) -> int: ...
    def take_events(self) -> list[tuple[str, str, int]]: ...


@dataclass
class LoopStats:
    """What the loop did.

    Attributes:
        ticks: ticks run.
        missed: deadlines skipped.
        late_ns: lateness of the last ``KEPT`` ticks, in no order once there were more [ns]; the log has it of all.
        frames_tx, frames_rx: frames sent and received.
        refused: frames that the bus did not take.
        cpu_s: that this process computed while the loop ran [s].
    """

    ticks: int = 0
    missed: int = 0
    late_ns: "array[int]" = field(default_factory=lambda: array("q"))
    frames_tx: int = 0
    frames_rx: int = 0
    refused: int = 0
    cpu_s: float = 0.0


class Signals:
    """Signals that end a program, as requests: the first relaxes and stops, the second cuts.

    SIGHUP is one of them, or a hand would be left armed when a terminal goes; with ``nohup`` it stays ignored.
    """

    def __init__(self) -> None:
        self.count = 0
        self.seen = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.count += 1

    def take(self) -> tuple[str, ...]:
        """Requests for the signals since the last call."""
        if self.seen == self.count:
            return ()
        self.seen += 1
        return (STOP,) if self.seen == 1 else (CUT,)

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Receive the signals while the loop runs."""
        hangs_up = signal.getsignal(signal.SIGHUP) != signal.SIG_IGN
        with handling(self, signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hangs_up else [])):
            yield


def _keep_nothing(entry: TickIn, state: object) -> None:
    """Keep no state."""


@dataclass
class Loop(Generic[S]):
    """One run of the controller.

    Attributes:
        clock: real time or lockstep.
        period_ns: control period.
        buses: in the order of the hand's buses (one object may stand for all of them).
        tick: the pure function.
        cut: frames that take the torque away, built before the run.
        requests: what people and programs asked since the last call.
        host_events: what recorder and host reported since the last call.
        record: hands one tick to the recorder.
        keep: hands the state after a tick to the recorder now and then.
        show: called after each tick; draws now and then.
        let_go: tells the drives once more to disable, from the last state, the time [ns] and the frames since; what it
            returns: the state after that, frames to send, and the drives that have not said yet that they are off.
        urgent: what the ticks run in, and nothing before or after them.
    """

    clock: Clock
    period_ns: int
    buses: Sequence[LoopBus]
    tick: Tick[S]
    cut: Sequence[Frame]
    requests: Callable[[], tuple[str, ...]]
    host_events: Callable[[], list[IoEvent]]
    record: Callable[[TickIn, TickOut], None]
    show: Callable[[TickIn, TickOut], None]
    keep: Callable[[TickIn, S], None] = _keep_nothing
    let_go: Callable[[S, int, list[Frame]], tuple[S, tuple[Frame, ...], tuple[str, ...]]] | None = None
    urgent: Callable[[], AbstractContextManager[object]] = nullcontext
    stats: LoopStats = field(default_factory=LoopStats)
    _k: int = 0

    def run(self, state: S) -> S:
        """Run ticks until the hand is disarmed and done; the final state."""
        self._warm_up(state)
        gc.collect()
        gc.freeze()
        gc.disable()
        cpu_s = time.process_time()
        try:
            with self.urgent():
                self.clock.begin()
                for bus in self.buses:
                    bus.drain()
                return self._guarded(state)
        finally:
            gc.enable()
            gc.unfreeze()
            self.stats.cpu_s = time.process_time() - cpu_s

    def _guarded(self, state: S) -> S:
        """Run; on any error tell the drives to let go before it travels on.

        Raises:
            PowerError: from that error, if a drive did not say that it is off.
        """
        last = [state]
        try:
            return self._run(last)
        except Exception as error:
            left: tuple[str, ...] = ("nobody knows which, asking failed as well",)
            try:
                self._send_cut()
                left = self._still_on(last[0])
            finally:
                if left:
                    raise PowerError(f"{REMOVE_POWER}: not confirmed disabled: {', '.join(left)}") from error
            raise

    def _still_on(self, state: S) -> tuple[str, ...]:
        """Drives that may be on and do not say that they are off, however often they are asked."""
        if self.let_go is None:
            return ()
        left: tuple[str, ...] = ()
        for k in range(self._k + 1, self._k + 2 + CONFIRM_NS // self.period_ns):
            self.clock.wait(k)
            heard = [frame for bus in self.buses for frame in bus.drain()]
            state, frames, left = self.let_go(state, k * self.period_ns, heard)
            if not left:
                break
            self._send(frames)
        return left

    def _send_cut(self) -> None:
        """Cut on every bus; what finds a queue full of the last tick's commands goes out as soon as there is room."""
        alone = len(self.buses) == 1
        left = [(bus, [f for f in self.cut if f.bus == index or alone]) for index, bus in enumerate(self.buses)]
        for _ in range(CUT_TRIES):
            self._cut(left)
            if not any(frames for _, frames in left):
                return
            time.sleep(CUT_PAUSE_S)

    def _cut(self, left: list[tuple[LoopBus, list[Frame]]]) -> None:
        """Send on every bus, also behind one that fails, and keep what was not taken."""
        if not left:
            return
        (bus, frames), *others = left
        try:
            if frames:
                del frames[: bus.send(frames)]
        finally:
            self._cut(others)

    def _warm_up(self, state: S) -> None:
        """Run a tick for nothing, so that what is built or imported at first use does not make the first one late."""
        self.tick(state, TickIn(0, 0))

    def _run(self, last: list[S]) -> S:
        """Run from the last state to the end; what is in ``last`` is always of a tick that was whole."""
        k, mode = 0, Mode.SILENT
        while mode != Mode.DONE:
            self._k = k
            late = self.clock.wait(k)
            skipped = late // self.period_ns
            k += skipped
            entry = self._collect(k, late - skipped * self.period_ns)
            last[0], out = self.tick(last[0], entry)
            self._send(out.frames)
            self.record(entry, out)
            self.keep(entry, last[0])
            self._count(entry, skipped, late)
            self.show(entry, out)
            mode = out.mode
            k += 1
        return last[0]

    def _collect(self, k: int, late_ns: int) -> TickIn:
        parts: list[Frames] = []
        events = self.host_events()
        for bus in self.buses:
            parts.append(bus.drain())
            events += [IoEvent(*event) for event in bus.take_events()]
        frames = joined(parts)
        return TickIn(k, k * self.period_ns, late_ns, frames, tuple(events), self.requests())

    def _send(self, frames: Sequence[Frame]) -> None:
        if len(self.buses) == 1:
            accepted = self.buses[0].send(frames)
        else:
            records = frames_of(frames).records
            wires = records["bus"]
            shares = [Frames(records[wires == index]) for index in range(len(self.buses))]
            accepted = sum(bus.send(share) for bus, share in zip(self.buses, shares, strict=True))
        self.stats.frames_tx += accepted
        self.stats.refused += len(frames) - accepted

    def _count(self, entry: TickIn, skipped: int, late: int) -> None:
        stats = self.stats
        if stats.ticks < KEPT:
            stats.late_ns.append(late)
        else:
            stats.late_ns[stats.ticks % KEPT] = late
        stats.ticks += 1
        stats.missed += skipped
        stats.frames_rx += len(entry.frames)
