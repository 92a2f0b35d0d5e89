"""Hubs that serve the local bus in tests.

The first kind of hub is the hub of the simulator, in a separate process. The second kind of hub
sends bytes that a test writes.
"""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

RUN_DIR_VARIABLE = "HANDCTL_RUN_DIR"


@contextmanager
def hub_process(bus_name: str, socket_folder: Path) -> Iterator[None]:
    """Run the hub of the simulator in a separate process.

    The hub serves ``local:NAME``. The socket of the hub is in the given folder.
    """
    words = [sys.executable, "-m", "firmware_sim", "bus", bus_name]
    environment = {**os.environ, RUN_DIR_VARIABLE: str(socket_folder)}
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("firmware_sim: ready")
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(20)


class ScriptedHub:
    """Hub of a local bus for one client. The test itself exchanges bytes with the client of the hub."""

    def __init__(self, socket_folder: Path, bus_name: str) -> None:
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(socket_folder / f"{bus_name}.bus"))
        self._listener.listen()

    def accept_client(self) -> socket.socket:
        """Accept the client, and return the socket through which the hub talks to the client."""
        link, _ = self._listener.accept()
        link.settimeout(20.0)
        return link

    def close(self) -> None:
        """Close the socket on which the hub accepts clients."""
        self._listener.close()


def frame_record(
    can_id: int, data: bytes = b"", frame_flags: int = 0, dropped_frames: int = 0
) -> bytes:
    """Build a record of the local bus byte by byte."""
    head = (
        can_id.to_bytes(4, "little")
        + bytes((len(data), frame_flags))
        + (dropped_frames & 0xFFFF).to_bytes(2, "little")
    )
    return head + data + bytes(64 - len(data))
