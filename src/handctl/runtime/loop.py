"""The control loop with a fixed rate.

In each tick, the loop waits for the deadline, receives frames, and begins the tick. In the middle
of a tick, the loop reads requests and streamed targets, and sends commands. At the end of a tick,
the loop concludes and records the tick. The same loop runs in real time and in lockstep.

If a tick is missed, the loop never executes it later. After missed deadlines, the loop skips the
numbers of the missed ticks. In the next executed tick, the controller decides whether the missing
tick numbers are a fault. Only this module of the project catches exceptions of every kind. After
any error inside a tick, the loop disables the drives, and polls them until they report that they
are disabled. After that, the loop raises the same error again.
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

from handctl.core.tick_types import HandMode, IoEvent, TickIn, TickOut, TickRequest
from handctl.drives.frame import Frame
from handctl.drives.frame_records import Frames, concatenate_frames, frames_as_records
from handctl.errors import REMOVE_POWER, PowerError
from handctl.runtime.clocks.real_clock import TickClock
from handctl.runtime.mailbox import CUT_REQUEST, STOP_REQUEST
from handctl.signal_handlers import installed_handler

S = TypeVar("S")
T = TypeVar("T", covariant=True)


class TickInProgress(Protocol[T]):
    """Interface of a tick that has begun, with one method for each remaining step.

    The control loop calls ``decide``, ``command`` and ``conclude``, in this order. See
    ``controller.tick.TickInProgress``.
    """

    @property
    def state(self) -> T:
        """Return the state of the controller after the executed steps of the tick."""
        ...

    def decide(self, requests: tuple[TickRequest, ...]) -> None:
        """Apply the requests of operators and programs, and choose the goals of the hand."""
        ...

    def command(self, targets: tuple[TickRequest, ...]) -> Sequence[Frame]:
        """Apply the targets of streams, and return the frames to send."""
        ...

    def conclude(self) -> tuple[T, TickOut]:
        """Return the state of the controller after the tick, and the output of the tick."""
        ...


TORQUE_CUT_ATTEMPTS = 20
"""Number of attempts to send the frames of the torque cut after an error, if an interface refuses these frames."""
TORQUE_CUT_RETRY_PAUSE_S = 1e-3
"""Pause between two attempts to send the torque cut [s]. A frame takes 0.1 ms on the wire."""

DISABLE_CONFIRMATION_TIMEOUT_NS = 500_000_000
"""Longest time for which the drives are polled after an error [ns].

The heartbeat of a drive can come as rarely as every 100 ms.
"""

LATENESS_RING_TICKS = 1 << 18
"""Number of ticks whose lateness stays in memory.

The number of stored ticks is limited, because their 2 MiB of memory may be locked.
"""


class LoopBus(Protocol):
    """Interface of a bus, as used by the loop. See ``runtime.buses.contract``."""

    def drain(self) -> Frames:
        """Return the frames received since the last call."""
        ...

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames, and return the number of frames that the bus has accepted."""
        ...

    def take_events(self) -> list[tuple[str, str, int]]:
        """Return the events of the bus since the last call."""
        ...


@dataclass
class LoopStats:
    """Statistics about the ticks of a run.

    Attributes:
        ticks: number of executed ticks.
        missed_ticks: number of skipped deadlines.
        tick_lateness_ns: lateness of the last ``LATENESS_RING_TICKS`` ticks [ns]. In a run with
            more ticks, the values are not in order. The log contains the lateness of all ticks.
        frames_tx: number of sent frames.
        frames_rx: number of received frames.
        refused_frames: number of frames refused by the bus.
        cpu_s: processor time of this process during the loop [s].
    """

    ticks: int = 0
    missed_ticks: int = 0
    tick_lateness_ns: "array[int]" = field(default_factory=lambda: array("q"))
    frames_tx: int = 0
    frames_rx: int = 0
    refused_frames: int = 0
    cpu_s: float = 0.0


class StopSignals:
    """Signals that end a program (SIGINT, SIGTERM, SIGHUP), converted to requests to the controller.

    When the process receives its first signal, the controller relaxes the hand and ends the run.
    Each later signal cuts the torque of the motors.

    SIGHUP is included, because a closed terminal would otherwise leave the hand armed. Under
    ``nohup``, SIGHUP stays ignored.

    Attributes:
        received_count: number of received signals.
        converted_count: number of signals that ``take_request`` has already converted to requests.
    """

    def __init__(self) -> None:
        """Start with no signal received."""
        self.received_count = 0
        self.converted_count = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Count a received signal. The operating system calls this object as the signal handler of the process."""
        self.received_count += 1

    def take_request(self) -> tuple[str, ...]:
        """Return the request for the oldest unread signal.

        If there is no unread signal, return an empty tuple. Each tick gets at most one request from
        a signal.
        """
        if self.converted_count == self.received_count:
            return ()
        self.converted_count += 1
        return (STOP_REQUEST,) if self.converted_count == 1 else (CUT_REQUEST,)

    @contextmanager
    def install_handlers(self) -> Iterator[None]:
        """Install the signal handler during a ``with`` block."""
        is_sighup_ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        with installed_handler(
            self, signal.SIGINT, signal.SIGTERM, *([] if is_sighup_ignored else [signal.SIGHUP])
        ):
            yield


def _skip_snapshot(tick_input: TickIn, state: object) -> None:
    """Do nothing with the state after a tick. A run that records no snapshots calls this function."""


def _skip_publication(
    tick_input: TickIn, tick_output: TickOut, state: object, sent_ns: int
) -> None:
    """Do nothing with a tick. A run that publishes no ticks to other programs calls this function."""


@dataclass
class ControlLoop(Generic[S]):
    """Fixed-rate loop of one run of the controller.

    Attributes:
        clock: clock of the run, in real time or in lockstep.
        period_ns: control period [ns].
        buses: buses in the order of the hand file. In lockstep, a single object stands for all
            buses of a hand.
        begin_tick: function that begins a tick, given the last state of the controller and the
            received frames.
        torque_cut_frames: frames that remove the torque of all motors, which are built before the run.
        take_requests: function that returns the requests of operators and programs since the last
            call of the function.
        take_host_events: function that returns the events of the recorder and the host since the
            last call of the function.
        record_tick: function that passes each tick to the recorder.
        record_snapshot: function that passes the state after a tick to the recorder. This function
            skips most ticks.
        show_tick: function that shows a tick to the operator and to watching programs. This
            function skips most ticks.
        publish_tick: function that passes the state after a tick to programs that observe the run, with
            the time at which the commands were sent [ns of CLOCK_MONOTONIC].
        disable_drives: function that disables all drives. The arguments are the last state, the
            time [ns], and the frames received since the last state. The function returns the next
            state, the frames to send, and the names of the drives that have not reported that they
            are off.
        tick_priority: function that returns a context manager, such as real-time priority. The loop
            executes only the ticks of the run in this context.
        take_targets: function that returns the streamed targets since its last call. The loop calls
            this function as late as possible in a tick, so that a target waits as briefly as
            possible.
        stats: statistics of the run.
    """

    clock: TickClock
    period_ns: int
    buses: Sequence[LoopBus]
    begin_tick: Callable[[S, TickIn], TickInProgress[S]]
    torque_cut_frames: Sequence[Frame]
    take_requests: Callable[[], tuple[TickRequest, ...]]
    take_host_events: Callable[[], list[IoEvent]]
    record_tick: Callable[[TickIn, TickOut], None]
    show_tick: Callable[[TickIn, TickOut], None]
    record_snapshot: Callable[[TickIn, S], None] = _skip_snapshot
    publish_tick: Callable[[TickIn, TickOut, S, int], None] = _skip_publication
    disable_drives: (
        Callable[[S, int, list[Frame]], tuple[S, tuple[Frame, ...], tuple[str, ...]]] | None
    ) = None
    tick_priority: Callable[[], AbstractContextManager[object]] = nullcontext
    take_targets: Callable[[], tuple[TickRequest, ...]] = tuple
    stats: LoopStats = field(default_factory=LoopStats)
    _k: int = 0
    _rehearsed_inputs: tuple[S, TickIn] | None = None

    def rehearse_tick(self) -> Iterator[None]:
        """Execute the first two steps of the last tick again, and yield between the steps.

        The steps begin and decide use most of the code and the data of a tick, see
        ``clocks.rehearsal``. A rehearsal includes neither requests nor commands, and the result of
        the rehearsal is discarded.
        """
        if self._rehearsed_inputs:
            tick = self.begin_tick(*self._rehearsed_inputs)
            yield
            tick.decide(())

    def run(self, state: S) -> S:
        """Run ticks until the run has ended and the hand is disarmed.

        Return the final state of the controller.
        """
        self._warm_up(state)
        gc.collect()  # a garbage collection during the run could make a tick late
        gc.freeze()
        gc.disable()
        cpu_s = time.process_time()
        try:
            with self.tick_priority():
                self.clock.start()
                # Frames that were received before the run do not belong to any tick.
                for bus in self.buses:
                    bus.drain()
                return self._run_and_disable_on_error(state)
        finally:
            gc.enable()
            gc.unfreeze()
            self.stats.cpu_s = time.process_time() - cpu_s

    def _run_and_disable_on_error(self, state: S) -> S:
        """Run the ticks of the run. After any error, disable the drives and raise the error again.

        Raises:
            PowerError: after an error, a drive has not reported that it is disabled. The error in
                the tick is the cause of this exception.
        """
        last_state = [state]
        try:
            return self._run(last_state)
        except Exception as error:
            unconfirmed_drives: tuple[str, ...] = (
                "the drives are unknown, because their query failed as well",
            )
            try:
                self._send_torque_cut()
                unconfirmed_drives = self._poll_until_disabled(last_state[0])
            finally:
                if unconfirmed_drives:
                    raise PowerError(
                        f"{REMOVE_POWER}: not confirmed disabled: {', '.join(unconfirmed_drives)}"
                    ) from error
            raise

    def _poll_until_disabled(self, state: S) -> tuple[str, ...]:
        """Disable all drives after an error.

        Poll the drives until all of them report that they are disabled, but no longer than
        DISABLE_CONFIRMATION_TIMEOUT_NS. Return the names of the drives that have not reported that
        they are disabled.
        """
        if self.disable_drives is None:
            return ()
        unconfirmed_drives: tuple[str, ...] = ()
        for k in range(
            self._k + 1, self._k + 2 + DISABLE_CONFIRMATION_TIMEOUT_NS // self.period_ns
        ):
            self.clock.wait(k)
            received_frames = [frame for bus in self.buses for frame in bus.drain()]
            state, frames, unconfirmed_drives = self.disable_drives(
                state, k * self.period_ns, received_frames
            )
            if not unconfirmed_drives:
                break
            self._send(frames)
        return unconfirmed_drives

    def _send_torque_cut(self) -> None:
        """Send, on every bus, the frames that remove the torque of the motors.

        If the full queue of a bus refuses frames, the loop sends the refused frames again.
        """
        is_single_bus = len(self.buses) == 1
        unsent_frames = [
            (bus, [f for f in self.torque_cut_frames if f.bus == index or is_single_bus])
            for index, bus in enumerate(self.buses)
        ]
        for _ in range(TORQUE_CUT_ATTEMPTS):
            self._send_torque_cut_once(unsent_frames)
            if not any(frames for _, frames in unsent_frames):
                return
            time.sleep(TORQUE_CUT_RETRY_PAUSE_S)

    def _send_torque_cut_once(self, unsent_frames: list[tuple[LoopBus, list[Frame]]]) -> None:
        """Send the frames in ``unsent_frames`` on their buses, and remove the accepted frames from ``unsent_frames``.

        If one bus raises an exception, the frames are still sent on the other buses.
        """
        if not unsent_frames:
            return
        (bus, frames), *other_frames = unsent_frames
        try:  # the recursion in ``finally`` sends on the other buses before the error is raised
            if frames:
                del frames[: bus.send(frames)]
        finally:
            self._send_torque_cut_once(other_frames)

    def _warm_up(self, state: S) -> None:
        """Execute a tick before the run, and discard the result.

        The discarded tick imports and creates everything that a tick needs for the first time.
        Without the discarded tick, the first tick of the run would be late.
        """
        tick = self.begin_tick(state, TickIn(0, 0))
        tick.decide(())
        tick.command(())
        tick.conclude()

    def _run(self, last_state: list[S]) -> S:
        """Run ticks until the end of the run, beginning with the state in ``last_state``.

        ``last_state`` has a single entry, which is the state after the last commands. After an
        error, the loop disables the drives, beginning with the state in ``last_state``.
        """
        k = 0
        mode = HandMode.SILENT
        while mode != HandMode.DONE:
            self._k = k
            late_ns = self.clock.wait(k)
            # Ticks that were missed are skipped, and are not executed later.
            skipped_ticks = late_ns // self.period_ns
            k += skipped_ticks
            self._k = k
            tick_input = self._collect_tick_input(k, late_ns - skipped_ticks * self.period_ns)
            tick = self.begin_tick(last_state[0], tick_input)
            self._rehearsed_inputs = last_state[0], tick_input
            requests = self.take_requests()
            tick.decide(requests)
            targets = self.take_targets()
            if requests or targets:
                tick_input = tick_input._replace(requests=requests + targets)
            frames = tick.command(targets)
            # After an error, every drive that may have received an enable command must report that
            # it is disabled. Therefore the loop stores the state before it sends the commands that
            # belong to this state.
            last_state[0] = tick.state
            self._send(frames)
            sent_ns = time.monotonic_ns()
            last_state[0], tick_output = tick.conclude()
            self.publish_tick(tick_input, tick_output, last_state[0], sent_ns)
            self.record_tick(tick_input, tick_output)
            self.record_snapshot(tick_input, last_state[0])
            self._count_tick(tick_input, skipped_ticks, late_ns)
            self.show_tick(tick_input, tick_output)
            mode = tick_output.mode
            k += 1
        return last_state[0]

    def _collect_tick_input(self, k: int, lateness_ns: int) -> TickIn:
        """Return the inputs of a tick: the frames and the events since the last tick."""
        frame_batches: list[Frames] = []
        events = self.take_host_events()
        for bus in self.buses:
            frame_batches.append(bus.drain())
            if bus_events := bus.take_events():
                events += [IoEvent(*event) for event in bus_events]
        frames = concatenate_frames(frame_batches)
        return TickIn(k, k * self.period_ns, lateness_ns, frames, tuple(events))

    def _send(self, frames: Sequence[Frame]) -> None:
        """Send each frame on its bus, and count the accepted and the refused frames."""
        if len(self.buses) == 1:
            accepted = self.buses[0].send(frames)
        else:
            frame_batch = frames_as_records(frames)
            bus_indices = frame_batch.records["bus"]
            frames_by_bus = [
                Frames(frame_batch.rows[bus_indices == index]) for index in range(len(self.buses))
            ]
            accepted = sum(
                bus.send(frames_of_bus)
                for bus, frames_of_bus in zip(self.buses, frames_by_bus, strict=True)
            )
        self.stats.frames_tx += accepted
        self.stats.refused_frames += len(frames) - accepted

    def _count_tick(self, tick_input: TickIn, skipped_ticks: int, lateness_ns: int) -> None:
        """Count a tick in the statistics, and store the lateness of the tick."""
        stats = self.stats
        if stats.ticks < LATENESS_RING_TICKS:
            stats.tick_lateness_ns.append(lateness_ns)
        else:
            stats.tick_lateness_ns[stats.ticks % LATENESS_RING_TICKS] = lateness_ns
        stats.ticks += 1
        stats.missed_ticks += skipped_ticks
        stats.frames_rx += len(tick_input.frames)
