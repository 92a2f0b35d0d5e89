"""Test handctl's SocketCAN bus on the CAN sockets of Linux."""

import socket
import struct
import subprocess
import time
from collections.abc import Iterator, Sequence

import pytest

from handctl.drives.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, Frame
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus

CLASSICAL_FRAME_FORMAT = struct.Struct("=IB3x8s")
NOMINAL_BITRATE, DATA_BITRATE = 1_000_000, 5_000_000
RECEIVE_TIMEOUT_S = 20.0
BUS_INDEX = 1
"""Index of the bus on vcan0 in the list of a hand's buses."""


@pytest.fixture
def bus() -> Iterator[Bus]:
    opened_bus = open_bus(
        "socketcan:vcan0", BUS_INDEX, NOMINAL_BITRATE, DATA_BITRATE, convert_time=int
    )
    yield opened_bus
    opened_bus.close()


@pytest.fixture
def other_bus() -> Iterator[Bus]:
    opened_bus = open_bus(
        "socketcan:vcan0", BUS_INDEX, NOMINAL_BITRATE, DATA_BITRATE, convert_time=int
    )
    yield opened_bus
    opened_bus.close()


def drain_bus(bus: Bus, frame_count: int) -> list[Frame]:
    """Read frames from a bus until at least ``frame_count`` frames have arrived or a time limit has passed."""
    frames, end = list(bus.drain()), time.monotonic() + RECEIVE_TIMEOUT_S
    while len(frames) < frame_count and time.monotonic() < end:
        time.sleep(0.005)
        frames += bus.drain()
    return frames


def frame_contents(frames: Sequence[Frame]) -> list[tuple[int, bytes, int]]:
    return [(frame.can_id, frame.data, frame.flags & (FDF | BRS)) for frame in frames]


def set_link_state(link_state: str) -> None:
    subprocess.run(["ip", "link", "set", "vcan0", link_state], check=True)


def test_a_batch_of_both_kinds_arrives_whole_and_in_order(bus: Bus, other_bus: Bus) -> None:
    classical_frames = [Frame(n, bytes([n]) * (n % 9), 0, BUS_INDEX) for n in range(50)]
    fd_frames = [Frame(n | EXTENDED_FLAG, bytes([n]) * 48, FDF | BRS, BUS_INDEX) for n in range(50)]
    batch = [frame for pair in zip(classical_frames, fd_frames, strict=True) for frame in pair]
    assert bus.send(batch) == len(batch)
    received_frames = drain_bus(other_bus, len(batch))
    assert frame_contents(received_frames) == frame_contents(batch)
    assert {frame.bus for frame in received_frames} == {BUS_INDEX}
    assert other_bus.take_events() == []


def test_a_sender_does_not_receive_its_frames(bus: Bus, other_bus: Bus) -> None:
    bus.send([Frame(1, b"mine", bus=BUS_INDEX)])
    other_bus.send([Frame(2, b"yours", bus=BUS_INDEX)])
    assert [frame.can_id for frame in drain_bus(other_bus, 1)] == [1]
    assert [frame.can_id for frame in drain_bus(bus, 1)] == [2]


def test_stamps_are_times_of_reception(bus: Bus, other_bus: Bus) -> None:
    time_ns_before = time.monotonic_ns()
    bus.send([Frame(1, b"", bus=BUS_INDEX)])
    send_time_ns = time.monotonic_ns()
    time.sleep(0.2)
    bus.send([Frame(2, b"", bus=BUS_INDEX)])
    time.sleep(0.2)
    first_frame, second_frame = drain_bus(other_bus, 2)
    slack = 100_000_000
    assert time_ns_before - slack <= first_frame.t_ns <= send_time_ns + slack
    assert second_frame.t_ns - first_frame.t_ns >= 150_000_000


def test_a_link_that_goes_down_is_an_event_and_may_come_back(bus: Bus, other_bus: Bus) -> None:
    set_link_state("down")
    try:
        assert bus.send([Frame(1, b"", bus=BUS_INDEX)]) == 0
        assert bus.drain() == []
        kinds = {kind for kind, _, _ in bus.take_events()}
        assert kinds == {"enetdown"}
    finally:
        set_link_state("up")
    bus.drain()
    other_bus.drain()
    bus.take_events()
    assert bus.send([Frame(2, b"back", bus=BUS_INDEX)]) == 1
    assert frame_contents(drain_bus(other_bus, 1)) == [(2, b"back", 0)]
    assert bus.take_events() == []


def test_every_frame_that_was_not_read_in_time_is_counted(other_bus: Bus) -> None:
    sent = 30_000
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as flood_socket:
        flood_socket.bind(("vcan0",))
        for n in range(sent - 1):
            flood_socket.send(CLASSICAL_FRAME_FORMAT.pack(n & 0x7FF, 0, b""))
        received = 0
        while frames := other_bus.drain():
            received += len(frames)
        # this frame carries the number of frames that Linux has dropped
        flood_socket.send(CLASSICAL_FRAME_FORMAT.pack(0x7FF, 0, b""))
        received += len(drain_bus(other_bus, 1))
    dropped = sum(number for kind, _, number in other_bus.take_events() if kind == "dropped")
    assert 0 < received < sent
    assert received + dropped == sent


def test_an_error_frame_of_the_kernel_is_an_event_and_no_frame(bus: Bus) -> None:
    """The test sends error frames as a CAN driver does: a warning, bus-off, and a restart."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as driver:
        driver.bind(("vcan0",))
        driver.send(
            CLASSICAL_FRAME_FORMAT.pack(ERROR_FLAG | 0x04, 8, bytes((0, 0x08, 0, 0, 0, 0, 96, 0)))
        )
        assert wait_for_bus_event(bus, "error_warning") == []
        driver.send(CLASSICAL_FRAME_FORMAT.pack(ERROR_FLAG | 0x40, 8, bytes(8)))
        assert wait_for_bus_event(bus, "bus_off") == []
        assert ("bus_off", "socketcan:vcan0", 1) in bus.take_events(), (
            "the event repeats during bus-off"
        )
        driver.send(CLASSICAL_FRAME_FORMAT.pack(ERROR_FLAG | 0x100, 8, bytes(8)))
        assert wait_for_bus_event(bus, "restarted") == []
    assert bus.take_events() == []


def wait_for_bus_event(bus: Bus, event_kind: str) -> list[Frame]:
    """Wait for a bus event of a given kind, and return the frames that arrived before the event."""
    frames, end = list(bus.drain()), time.monotonic() + RECEIVE_TIMEOUT_S
    while event_kind not in {event for event, _, _ in bus.take_events()}:
        assert time.monotonic() < end, f"no {event_kind} in {RECEIVE_TIMEOUT_S} s"
        time.sleep(0.005)
        frames += bus.drain()
    return frames


def test_a_full_transmit_queue_refuses_and_is_an_event(
    slow_tunnel_interfaces: tuple[str, str],
) -> None:
    """In this test, sent frames wait in a queue that holds ten frames, and then pass a simulated wire of 50 kbit/s.

    The Linux module netem simulates the slow wire. A vcan interface alone never refuses a frame.
    """
    sender, receiver = (
        open_bus(f"socketcan:{name}", BUS_INDEX, NOMINAL_BITRATE, convert_time=int)
        for name in slow_tunnel_interfaces
    )
    batch = [Frame(n, bytes(8), bus=BUS_INDEX) for n in range(60)]
    accepted_count = sender.send(batch)
    assert 1 <= accepted_count < len(batch)
    assert sender.take_events() == [
        ("enobufs", f"socketcan:{slow_tunnel_interfaces[0]}", len(batch) - accepted_count)
    ]
    received_frames = drain_bus(receiver, accepted_count)
    assert [frame.can_id for frame in received_frames] == list(range(accepted_count)), (
        "no refused frame is sent later"
    )
    assert sender.send(batch[:1]) == 1, "the queue has room again"
    sender.close()
    receiver.close()


@pytest.fixture
def slow_tunnel_interfaces() -> Iterator[tuple[str, str]]:
    """Make a CAN tunnel with a slow wire behind the first interface, and yield the names of both interfaces."""
    result = subprocess.run(
        ["bash", "-c", SLOW_TUNNEL_SCRIPT], capture_output=True, text=True, check=False
    )
    if result.returncode:
        pytest.skip(f"no vxcan with netem here: {result.stderr.strip()}")
    yield "vxcan0", "vxcan1"
    subprocess.run(["ip", "link", "del", "vxcan0"], check=True)


SLOW_TUNNEL_SCRIPT = """
set -e
ip link add dev vxcan0 type vxcan peer name vxcan1
ip link set vxcan0 up
ip link set vxcan1 up
tc qdisc add dev vxcan0 root netem rate 50kbit limit 10
"""
