"""Files that verbs write: all of one or nothing of it, whatever comes between."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError

NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.ENOSYS}
"""What file systems without links answer, such as that of a memory stick."""
LOG, LOG_BEGINS = ".mcap", b"\x89MCAP0\r\n"
"""Suffix, and first bytes, of what nothing may be written over."""
DRAWN = {".png", ".svg", ".pdf"}
"""Suffixes that say how a figure is written; others are PNG."""


@contextmanager
def whole(path: Path, new: bool = False) -> Iterator[Path]:
    """A name to write a file or folder to, which is moved to ``path`` once all of it is on the disk, if there is any.

    Whoever reads, also after a power cut, finds the old file or the new one, and nothing is left of what failed. A link
    is followed; what is there and no file, as a terminal or a pipe, is written to as it is.

    Args:
        path: where it shall be.
        new: refuse what is there.

    Raises:
        ConfigError: nothing can be written there.
        OSError: it could not be written; with the name of ``path``.
    """
    target = _target(path, new)
    if target.exists() and not target.is_file():
        with _named(path, target), _read_pipe(target, path):
            yield target
        return
    beside = target.with_name(f".{os.getpid()}{target.suffix}")
    try:
        with _named(path, beside):
            yield beside
            if beside.exists():
                _settle(beside)
                _move(beside, target, new)
                _settle(target.parent)
    finally:
        if beside.is_dir():
            shutil.rmtree(beside, ignore_errors=True)
        else:
            beside.unlink(missing_ok=True)


def named_after(path: Path, suffix: str) -> Path:
    """Name an output after the file that it is made of: its path with another suffix.

    Raises:
        ConfigError: the path has no file name, as ``.`` and ``/``.
    """
    if not path.name:
        raise ConfigError("is a folder", str(path), "a file")
    return path.with_suffix(suffix)


def write_whole(path: Path, text: str, new: bool = False) -> None:
    """Write text; see ``whole``."""
    with whole(path, new) as part:
        part.write_text(text, encoding="utf-8")


def save_figure(figure: Any, path: Path, dpi: int = 110) -> None:
    """Write a figure of matplotlib; see ``whole``."""
    with whole(path) as part:
        figure.savefig(part, dpi=dpi, format=path.suffix[1:] if path.suffix in DRAWN else "png")


def check_output(path: Path, what: str, *read: Path | None) -> None:
    """Refuse a name that ``whole`` would refuse, before anything is done.

    Args:
        path: of the file.
        what: to call it, such as its option.
        read: files that the same verb reads, if they are given.

    Raises:
        ConfigError: nothing can be written there.
    """
    try:
        target = _target(path, False)
    except ConfigError as error:
        raise ConfigError(error.what, f"{what} {path}", error.right) from None
    if any(one and _same(target, one) for one in read):
        raise ConfigError("is what is read", f"{what} {path}", "another name")


def _same(target: Path, other: Path) -> bool:
    """Whether two names lead to one file, there or not."""
    there = target.exists() and other.exists()
    return target.samefile(other) if there else str(target) == os.path.realpath(other)


def _target(path: Path, new: bool) -> Path:
    """Where a name leads to."""
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise ConfigError("no such folder", str(path), "a name in a folder that exists")
    if new and os.path.lexists(path):
        raise ConfigError("is there already", str(path), "a new name")
    if target.is_dir():
        raise ConfigError("is a folder", str(path), "a file")
    if target.is_file() and (target.suffix == LOG or _is_log(target)):
        raise ConfigError("is a log", str(path), "another name: nothing is written over a log")
    return target


@contextmanager
def _read_pipe(target: Path, path: Path) -> Iterator[None]:
    """Refuse a named pipe that nobody reads: opening it would wait without end.

    The pipe stays open meanwhile, because its reader ends when the last writer closes it.
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


def _is_log(path: Path) -> bool:
    """Whether a file begins as a log does, whatever it is called."""
    with suppress(PermissionError), path.open("rb") as file:
        return file.read(len(LOG_BEGINS)) == LOG_BEGINS
    return False


@contextmanager
def _named(path: Path, written: Path) -> Iterator[None]:
    """Errors name the file that the person knows."""
    try:
        yield
    except OSError as error:
        if error.filename not in (None, str(written), written):
            raise
        text = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, text, str(path)) from None


def _move(beside: Path, target: Path, new: bool) -> None:
    """Put a file in its place; a new one never over what another process has put there meanwhile."""
    if new and beside.is_file():
        try:
            os.link(beside, target)
        except OSError as error:
            if error.errno not in NO_LINKS:
                raise
        else:
            return
    os.replace(beside, target)


def _settle(path: Path) -> None:
    """Have a file's bytes, or a folder's entries, on the disk."""
    with suppress(PermissionError):  # of a folder that may be written to, but not read
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
