"""Where sockets and truth files of this user lie."""

import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from firmware_sim.description import SimulatorError

_PRIVATE = 0o700
_PATH_MAX = 103
"""Longest path of a Unix socket that every Unix takes [bytes]."""


def run_dir() -> Path:
    """Return the run directory, made if need be, after checking that no other user can change it.

    Raises:
        SimulatorError: it cannot be made; or it, or a directory above it, is another user's, open to others, or a link.
    """
    if named := os.environ.get("HANDCTL_RUN_DIR"):
        folder, own = Path(named), 1
    elif base := os.environ.get("XDG_RUNTIME_DIR"):
        folder, own = Path(base, "handctl"), 1
    else:
        folder, own = Path(tempfile.gettempdir(), f"handctl-{os.geteuid()}", "handctl"), 2
    folder = Path(os.path.abspath(folder))
    folder = Path(os.path.realpath(_above(folder, own)), *folder.parts[-own:])
    try:
        for path in [*reversed(folder.parents), folder][1:]:  # downwards: what lies below a safe one cannot be swapped
            _check(path, mine=len(folder.parts) - len(path.parts) < own)
    except OSError as error:
        raise SimulatorError(f"run directory {folder}: {error.strerror}; HANDCTL_RUN_DIR names another") from error
    return folder


def _above(folder: Path, own: int) -> Path:
    """Return the directory above the run directory's own parts, no part of which may be a link, save the system's.

    Raises:
        SimulatorError: such a link.
    """
    above = folder.parents[own - 1]
    for path in (*above.parents, above):
        if path.is_symlink() and path.lstat().st_uid:
            raise _refusal(path, "is a link, and not the system's")
    return above


def _check(path: Path, mine: bool) -> None:
    """Make a missing directory, and refuse one that another user can change.

    Args:
        path: of the directory; what is above it has been checked.
        mine: whether it is the run directory's own, and nobody else's at all.

    Raises:
        SimulatorError: see ``run_dir``.
    """
    with suppress(FileExistsError):
        path.mkdir(mode=_PRIVATE)
    seen = path.lstat()
    if stat.S_ISLNK(seen.st_mode):
        raise _refusal(path, "is a link")
    if seen.st_uid != os.geteuid() and (mine or seen.st_uid):
        raise _refusal(path, f"belongs to another user ({seen.st_uid})")
    if seen.st_mode & 0o022 and (mine or not seen.st_mode & stat.S_ISVTX):
        raise _refusal(path, f"is open to others (mode {stat.S_IMODE(seen.st_mode):04o})")
    if mine and seen.st_mode & 0o077:
        path.chmod(_PRIVATE)


def _refusal(path: Path, why: str) -> SimulatorError:
    return SimulatorError(f"run directory {path}: {why}; expected one of mode 0700 that is yours; HANDCTL_RUN_DIR")


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
