"""Where processes of one machine meet: sockets and truth files of this user, out of other users' reach."""

import os
import tempfile
from pathlib import Path


def run_dir() -> Path:
    """The directory for sockets: HANDCTL_RUN_DIR, else XDG_RUNTIME_DIR/handctl, else TMP/handctl-UID/handctl."""
    if override := os.environ.get("HANDCTL_RUN_DIR"):
        return Path(override)
    base = os.environ.get("XDG_RUNTIME_DIR") or f"{tempfile.gettempdir()}/handctl-{os.getuid()}"
    return Path(base) / "handctl"


def _flat(spec: str) -> str:
    return spec.replace(":", "_").replace("/", "_")


def local_bus_path(name: str) -> Path:
    """Socket of the hub of ``local:NAME``."""
    return run_dir() / f"{name}.bus"


def mailbox_path(spec: str) -> Path:
    """Socket on which the controller of a bus takes requests."""
    return run_dir() / f"{_flat(spec)}.requests"


def watcher_path(number: int) -> Path:
    """Socket on which this process gets status lines, one for each controller that it watches."""
    return run_dir() / f"watcher-{os.getpid()}-{number}"


def faults_path(spec: str) -> Path:
    """Socket on which a simulator on this bus takes faults."""
    return run_dir() / f"{_flat(spec)}.faults"


def truth_path(spec: str) -> Path:
    """Where a simulator on this bus keeps its truth, unless told otherwise."""
    return run_dir() / f"{_flat(spec)}.truth"
