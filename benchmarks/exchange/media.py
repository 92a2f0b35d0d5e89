"""The two buses that a tick's exchange is measured on, and the motors at their other end, which are not timed."""

import os
import socket
import struct
from contextlib import contextmanager
from pathlib import Path

CLASSICAL = struct.Struct("=IB3x8s")
RECORD = struct.Struct("<IBBH64s")
REPLY = bytes((0x11, 0x80, 0x10, 0x7F, 0xF8, 0x20, 30, 31))
"""Feedback of an enabled motor."""


class LocalMotors:
    """Answer on a Unix stream socket as the hub of a local bus does."""

    def __init__(self, name: str) -> None:
        self.path = Path(os.environ["HANDCTL_RUN_DIR"]) / f"{name}.bus"
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.listener.bind(str(self.path))
        self.listener.listen()
        self.link = None

    def answer(self, motors: int) -> None:
        if self.link is None:
            self.link, _ = self.listener.accept()
        size = 0
        while size < motors * RECORD.size:
            size += len(self.link.recv(1 << 16))
        self.link.sendall(b"".join(RECORD.pack(0x11 + i, 8, 0, 0, REPLY) for i in range(motors)))

    def close(self) -> None:
        if self.link:
            self.link.close()
        self.listener.close()
        self.path.unlink()


class VcanMotors:
    """Answer on a raw CAN socket."""

    def __init__(self, name: str) -> None:
        self.link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.link.bind((name,))
        self.link.settimeout(5.0)

    def answer(self, motors: int) -> None:
        for _ in range(motors):
            self.link.recv(16)
        for i in range(motors):
            self.link.send(CLASSICAL.pack(0x11 + i, 8, REPLY))

    def close(self) -> None:
        self.link.close()


MEDIA = {"local": (LocalMotors, "local", "b"), "vcan": (VcanMotors, "socketcan", "vcan0")}
"""Motors, interface, channel."""


@contextmanager
def motors_on(medium: str):
    """Motors, and the bus to reach them on."""
    made, interface, channel = MEDIA[medium]
    motors = made(channel)
    try:
        yield motors, interface, channel
    finally:
        motors.close()
