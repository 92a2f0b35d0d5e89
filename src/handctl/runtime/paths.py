"""Paths of the sockets and truth files of this user, out of the reach of other users.

A user who can write in the folder of the sockets can take the place of a controller and receive its stop
request. The folder is therefore used only if no other user can change it or any folder above it. The
check walks from the root downwards, each step relative to the folder that was just checked. A checked
folder cannot be replaced later: only its owner, root, and users who can write in its parent could do
that, and the check has found these to be this user and root alone.
"""

import os
import pwd
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from handctl.errors import BusError

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
"""Mode bits by which group or others may write."""
OTHERS = stat.S_IRWXG | stat.S_IRWXO
"""Mode bits of group and others."""
PRIVATE = 0o700
"""Mode of a folder that handctl makes."""
OPEN_FLAGS = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC
"""Flags to open a folder above handctl's own. O_PATH needs no permission to read the folder."""
MAX_LINKS = 8
"""Symbolic links that the walk follows at most."""
RIGHT_FOLDER = "a folder that is yours alone (mode 0700); HANDCTL_RUN_DIR names another"


def run_dir() -> Path:
    """Return the folder for sockets after checking that no other user can change it. Make it if it is missing.

    The folder is HANDCTL_RUN_DIR, else XDG_RUNTIME_DIR/handctl, else TMP/handctl-UID/handctl.

    Raises:
        BusError: the folder cannot be made. Or the folder or one above it belongs to another user, is
            open to others, or is a link.
    """
    if override := os.environ.get("HANDCTL_RUN_DIR"):
        return _private(Path(override), 1)
    if base := os.environ.get("XDG_RUNTIME_DIR"):
        return _private(Path(base) / "handctl", 1)
    return _private(Path(tempfile.gettempdir()) / f"handctl-{os.geteuid()}" / "handctl", 2)


def _private(path: Path, private_parts: int, links: int = 0) -> Path:
    """Walk down to a folder, check each step, and make missing folders.

    Args:
        path: of the folder.
        private_parts: number of its last parts that are handctl's own. They must belong to this user.
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
                return _private(target.joinpath(*parts[number + 1 :]), private_parts, links + 1)
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
    """Return the state of a part of a path without following a link. Make a folder if the part is missing."""
    with suppress(FileNotFoundError):
        return os.stat(part, dir_fd=at, follow_symlinks=False)
    with suppress(FileExistsError):  # another process has made the folder meanwhile, and it is checked like any other
        os.mkdir(part, PRIVATE, dir_fd=at)
    return os.stat(part, dir_fd=at, follow_symlinks=False)


def _refuse_shared(here: Path, at: int) -> None:
    """Refuse a folder of handctl that others own or can write in. Make a readable one private."""
    state = os.fstat(at)
    if state.st_uid != os.geteuid():
        raise BusError(f"belongs to {_user_name(state.st_uid)}", str(here), RIGHT_FOLDER)
    if state.st_mode & OTHERS_WRITE:
        raise BusError(f"is open to others (mode {stat.S_IMODE(state.st_mode):04o})", str(here), RIGHT_FOLDER)
    if state.st_mode & OTHERS:
        os.fchmod(at, PRIVATE)


def _refuse_unsafe(here: Path, at: int) -> None:
    """Refuse a folder above handctl's in which others could replace handctl's folder.

    The sticky bit is enough: with it, as on /tmp, only the owner of an entry can replace it.
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
    """Turn a bus specification into a file name."""
    return spec.replace(":", "_").replace("/", "_")


def local_bus_path(name: str) -> Path:
    """Return the socket of the hub of ``local:NAME``."""
    return run_dir() / f"{name}.bus"


def mailbox_path(spec: str) -> Path:
    """Return the socket on which the controller of a bus takes requests."""
    return run_dir() / f"{_file_name(spec)}.requests"


def targets_path(spec: str) -> Path:
    """Return the socket on which the controller of a bus takes streamed targets."""
    return run_dir() / f"{_file_name(spec)}.targets"


def observations_path(spec: str) -> Path:
    """Return the file of shared memory in which the controller of a bus writes its observations."""
    return run_dir() / f"{_file_name(spec)}.observations"


def watcher_path(number: int) -> Path:
    """Return the socket on which this process receives the status lines of one watched controller."""
    return run_dir() / f"watcher-{os.getpid()}-{number}"


def faults_path(spec: str) -> Path:
    """Return the socket on which the simulator of a bus takes faults."""
    return run_dir() / f"{_file_name(spec)}.faults"


def truth_path(spec: str) -> Path:
    """Return the default truth file of the simulator of a bus."""
    return run_dir() / f"{_file_name(spec)}.truth"
