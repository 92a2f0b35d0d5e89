"""Test the CAN sockets of Linux without any library.

The other test files in ``tests/vcan/inside`` rely on the CAN sockets that this file tests.
"""

import json
import socket
import struct
import subprocess

import pytest

from handctl.drives.frame import BRS, FDF

CLASSICAL_FRAME_FORMAT = struct.Struct("=IB3x8s")
FD_FRAME_FORMAT = struct.Struct("=IBB2x64s")


def raw_socket(interface: str) -> socket.socket:
    can_socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    can_socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    can_socket.settimeout(20.0)
    can_socket.bind((interface,))
    return can_socket


@pytest.mark.parametrize("interface", ["vcan0", "vcan1"])
def test_the_interface_is_up_and_carries_fd(interface: str) -> None:
    ip_output = subprocess.run(
        ["ip", "-json", "link", "show", interface], capture_output=True, check=True
    ).stdout
    (state,) = json.loads(ip_output)
    assert state["mtu"] == FD_FRAME_FORMAT.size
    assert "UP" in state["flags"]


@pytest.mark.parametrize("payload_length", [0, 1, 8])
def test_a_classical_frame_arrives_as_sent(payload_length: int) -> None:
    data = bytes(range(payload_length))
    with raw_socket("vcan0") as sender, raw_socket("vcan0") as receiver:
        sender.send(CLASSICAL_FRAME_FORMAT.pack(0x123, payload_length, data))
        assert receiver.recv(FD_FRAME_FORMAT.size) == CLASSICAL_FRAME_FORMAT.pack(
            0x123, payload_length, data
        )


@pytest.mark.parametrize("payload_length", [0, 12, 64])
def test_an_fd_frame_arrives_as_sent(payload_length: int) -> None:
    frame_bytes = FD_FRAME_FORMAT.pack(
        0x12345678 | socket.CAN_EFF_FLAG, payload_length, BRS | FDF, bytes(range(payload_length))
    )
    with raw_socket("vcan0") as sender, raw_socket("vcan0") as receiver:
        sender.send(frame_bytes)
        assert receiver.recv(FD_FRAME_FORMAT.size) == frame_bytes


def test_frames_of_one_bus_do_not_reach_the_other() -> None:
    with (
        raw_socket("vcan0") as sender,
        raw_socket("vcan0") as same_bus_socket,
        raw_socket("vcan1") as other_socket,
    ):
        sender.send(CLASSICAL_FRAME_FORMAT.pack(1, 0, b""))
        assert len(same_bus_socket.recv(FD_FRAME_FORMAT.size)) == CLASSICAL_FRAME_FORMAT.size
        other_socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            other_socket.recv(FD_FRAME_FORMAT.size)
