"""Test the SocketCAN bus over datagram sockets: batches, time stamps, lost frames and refused frames."""

import socket
import struct
import time
from collections.abc import Iterator

import pytest

from handctl.drives.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, Frame
from handctl.runtime.buses.socketcan import SocketCanBus
from tests.runtime.datagram_bus import datagram_bus

CLASSICAL_FRAME_STRUCT = struct.Struct("=IB3x8s")
FD_FRAME_STRUCT = struct.Struct("=IBB2x64s")
"""Layout of an FD frame in Linux. Source: Linux ``can.h``."""


@pytest.fixture
def udp_bus() -> Iterator[tuple[SocketCanBus, socket.socket]]:
    """Yield a bus, and the socket at the other end of the bus. Bus and socket are connected over UDP.

    Like CAN sockets, UDP sockets have time stamps and count dropped datagrams.
    """
    with datagram_bus(1) as pair:
        yield pair


def wait_for_frames(bus: SocketCanBus, frame_count: int) -> list[Frame]:
    frames = list(bus.drain())
    end = time.monotonic() + 20.0
    while len(frames) < frame_count and time.monotonic() < end:
        time.sleep(0.001)
        frames += bus.drain()
    return frames


def test_sent_frames_have_the_kernels_layout(udp_bus: tuple[SocketCanBus, socket.socket]) -> None:
    bus, peer_socket = udp_bus
    frames = [
        Frame(0x7FF, b"\x01"),
        Frame(5 | EXTENDED_FLAG, bytes(range(64)), FDF | BRS),
        Frame(2, bytes(8)),
    ]
    assert bus.send(frames) == 3
    assert peer_socket.recv(100) == CLASSICAL_FRAME_STRUCT.pack(0x7FF, 1, b"\x01")
    assert peer_socket.recv(100) == FD_FRAME_STRUCT.pack(
        5 | EXTENDED_FLAG, 64, FDF | BRS, bytes(range(64))
    )
    assert peer_socket.recv(100) == CLASSICAL_FRAME_STRUCT.pack(2, 8, bytes(8))


@pytest.mark.parametrize(
    ("long_frame", "short_frames"),
    [
        (Frame(1, b"\xff" * 8), [Frame(2, bytes(size)) for size in range(3)]),
        (Frame(1, b"\xff" * 64, FDF), [Frame(2, bytes(size), FDF) for size in (0, 1, 12)]),
        (Frame(1, b"\xff" * 64, FDF), [Frame(2, bytes(size)) for size in (0, 1, 7)]),
    ],
    ids=["classical", "FD", "classical after FD"],
)
def test_a_short_frame_after_a_long_one_has_none_of_its_bytes(
    udp_bus: tuple[SocketCanBus, socket.socket], long_frame: Frame, short_frames: list[Frame]
) -> None:
    bus, peer_socket = udp_bus
    for short_frame in short_frames:
        for can_id, data, flags, *_ in (long_frame, short_frame):
            if flags:
                peer_socket.send(FD_FRAME_STRUCT.pack(can_id, len(data), flags, data))
            else:
                peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(can_id, len(data), data))
            (frame,) = wait_for_frames(bus, 1)
            assert frame[:4] == (can_id, data, flags, 1)


def test_the_size_of_a_datagram_distinguishes_fd_from_classical(
    udp_bus: tuple[SocketCanBus, socket.socket],
) -> None:
    bus, peer_socket = udp_bus
    # Linux before version 6.1 does not have CANFD_FDF
    peer_socket.send(FD_FRAME_STRUCT.pack(1, 8, 0, bytes(8)))
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(1, 8, bytes(8)))
    assert [frame.flags for frame in wait_for_frames(bus, 2)] == [FDF, 0]


def test_batches_beyond_the_buffers_keep_their_order(
    udp_bus: tuple[SocketCanBus, socket.socket],
) -> None:
    bus, peer_socket = udp_bus
    count = 300
    assert (
        bus.send([Frame(number, number.to_bytes(2, "little")) for number in range(count)]) == count
    )
    sent_structs = [CLASSICAL_FRAME_STRUCT.unpack(peer_socket.recv(100)) for _ in range(count)]
    assert [can_id for can_id, _, _ in sent_structs] == list(range(count))
    for number in range(count):
        peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(number, 2, number.to_bytes(2, "little")))
    received_frames = wait_for_frames(bus, count)
    assert [frame.can_id for frame in received_frames] == list(range(count))
    assert [int.from_bytes(frame.data, "little") for frame in received_frames] == list(range(count))


TIME_STAMP_DELAY_S = 0.3
"""Time from the first request for time stamps until Linux adds time stamps [s].

For the first request of time stamps, Linux has to patch the code of its kernel.
"""


def test_stamps_are_times_of_arrival_not_of_reading(
    udp_bus: tuple[SocketCanBus, socket.socket],
) -> None:
    bus, peer_socket = udp_bus
    time.sleep(TIME_STAMP_DELAY_S)
    start = time.monotonic_ns()
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(1, 0, b""))
    sent_time_ns = time.monotonic_ns()
    time.sleep(0.1)
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(2, 0, b""))
    first_frame, second_frame = wait_for_frames(bus, 2)
    slack = 20_000_000
    assert start - slack <= first_frame.t_ns <= sent_time_ns + slack
    assert second_frame.t_ns - first_frame.t_ns >= 80_000_000


def test_stamps_never_run_backwards_or_ahead(
    udp_bus: tuple[SocketCanBus, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this test, the wall clock is set while frames wait in the socket.

    The change of the wall clock must neither disturb the order of the frames' time stamps, nor put
    a time stamp into the future.
    """
    bus, peer_socket = udp_bus
    real_time_ns = time.time_ns
    stamps = []
    for step in (0, 5 * 10**9, -5 * 10**9, 3600 * 10**9, 0):
        monkeypatch.setattr(time, "time_ns", lambda step=step: real_time_ns() + step)
        bus._offset.request_measurement()
        peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(1, 0, b""))
        time_ns_before = time.monotonic_ns()
        stamps.append(wait_for_frames(bus, 1)[0].t_ns)
        assert time_ns_before - 10**9 <= stamps[-1] <= time.monotonic_ns()
    assert stamps == sorted(stamps)


@pytest.mark.parametrize("step_ns", [5 * 10**9, -5 * 10**9, 50_000_000])
def test_stamps_are_right_although_the_wall_clock_was_set(
    udp_bus: tuple[SocketCanBus, socket.socket], step_ns: int
) -> None:
    """The host measures the offset between wall clock and monotonic clock.

    After the host has measured the offset, the test sets the wall clock, and Linux stamps a frame.
    """
    bus, peer_socket = udp_bus
    time.sleep(TIME_STAMP_DELAY_S)
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(1, 0, b""))
    wait_for_frames(bus, 1)
    bus._offset._offset_ns += step_ns
    time_ns_before = time.monotonic_ns()
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(2, 0, b""))
    time_ns_after = time.monotonic_ns()
    time.sleep(0.05)
    slack = 10_000_000
    assert time_ns_before - slack <= wait_for_frames(bus, 1)[0].t_ns <= time_ns_after + slack


def overflow_socket(bus: SocketCanBus, peer_socket: socket.socket) -> None:
    """Send more frames than a small buffer can store, and then one more frame.

    The last frame carries the number of dropped frames.
    """
    with socket.socket(fileno=bus.fileno()) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.detach()
    for _ in range(2000):
        peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(1, 0, b""))
    while bus.drain():
        pass
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(1, 0, b""))
    wait_for_frames(bus, 1)


@pytest.mark.parametrize("fd_flag", [0, FDF])
def test_after_a_loss_frames_are_converted_as_batches_again(
    udp_bus: tuple[SocketCanBus, socket.socket], monkeypatch: pytest.MonkeyPatch, fd_flag: int
) -> None:
    """Reproduce a defect: after a lost frame, the bus converted all later frames one by one instead of in batches.

    The conversion of frames one by one is slower than the conversion of a batch.

    Linux adds the counter of lost frames to each frame that follows a loss.
    """
    bus, peer_socket = udp_bus
    time.sleep(TIME_STAMP_DELAY_S)
    convert_one_by_one = bus._convert_one_by_one
    calls = []
    monkeypatch.setattr(
        bus, "_convert_one_by_one", lambda *words: calls.append(words) or convert_one_by_one(*words)
    )
    for _ in range(2):
        overflow_socket(bus, peer_socket)
        assert [kind for kind, _, _ in bus.take_events()] == ["dropped"]
        calls.clear()
        for number in range(40):
            data = bytes([number] * (number % 9))
            peer_socket.send(
                FD_FRAME_STRUCT.pack(number, len(data), FDF, data)
                if fd_flag
                else CLASSICAL_FRAME_STRUCT.pack(number, len(data), data)
            )
            (frame,) = wait_for_frames(bus, 1)
            assert frame[:4] == (number, data, fd_flag, 1)
            assert frame.t_ns > time.monotonic_ns() - 10**9
        # handctl converts a frame separately if it arrives more than MAX_STAMP_STEP_NS after the
        # last frame.
        assert len(calls) < 20
        assert bus.take_events() == []


def test_frames_that_overflow_the_socket_are_counted(
    udp_bus: tuple[SocketCanBus, socket.socket],
) -> None:
    bus, peer_socket = udp_bus
    with socket.socket(fileno=bus.fileno()) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.detach()
    sent = 0
    received = 0
    dropped = []
    for _ in range(3):
        for number in range(2000):
            peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(number & 0x7FF, 0, b""))
        received += len(bus.drain())
        # this frame carries the number of dropped frames
        peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(0, 0, b""))
        received += len(wait_for_frames(bus, 1))
        sent += 2001
        dropped += [number for kind, _, number in bus.take_events() if kind == "dropped"]
        assert 0 < received < sent
        assert received + sum(dropped) == sent
    assert len(dropped) == 3
    assert bus.take_events() == []


def test_a_full_queue_refuses_without_waiting() -> None:
    near, peer_socket = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    bus = SocketCanBus(near, "socketcan:test", 0, convert_time=int)
    with peer_socket:
        peer_socket.setblocking(False)
        accepted = bus.send([Frame(number, b"") for number in range(1000)])
        assert 0 < accepted < 1000
        assert bus.take_events() == [("enobufs", "socketcan:test", 1000 - accepted)]
        arrived = [CLASSICAL_FRAME_STRUCT.unpack(peer_socket.recv(100))[0] for _ in range(accepted)]
        assert arrived == list(range(accepted))
    bus.close()


def test_a_broken_socket_is_an_event(udp_bus: tuple[SocketCanBus, socket.socket]) -> None:
    bus, peer_socket = udp_bus
    peer_socket.close()
    bus.send([Frame(1, b"")])  # this call of ``send`` makes the next call of ``drain`` fail
    assert bus.drain() == []
    assert bus.take_events() == [("enodev", "socketcan:test", 1)]
    for _ in range(3):
        bus.send([Frame(1, b"")])
        assert bus.drain() == []
    assert {kind for kind, _, _ in bus.take_events()} <= {"enodev", "enobufs"}


def test_error_frames_become_events(udp_bus: tuple[SocketCanBus, socket.socket]) -> None:
    bus, peer_socket = udp_bus
    peer_socket.send(
        CLASSICAL_FRAME_STRUCT.pack(ERROR_FLAG | 0x04, 8, bytes((0, 0x20, 0, 0, 0, 0, 0, 0)))
    )
    peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(3, 0, b""))
    assert [frame.can_id for frame in wait_for_frames(bus, 1)] == [3]
    assert ("error_passive", "socketcan:test", 1) in bus.take_events()
