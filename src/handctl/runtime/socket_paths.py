"""Paths of the sockets and shared files of a user's runs.

The paths are protected against other users of the machine.

A user who can write into the folder of the sockets could replace the socket of a controller, and
would receive the stop requests to the controller. Therefore the folder of the sockets is used only
if no other user can change this folder or any folder above it. The check of the folders begins at
the root folder and goes down. Each folder is opened relative to its parent folder, which has just
been checked. Three kinds of users can replace a folder: its owner, root, and every user who can
write into the parent folder. The check makes sure that only root and this user can replace the
folder. No other user can therefore replace a folder after the check of this folder.
"""

import os
import pwd
import socket
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from handctl.errors import BusError

WRITABLE_BY_OTHERS_MODE = stat.S_IWGRP | stat.S_IWOTH
"""Permission bits that allow the group or other users to write."""
GROUP_AND_OTHERS_PERMISSIONS = stat.S_IRWXG | stat.S_IRWXO
"""All permission bits of the group and of other users."""
PRIVATE_FOLDER_MODE = 0o700
"""Permission bits of folders created by handctl."""
FOLDER_OPEN_FLAGS = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC
"""Flags to open a parent folder.

With O_PATH, a folder can be opened without permission to read it.
"""
MAX_SYMBOLIC_LINKS = 8
"""Largest number of symbolic links that are followed on the way to a folder."""
PRIVATE_FOLDER_TEXT = "a folder that only you can access (mode 0700); HANDCTL_RUN_DIR names another"


def run_dir() -> Path:
    """Return the folder for the sockets, after a check that no other user can change the folder.

    A missing folder is created.

    If the environment variable HANDCTL_RUN_DIR is set, it names the folder. If only XDG_RUNTIME_DIR
    is set, the folder is XDG_RUNTIME_DIR/handctl. If neither variable is set, the folder is
    handctl-UID/handctl in the folder for temporary files.

    Raises:
        BusError: the folder cannot be created, or the folder or a parent belongs to another user,
            is writable by others, or is a symbolic link. Symbolic links that root has made in
            parent folders are allowed and followed.
    """
    if override := os.environ.get("HANDCTL_RUN_DIR"):
        return _private_folder(Path(override), 1)
    if base := os.environ.get("XDG_RUNTIME_DIR"):
        return _private_folder(Path(base) / "handctl", 1)
    return _private_folder(Path(tempfile.gettempdir()) / f"handctl-{os.geteuid()}" / "handctl", 2)


def _private_folder(path: Path, private_path_parts: int, link_count: int = 0) -> Path:
    """Check each folder from the root folder to a given folder, and create missing folders.

    Args:
        path: path of the folder.
        private_path_parts: number of parts at the end of the path that must belong to this user.
        link_count: number of symbolic links followed so far.

    Raises:
        BusError: see ``run_dir``.
    """
    folder_names = Path(os.path.abspath(path)).parts
    folder = Path(folder_names[0])
    folder_fd = os.open(folder_names[0], FOLDER_OPEN_FLAGS)
    try:
        for number, folder_name in enumerate(folder_names[1:], 1):
            folder /= folder_name
            is_private = number >= len(folder_names) - private_path_parts
            state = _stat_or_make_folder(folder_name, folder_fd)
            if stat.S_ISLNK(state.st_mode):
                # Only symbolic links that root has created are followed, such as /tmp on macOS.
                if is_private or state.st_uid != 0 or link_count == MAX_SYMBOLIC_LINKS:
                    raise BusError("is a link", str(folder), PRIVATE_FOLDER_TEXT)
                target = folder.parent / os.readlink(folder_name, dir_fd=folder_fd)
                return _private_folder(
                    target.joinpath(*folder_names[number + 1 :]), private_path_parts, link_count + 1
                )
            flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC if is_private else FOLDER_OPEN_FLAGS
            # The folder name is relative to the parent folder that has been checked. A new name of
            # the parent folder therefore has no effect on the opened folder.
            child_fd = os.open(folder_name, flags | os.O_NOFOLLOW, dir_fd=folder_fd)
            os.close(folder_fd)
            folder_fd = child_fd
            (_refuse_shared_folder if is_private else _refuse_unsafe_folder)(folder, folder_fd)
    except OSError as error:
        raise BusError(
            f"cannot be used: {error.strerror}", str(folder), PRIVATE_FOLDER_TEXT
        ) from None
    finally:
        os.close(folder_fd)
    return Path(os.path.abspath(path))


def _stat_or_make_folder(folder_name: str, parent_fd: int) -> os.stat_result:
    """Return the file status of a part of a path. A symbolic link is not followed.

    If the part of the path does not exist, the function creates a folder.
    """
    with suppress(FileNotFoundError):
        return os.stat(folder_name, dir_fd=parent_fd, follow_symlinks=False)
    # If another process creates the folder at the same time, the folder is checked like any other
    # folder.
    with suppress(FileExistsError):
        os.mkdir(folder_name, PRIVATE_FOLDER_MODE, dir_fd=parent_fd)
    return os.stat(folder_name, dir_fd=parent_fd, follow_symlinks=False)


def _refuse_shared_folder(folder_path: Path, folder_fd: int) -> None:
    """Raise an error if another user owns a folder of handctl or can write into it.

    If other users can only read the folder, they lose the permission to read it.
    """
    state = os.fstat(folder_fd)
    if state.st_uid != os.geteuid():
        raise BusError(
            f"belongs to {_user_name(state.st_uid)}", str(folder_path), PRIVATE_FOLDER_TEXT
        )
    if state.st_mode & WRITABLE_BY_OTHERS_MODE:
        raise BusError(
            f"is open to others (mode {stat.S_IMODE(state.st_mode):04o})",
            str(folder_path),
            PRIVATE_FOLDER_TEXT,
        )
    if state.st_mode & GROUP_AND_OTHERS_PERMISSIONS:
        os.fchmod(folder_fd, PRIVATE_FOLDER_MODE)


def _refuse_unsafe_folder(folder_path: Path, folder_fd: int) -> None:
    """Raise an error if another user could replace the folder of handctl inside a given parent folder.

    A parent folder with the sticky bit, such as /tmp, is safe. In a folder with the sticky bit,
    only the owner of an entry can replace the entry.
    """
    state = os.fstat(folder_fd)
    if state.st_uid not in (0, os.geteuid()):
        raise BusError(
            f"belongs to {_user_name(state.st_uid)}", str(folder_path), PRIVATE_FOLDER_TEXT
        )
    if state.st_mode & WRITABLE_BY_OTHERS_MODE and not state.st_mode & stat.S_ISVTX:
        raise BusError(
            f"is open to others (mode {stat.S_IMODE(state.st_mode):04o})",
            str(folder_path),
            PRIVATE_FOLDER_TEXT,
        )


def _user_name(user_id: int) -> str:
    """Return the name of a user.

    If this machine has no name for the user, return the user's number as text.
    """
    with suppress(KeyError):
        return f"user {pwd.getpwuid(user_id).pw_name}"
    return f"user {user_id}"


def _file_name(spec: str) -> str:
    """Convert a bus specification to the first part of the file names of the bus's sockets and shared files."""
    return spec.replace(":", "_").replace("/", "_")


def local_bus_path(name: str) -> Path:
    """Return the path of the socket on which the hub of a simulator serves the bus ``local:NAME``."""
    return run_dir() / f"{name}.bus"


def mailbox_path(spec: str) -> Path:
    """Return the path of the socket that receives the requests to the controller on a bus."""
    return run_dir() / f"{_file_name(spec)}.requests"


def targets_path(spec: str) -> Path:
    """Return the path of the socket that receives the streamed targets for the controller on a bus."""
    return run_dir() / f"{_file_name(spec)}.targets"


def observations_path(spec: str) -> Path:
    """Return the path of the shared-memory file with the observations of the controller on a bus."""
    return run_dir() / f"{_file_name(spec)}.observations"


def watcher_path(watcher_number: int) -> Path:
    """Return the path of the socket on which this process receives the status lines of a controller."""
    return run_dir() / f"watcher-{os.getpid()}-{watcher_number}"


def faults_path(spec: str) -> Path:
    """Return the path of the socket that receives fault requests to the simulator on a bus."""
    return run_dir() / f"{_file_name(spec)}.faults"


def truth_path(spec: str) -> Path:
    """Return the default path of the truth file.

    The simulator on a bus writes the true values of the simulated hand into its truth file.
    """
    return run_dir() / f"{_file_name(spec)}.truth"


def clock_path(spec: str) -> Path:
    """Return the path of the clock file.

    With the clock file, the simulator on a bus shares its clock with the controller.
    """
    return run_dir() / f"{_file_name(spec)}.clock"


def is_socket_served(path: Path) -> bool:
    """Return True if a running process receives datagrams at the path of a socket.

    A socket that a killed process has left behind does not count.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
