"""Test the contract that the clocks for real time, scaled time and virtual time must fulfil.

Each kind of clock must fulfil the same contract.
"""

import statistics
import time

import pytest

from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from handctl.drives.frame_records import Frames, RecordArray, frames_as_records
from handctl.errors import ConfigError
from handctl.runtime.clocks.lockstep import LockstepBus, LockstepClock, load_simulator
from handctl.runtime.clocks.real_clock import BUSY_WAIT_NS, RealClock
from handctl.runtime.clocks.realtime_priority import GrantedPriority

PERIOD_NS = 2_000_000


class FakeMonotonicClock:
    """A simulated CLOCK_MONOTONIC.

    A sleep advances this clock by the duration of the sleep plus ``overshoot_ns``.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, overshoot_ns: int = 0) -> None:
        self.now_ns = 5_000_000_000
        self.overshoot_ns = overshoot_ns
        self.sleeps_s = list[float]()
        monkeypatch.setattr(time, "monotonic_ns", self.read)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def read(self) -> int:
        self.now_ns += 100
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.sleeps_s.append(seconds)
        self.now_ns += round(seconds * 1e9) + self.overshoot_ns


@pytest.mark.parametrize("time_scale", [1.0, 0.1, 10.0, 0.37])
@pytest.mark.parametrize("busy_wait", [False, True])
def test_deadlines_are_absolute_and_scaled(
    monkeypatch: pytest.MonkeyPatch, time_scale: float, busy_wait: bool
) -> None:
    wall = FakeMonotonicClock(monkeypatch, overshoot_ns=20_000)
    clock = RealClock(PERIOD_NS, time_scale, busy_wait)
    clock.start()
    start = clock.start_ns
    for k in range(50):
        late = clock.wait(k)
        assert wall.now_ns >= start + int(k * PERIOD_NS / time_scale), "never early"
        assert 0 <= late <= 30_000 * time_scale + 200 * time_scale + 1
        assert abs(clock.now_ns() - (k * PERIOD_NS + late)) <= 1000 * time_scale + 1
    assert start - 5_000_000_000 == pytest.approx(PERIOD_NS / time_scale, rel=0.01), (
        "tick 0 is one period after the start"
    )


def test_lateness_is_in_the_runs_time_and_shifts_no_later_deadline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall = FakeMonotonicClock(monkeypatch)
    clock = RealClock(PERIOD_NS, 0.1)
    clock.start()
    clock.wait(0)
    wall.now_ns = (
        clock.start_ns + 25 * PERIOD_NS
    )  # tick 1 is due after 10 periods of wall time, and tick 2 after 20
    assert clock.wait(1) == pytest.approx(1.5 * PERIOD_NS, abs=1000)
    assert clock.wait(2) == pytest.approx(0.5 * PERIOD_NS, abs=1000)
    assert clock.wait(3) < 1000


@pytest.mark.parametrize("delay_ns", [0, 30_000, 70_000])
def test_the_clock_wakes_up_as_early_as_its_wake_ups_are_late(
    monkeypatch: pytest.MonkeyPatch, delay_ns: int
) -> None:
    wall = FakeMonotonicClock(monkeypatch, delay_ns)
    clock = RealClock(PERIOD_NS, busy_wait=True)
    clock.start()
    lateness_ns = [clock.wait(k) for k in range(200)]
    assert max(lateness_ns[100:]) < 1000
    busy_wait_ns = [PERIOD_NS - sleep_s * 1e9 - delay_ns for sleep_s in wall.sleeps_s[100:]]
    assert busy_wait_ns == pytest.approx([BUSY_WAIT_NS] * 100, abs=5000)


def test_a_single_late_wake_up_changes_the_next_one_little(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = FakeMonotonicClock(monkeypatch, 20_000)
    clock = RealClock(PERIOD_NS, busy_wait=True)
    clock.start()
    for k in range(200):
        clock.wait(k)
    wall.overshoot_ns = PERIOD_NS // 2
    assert clock.wait(200) > 0.4 * PERIOD_NS
    wall.overshoot_ns = 20_000
    assert clock.wait(201) < 1000
    lead_ns = clock.wake_up_delay.expected_ns
    assert 20_000 < lead_ns <= 1.25 * 21_000


def test_a_clock_without_realtime_priority_sleeps_until_the_deadline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall = FakeMonotonicClock(monkeypatch)
    clock = RealClock(PERIOD_NS)
    clock.start()
    clock.wait(0)
    wall.sleeps_s.clear()
    clock.wait(1)
    assert len(wall.sleeps_s) == 1
    assert PERIOD_NS - wall.sleeps_s[0] * 1e9 == pytest.approx(0, abs=5000)


def test_stamps_before_the_beginning_are_negative(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = FakeMonotonicClock(monkeypatch)
    clock = RealClock(PERIOD_NS, 0.5)
    clock.start()
    assert clock.convert_to_run_time(clock.start_ns) == 0
    assert clock.convert_to_run_time(clock.start_ns + 4_000_000) == 2_000_000
    assert clock.convert_to_run_time(wall.now_ns) < 0


@pytest.mark.realtime
@pytest.mark.alone
def test_the_real_clock_keeps_time() -> None:
    clock = RealClock(PERIOD_NS)
    clock.start()
    late = [clock.wait(k) for k in range(200)]
    assert min(late) >= 0
    assert statistics.median(late) < PERIOD_NS / 2
    assert time.monotonic_ns() - clock.start_ns >= 199 * PERIOD_NS


def test_the_granted_priority_is_described() -> None:
    assert str(GrantedPriority(True, True)) == "SCHED_FIFO, memory locked"
    assert (
        str(GrantedPriority(True, True, are_processors_awake=True))
        == "SCHED_FIFO, memory locked, processors kept awake"
    )
    assert "not permitted" in str(GrantedPriority(False, False))


class FakeLockstepSimulator:
    """A fake simulator that records each of its steps.

    A lockstep clock advances the fake simulator.

    The simulator replies to each frame. The identifier of the reply is the identifier of the frame
    plus 0x10.
    """

    def __init__(self, failure_text: str = "") -> None:
        if failure_text:
            raise ValueError(failure_text)
        self.steps: list[tuple[int, list[Frame]]] = []

    def step(self, t_ns: int, frames: list[Frame]) -> list[tuple[int, bytes, int, int, int]]:
        self.steps.append((t_ns, list(frames)))
        return [(frame.can_id + 0x10, frame.data, 0, frame.bus, t_ns + 300) for frame in frames]

    def close(self) -> None: ...


def test_lockstep_steps_the_peer_once_a_tick_with_the_frames_of_that_tick() -> None:
    peer = FakeLockstepSimulator()
    clock = LockstepClock(peer, PERIOD_NS)
    bus = LockstepBus(clock)
    seen_frames = []
    for k in range(4):
        assert clock.wait(k) == 0
        assert clock.now_ns() == k * PERIOD_NS
        seen_frames.append(bus.drain())
        assert bus.send([Frame(k, bytes((k,)))]) == 1
    assert [t for t, _ in peer.steps] == [0, PERIOD_NS, 2 * PERIOD_NS]
    assert [[f.can_id for f in frames] for _, frames in peer.steps] == [[0], [1], [2]]
    assert seen_frames == [
        [],
        *[[Frame(0x10 + k, bytes((k,)), 0, 0, k * PERIOD_NS + 300)] for k in range(3)],
    ]
    assert bus.take_events() == []


def test_a_second_run_continues_the_peers_time_from_its_own_zero() -> None:
    peer = FakeLockstepSimulator()
    clock = LockstepClock(peer, PERIOD_NS)
    bus = LockstepBus(clock)
    for k in range(3):
        clock.wait(k)
        bus.send([Frame(k, b"")])
    clock.restart()
    assert clock.offset_ns == 3 * PERIOD_NS
    assert [f.can_id for f in peer.steps[-1][1]] == [2], (
        "frames of the last tick arrive, because they disarm the drives"
    )
    for k in range(3):
        clock.wait(k)
        frames = bus.drain()
        assert [(f.can_id, f.t_ns) for f in frames] == (
            [(0x17, (k - 1) * PERIOD_NS + 300)] if k else []
        )
        bus.send([Frame(7, b"")])
    assert [t for t, _ in peer.steps] == [k * PERIOD_NS for k in range(5)], (
        "every period exactly once"
    )
    assert [[f.can_id for f in frames] for _, frames in peer.steps[3:]] == [[7], [7]], (
        "no frames of the first run"
    )
    clock = LockstepClock(peer, PERIOD_NS)
    clock.restart()
    assert (clock.offset_ns, len(peer.steps)) == (0, 5), "no tick to finish before the first run"


class FakePackedSimulator(FakeLockstepSimulator):
    """A fake simulator that exchanges frames as packed records instead of objects.

    A lockstep clock advances the fake simulator.
    """

    def exchange(self, t_ns: int, records: RecordArray) -> RecordArray:
        self.steps.append((t_ns, list(Frames.from_records(records))))
        answers = records.copy()
        answers["can_id"] += 0x10
        answers["t_ns"] = t_ns + 300
        answers.flags.writeable = False
        return answers

    def step(self, t_ns: int, frames: list[Frame]) -> list[tuple[int, bytes, int, int, int]]:
        raise AssertionError("frames are objects, although the peer takes records")


def test_a_peer_with_exchange_and_one_with_step_get_the_same_frames() -> None:
    runs = []
    for peer in (FakeLockstepSimulator(), FakePackedSimulator()):
        clock = LockstepClock(peer, PERIOD_NS)
        bus = LockstepBus(clock)
        seen_frames = []
        for _ in range(2):
            for k in range(4):
                clock.wait(k)
                seen_frames.append(bus.drain())
                if k != 2:
                    bus.send([Frame(k, bytes(range(k))), Frame(0x100 + k, bytes(8), bus=1)])
                    bus.send(frames_as_records([Frame(0x200 + k, b"later")]))
            clock.restart()
            assert bus.drain() == []
        runs.append((seen_frames, peer.steps))
    assert runs[0] == runs[1]
    assert [len(frames) for frames in runs[0][0]] == [0, 3, 3, 0] * 2
    assert [frame.bus for frame in runs[0][0][1]] == [0, 1, 0]


def test_extended_and_remote_frames_of_a_peer_are_no_error_frames() -> None:
    clock = LockstepClock(FakePackedSimulator(), PERIOD_NS)
    bus = LockstepBus(clock)
    sent_ids = [EXTENDED_FLAG | 0x1FFF_0000, REMOTE_FLAG | 0x30, EXTENDED_FLAG | REMOTE_FLAG | 5]
    bus.send([Frame(can_id, b"") for can_id in sent_ids])
    clock.wait(1)
    assert [frame.can_id for frame in bus.drain()] == [can_id + 0x10 for can_id in sent_ids]
    assert bus.take_events() == []
    bus.send([Frame(sent_ids[0], b""), Frame(ERROR_FLAG | 0x30, bytes(8))])
    clock.wait(2)
    assert len(bus.drain()) == 1
    assert bus.take_events() != []


def test_error_frames_of_a_peer_are_events_of_their_bus() -> None:
    clock = LockstepClock(FakePackedSimulator(), PERIOD_NS)
    bus = LockstepBus(clock)
    bus.send([Frame(1, b"a"), Frame(ERROR_FLAG | 0x30, bytes(8), bus=1), Frame(2, b"b", bus=1)])
    clock.wait(1)
    assert [frame.data for frame in bus.drain()] == [b"a", b"b"]
    assert ("bus_off", "lockstep:1", 1) in bus.take_events()


def test_peers_are_loaded_by_name() -> None:
    assert isinstance(load_simulator(f"{__name__}:FakeLockstepSimulator"), FakeLockstepSimulator)
    for entry in ("no.such.module:Peer", f"{__name__}:Nobody", "nonsense"):
        with pytest.raises(ConfigError, match="module:Class"):
            load_simulator(entry)
    with pytest.raises(ConfigError, match="too hot"):
        load_simulator(f"{__name__}:FakeLockstepSimulator", failure_text="too hot")
