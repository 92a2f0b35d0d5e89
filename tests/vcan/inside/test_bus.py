"""The contract of handctl's own bus, against the kernel's sockets instead of an imitation."""

import socket
import struct
import subprocess
import time
from collections.abc import Iterator, Sequence

import pytest

from handctl.drives.frame import BRS, EXTENDED, FDF, Frame
from handctl.runtime.bus import Bus, open_bus

CLASSICAL = struct.Struct("=IB3x8s")
NOMINAL, DATA = 1_000_000, 5_000_000
WAIT_S = 20.0
INDEX = 1
"""The hand's bus that vcan0 stands for in these tests."""


@pytest.fixture
def bus() -> Iterator[Bus]:
    opened = open_bus("socketcan:vcan0", INDEX, NOMINAL, DATA, stamp=int)
    yield opened
    opened.close()


@pytest.fixture
def peer() -> Iterator[Bus]:
    opened = open_bus("socketcan:vcan0", INDEX, NOMINAL, DATA, stamp=int)
    yield opened
    opened.close()


def drained(bus: Bus, count: int) -> list[Frame]:
    """At least this many frames, or all that came in time."""
    frames, end = bus.drain(), time.monotonic() + WAIT_S
    while len(frames) < count and time.monotonic() < end:
        time.sleep(0.005)
        frames += bus.drain()
    return frames


def contents(frames: Sequence[Frame]) -> list[tuple[int, bytes, int]]:
    return [(frame.can_id, frame.data, frame.flags & (FDF | BRS)) for frame in frames]


def link(state: str) -> None:
    subprocess.run(["ip", "link", "set", "vcan0", state], check=True)


def test_a_batch_of_both_kinds_arrives_whole_and_in_order(bus: Bus, peer: Bus) -> None:
    classical = [Frame(n, bytes([n]) * (n % 9), 0, INDEX) for n in range(50)]
    fd = [Frame(n | EXTENDED, bytes([n]) * 48, FDF | BRS, INDEX) for n in range(50)]
    batch = [frame for pair in zip(classical, fd, strict=True) for frame in pair]
    assert bus.send(batch) == len(batch)
    received = drained(peer, len(batch))
    assert contents(received) == contents(batch)
    assert {frame.bus for frame in received} == {INDEX}
    assert peer.take_events() == []


def test_nobody_hears_himself(bus: Bus, peer: Bus) -> None:
    bus.send([Frame(1, b"mine", bus=INDEX)])
    peer.send([Frame(2, b"yours", bus=INDEX)])
    assert [frame.can_id for frame in drained(peer, 1)] == [1]
    assert [frame.can_id for frame in drained(bus, 1)] == [2]


def test_stamps_are_times_of_reception(bus: Bus, peer: Bus) -> None:
    before = time.monotonic_ns()
    bus.send([Frame(1, b"", bus=INDEX)])
    first_sent = time.monotonic_ns()
    time.sleep(0.2)
    bus.send([Frame(2, b"", bus=INDEX)])
    time.sleep(0.2)
    first, second = drained(peer, 2)
    slack = 100_000_000
    assert before - slack <= first.t_ns <= first_sent + slack
    assert second.t_ns - first.t_ns >= 150_000_000


def test_a_link_that_goes_down_is_an_event_and_may_come_back(bus: Bus, peer: Bus) -> None:
    link("down")
    try:
        assert bus.send([Frame(1, b"", bus=INDEX)]) == 0
        assert bus.drain() == []
        kinds = {kind for kind, _, _ in bus.take_events()}
        assert kinds == {"enetdown"}
    finally:
        link("up")
    bus.drain()
    peer.drain()
    bus.take_events()
    assert bus.send([Frame(2, b"back", bus=INDEX)]) == 1
    assert contents(drained(peer, 1)) == [(2, b"back", 0)]
    assert bus.take_events() == []


def test_every_frame_that_was_not_read_in_time_is_counted(peer: Bus) -> None:
    sent = 30_000
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as flood:
        flood.bind(("vcan0",))
        for n in range(sent - 1):
            flood.send(CLASSICAL.pack(n & 0x7FF, 0, b""))
        received = 0
        while frames := peer.drain():
            received += len(frames)
        flood.send(CLASSICAL.pack(0x7FF, 0, b""))  # the kernel tells its count with the next frame that fits
        received += len(drained(peer, 1))
    dropped = sum(number for kind, _, number in peer.take_events() if kind == "dropped")
    assert 0 < received < sent
    assert received + dropped == sent
