"""Paths of the sockets and truth files of this user, protected against other users.

A user who can write in the folder of the sockets could replace the socket of a controller and
receive its stop request. The folder is therefore used only if no other user can change it or any
folder above it. The check walks from the root downwards, each step relative to the folder that was
just checked. Only the owner of a folder, root, and users who can write in its parent can replace
the folder. The check makes sure that these are only this user and root, so a checked folder cannot
be replaced later.
"""

import os
import pwd
import socket
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from handctl.errors import BusError

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
"""Permission bits for writing by group or others."""
GROUP_AND_OTHERS = stat.S_IRWXG | stat.S_IRWXO
"""Permission bits of group and others."""
PRIVATE_MODE = 0o700
"""Permission bits of a folder created by handctl."""
OPEN_FLAGS = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC
"""Flags to open a parent folder. With O_PATH no permission to read the folder is needed."""
MAX_LINKS = 8
"""Largest number of symbolic links to follow."""
RIGHT_FOLDER = "a folder that only you can access (mode 0700); HANDCTL_RUN_DIR names another"


def run_dir() -> Path:
    """Return the folder for sockets, after a check that no other user can change the folder.

    A missing folder is created.

    The folder is HANDCTL_RUN_DIR, else XDG_RUNTIME_DIR/handctl, else TMP/handctl-UID/handctl.

    Raises:
        BusError: the folder cannot be created, or the folder or a parent belongs to another user,
            is writable by others, or is a symbolic link.
    """
    if override := os.environ.get("HANDCTL_RUN_DIR"):
        return _private_folder(Path(override), 1)
    if base := os.environ.get("XDG_RUNTIME_DIR"):
        return _private_folder(Path(base) / "handctl", 1)
    return _private_folder(Path(tempfile.gettempdir()) / f"handctl-{os.geteuid()}" / "handctl", 2)


def _private_folder(path: Path, private_parts: int, links: int = 0) -> Path:
    """Walk from the root to a folder, check each folder on the way, and create missing folders.

    Args:
        path: path of the folder.
        private_parts: number of last parts of the path that must belong to this user.
        links: number of symbolic links followed so far.

    Raises:
        BusError: see ``run_dir``.
    """
    parts = Path(os.path.abspath(path)).parts
    here = Path(parts[0])
    at = os.open(parts[0], OPEN_FLAGS)
    try:
        for number, part in enumerate(parts[1:], 1):
            here /= part
            private = number >= len(parts) - private_parts
            state = _stat_or_make(part, at)
            if stat.S_ISLNK(state.st_mode):
                if private or state.st_uid != 0 or links == MAX_LINKS:  # only links of root pass, as /tmp on macOS
                    raise BusError("is a link", str(here), RIGHT_FOLDER)
                target = here.parent / os.readlink(part, dir_fd=at)
                return _private_folder(target.joinpath(*parts[number + 1 :]), private_parts, links + 1)
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC if private else OPEN_FLAGS
            below = os.open(part, flags | os.O_NOFOLLOW, dir_fd=at)  # relative: a renamed parent changes nothing
            os.close(at)
            at = below
            (_refuse_shared if private else _refuse_unsafe)(here, at)
    except OSError as error:
        raise BusError(f"cannot be used: {error.strerror}", str(here), RIGHT_FOLDER) from None
    finally:
        os.close(at)
    return Path(os.path.abspath(path))


def _stat_or_make(part: str, at: int) -> os.stat_result:
    """Return the status of a part of a path without following a link.

    A missing part is created as a folder.
    """
    with suppress(FileNotFoundError):
        return os.stat(part, dir_fd=at, follow_symlinks=False)
    with suppress(FileExistsError):  # another process has made the folder meanwhile, and it is checked like any other
        os.mkdir(part, PRIVATE_MODE, dir_fd=at)
    return os.stat(part, dir_fd=at, follow_symlinks=False)


def _refuse_shared(here: Path, at: int) -> None:
    """Raise an error if others own or can write in a folder of handctl.

    A folder readable by others is made private.
    """
    state = os.fstat(at)
    if state.st_uid != os.geteuid():
        raise BusError(f"belongs to {_user_name(state.st_uid)}", str(here), RIGHT_FOLDER)
    if state.st_mode & OTHERS_WRITE:
        raise BusError(f"is open to others (mode {stat.S_IMODE(state.st_mode):04o})", str(here), RIGHT_FOLDER)
    if state.st_mode & GROUP_AND_OTHERS:
        os.fchmod(at, PRIVATE_MODE)


def _refuse_unsafe(here: Path, at: int) -> None:
    """Raise an error if others could replace handctl's folder in a parent folder.

    A parent folder with the sticky bit, such as /tmp, is safe: only the owner of an entry can
    replace the entry.
    """
    state = os.fstat(at)
    if state.st_uid not in (0, os.geteuid()):
        raise BusError(f"belongs to {_user_name(state.st_uid)}", str(here), RIGHT_FOLDER)
    if state.st_mode & OTHERS_WRITE and not state.st_mode & stat.S_ISVTX:
        raise BusError(f"is open to others (mode {stat.S_IMODE(state.st_mode):04o})", str(here), RIGHT_FOLDER)


def _user_name(number: int) -> str:
    """Return the name of a user, or the number if the user has no name here."""
    with suppress(KeyError):
        return f"user {pwd.getpwuid(number).pw_name}"
    return f"user {number}"


def _file_name(spec: str) -> str:
    """Return a bus specification converted to a file name."""
    return spec.replace(":", "_").replace("/", "_")


def local_bus_path(name: str) -> Path:
    """Return the path of the hub's socket for ``local:NAME``."""
    return run_dir() / f"{name}.bus"


def mailbox_path(spec: str) -> Path:
    """Return the path of the socket that receives requests to the controller of a bus."""
    return run_dir() / f"{_file_name(spec)}.requests"


def targets_path(spec: str) -> Path:
    """Return the path of the socket that receives streamed targets for the controller of a bus."""
    return run_dir() / f"{_file_name(spec)}.targets"


def observations_path(spec: str) -> Path:
    """Return the path of the shared-memory file with the observations of the controller of a bus."""
    return run_dir() / f"{_file_name(spec)}.observations"


def watcher_path(number: int) -> Path:
    """Return the path of the socket on which this process receives the status lines of a controller."""
    return run_dir() / f"watcher-{os.getpid()}-{number}"


def faults_path(spec: str) -> Path:
    """Return the path of the socket that receives fault requests to the simulator of a bus."""
    return run_dir() / f"{_file_name(spec)}.faults"


def truth_path(spec: str) -> Path:
    """Return the default path of the truth file of the simulator of a bus."""
    return run_dir() / f"{_file_name(spec)}.truth"


def clock_path(spec: str) -> Path:
    """Return the path of the file with the clock that the simulator of a bus shares with its controller."""
    return run_dir() / f"{_file_name(spec)}.clock"


def is_served(path: Path) -> bool:
    """Return True if a process takes datagrams at the path of a socket.

    A socket left from a killed process does not count.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
