"""Where processes of one machine meet: sockets and truth files of this user, out of other users' reach.

Whoever can write in the folder of the sockets can take a controller's place and receive the order to stop. So the
folder is used only if no other user can change it or any folder above it. The walk goes from the root downwards, each
step relative to the folder that was just checked. A checked folder stays what it is: only its owner, root, and whoever
may write in the one above it could replace it, and those were found to be this user and root alone.
"""

import os
import pwd
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from handctl.errors import BusError

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
OTHERS = stat.S_IRWXG | stat.S_IRWXO
PRIVATE = 0o700
LOOK = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC
"""To look at a folder above ours; O_PATH needs no permission to read it."""
MOST_LINKS = 8
A_FOLDER = "a folder that is yours alone (mode 0700); HANDCTL_RUN_DIR names another"


def run_dir() -> Path:
    """Return the folder for sockets, made if need be, after checking that no other user can change it.

    It is HANDCTL_RUN_DIR, else XDG_RUNTIME_DIR/handctl, else TMP/handctl-UID/handctl.

    Raises:
        BusError: it cannot be made, or it or a folder above it is another user's, open to others, or a link.
    """
    if override := os.environ.get("HANDCTL_RUN_DIR"):
        return _private(Path(override), 1)
    if base := os.environ.get("XDG_RUNTIME_DIR"):
        return _private(Path(base) / "handctl", 1)
    return _private(Path(tempfile.gettempdir()) / f"handctl-{os.geteuid()}" / "handctl", 2)


def _private(path: Path, own: int, links: int = 0) -> Path:
    """Walk down to a folder, making what is missing.

    Args:
        path: of the folder.
        own: how many of its last parts are handctl's own, and may be nobody else's.
        links: followed so far.

    Raises:
        BusError: see ``run_dir``.
    """
    parts = Path(os.path.abspath(path)).parts
    here, at = Path(parts[0]), os.open(parts[0], LOOK)
    try:
        for number, part in enumerate(parts[1:], 1):
            here /= part
            ours = number >= len(parts) - own
            found = _found(part, at)
            if stat.S_ISLNK(found.st_mode):
                if ours or found.st_uid != 0 or links == MOST_LINKS:  # the system's, as /tmp is on macOS
                    raise BusError("is a link", str(here), A_FOLDER)
                target = here.parent / os.readlink(part, dir_fd=at)
                return _private(target.joinpath(*parts[number + 1 :]), own, links + 1)
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC if ours else LOOK
            below = os.open(part, flags | os.O_NOFOLLOW, dir_fd=at)
            os.close(at)
            at = below
            (_refuse_shared if ours else _refuse_unsafe)(here, at)
    except OSError as error:
        raise BusError(f"cannot be used: {error.strerror}", str(here), A_FOLDER) from None
    finally:
        os.close(at)
    return Path(os.path.abspath(path))


def _found(part: str, at: int) -> os.stat_result:
    """Return the state of a part of a path, without following a link; make a missing one a folder of this user."""
    with suppress(FileNotFoundError):
        return os.stat(part, dir_fd=at, follow_symlinks=False)
    with suppress(FileExistsError):  # somebody else has made it meanwhile, and is looked at like any other
        os.mkdir(part, PRIVATE, dir_fd=at)
    return os.stat(part, dir_fd=at, follow_symlinks=False)


def _refuse_shared(here: Path, at: int) -> None:
    """Refuse a folder of handctl that others own or can write in; close one that they could only read."""
    seen = os.fstat(at)
    if seen.st_uid != os.geteuid():
        raise BusError(f"belongs to {_user(seen.st_uid)}", str(here), A_FOLDER)
    if seen.st_mode & OTHERS_WRITE:
        raise BusError(f"is open to others (mode {stat.S_IMODE(seen.st_mode):04o})", str(here), A_FOLDER)
    if seen.st_mode & OTHERS:
        os.fchmod(at, PRIVATE)


def _refuse_unsafe(here: Path, at: int) -> None:
    """Refuse a folder above handctl's in which others could put another one in its place."""
    seen = os.fstat(at)
    if seen.st_uid not in (0, os.geteuid()):
        raise BusError(f"belongs to {_user(seen.st_uid)}", str(here), A_FOLDER)
    if seen.st_mode & OTHERS_WRITE and not seen.st_mode & stat.S_ISVTX:
        raise BusError(f"is open to others (mode {stat.S_IMODE(seen.st_mode):04o})", str(here), A_FOLDER)


def _user(number: int) -> str:
    """Return a user's name, or the number of one that has none here."""
    with suppress(KeyError):
        return f"user {pwd.getpwuid(number).pw_name}"
    return f"user {number}"


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
