"""Test the bytes of frames on a Linux CAN socket.

The tests also cover a CAN interface that refuses frames. The tests in the folder tests/vcan use
real CAN interfaces.
"""

import errno
import os
import socket

import pytest

from firmware_sim.bus.frame import BRS, FDF, Frame
from firmware_sim.bus.socketcan import SocketCanPort
from firmware_sim.description.hand_description import SimulatorError

CLASSICAL_FRAME_BYTES = bytes.fromhex("23010000 03 000000 0102030000000000")
FD_FRAME_BYTES = bytes.fromhex("debc1a80 0c 05 0000") + bytes(range(12)) + bytes(52)
FD_FRAME = Frame(1 << 31 | 0x1ABCDE, bytes(range(12)), FDF | BRS)


class FakeSocket:
    """Fake raw CAN socket, with which a test takes the role of the Linux kernel."""

    def __init__(self) -> None:
        self.waiting: list[bytes | OSError] = []
        self.sent: list[bytes] = []
        self.refusal: OSError | None = None
        self.bound: object = None

    def setsockopt(self, *_: int) -> None: ...

    def setblocking(self, flag: bool) -> None:
        assert not flag

    def bind(self, address: tuple[str]) -> None:
        if self.refusal:
            raise self.refusal
        self.bound = address

    def recv(self, size: int) -> bytes:
        assert size >= 72
        if not self.waiting:
            raise BlockingIOError
        datagram = self.waiting.pop(0)
        if isinstance(datagram, OSError):
            raise datagram
        return datagram

    def send(self, raw: bytes) -> int:
        if self.refusal:
            raise self.refusal
        self.sent.append(raw)
        return len(raw)

    def close(self) -> None:
        self.bound = None


def os_error(error_number: int) -> OSError:
    return OSError(error_number, os.strerror(error_number))


@pytest.fixture
def fake_socket(monkeypatch: pytest.MonkeyPatch) -> FakeSocket:
    kernel = FakeSocket()
    for name in ("AF_CAN", "CAN_RAW", "SOL_CAN_RAW", "CAN_RAW_FD_FRAMES"):
        monkeypatch.setattr(socket, name, getattr(socket, name, 0), raising=False)
    monkeypatch.setattr(socket, "socket", lambda *_: kernel)
    return kernel


def test_classical_and_fd_frames_from_the_kernel(fake_socket: FakeSocket) -> None:
    port = SocketCanPort("vcan7", 2)
    assert fake_socket.bound == ("vcan7",)
    fake_socket.waiting = [CLASSICAL_FRAME_BYTES, FD_FRAME_BYTES]
    assert port.receive(port.read_sockets()) == [
        Frame(0x123, b"\x01\x02\x03", 0, 2),
        FD_FRAME._replace(bus=2),
    ]


def test_an_fd_frame_is_recognised_by_its_size_without_the_flag(fake_socket: FakeSocket) -> None:
    port = SocketCanPort("vcan7", 0)
    fake_socket.waiting = [FD_FRAME_BYTES[:5] + b"\x00" + FD_FRAME_BYTES[6:]]
    assert port.receive(port.read_sockets())[0].flags == FDF


def test_classical_and_fd_frames_to_the_kernel(fake_socket: FakeSocket) -> None:
    SocketCanPort("vcan7", 0).send([Frame(0x123, b"\x01\x02\x03"), FD_FRAME])
    assert fake_socket.sent == [CLASSICAL_FRAME_BYTES, FD_FRAME_BYTES]


def test_only_ready_sockets_are_read(fake_socket: FakeSocket) -> None:
    fake_socket.waiting = [CLASSICAL_FRAME_BYTES]
    assert SocketCanPort("vcan7", 0).receive([]) == []


def test_a_full_queue_and_an_interface_that_is_down_count_as_losses(
    fake_socket: FakeSocket,
) -> None:
    port = SocketCanPort("vcan7", 0)
    fake_socket.refusal = os_error(errno.ENOBUFS)
    port.send([FD_FRAME])
    assert port.lost_frame_count == 1
    fake_socket.refusal, fake_socket.waiting = (
        None,
        [os_error(errno.ENETDOWN), CLASSICAL_FRAME_BYTES],
    )
    assert port.receive(port.read_sockets()) == []
    assert len(port.receive(port.read_sockets())) == 1
    assert port.lost_frame_count == 2


def test_a_missing_interface_comes_with_the_command(fake_socket: FakeSocket) -> None:
    fake_socket.refusal = os_error(errno.ENODEV)
    with pytest.raises(SimulatorError, match="ip link add dev can9 type vcan"):
        SocketCanPort("can9", 0)
