"""Paths of the sockets and truth files of the present user."""

import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from firmware_sim.description.hand_description import SimulatorError

_PRIVATE_FOLDER_MODE = 0o700
"""File mode of a directory with access only for the owner."""
_PATH_MAX = 103
"""Maximum length of a Unix socket's path that all operating systems allow [bytes]."""


def run_dir() -> Path:
    """Return the run directory, for the sockets and truth files of the user.

    The function creates a missing directory, and refuses a directory that other users can access.

    Raises:
        SimulatorError: the directory cannot be created. The error is also raised if the directory,
            or a directory above it, is a link, belongs to another user, or is open to other users.
    """
    if run_folder_name := os.environ.get("HANDCTL_RUN_DIR"):
        folder = Path(run_folder_name)
        path_parts = 1
    elif base := os.environ.get("XDG_RUNTIME_DIR"):
        folder = Path(base, "handctl")
        path_parts = 1
    else:
        folder = Path(tempfile.gettempdir(), f"handctl-{os.geteuid()}", "handctl")
        path_parts = 2
    folder = Path(os.path.abspath(folder))
    folder = Path(os.path.realpath(_parent_dir(folder, path_parts)), *folder.parts[-path_parts:])
    try:
        # The check starts at the highest directory of the path. In a directory that has passed the
        # check, no other user can replace an entry.
        for path in [*reversed(folder.parents), folder][1:]:
            _check_directory(path, is_private=len(folder.parts) - len(path.parts) < path_parts)
    except OSError as error:
        raise SimulatorError(
            f"run directory {folder}: {error.strerror}; HANDCTL_RUN_DIR names another"
        ) from error
    return folder


def _parent_dir(folder: Path, path_parts: int) -> Path:
    """Return the directory above the private directories in the path of the run directory.

    The last ``path_parts`` directories of the path ``folder`` are private.

    The path of the returned directory can contain symbolic links, but only links that belong to
    root.

    Raises:
        SimulatorError: a directory in the path is a link that belongs to a user.
    """
    parent = folder.parents[path_parts - 1]
    for path in (*parent.parents, parent):
        if path.is_symlink() and path.lstat().st_uid:
            raise _path_error(path, "is a link of a user")
    return parent


def _check_directory(path: Path, is_private: bool) -> None:
    """Create the directory if it is missing, and refuse a directory that another user can change.

    Args:
        path: path of a directory, whose parent directories have already been checked.
        is_private: True for a directory that no other user is allowed to access.

    Raises:
        SimulatorError: see ``run_dir``.
    """
    with suppress(FileExistsError):
        path.mkdir(mode=_PRIVATE_FOLDER_MODE)
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode):
        raise _path_error(path, "is a link")
    if status.st_uid != os.geteuid() and (is_private or status.st_uid):
        raise _path_error(path, f"belongs to another user ({status.st_uid})")
    # A directory in which other users are allowed to write is safe if it has the sticky bit. In a
    # directory with the sticky bit, such as /tmp, only the owner of an entry can replace the entry.
    if status.st_mode & 0o022 and (is_private or not status.st_mode & stat.S_ISVTX):
        raise _path_error(path, f"is open to others (mode {stat.S_IMODE(status.st_mode):04o})")
    if is_private and status.st_mode & 0o077:
        path.chmod(_PRIVATE_FOLDER_MODE)


def _path_error(path: Path, problem_text: str) -> SimulatorError:
    """Build the error for a directory that cannot be a run directory."""
    expected = (
        "expected a directory of mode 0700 that belongs to you; HANDCTL_RUN_DIR names another"
    )
    return SimulatorError(f"run directory {path}: {problem_text}; {expected}")


def bus_path(name: str) -> Path:
    """Return the path of the socket of a local bus.

    Raises:
        SimulatorError: the name is not a valid file name, or the path is too long for a socket.
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
    """Return the path of the socket through which faults are injected into the simulator on a given bus.

    The path is the same for the buses ``join:NAME`` and ``local:NAME``.
    """
    return truth_path(spec).with_suffix(".faults")


def truth_path(spec: str) -> Path:
    """Return the default path of the truth file of the simulator on a given bus.

    The path is the same for the buses ``join:NAME`` and ``local:NAME``.
    """
    name = spec.replace("join:", "local:", 1) if spec.startswith("join:") else spec
    return run_dir() / (name.replace(":", "_").replace("/", "_") + ".truth")


def clock_path(spec: str) -> Path:
    """Return the path of the file that contains the shared clock of the simulator on a given bus."""
    return truth_path(spec).with_suffix(".clock")
