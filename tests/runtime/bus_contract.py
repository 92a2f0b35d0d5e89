"""Define tests of the contract that every bus class must fulfil.

A test module that imports the tests must define the fixture ``bus_under_test``, which returns the
tested bus.
"""

import random
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import can
import pytest

from handctl.drives.frame import BRS, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus

RECEIVE_TIMEOUT_S = 20.0
FD_PAYLOAD_SIZES = (*range(9), 12, 16, 20, 24, 32, 48, 64)


@dataclass
class BusUnderTest:
    """CAN bus under test, to which several nodes can be connected.

    Attributes:
        spec: specification of the bus, as ``open_bus`` takes it.
        opened: functions that close the nodes of the bus after the test.
    """

    spec: str
    opened: list[Callable[[], None]] = field(default_factory=list)

    def open(self, bus_index: int = 0, convert_time: Callable[[int], int] = int) -> Bus:
        """Connect a further node to the bus, with a bus class of handctl."""
        bus = open_bus(self.spec, bus_index, 1_000_000, 5_000_000, convert_time=convert_time)
        self.opened.append(bus.close)
        return bus

    def connect_python_can(self) -> can.BusABC:
        """Connect a further node to the bus, with python-can and without handctl."""
        interface, _, channel = self.spec.partition(":")
        bus = can.Bus(channel, interface=interface, fd=True, ignore_config=True)
        self.opened.append(bus.shutdown)
        return bus

    def close(self) -> None:
        """Close all nodes that were connected to the bus."""
        for close in self.opened:
            close()


def drain_bus(bus: Bus, frame_count: int) -> list[Frame]:
    """Read frames from a bus until ``frame_count`` frames have arrived, or until a timeout."""
    frames = list(bus.drain())
    end = time.monotonic() + RECEIVE_TIMEOUT_S
    while len(frames) < frame_count and time.monotonic() < end:
        time.sleep(0.002)
        frames += bus.drain()
    return frames


def frame_contents(frames: Sequence[Frame]) -> list[tuple[int, bytes, int]]:
    return [(frame.can_id, frame.data, frame.flags & (FDF | BRS)) for frame in frames]


def random_frames(frame_count: int, seed: int) -> list[Frame]:
    """Return random frames of all kinds: classical, remote and FD frames, with standard and extended identifiers."""
    rng = random.Random(seed)
    frames = []
    for _ in range(frame_count):
        can_id = rng.choice((rng.randrange(0x800), rng.randrange(1 << 29) | EXTENDED_FLAG))
        kind = rng.randrange(4)
        if kind == 0:
            frames.append(Frame(can_id | REMOTE_FLAG, bytes(rng.randrange(9))))
        elif kind == 1:
            frames.append(
                Frame(
                    can_id, rng.randbytes(rng.choice(FD_PAYLOAD_SIZES)), FDF | rng.choice((0, BRS))
                )
            )
        else:
            frames.append(Frame(can_id, rng.randbytes(rng.randrange(9))))
    return frames


def test_frames_of_all_kinds_arrive_complete_and_in_order(bus_under_test: BusUnderTest) -> None:
    sender = bus_under_test.open()
    receiver = bus_under_test.open(bus_index=3)
    batch = random_frames(500, seed=1)
    assert sender.send(batch[:300]) + sender.send(batch[300:]) == len(batch)
    received_frames = drain_bus(receiver, len(batch))
    assert frame_contents(received_frames) == frame_contents(batch)
    assert {frame.bus for frame in received_frames} == {3}
    assert sender.take_events() == receiver.take_events() == []


def test_every_node_receives_all_frames_but_its_own(bus_under_test: BusUnderTest) -> None:
    buses = [bus_under_test.open() for _ in range(3)]
    for number, bus in enumerate(buses):
        assert bus.send([Frame(number, b"me")]) == 1
    for number, bus in enumerate(buses):
        other_numbers = {0, 1, 2} - {number}
        assert {frame.can_id for frame in drain_bus(bus, 2)} == other_numbers
        assert bus.drain() == []


def test_reading_an_empty_bus_does_not_wait(bus_under_test: BusUnderTest) -> None:
    bus = bus_under_test.open()
    start = time.monotonic()
    for _ in range(100):
        assert bus.drain() == []
    assert time.monotonic() - start < 5.0
    assert bus.send([]) == 0
    assert bus.take_events() == []


def test_stamps_are_the_runs_time_of_reception(bus_under_test: BusUnderTest) -> None:
    offset = 10**15
    sender = bus_under_test.open()
    receiver = bus_under_test.open(convert_time=lambda t_ns: t_ns + offset)
    start = time.monotonic_ns()
    for number in range(20):
        sender.send([Frame(number, b"")])
    stamps = [frame.t_ns - offset for frame in drain_bus(receiver, 20)]
    slack = 20_000_000  # the wall clock and the monotonic clock can differ
    assert len(stamps) == 20
    assert stamps == sorted(stamps)
    assert start - slack <= stamps[0]
    assert stamps[-1] <= time.monotonic_ns()


@pytest.mark.parametrize(("payload_size", "frame_flags"), [(9, 0), (64, 0), (65, FDF)])
def test_a_payload_that_does_not_fit_is_refused_and_nothing_is_sent(
    bus_under_test: BusUnderTest, payload_size: int, frame_flags: int
) -> None:
    sender = bus_under_test.open()
    receiver = bus_under_test.open()
    with pytest.raises(ValueError, match=f"payload of {payload_size} bytes"):
        sender.send([Frame(1, bytes(payload_size), frame_flags)])
    sender.send([Frame(2, b"last")])
    assert frame_contents(drain_bus(receiver, 1)) == [(2, b"last", 0)]


def test_the_file_descriptor_becomes_readable_with_a_frame(bus_under_test: BusUnderTest) -> None:
    sender = bus_under_test.open()
    receiver = bus_under_test.open()
    descriptor = receiver.fileno()
    if descriptor < 0:
        assert bus_under_test.spec.startswith("virtual:")
        return
    assert select.select([descriptor], [], [], 0.0)[0] == []
    sender.send([Frame(1, b"")])
    assert select.select([descriptor], [], [], RECEIVE_TIMEOUT_S)[0] == [descriptor]


def test_python_can_understands_every_frame(bus_under_test: BusUnderTest) -> None:
    handctl_bus = bus_under_test.open()
    python_can_bus = bus_under_test.connect_python_can()
    for frame in random_frames(50, seed=2):
        assert handctl_bus.send([frame]) == 1
        message = python_can_bus.recv(RECEIVE_TIMEOUT_S)
        assert message is not None
        assert (
            message.arbitration_id | EXTENDED_FLAG * message.is_extended_id
            == frame.can_id & ~REMOTE_FLAG
        )
        assert message.is_remote_frame == bool(frame.can_id & REMOTE_FLAG)
        assert (message.is_fd, message.bitrate_switch) == (
            bool(frame.flags & FDF),
            bool(frame.flags & BRS),
        )
        assert message.dlc == len(frame.data)
        assert bytes(message.data) == (b"" if message.is_remote_frame else frame.data)


def test_every_message_of_python_can_is_understood(bus_under_test: BusUnderTest) -> None:
    handctl_bus = bus_under_test.open()
    python_can_bus = bus_under_test.connect_python_can()
    sent = [
        can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"\x00\xff"),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(range(8))),
        can.Message(arbitration_id=0x10, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(
            arbitration_id=0x20,
            is_extended_id=False,
            is_fd=True,
            bitrate_switch=True,
            data=bytes(48),
        ),
    ]
    for message in sent:
        python_can_bus.send(message)
    assert frame_contents(drain_bus(handctl_bus, len(sent))) == [
        (0x7FF, b"\x00\xff", 0),
        (0x1FFFFFFF | EXTENDED_FLAG, bytes(range(8)), 0),
        (0x10 | REMOTE_FLAG, bytes(4), 0),
        (0x20, bytes(48), FDF | BRS),
    ]
