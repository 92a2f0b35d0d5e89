"""Output files that are written atomically.

A program that reads the output finds either the complete old file or the complete new file.
"""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError

NO_HARD_LINK_ERRNOS = {errno.EPERM, errno.ENOTSUP, errno.ENOSYS}
"""Error numbers of file systems that have no hard links, such as FAT on a memory stick."""
LOG_SUFFIX, LOG_MAGIC = ".mcap", b"\x89MCAP0\r\n"
"""Suffix and first bytes of a log. An output never overwrites a log."""
FIGURE_SUFFIXES = {".png", ".svg", ".pdf"}
"""Suffixes that select the format of a figure. Every other suffix gives PNG."""


@contextmanager
def atomic_path(path: Path, must_be_new: bool = False) -> Iterator[Path]:
    """Yield a temporary path.

    When the new content is on the disk, the temporary file is moved to ``path``.

    Even after a power cut, the path leads to the complete old file or the complete new file. If the
    output fails, no temporary file remains. Symbolic links are followed. Output to an existing
    terminal or pipe is written directly.

    Args:
        path: path of the output.
        must_be_new: True to refuse a path that already exists.

    Raises:
        ConfigError: the path cannot be written.
        OSError: the content could not be written. The error message contains ``path`` instead of
            the temporary path.
    """
    target = _resolve_target(path, must_be_new)
    if target.exists() and not target.is_file():
        with _error_with_user_path(path, target), _check_pipe_reader(target, path):
            yield target
        return
    temporary_path = target.with_name(f".{os.getpid()}{target.suffix}")
    try:
        with _error_with_user_path(path, temporary_path):
            yield temporary_path
            if temporary_path.exists():
                _fsync_file(temporary_path)
                _move_into_place(temporary_path, target, must_be_new)
                _fsync_file(target.parent)
    finally:
        if temporary_path.is_dir():
            shutil.rmtree(temporary_path, ignore_errors=True)
        else:
            temporary_path.unlink(missing_ok=True)


def path_with_suffix(path: Path, suffix: str) -> Path:
    """Return the path of an output file.

    The returned path is the path of the source file with another suffix.

    Raises:
        ConfigError: the path has no file name, e.g. ``.`` or ``/``.
    """
    if not path.name:
        raise ConfigError("is a folder", str(path), "a file")
    return path.with_suffix(suffix)


def write_text_atomically(path: Path, text: str, must_be_new: bool = False) -> None:
    """Write text to a file atomically, see ``atomic_path``."""
    with atomic_path(path, must_be_new) as temporary_path:
        temporary_path.write_text(text, encoding="utf-8")


def save_figure(figure: Any, path: Path, dpi: int = 110) -> None:
    """Write a figure of matplotlib atomically, with the version of handctl in the metadata.

    For the rules and the errors, see ``atomic_path``.
    """
    creator_text = f"handctl {version('handctl')}"
    kind = path.suffix[1:] if path.suffix in FIGURE_SUFFIXES else "png"
    metadata = {
        "png": {"Software": creator_text},
        "svg": {"Creator": creator_text, "Date": None},
        "pdf": {"Creator": creator_text},
    }
    with atomic_path(path) as temporary_path:
        figure.savefig(temporary_path, dpi=dpi, format=kind, metadata=metadata[kind])


def check_output_path(path: Path, output_name: str, *read_paths: Path | None) -> None:
    """Check by the rules of ``atomic_path`` whether a command can write an output, before the command starts its work.

    Args:
        path: path of the output.
        output_name: name of the output in the error message, e.g. the name of the option.
        read_paths: paths of the input files of the same command.

    Raises:
        ConfigError: the path cannot be written, or is the path of an input file.
    """
    try:
        target = _resolve_target(path, False)
    except ConfigError as error:
        raise ConfigError(error.what, f"{output_name} {path}", error.right) from None
    if any(read_path and _is_same_file(target, read_path) for read_path in read_paths):
        raise ConfigError("is what is read", f"{output_name} {path}", "another name")


def _is_same_file(target: Path, other_path: Path) -> bool:
    """Return True if two paths lead to the same file. The files need not exist."""
    both_exist = target.exists() and other_path.exists()
    return (
        target.samefile(other_path) if both_exist else str(target) == os.path.realpath(other_path)
    )


def _resolve_target(path: Path, must_be_new: bool) -> Path:
    """Check the path of an output file, and return the path with all symbolic links resolved.

    If the path is a symbolic link, the result is the path of the file to which the link leads.
    """
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise ConfigError("no such folder", str(path), "a name in a folder that exists")
    if must_be_new and os.path.lexists(path):
        raise ConfigError("is there already", str(path), "a new name")
    if target.is_dir():
        raise ConfigError("is a folder", str(path), "a file")
    if target.is_file() and (target.suffix == LOG_SUFFIX or _is_log_file(target)):
        raise ConfigError("is a log", str(path), "another name: nothing is written over a log")
    return target


@contextmanager
def _check_pipe_reader(target: Path, path: Path) -> Iterator[None]:
    """Raise an error if a named pipe has no reader. Without a reader, the opening of the pipe would wait forever.

    The pipe stays open during the block. If the function closed the pipe, the reader would end.
    """
    if not target.is_fifo():
        yield
        return
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        if error.errno != errno.ENXIO:
            raise
        raise ConfigError("is a pipe that nobody reads", str(path), "a file") from None
    try:
        yield
    finally:
        os.close(descriptor)


def _is_log_file(path: Path) -> bool:
    """Return True if the content of a file begins like a log, whatever the name of the file is."""
    with suppress(PermissionError), path.open("rb") as file:
        return file.read(len(LOG_MAGIC)) == LOG_MAGIC
    return False


@contextmanager
def _error_with_user_path(path: Path, temporary_path: Path) -> Iterator[None]:
    """Replace the temporary path in errors by the path that the user has given."""
    try:
        yield
    except OSError as error:
        if error.filename not in (None, str(temporary_path), temporary_path):
            raise
        text = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, text, str(path)) from None


def _move_into_place(temporary_path: Path, target: Path, must_be_new: bool) -> None:
    """Move a finished file to the path of the output.

    If ``must_be_new`` is True, the function does not replace a file that another process has
    created in the meantime. On a file system without hard links, the function can replace such a
    file.
    """
    if must_be_new and temporary_path.is_file():
        try:
            os.link(temporary_path, target)
        except OSError as error:
            if error.errno not in NO_HARD_LINK_ERRNOS:
                raise
        else:
            return
    os.replace(temporary_path, target)


def _fsync_file(path: Path) -> None:
    """Write the content of a file, or the entries of a folder, to the disk (fsync)."""
    with suppress(PermissionError):  # a folder can be writable although it is not readable
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
