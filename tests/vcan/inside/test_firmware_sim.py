"""Test the simulated drives and the simulated sensor node on real CAN sockets.

The expected frames were made from the fact sheets of the drives.
"""

import socket
import struct
import time
from collections.abc import Iterator

import pytest

CAN_FRAME_STRUCT = struct.Struct("=IB3x8s")
MOTOR_NODE_IDS = (1, 2, 3, 4)
SYNC_ID, TENSIONS_ID, REGISTERS_ID = 0x080, 0x1A0, 0x7FF
READ_REGISTER, REFRESH_FEEDBACK = 0x33, 0xCC
POSITION_RANGE_REGISTER, TORQUE_RANGE_REGISTER, WATCHDOG_REGISTER = 21, 23, 9
ENABLE_PAYLOAD = b"\xff" * 7 + b"\xfc"
DISABLED_STATE, ENABLED_STATE, COMMUNICATION_LOST_STATE = 0, 1, 0xD
RECEIVE_TIMEOUT_S = 20.0

pytestmark = pytest.mark.usefixtures("simulator")


class RawCanBus:
    """A raw CAN socket that can wait for a frame with a given identifier."""

    def __init__(self, can_socket: socket.socket) -> None:
        self.socket = can_socket

    def send(self, can_id: int, data: bytes) -> None:
        self.socket.send(CAN_FRAME_STRUCT.pack(can_id, len(data), data))

    def receive(self, can_id: int) -> bytes:
        end = time.monotonic() + RECEIVE_TIMEOUT_S
        while time.monotonic() < end:
            received_id, length, data = CAN_FRAME_STRUCT.unpack(
                self.socket.recv(CAN_FRAME_STRUCT.size)
            )
            if received_id == can_id:
                return bytes(data[:length])
        pytest.fail(f"no frame {can_id:#x} within {RECEIVE_TIMEOUT_S} s")

    def motor_state(self, node_id: int) -> int:
        """Send a refresh request to a motor, and return the state bits in the reply of the motor."""
        self.send(REGISTERS_ID, bytes([node_id, 0, REFRESH_FEEDBACK, 0, 0, 0, 0, 0]))
        return self.receive(node_id + 0x10)[0] >> 4

    def read_register(self, node_id: int, register_number: int) -> bytes:
        self.send(REGISTERS_ID, bytes([node_id, 0, READ_REGISTER, register_number, 0, 0, 0, 0]))
        reply = self.receive(node_id + 0x10)
        assert reply[:4] == bytes([node_id, 0, READ_REGISTER, register_number])
        return reply[4:]


@pytest.fixture
def bus() -> Iterator[RawCanBus]:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can_socket:
        can_socket.settimeout(RECEIVE_TIMEOUT_S)
        can_socket.bind(("vcan0",))
        yield RawCanBus(can_socket)


def test_every_drive_answers_a_refresh_as_disabled(bus: RawCanBus) -> None:
    for node in MOTOR_NODE_IDS:
        bus.send(REGISTERS_ID, bytes([node, 0, REFRESH_FEEDBACK, 0, 0, 0, 0, 0]))
        reply = bus.receive(node + 0x10)
        assert len(reply) == 8
        assert (reply[0] >> 4, reply[0] & 0xF) == (DISABLED_STATE, node)


def test_the_drives_hold_the_limits_of_the_hand_file(bus: RawCanBus) -> None:
    for node in MOTOR_NODE_IDS:
        assert bus.read_register(node, TORQUE_RANGE_REGISTER) == struct.pack("<f", 0.8)
        assert bus.read_register(node, POSITION_RANGE_REGISTER) == struct.pack("<f", 12.5)


@pytest.mark.parametrize("sync_counter", [0, 0x5A, 0xFF])
def test_a_sync_brings_the_tensions_of_that_moment(bus: RawCanBus, sync_counter: int) -> None:
    bus.send(SYNC_ID, bytes([sync_counter]))
    reply = bus.receive(TENSIONS_ID)
    assert len(reply) == 7  # the payload has a counter of 4 bits, and four channels of 12 bits each
    bits = int.from_bytes(reply, "little")
    assert bits & 0xF == sync_counter & 0xF
    assert bits >> 52 == 0
    raw = [bits >> (4 + 12 * channel) & 0xFFF for channel in range(4)]
    assert all(0 < value < 0xFFF for value in raw), raw


def test_a_drive_without_commands_drops_its_torque(bus: RawCanBus) -> None:
    node = MOTOR_NODE_IDS[0]
    bus.send(
        REGISTERS_ID, bytes([node, 0, 0x55, WATCHDOG_REGISTER]) + struct.pack("<I", 1000)
    )  # 50 ms, in units of 50 us
    bus.receive(node + 0x10)
    bus.send(node, ENABLE_PAYLOAD)
    assert bus.receive(node + 0x10)[0] >> 4 == ENABLED_STATE
    time.sleep(2.0)  # the test waits 200 ms of slowed time
    assert bus.motor_state(node) == COMMUNICATION_LOST_STATE
    assert bus.motor_state(MOTOR_NODE_IDS[1]) == DISABLED_STATE
