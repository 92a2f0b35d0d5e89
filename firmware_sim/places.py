"""Where sockets and truth files of this user lie."""

import os
import tempfile
from pathlib import Path

from firmware_sim.description import SimulatorError

_PATH_MAX = 103
"""Longest path of a Unix socket that every Unix takes [bytes]."""


def run_dir() -> Path:
    """Return the run directory, made if need be and closed to other users.

    Raises:
        SimulatorError: it cannot be made, or it belongs to somebody else.
    """
    base = os.environ.get("XDG_RUNTIME_DIR") or f"{tempfile.gettempdir()}/handctl-{os.getuid()}"
    folder = Path(os.environ.get("HANDCTL_RUN_DIR") or f"{base}/handctl")
    try:
        for path in (folder.parent, folder):
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise SimulatorError(f"run directory {folder}: {error.strerror}; HANDCTL_RUN_DIR names another") from error
    if folder.stat().st_uid != os.getuid():
        raise SimulatorError(f"run directory {folder} belongs to another user; HANDCTL_RUN_DIR names another")
    return folder


def bus_path(name: str) -> Path:
    """Return the socket of the hub of a local bus.

    Raises:
        SimulatorError: the name is no file name, or the path is too long for a socket.
    """
    if not name or "/" in name or name.startswith("."):
        raise SimulatorError(f"bus name {name!r}: expected a plain name, as in local:demo")
    path = run_dir() / f"{name}.bus"
    if len(os.fsencode(path)) > _PATH_MAX:
        raise SimulatorError(
            f"socket path {path}: longer than {_PATH_MAX} bytes; choose a shorter name or HANDCTL_RUN_DIR"
        )
    return path


def faults_path(spec: str) -> Path:
    """Return the socket on which a simulator on this bus takes faults; a joined bus counts as local."""
    return truth_path(spec).with_suffix(".faults")


def truth_path(spec: str) -> Path:
    """Return where the truth of a simulator on this bus is kept unless told otherwise; a joined bus counts as local."""
    name = spec.replace("join:", "local:", 1) if spec.startswith("join:") else spec
    return run_dir() / (name.replace(":", "_").replace("/", "_") + ".truth")
