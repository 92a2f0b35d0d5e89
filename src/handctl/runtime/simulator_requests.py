"""Requests to a running simulator, for example to inject a fault."""

import json
import os
import socket
from pathlib import Path
from typing import Any

from handctl.errors import BusError, ConfigError
from handctl.runtime.buses.bus_opening import check_bus_spec
from handctl.runtime.socket_paths import faults_path, is_socket_served, run_dir

ANSWER_TIMEOUT_S = 5.0
"""Longest wait for the answer of a simulator [s]."""
MAX_ANSWER_BYTES = 1 << 18
"""Longest answer of a simulator [bytes]."""


def find_simulator(bus: str | None) -> Path:
    """Return the path of the socket on which a simulator receives requests.

    If ``bus`` is None, the path belongs to the only running simulator.

    Raises:
        BusError: ``bus`` is None, and either no simulator or more than one simulator is running.
        ConfigError: ``bus`` is not a valid bus specification.
    """
    if bus is not None:
        check_bus_spec(bus)
        return faults_path(bus)
    socket_paths = sorted(run_dir().glob("*.faults"))
    if len(socket_paths) != 1:
        running_text = ", ".join(path.stem.replace("_", ":", 1) for path in socket_paths) or "none"
        raise BusError(
            f"simulators that run: {running_text}",
            "--bus",
            "the bus of one, as in --bus local:demo",
        )
    return socket_paths[0]


def simulated_time_scale(bus: str) -> float | None:
    """Return the time scale of the simulator on a bus.

    If no simulator on this machine serves the bus, return None.

    Raises:
        BusError: the simulator does not answer.
        ConfigError: ``bus`` is not a valid bus specification.
    """
    path = find_simulator(bus)
    if not is_socket_served(path):
        return None
    pace: dict[str, float | None] = ask_simulator(path, {"pace": True}).get("pace", {})
    return pace.get("time_scale")


def ask_simulator(path: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Send a request to a simulator, and return the answer.

    Raises:
        BusError: no simulator answers.
        ConfigError: the simulator refuses the request, for example because it does not know the
            fault.
    """
    reply_path = run_dir() / f"asking-{os.getpid()}"
    reply_path.unlink(missing_ok=True)
    location = f"bus {path.stem.replace('_', ':', 1)}"  # the socket local_demo.faults belongs to the bus local:demo
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        try:
            asking.bind(str(reply_path))
            asking.settimeout(ANSWER_TIMEOUT_S)
            asking.sendto(json.dumps(request).encode(), str(path))
            answer: dict[str, Any] = json.loads(asking.recv(MAX_ANSWER_BYTES))
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno else "no answer"
            raise BusError(
                f"no simulator answers ({reason})", location, "a running handctl sim"
            ) from None
        finally:
            reply_path.unlink(missing_ok=True)
    if "error" in answer:
        raise ConfigError(str(answer["error"]), location)
    return answer
