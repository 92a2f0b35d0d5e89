"""Test the control loop with a scripted clock.

The loop skips missed ticks, loses no frame, and disables the drives after every error.
"""

import gc
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from handctl.core.tick_types import HandMode, IoEvent, TickIn, TickOut, TickRequest
from handctl.drives.frame import Frame
from handctl.drives.frame_records import Frames, frames_as_records
from handctl.errors import PowerError
from handctl.runtime import loop
from handctl.runtime.loop import ControlLoop

PERIOD_NS = 1_000_000
TORQUE_CUT_FRAMES = (Frame(1, b"\xfd"), Frame(2, b"\xfd", bus=1))


@dataclass
class ScriptedClock:
    """A clock that records all waits of the control loop.

    ``late`` contains the delays of the first waits [ns]. All later waits of the clock end in time.
    """

    late: list[int] = field(default_factory=list)
    waited_ticks: list[int] = field(default_factory=list)
    began: int = 0

    def start(self) -> None:
        self.began += 1

    def wait(self, tick_index: int) -> int:
        self.waited_ticks.append(tick_index)
        return self.late.pop(0) if self.late else 0

    def now_ns(self) -> int:
        return 0

    def clock_statistics(self) -> dict[str, str]:
        return {}


@dataclass
class FakeBus:
    """A bus that delivers the given frames in each tick.

    One call of ``send`` accepts at most ``capacity`` frames.
    """

    index: int = 0
    capacity: int = 1000
    frames_by_tick: list[list[Frame]] = field(default_factory=list)
    sent: list[tuple[Frame, ...]] = field(default_factory=list)
    pending_events: list[tuple[str, str, int]] = field(default_factory=list)
    drain_count: int = 0

    def drain(self) -> Frames:
        self.drain_count += 1
        return frames_as_records(self.frames_by_tick.pop(0) if self.frames_by_tick else ())

    def send(self, frames: Sequence[Frame]) -> int:
        self.sent.append(tuple(frames[: self.capacity]))
        return min(len(frames), self.capacity)

    def take_events(self) -> list[tuple[str, str, int]]:
        events = self.pending_events
        self.pending_events = []
        return events


@dataclass
class FakeControllerTick:
    """Fake controller tick, whose method ``command`` executes the whole tick."""

    tick: Callable[[int, TickIn], tuple[int, TickOut]]
    state: int
    tick_input: TickIn
    requests: tuple[TickRequest, ...] = ()
    result: tuple[int, TickOut] | None = None

    def decide(self, requests: tuple[TickRequest, ...]) -> None:
        self.requests = requests

    def command(self, targets: tuple[TickRequest, ...]) -> Sequence[Frame]:
        self.result = self.tick(
            self.state, self.tick_input._replace(requests=self.requests + targets)
        )
        self.state = self.result[0]
        return self.result[1].frames

    def conclude(self) -> tuple[int, TickOut]:
        assert self.result
        return self.result


@dataclass
class RecordedControlLoop:
    """A control loop that runs a few ticks. The test records all calls that the loop makes."""

    ticks: int = 5
    clock: ScriptedClock = field(default_factory=ScriptedClock)
    buses: list[FakeBus] = field(default_factory=lambda: [FakeBus()])
    frames: tuple[Frame, ...] = ()
    tick_hook: Callable[[TickIn], None] = lambda tick_input: None
    requests: list[tuple[str, ...]] = field(default_factory=list)
    host: list[list[IoEvent]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.tick_inputs: list[TickIn] = []
        self.recorded_ticks: list[tuple[TickIn, TickOut]] = []
        self.shown: list[tuple[TickIn, TickOut]] = []
        self.loop: ControlLoop[int] = ControlLoop(
            self.clock, PERIOD_NS, self.buses,
            lambda state, tick_input: FakeControllerTick(self.tick, state, tick_input), TORQUE_CUT_FRAMES,
            lambda: self.requests.pop(0) if self.requests else (),
            lambda: self.host.pop(0) if self.host else [],
            lambda tick_input, out: self.recorded_ticks.append((tick_input, out)),
            lambda tick_input, out: self.shown.append((tick_input, out)),
        )  # fmt: skip

    def tick(self, state: int, tick_input: TickIn) -> tuple[int, TickOut]:
        self.tick_inputs.append(tick_input)
        self.tick_hook(tick_input)
        done = state + 1 >= self.ticks
        mode = HandMode.DONE if done else HandMode.ACTIVE
        return state + 1, TickOut(self.frames, mode, "", 0, None, (), b"")  # type: ignore[arg-type]

    def go(self) -> int:
        return self.loop.run(0)


def test_ticks_follow_one_another_at_their_times() -> None:
    run = RecordedControlLoop()
    assert run.go() == 5
    assert [tick_input.k for tick_input, _ in run.recorded_ticks] == [0, 1, 2, 3, 4]
    assert [tick_input.t_ns for tick_input, _ in run.recorded_ticks] == [
        k * PERIOD_NS for k in range(5)
    ]
    assert run.clock.waited_ticks == [0, 1, 2, 3, 4]
    assert run.clock.began == 1
    assert run.shown == run.recorded_ticks
    assert (run.loop.stats.ticks, run.loop.stats.missed_ticks) == (5, 0)


def test_the_warm_up_tick_has_no_effect() -> None:
    """Before the clock starts, the loop runs one tick to warm up.

    The warm-up tick sends and records nothing, and the loop discards the state that the warm-up
    tick returns.
    """
    run = RecordedControlLoop(frames=(Frame(7, b""),))
    run.go()
    assert len(run.tick_inputs) == 6
    assert run.tick_inputs[0] == TickIn(0, 0)
    assert len(run.recorded_ticks) == 5
    assert len(run.buses[0].sent) == 5


def test_only_ticks_run_with_realtime_priority() -> None:
    run = RecordedControlLoop()
    is_realtime = [False]

    @contextmanager
    def record_realtime_priority() -> Iterator[None]:
        is_realtime[0] = True
        yield
        is_realtime[0] = False

    realtime_in_ticks: list[bool] = []
    run.loop.tick_priority = record_realtime_priority
    run.tick_hook = lambda tick_input: realtime_in_ticks.append(is_realtime[0])
    run.go()
    assert realtime_in_ticks + is_realtime == [False, True, True, True, True, True, False], (
        "the first value is of the warm-up"
    )


@pytest.mark.parametrize(
    ("lateness_by_tick", "executed_ticks", "missed_ticks", "expected_lateness_ns"),
    [
        ([0, PERIOD_NS - 1], [0, 1, 2, 3], 0, [0, PERIOD_NS - 1, 0, 0]),
        ([0, PERIOD_NS], [0, 2, 3, 4], 1, [0, 0, 0, 0]),
        ([0, 3 * PERIOD_NS + 5], [0, 4, 5, 6], 3, [0, 5, 0, 0]),
        ([2 * PERIOD_NS, PERIOD_NS + 1, 0, 7], [2, 4, 5, 6], 3, [0, 1, 0, 7]),
        ([0, 10**9], [0, 1001, 1002, 1003], 1000, [0, 0, 0, 0]),
    ],
)
def test_missed_deadlines_are_skipped_and_counted_never_caught_up(
    lateness_by_tick: list[int],
    executed_ticks: list[int],
    missed_ticks: int,
    expected_lateness_ns: list[int],
) -> None:
    run = RecordedControlLoop(ticks=4, clock=ScriptedClock(list(lateness_by_tick)))
    run.go()
    assert [tick_input.k for tick_input, _ in run.recorded_ticks] == executed_ticks
    assert [tick_input.t_ns for tick_input, _ in run.recorded_ticks] == [
        k * PERIOD_NS for k in executed_ticks
    ]
    assert [tick_input.late_ns for tick_input, _ in run.recorded_ticks] == expected_lateness_ns
    assert run.loop.stats.missed_ticks == missed_ticks
    assert run.loop.stats.ticks == 4
    assert list(run.loop.stats.tick_lateness_ns) == (lateness_by_tick + [0] * 4)[:4], (
        "the statistics have the measured lateness"
    )
    waited_ticks = run.clock.waited_ticks
    assert all(b > a for a, b in pairwise(waited_ticks)), "each deadline is waited for at most once"


def test_received_frames_enter_one_tick_in_order() -> None:
    old_frame = Frame(1, b"old")
    first_frame = Frame(1, b"1")
    second_frame = Frame(2, b"2", bus=1)
    left_bus = FakeBus(
        frames_by_tick=[[old_frame], [first_frame], []], pending_events=[("dropped", "a", 3)]
    )
    right_bus = FakeBus(1, frames_by_tick=[[], [second_frame]])
    run = RecordedControlLoop(
        3,
        buses=[left_bus, right_bus],
        requests=[("x", "y"), (), ("z",)],
        host=[[IoEvent("recorder", "gone")]],
    )
    run.go()
    tick_inputs = [tick_input for tick_input, _ in run.recorded_ticks]
    assert tick_inputs[0].frames == (first_frame, second_frame), (
        "frames from before the run are discarded"
    )
    assert tick_inputs[0].io_events == (IoEvent("recorder", "gone"), IoEvent("dropped", "a", 3))
    assert [tick_input.requests for tick_input in tick_inputs] == [("x", "y"), (), ("z",)]
    assert tick_inputs[1].frames == tick_inputs[2].frames == ()
    assert tick_inputs[1].io_events == ()
    assert run.loop.stats.frames_rx == 2


def test_each_bus_gets_its_own_frames() -> None:
    left_bus = FakeBus()
    right_bus = FakeBus(1)
    frames = (Frame(1, b"a"), Frame(2, b"b", bus=1), Frame(3, b"c"))
    RecordedControlLoop(1, buses=[left_bus, right_bus], frames=frames).go()
    assert left_bus.sent == [(frames[0], frames[2])]
    assert right_bus.sent == [(frames[1],)]


def test_one_bus_object_may_serve_all_buses() -> None:
    bus, frames = FakeBus(), (Frame(1, b"a"), Frame(2, b"b", bus=1))
    RecordedControlLoop(1, buses=[bus], frames=frames).go()
    assert bus.sent == [frames]


def test_frames_that_a_bus_refuses_are_counted_as_refused_not_as_sent() -> None:
    frames = tuple(Frame(i, b"") for i in range(5))
    run = RecordedControlLoop(3, buses=[FakeBus(capacity=2)], frames=frames)
    run.go()
    assert run.loop.stats.refused_frames == 9
    assert run.loop.stats.frames_tx == 6


class InjectedError(Exception):
    """Error that a test raises in a stage of a tick."""


def raise_error(*_: object) -> None:
    raise InjectedError


@pytest.mark.parametrize(
    "failing_stage",
    [
        "tick",
        "record_tick",
        "show_tick",
        "publish_tick",
        "record_snapshot",
        "take_requests",
        "take_targets",
        "take_host_events",
        "wait",
        "send",
        "drain",
        "take_events",
    ],
)
def test_any_error_cuts_the_drives_and_is_raised_again(failing_stage: str) -> None:
    left_bus = FakeBus()
    right_bus = FakeBus(1)
    run = RecordedControlLoop(5, buses=[left_bus, right_bus], frames=(Frame(9, b"torque"),))
    if failing_stage == "tick":
        run.tick_hook = lambda tick_input: raise_error() if tick_input.k == 2 else None
    elif hasattr(run.loop, failing_stage):
        setattr(run.loop, failing_stage, raise_error)
    else:
        owner = run.clock if failing_stage == "wait" else left_bus
        original_method = getattr(owner, failing_stage)
        setattr(
            owner,
            failing_stage,
            lambda *words: raise_error() if run.recorded_ticks else original_method(*words),
        )
    # an error is raised because the frames that disable the drives were not sent
    with pytest.raises(PowerError if failing_stage == "send" else InjectedError):
        run.go()
    assert right_bus.sent[-1] == (TORQUE_CUT_FRAMES[1],)
    if failing_stage != "send":
        assert left_bus.sent[-1] == (TORQUE_CUT_FRAMES[0],)
    assert gc.isenabled()


def times_of_polls(
    recorded_loop: RecordedControlLoop, motors_by_poll: list[tuple[str, ...]]
) -> list[int]:
    """Return the times [ns] at which a loop polls the drives after a failure.

    The loop of this test fails in its third tick. For each poll of the drives, ``motors_by_poll``
    lists the drives that have not confirmed that they are disabled.
    """
    times: list[int] = []

    def disable_drives(
        state: int, t_ns: int, received_frames: list[Frame]
    ) -> tuple[int, tuple[Frame, ...], tuple[str, ...]]:
        times.append(t_ns)
        return (
            state,
            (Frame(3, b"off"),),
            motors_by_poll.pop(0) if motors_by_poll else ("index", "thumb"),
        )

    recorded_loop.loop.disable_drives = disable_drives
    recorded_loop.tick_hook = lambda tick_input: raise_error() if tick_input.k == 2 else None
    recorded_loop.go()
    return times


@pytest.mark.parametrize("failing_stage", ["send", "publish_tick"])
def test_an_error_after_the_commands_disables_from_the_state_with_these_commands(
    failing_stage: str,
) -> None:
    """Reproduce a defect.

    To disable the drives after an error, the loop used the state from before the failed tick. In
    the state from before the failed tick, a drive counted as disabled even if the failed tick had
    enabled the drive.
    """
    bus = FakeBus()
    run = RecordedControlLoop(5, buses=[bus], frames=(Frame(9, b"enable"),))
    states: list[int] = []

    def disable_drives(
        state: int, t_ns: int, received_frames: list[Frame]
    ) -> tuple[int, tuple[Frame, ...], tuple[str, ...]]:
        states.append(state)
        return state, (), ()

    def fail_in_third_tick(*words: object) -> int:
        if len(run.recorded_ticks) == 2:
            run.recorded_ticks.append(run.recorded_ticks[0])
            raise InjectedError
        return 0

    run.loop.disable_drives = disable_drives
    if failing_stage == "send":
        bus.send = fail_in_third_tick  # type: ignore[method-assign]
    else:
        run.loop.publish_tick = fail_in_third_tick  # type: ignore[assignment]
    with pytest.raises(InjectedError):
        run.go()
    assert states == [3], "the state after the third tick"


def test_after_an_error_drives_are_polled_until_each_reports_off() -> None:
    bus = FakeBus()
    answers = [("index", "thumb"), ("thumb",), ()]
    with pytest.raises(InjectedError):
        times_of_polls(RecordedControlLoop(5, buses=[bus]), answers)
    assert answers == []
    assert [sent for sent in bus.sent if sent] == [
        TORQUE_CUT_FRAMES,
        (Frame(3, b"off"),),
        (Frame(3, b"off"),),
    ]


def test_a_drive_that_does_not_report_off_is_named_with_the_error() -> None:
    run = RecordedControlLoop(5)
    with pytest.raises(
        PowerError, match="REMOVE POWER: not confirmed disabled: index, thumb"
    ) as message:
        times_of_polls(run, [])
    assert isinstance(message.value.__cause__, InjectedError)
    assert len(run.clock.waited_ticks) == 3 + 501, "half a second of ticks"


def test_after_a_stall_drives_are_polled_from_the_present_time_on() -> None:
    """Reproduce a defect.

    After a stall of the loop, the loop sent the polls of all missed ticks at once, so the drives
    had no time to reply.
    """
    run = RecordedControlLoop(600, clock=ScriptedClock([0, 600 * PERIOD_NS]))
    times: list[int] = []

    def disable_drives(
        state: int, t_ns: int, received_frames: list[Frame]
    ) -> tuple[int, tuple[Frame, ...], tuple[str, ...]]:
        times.append(t_ns)
        return state, (), () if len(times) == 2 else ("index",)

    run.loop.disable_drives = disable_drives
    run.tick_hook = lambda tick_input: raise_error() if tick_input.k == 601 else None
    with pytest.raises(InjectedError):
        run.go()
    assert times == [602 * PERIOD_NS, 603 * PERIOD_NS]


def test_drives_that_cannot_be_polled_do_not_count_as_disabled() -> None:
    run = RecordedControlLoop(5)
    run.tick_hook = lambda tick_input: raise_error() if tick_input.k == 2 else None
    run.loop.disable_drives = raise_error  # type: ignore[assignment]
    with pytest.raises(PowerError, match="the drives are unknown"):
        run.go()


def test_a_cut_that_finds_a_full_queue_is_sent_until_there_is_room() -> None:
    """The frames that disable the drives must not be lost, because no later tick sends them again.

    If the disabling frames were lost, a drive without a watchdog would keep its torque.
    """
    left_bus = FakeBus()
    right_bus = FakeBus(1)
    run = RecordedControlLoop(5, buses=[left_bus, right_bus])
    run.tick_hook = lambda tick_input: raise_error() if tick_input.k == 2 else None
    remaining_capacities = [0, 0, 1]
    original_send = left_bus.send

    def send(frames: Sequence[Frame]) -> int:
        left_bus.capacity = remaining_capacities.pop(0) if frames else 1000
        return original_send(frames)

    left_bus.send = send  # type: ignore[method-assign]
    with pytest.raises(InjectedError):
        run.go()
    assert [sent for sent in left_bus.sent if sent] == [(TORQUE_CUT_FRAMES[0],)]
    assert remaining_capacities == []
    assert right_bus.sent.count((TORQUE_CUT_FRAMES[1],)) == 1


@pytest.mark.parametrize("refusing_bus", [0, 1])
def test_a_bus_that_refuses_every_cut_delays_no_other(
    refusing_bus: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If a bus refuses the frames that disable the drives, the loop repeats these frames for a limited time.

    Before the first repetition, the loop sends the frames that disable the drives on all other
    buses.
    """
    pauses: list[float] = []
    monkeypatch.setattr(loop.time, "sleep", pauses.append)
    tries: list[tuple[int, int]] = []
    buses = [FakeBus(), FakeBus(1)]
    buses[refusing_bus].capacity = 0
    for index, bus in enumerate(buses):

        def send(
            frames: Sequence[Frame],
            original_send: Callable[[Sequence[Frame]], int] = bus.send,
            index: int = index,
        ) -> int:
            if tuple(frames) == (TORQUE_CUT_FRAMES[index],):
                tries.append((index, len(pauses)))
            return original_send(frames)

        bus.send = send  # type: ignore[method-assign]
    run = RecordedControlLoop(5, buses=buses)
    run.tick_hook = lambda tick_input: raise_error() if tick_input.k == 2 else None
    with pytest.raises(InjectedError):
        run.go()
    other_bus = 1 - refusing_bus
    assert [pause for index, pause in tries if index == other_bus] == [0]
    assert buses[other_bus].sent[-1] == (TORQUE_CUT_FRAMES[other_bus],)
    assert [pause for index, pause in tries if index == refusing_bus] == list(
        range(loop.TORQUE_CUT_ATTEMPTS)
    )


def test_a_failed_tick_sends_nothing_else() -> None:
    run = RecordedControlLoop(5, frames=(Frame(9, b"torque"),))
    run.tick_hook = lambda tick_input: raise_error() if tick_input.k == 2 else None
    with pytest.raises(InjectedError):
        run.go()
    assert run.buses[0].sent == [run.frames, run.frames, TORQUE_CUT_FRAMES]
    assert [tick_input.k for tick_input, _ in run.recorded_ticks] == [0, 1]


@pytest.mark.parametrize("with_failure", [False, True])
def test_garbage_collection_is_off_in_the_loop_only(with_failure: bool) -> None:
    collector_states = []
    run = RecordedControlLoop(3)
    run.tick_hook = lambda tick_input: (
        collector_states.append((gc.isenabled(), gc.get_freeze_count() > 0))
        or (raise_error() if with_failure and tick_input.k else None)
    )
    freeze_count_before = gc.get_freeze_count()
    assert gc.isenabled()
    if with_failure:
        with pytest.raises(InjectedError):
            run.go()
    else:
        run.go()
    assert set(collector_states[1:]) == {(False, True)}
    assert gc.isenabled()
    assert gc.get_freeze_count() == freeze_count_before == 0


def test_garbage_collection_is_restored_when_the_clock_does_not_begin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = RecordedControlLoop(3)
    monkeypatch.setattr(run.clock, "start", raise_error)
    with pytest.raises(InjectedError):
        run.go()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_a_long_run_has_the_lateness_of_its_last_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control loop stores the lateness of only its last ``LATENESS_RING_TICKS`` ticks.

    At 500 Hz, the lateness of all ticks of a day would take 330 MiB of locked memory.
    """
    monkeypatch.setattr(loop, "LATENESS_RING_TICKS", 16)
    run = RecordedControlLoop(200, clock=ScriptedClock(list(range(200))))
    run.go()
    assert sorted(run.loop.stats.tick_lateness_ns) == list(range(184, 200))
    assert run.loop.stats.ticks == 200


def test_lateness_is_recorded_for_every_tick() -> None:
    run = RecordedControlLoop(200, clock=ScriptedClock(list(range(200))))
    run.go()
    assert isinstance(run.loop.stats.tick_lateness_ns, array)
    np.testing.assert_array_equal(run.loop.stats.tick_lateness_ns, range(200))
