"""Conversion of a log to the chunks that Rerun shows.

The converted chunks go to a recording file or to a viewer.
"""

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
from handctl.log.read.record_scan import RecordScan, scan_path
from handctl.log.read.recover import RecoveryStatus, recover_log
from handctl.view.scene.blueprint import dashboard_layout
from handctl.view.scene.chunk_arrays import LOG_TIME_TIMELINE, times_since_start
from handctl.view.scene.entity_styles import style_chunks
from handctl.view.scene.geometry import mesh_chunks
from handctl.view.scene.object_and_table import object_and_table_chunks
from handctl.view.scene.run_info import RunInfo
from handctl.view.scene.topic_converters import TopicConverters
from handctl.view.time_slices import SLICE_DURATION_NS, time_slices

DISK_SPACE_FACTOR = 2
"""Free disk space that must exist before a recording is written, as a multiple of the log's size.

If the disk became full during the recording, Rerun's writer would block forever.
"""
MESSAGE_DECODERS = ("ros2msg", "ros2_reflection", "urdf")
"""Names of the decoders with which Rerun reads the messages of a log."""


@contextmanager
def rerun_errors(name: str) -> Iterator[None]:
    """Replace an error that Rerun raises about a bad file by a LogError."""
    try:
        yield
    except (RuntimeError, ValueError, OSError) as error:
        raise LogError(
            f"damaged log: {error}", name, "an intact file; see `handctl log recover`"
        ) from error


def chunks_of_run(
    path: Path, run: RunInfo, first_slice_duration_ns: int = SLICE_DURATION_NS
) -> Iterator[Chunk]:
    """Return all chunks of a log one after another, see `chunks_of_run_by_part`."""
    return chain.from_iterable(chunks_of_run_by_part(path, run, first_slice_duration_ns))


def chunks_of_run_by_part(
    path: Path,
    run: RunInfo,
    first_slice_duration_ns: int = SLICE_DURATION_NS,
    record_scan: RecordScan | None = None,
) -> Iterator[list[Chunk]]:
    """Yield all chunks of a log in parts.

    The first part of the result has the chunks that are valid for the whole run. Each part after
    the first has the chunks of one time interval of the run. The time intervals are in ascending
    order.

    Args:
        path: path of the log. An incomplete log is accepted.
        run: data about the run and the hand of the log.
        first_slice_duration_ns: duration of the first part of the run [ns].
        record_scan: list of the log's records, if the records have been scanned already.

    Raises:
        LogError: the log is damaged.
    """
    yield [*style_chunks(run), *mesh_chunks(run), *object_and_table_chunks(run)]
    with tempfile.TemporaryDirectory(prefix="handctl-view-") as folder:
        converters = TopicConverters(run)
        complete_log, record_scan = ensure_complete_log(
            path, Path(folder), record_scan or scan_path(path)
        )
        for partial_log, since_ns in time_slices(
            complete_log, record_scan, Path(folder), first_slice_duration_ns
        ):
            yield list(chunks_of_log(partial_log, converters, run.name, since_ns))


def ensure_complete_log(
    path: Path, folder: Path, record_scan: RecordScan
) -> tuple[Path, RecordScan]:
    """Return the path and the list of records of a complete log.

    If the log ends early, the function repairs a copy of the log, and returns the path and the list
    of this copy.

    A repaired copy is necessary because Rerun omits parts of the last chunk of an incomplete log.

    Raises:
        LogError: the log has no complete chunk.
    """
    if not record_scan.problem:
        return path, record_scan
    repaired_path = folder / path.name
    if recover_log(path, repaired_path).status == RecoveryStatus.NOTHING:
        raise LogError("no complete chunk in it", str(path), "a log with at least its header")
    return repaired_path, scan_path(repaired_path)


def chunks_of_log(
    path: Path, converters: TopicConverters, name: str, since_ns: int = 0
) -> Iterator[Chunk]:
    """Convert topics of a log to the chunks that the dashboard needs, and yield these chunks.

    Args:
        path: path of the log. An incomplete log is accepted.
        converters: converters for the topics of the log.
        name: name of the log, for error messages.
        since_ns: log time [ns] from which the log is read.

    Raises:
        LogError: the log is damaged.
    """
    with rerun_errors(name):
        reader = McapReader(
            path, decoders=MESSAGE_DECODERS, include_topic_regex=converters.topics, recover=True
        )
        start_ns, end_ns = reader.time_bounds()
        # The time range of the stream does not include the end of the range, so 1 is added.
        raw_chunks = (
            reader.stream(start_time_ns=max(start_ns, since_ns), end_time_ns=end_ns + 1)
            .collect()
            .stream()
            .to_chunks()
        )
    yield from (
        new_chunk
        for chunk in sorted(raw_chunks, key=_start_time_ns)
        for new_chunk in converters(chunk)
    )


def _start_time_ns(chunk: Chunk) -> int:
    """Return the log time of the first row of a chunk [ns].

    For a chunk without times, the result is -1. In a sorted list, a chunk without times therefore
    comes first.
    """
    return int(times_since_start(chunk, 0)[0]) if LOG_TIME_TIMELINE in chunk.timeline_names else -1


def new_recording(run: RunInfo) -> rr.RecordingStream:
    """Return a new Rerun recording that is not yet connected to a file or a viewer."""
    stream = rr.RecordingStream(run.application_id, recording_id=run.name, send_properties=False)
    stream.send_recording_name(run.name)
    if run.header.offset_ns:
        stream.send_recording_start_time_nanos(run.header.offset_ns)
    return stream


def write_rrd(path: Path, run: RunInfo, recording_path: Path) -> int:
    """Write a log as a Rerun recording that also contains the layout of the dashboard.

    Args:
        path: path of the log.
        run: data about the run and the hand of the log.
        recording_path: path of the recording to write.

    Returns:
        size of the recording [bytes].

    Raises:
        LogError: the log is damaged, or the file cannot be written.
        OSError: the free disk space is too small.
    """
    if (
        shutil.disk_usage(recording_path.absolute().parent).free
        < DISK_SPACE_FACTOR * path.stat().st_size
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(recording_path))
    stream = new_recording(run)
    try:
        stream.save(recording_path, default_blueprint=dashboard_layout(run))
    except (RuntimeError, OSError) as error:
        raise LogError(
            f"cannot write: {error}", str(recording_path), "a file in a writable folder"
        ) from error
    rr.send_chunks(chunks_of_run(path, run), recording=stream)
    stream.flush()
    stream.disconnect()
    return recording_path.stat().st_size
