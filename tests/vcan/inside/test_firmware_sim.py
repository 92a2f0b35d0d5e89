"""Test the simulated drives and the simulated sensor node on real CAN sockets.

The frames were made from the fact sheets.
"""

import socket
import struct
import time
from collections.abc import Iterator

import pytest

FRAME = struct.Struct("=IB3x8s")
NODES = (1, 2, 3, 4)
SYNC, TENSIONS, REGISTERS = 0x080, 0x1A0, 0x7FF
READ, REFRESH = 0x33, 0xCC
POSITION_RANGE, TORQUE_RANGE, WATCHDOG = 21, 23, 9
ENABLE = b"\xff" * 7 + b"\xfc"
DISABLED, ENABLED, COMMUNICATION_LOST = 0, 1, 0xD
WAIT_S = 20.0

pytestmark = pytest.mark.usefixtures("simulator")


class Bus:
    """A raw CAN socket that can wait for a frame with a given identifier."""

    def __init__(self, opened: socket.socket) -> None:
        self.socket = opened

    def send(self, can_id: int, data: bytes) -> None:
        self.socket.send(FRAME.pack(can_id, len(data), data))

    def receive(self, can_id: int) -> bytes:
        end = time.monotonic() + WAIT_S
        while time.monotonic() < end:
            received_id, length, data = FRAME.unpack(self.socket.recv(FRAME.size))
            if received_id == can_id:
                return bytes(data[:length])
        pytest.fail(f"no frame {can_id:#x} within {WAIT_S} s")

    def state(self, node: int) -> int:
        """Send a refresh request to a motor, and return the state bits of its reply."""
        self.send(REGISTERS, bytes([node, 0, REFRESH, 0, 0, 0, 0, 0]))
        return self.receive(node + 0x10)[0] >> 4

    def register(self, node: int, number: int) -> bytes:
        self.send(REGISTERS, bytes([node, 0, READ, number, 0, 0, 0, 0]))
        reply = self.receive(node + 0x10)
        assert reply[:4] == bytes([node, 0, READ, number])
        return reply[4:]


@pytest.fixture
def bus() -> Iterator[Bus]:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as opened:
        opened.settimeout(WAIT_S)
        opened.bind(("vcan0",))
        yield Bus(opened)


def test_every_drive_answers_a_refresh_as_disabled(bus: Bus) -> None:
    for node in NODES:
        bus.send(REGISTERS, bytes([node, 0, REFRESH, 0, 0, 0, 0, 0]))
        reply = bus.receive(node + 0x10)
        assert len(reply) == 8
        assert (reply[0] >> 4, reply[0] & 0xF) == (DISABLED, node)


def test_the_drives_hold_the_limits_of_the_hand_file(bus: Bus) -> None:
    for node in NODES:
        assert bus.register(node, TORQUE_RANGE) == struct.pack("<f", 0.8)
        assert bus.register(node, POSITION_RANGE) == struct.pack("<f", 12.5)


@pytest.mark.parametrize("counter", [0, 0x5A, 0xFF])
def test_a_sync_brings_the_tensions_of_that_moment(bus: Bus, counter: int) -> None:
    bus.send(SYNC, bytes([counter]))
    reply = bus.receive(TENSIONS)
    assert len(reply) == 7  # a counter of 4 bits and four channels of 12
    bits = int.from_bytes(reply, "little")
    assert bits & 0xF == counter & 0xF
    assert bits >> 52 == 0
    raw = [bits >> (4 + 12 * channel) & 0xFFF for channel in range(4)]
    assert all(0 < value < 0xFFF for value in raw), raw


def test_a_drive_without_commands_drops_its_torque(bus: Bus) -> None:
    node = NODES[0]
    bus.send(
        REGISTERS, bytes([node, 0, 0x55, WATCHDOG]) + struct.pack("<I", 1000)
    )  # 50 ms, in 50 us
    bus.receive(node + 0x10)
    bus.send(node, ENABLE)
    assert bus.receive(node + 0x10)[0] >> 4 == ENABLED
    time.sleep(2.0)  # 200 ms of slowed time
    assert bus.state(node) == COMMUNICATION_LOST
    assert bus.state(NODES[1]) == DISABLED
