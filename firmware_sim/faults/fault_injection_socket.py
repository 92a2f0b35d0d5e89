"""The socket through which a user injects faults into a running simulator.

Each request and each answer is one datagram.
"""

import json
import socket
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.description.hand_description import SimulatorError

if TYPE_CHECKING:  # The program ``bus`` must not import the modules for faults and for the plant.
    from firmware_sim.clock.simulation_pace import PaceMeter
    from firmware_sim.faults.active_faults import ActiveFaults

MAX_REQUEST_BYTES = 4096
"""Maximum length of a request to the fault socket [bytes]."""


def is_socket_served(path: Path) -> bool:
    """Return True if a running simulator listens on the fault socket at the given path."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


class FaultInjectionSocket:
    """A Unix datagram socket that receives requests in JSON and answers each request with a JSON object.

    A request is ``{"inject": TEXT}``, ``{"list": true}``, ``{"kinds": true}`` or ``{"pace":
    true}``.
    """

    def __init__(self, path: Path, faults: "ActiveFaults") -> None:
        """Open the fault socket.

        Args:
            path: path of the socket's file.
            faults: faults of the simulated hand.

        Raises:
            SimulatorError: the socket cannot be created.
        """
        self._path = path
        self._faults = faults
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        path.unlink(missing_ok=True)
        try:
            self._socket.bind(str(path))
        except OSError as error:
            self._socket.close()
            raise SimulatorError(f"fault socket {path}: {error.strerror}") from error

    def read_sockets(self) -> list[socket.socket]:
        """Return the sockets to poll for reading."""
        return [self._socket]

    def serve(self, pace: "PaceMeter | None" = None) -> None:
        """Answer all requests that are waiting in the socket.

        Args:
            pace: measured pace of the simulator, or None for a program that does not measure its
                pace.
        """
        while True:
            try:
                request_bytes, client = self._socket.recvfrom(MAX_REQUEST_BYTES)
            except (BlockingIOError, ConnectionError):
                return
            answer = json.dumps(self._answer_request(request_bytes, pace)).encode()
            if client:
                try:
                    self._socket.sendto(answer, client)
                except OSError:
                    continue  # The client that sent the request has ended, or the queue of the client's socket is full.

    def _answer_request(self, request_bytes: bytes, pace: "PaceMeter | None") -> dict[str, object]:
        """Carry out one request of a client, and return the answer to the client."""
        try:
            request = json.loads(request_bytes)
        except ValueError:
            request = None
        if isinstance(request, dict) and isinstance(request.get("inject"), str):
            try:
                self._faults.inject(request["inject"])
            except SimulatorError as error:
                return {"error": str(error)}
        elif isinstance(request, dict) and request.get("kinds"):
            return {"kinds": self._faults.describe_kinds()}
        elif isinstance(request, dict) and request.get("pace") and pace:
            return {"pace": pace.report(self._faults.t_ns - self._faults.slip_ns)}
        elif not isinstance(request, dict) or not request.get("list"):
            return {"error": 'expected {"inject": TEXT}, {"list": true} or {"kinds": true}'}
        return {
            "faults": self._faults.fault_states()[-20:],
            "t_ns": self._faults.t_ns,
            "slip_ns": self._faults.slip_ns,
        }

    def close(self) -> None:
        """Close the fault socket, and remove the file of the socket."""
        self._socket.close()
        self._path.unlink(missing_ok=True)
