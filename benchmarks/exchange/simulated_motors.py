"""Define the two buses of the exchange benchmark, each with simulated motors.

The benchmark subtracts the time of the simulated motors from the measured time.
"""

import os
import socket
import struct
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

CLASSICAL_FRAME_STRUCT = struct.Struct("=IB3x8s")
FD_FRAME_STRUCT = struct.Struct("=IBB2x64s")
FRAME_RECORD_STRUCT = struct.Struct("<IBBH64s")
CAN_FD_FLAG = 4
ReplyFunction = Callable[[int], tuple[int, bytes, int]]
"""Function that takes the number of a motor and returns the identifier, payload and flags of its reply frame.

The motors are numbered from 1.
"""


class LocalMotors:
    """Simulated motors that reply on a Unix socket. The motors replace the hub process of a local bus."""

    def __init__(self, bus_name: str) -> None:
        self.path = Path(os.environ["HANDCTL_RUN_DIR"]) / f"{bus_name}.bus"
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.listener.bind(str(self.path))
        self.listener.listen()
        self.link = None

    def send_replies(self, motor_count: int, reply_function: ReplyFunction) -> None:
        if self.link is None:
            self.link, _ = self.listener.accept()
        size = 0
        while size < motor_count * FRAME_RECORD_STRUCT.size:
            size += len(self.link.recv(1 << 16))
        answer_frames = [reply_function(i + 1) for i in range(motor_count)]
        self.link.sendall(
            b"".join(
                FRAME_RECORD_STRUCT.pack(can_id, len(data), flags, 0, data)
                for can_id, data, flags in answer_frames
            )
        )

    def close(self) -> None:
        if self.link:
            self.link.close()
        self.listener.close()
        self.path.unlink()


class VcanMotors:
    """Simulated motors that reply on a raw CAN socket."""

    def __init__(self, bus_name: str) -> None:
        self.link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.link.bind((bus_name,))
        self.link.settimeout(5.0)

    def send_replies(self, motor_count: int, reply_function: ReplyFunction) -> None:
        for _ in range(motor_count):
            self.link.recv(FD_FRAME_STRUCT.size)
        for i in range(motor_count):
            can_id, data, flags = reply_function(i + 1)
            fd = (
                FD_FRAME_STRUCT.pack(can_id, len(data), flags, data) if flags & CAN_FD_FLAG else b""
            )
            self.link.send(fd or CLASSICAL_FRAME_STRUCT.pack(can_id, len(data), data))

    def close(self) -> None:
        self.link.close()


BUS_SETTINGS_BY_KIND = {
    "local": (LocalMotors, "local", "b"),
    "vcan": (VcanMotors, "socketcan", "vcan0"),
}
"""For each kind of bus: the class of the simulated motors, and the interface and channel of python-can."""


@contextmanager
def open_simulated_motors(bus_kind: str):
    """Start simulated motors on a bus.

    Yield the simulated motors, and the two arguments with which python-can opens the bus: interface
    and channel.
    """
    motors_class, interface, channel = BUS_SETTINGS_BY_KIND[bus_kind]
    motors = motors_class(channel)
    try:
        yield motors, interface, channel
    finally:
        motors.close()
