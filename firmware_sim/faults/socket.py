"""Where a running simulator takes faults: one datagram a question, answered to whoever asked."""

import json
import socket
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.description import SimulatorError

if TYPE_CHECKING:  # a bus alone has a server, too, but neither faults nor a plant
    from firmware_sim.faults.active import Faults
    from firmware_sim.pace import Pace

LONGEST = 4096
"""Bytes of a question."""


class FaultSocket:
    """A Unix datagram socket: a question in, a JSON object out.

    Questions are ``{"inject": TEXT}``, ``{"list": true}``, ``{"kinds": true}`` and ``{"pace": true}``.
    """

    def __init__(self, path: Path, faults: "Faults") -> None:
        """Args: where it lies; whose faults it takes.

        Raises:
            SimulatorError: it cannot be made.
        """
        self._path, self._faults = path, faults
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        path.unlink(missing_ok=True)
        try:
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            raise SimulatorError(f"fault socket {path}: {error.strerror}") from error

    def readers(self) -> list[socket.socket]:
        """Return what to wait on."""
        return [self._socket]

    def serve(self, pace: "Pace | None" = None) -> None:
        """Answer what has been asked, also for the pace."""
        while True:
            try:
                question, asker = self._socket.recvfrom(LONGEST)
            except (BlockingIOError, ConnectionError):
                return
            answer = json.dumps(self._answer(question, pace)).encode()
            if asker:
                try:
                    self._socket.sendto(answer, asker)
                except OSError:
                    continue  # whoever asked has gone, or its queue is full

    def _answer(self, question: bytes, pace: "Pace | None") -> dict[str, object]:
        try:
            asked = json.loads(question)
        except ValueError:
            asked = None
        if isinstance(asked, dict) and isinstance(asked.get("inject"), str):
            try:
                self._faults.inject(asked["inject"])
            except SimulatorError as error:
                return {"error": str(error)}
        elif isinstance(asked, dict) and asked.get("kinds"):
            return {"kinds": self._faults.kinds()}
        elif isinstance(asked, dict) and asked.get("pace") and pace:
            return {"pace": pace.told(self._faults.t_ns - self._faults.slip_ns)}
        elif not isinstance(asked, dict) or not asked.get("list"):
            return {"error": 'expected {"inject": TEXT}, {"list": true} or {"kinds": true}'}
        return {"faults": self._faults.told()[-20:], "t_ns": self._faults.t_ns, "slip_ns": self._faults.slip_ns}

    def close(self) -> None:
        """Take it away."""
        self._socket.close()
        self._path.unlink(missing_ok=True)
