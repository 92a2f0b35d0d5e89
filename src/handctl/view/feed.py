"""Conversion of a log to Rerun, into a file or a viewer."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import rerun as rr
from rerun.chunk import Chunk, McapReader

from handctl.errors import LogError
from handctl.log.read.recover import Status, recover
from handctl.log.read.scan import Scan, scanned
from handctl.view.scene.arrow import LOG_TIME, run_times
from handctl.view.scene.blueprint import dashboard
from handctl.view.scene.lenses import Lenses
from handctl.view.scene.styles import styles
from handctl.view.scene.subject import Subject
from handctl.view.windows import SPAN_NS, windows

ROOM = 2
"""Required free space for a recording, as a multiple of the log's size. On a full disk Rerun's writer never returns."""
DECODERS = ("ros2msg", "ros2_reflection", "urdf")
"""Rerun's decoders for the messages of a log."""


@contextmanager
def reading(name: str) -> Iterator[None]:
    """Convert errors of Rerun about a bad file to a LogError."""
    try:
        yield
    except (RuntimeError, ValueError, OSError) as error:
        raise LogError(f"damaged log: {error}", name, "an intact file; see `handctl log recover`") from error


def run_chunks(path: Path, subject: Subject, first_ns: int = SPAN_NS) -> Iterator[Chunk]:
    """Return all chunks of a log in the order of time, see `run_parts`."""
    return chain.from_iterable(run_parts(path, subject, first_ns))


def run_parts(
    path: Path, subject: Subject, first_ns: int = SPAN_NS, found: Scan | None = None
) -> Iterator[list[Chunk]]:
    """Yield all chunks of a log in parts: static chunks first, then the run in the order of time.

    Args:
        path: a log, complete or ending early.
        subject: run and hand of the log.
        first_ns: length of the run in the first part [ns].
        found: outer records of the log if already scanned.

    Raises:
        LogError: the log is damaged.
    """
    yield list(styles(subject))
    with tempfile.TemporaryDirectory(prefix="handctl-view-") as folder:
        lenses = Lenses(subject)
        (sound, places) = whole(path, Path(folder), found or scanned(path))
        for part, since_ns in windows(sound, places, Path(folder), first_ns):
            yield list(log_chunks(part, lenses, subject.name, since_ns))


def whole(path: Path, folder: Path, found: Scan) -> tuple[Path, Scan]:
    """Return the log, or a repaired copy of a log that ends early. Rerun would leave out parts of the last chunk.

    Raises:
        LogError: the log has no complete chunk.
    """
    if not found.problem:
        return path, found
    copy = folder / path.name
    if recover(path, copy).status == Status.NOTHING:
        raise LogError("no complete chunk in it", str(path), "a log with at least its header")
    return copy, scanned(copy)


def log_chunks(path: Path, lenses: Lenses, name: str, since_ns: int = 0) -> Iterator[Chunk]:
    """Yield the chunks of all topics that change.

    Args:
        path: a log, complete or ending early.
        lenses: converters of the topics.
        name: name of the log in messages.
        since_ns: first log time [ns].

    Raises:
        LogError: the log is damaged.
    """
    with reading(name):
        reader = McapReader(path, decoders=DECODERS, include_topic_regex=lenses.topics, recover=True)
        first, last = reader.time_bounds()
        # The end of a stream's time range is exclusive.
        raw = reader.stream(start_time_ns=max(first, since_ns), end_time_ns=last + 1).collect().stream().to_chunks()
    yield from (new for chunk in sorted(raw, key=_begin) for new in lenses(chunk))


def _begin(chunk: Chunk) -> int:
    """Return the log time of a chunk's first row [ns]. A chunk without times comes first."""
    return int(run_times(chunk, 0)[0]) if LOG_TIME in chunk.timeline_names else -1


def recording(subject: Subject) -> rr.RecordingStream:
    """Create a recording without a sink."""
    stream = rr.RecordingStream(subject.application, recording_id=subject.name, send_properties=False)
    stream.send_recording_name(subject.name)
    if subject.header.offset_ns:
        stream.send_recording_start_time_nanos(subject.header.offset_ns)
    return stream


def write_rrd(path: Path, subject: Subject, out: Path) -> int:
    """Write a log as a Rerun recording with its layout.

    Args:
        path: the log.
        subject: run and hand of the log.
        out: file to write.

    Returns:
        Size of the file [bytes].

    Raises:
        LogError: the log is damaged, or the file cannot be written.
        OSError: the free space is too small.
    """
    if shutil.disk_usage(out.absolute().parent).free < ROOM * path.stat().st_size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(out))
    stream = recording(subject)
    try:
        stream.save(out, default_blueprint=dashboard(subject))
    except (RuntimeError, OSError) as error:
        raise LogError(f"cannot write: {error}", str(out), "a place for the recording") from error
    rr.send_chunks(run_chunks(path, subject), recording=stream)
    stream.flush()
    stream.disconnect()
    return out.stat().st_size
