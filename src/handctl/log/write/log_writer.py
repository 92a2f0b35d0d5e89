"""Writer of the log file of a run.

The log stays readable even if the disk is full or a write fails.
"""

import errno
import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from handctl.core.plain_data import json_from_serialized_bytes
from handctl.log.header import RunHeader
from handctl.log.mcap_container import McapContainer, MessageBlock
from handctl.log.tick_batch import TickBatcher
from handctl.log.tick_record import SNAPSHOT_HEAD_STRUCT
from handctl.log.topics.clock_pair_topic import CLOCK_PAIR_PERIOD_NS
from handctl.log.topics.snapshot_topic import ControllerSnapshot
from handctl.log.topics.topic_set import TopicSet
from handctl.log.write.disk_syncer import sync_to_disk

CHUNK_SPAN_NS = 250_000_000
"""Longest time span of a chunk [ns].

If the recorder is killed, at most the ticks of one chunk are lost.
"""
CHUNK_BYTES = 1 << 20
"""Total size of the collected tick records above which they are written as a chunk [bytes]."""
RESERVED_BYTES = 512 << 10
"""Disk space that is reserved for the summary and footer of a log [bytes].

The writer uses the reserved disk space if the disk becomes full.
"""
LOG_SCHEMA_VERSION = 1
"""Version of the topics and records of a log. The reader refuses logs of other versions."""

_MEDIA_TYPES = {
    ".toml": "application/toml",
    ".urdf": "application/xml",
    ".txt": "text/plain",
    ".json": "application/json",
    ".stl": "model/stl",
    ".obj": "model/obj",
}
_DISK_FULL_ERRNOS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

ReportFunction = Callable[[str, int], None]
ClockFunction = Callable[[], tuple[int, int]]


def _read_both_clocks() -> tuple[int, int]:
    """Return the readings of wall clock and monotonic clock [ns]."""
    return time.time_ns(), time.monotonic_ns()


def _create_file(path: Path) -> int:
    """Create a new file, and return the file descriptor."""
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o644)


class _ReservedDiskSpace:
    """Disk space that is reserved for the end of a log.

    A file without a name occupies the reserved space on the disk. If the recorder is killed, the
    file without a name disappears.
    """

    def __init__(self, folder: Path) -> None:
        """Reserve the disk space.

        If the disk space cannot be reserved, the log is written nevertheless.
        """
        self._fd = -1
        with suppress(OSError):
            self._fd, name = tempfile.mkstemp(dir=folder)
            # The space stays reserved while the file descriptor is open.
            os.unlink(name)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._fd, 0, RESERVED_BYTES)
            else:
                os.write(self._fd, bytes(RESERVED_BYTES))

    def release(self) -> None:
        """Free the reserved space."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class LogWriter:
    """Writer of the log file of a run.

    After a write has failed, the writer closes the file. Ticks that arrive after the failure are
    not written, and are counted as lost.

    Attributes:
        ticks: number of ticks written or waiting for the next chunk.
        lost: number of ticks that were lost because a write failed, or because they arrived after
            the file was closed.
        closed: True if the file is closed.
    """

    def __init__(
        self,
        path: Path,
        header: RunHeader,
        report: ReportFunction,
        min_free_bytes: int,
        clocks: ClockFunction = _read_both_clocks,
        sync_file: Callable[[int], None] = sync_to_disk,
    ) -> None:
        """Create the file, and write the header.

        Args:
            path: path of the new file.
            header: header of the run.
            report: function that is called for each event. The arguments of this function are one
                of disk_low, disk_full, error and misshapen, and a number: free bytes, errno, or 1.
            min_free_bytes: smallest amount of free disk space for the recording [bytes]. If less space
                is free, the writer finishes the file early.
            clocks: function that reads the wall clock and the monotonic clock [ns]. In a lockstep
                run, this function is not called.
            sync_file: function that takes a file descriptor, and syncs the file to the disk.

        Raises:
            OSError: the file cannot be created. A failure after the creation of the file raises no
                error. Instead, the writer calls `report`.
        """
        self._clocks = clocks
        self._next_pair_ns = 0
        self._to_disk = sync_file
        self._path = path
        self._header = header
        self._report = report
        self._min_free_bytes = min_free_bytes
        self._topics = TopicSet(header)
        self._batcher = TickBatcher(header)
        self._fd = _create_file(path)
        self._reserved = _ReservedDiskSpace(path.parent)
        self._warned = self.closed = False
        self._mark = -1
        self._first_k = 0
        self._last_k = -1
        self._snapshots: list[MessageBlock] = []
        self.ticks = self.lost = self._missed = 0
        self._container = McapContainer(self._fd)
        self._write_header_records()

    def _write_header_records(self) -> None:
        """Write the records that come before the ticks in the file: attachments, metadata, schemas and channels."""
        header = self._header
        container = self._container
        for name, data in ({"hand.toml": header.hand_toml.encode()} | header.attachments).items():
            container.write_attachment(
                name,
                _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream"),
                data,
                header.offset_ns,
            )
        container.write_metadata("handctl", header.metadata)
        lists = {
            name: list(getattr(header, name))
            for name in ("joints", "tendons", "motors", "digits", "buses")
        }
        numbers = {
            "schema": LOG_SCHEMA_VERSION,
            "period_ns": header.period_ns,
            "offset_ns": header.offset_ns,
        }
        fields = lists | numbers | {"deterministic": header.deterministic}
        container.write_metadata(
            "handctl.run", {name: json.dumps(value) for name, value in fields.items()}
        )
        container.write_metadata("handctl.gains", header.gains)
        if header.wall:
            container.write_metadata("handctl.wall", header.wall)
        container.write_chunk(
            self._topics.latched_messages(), self._topics.schemas, self._topics.channels
        )

    @property
    def has_pending_ticks(self) -> bool:
        """Return True if ticks wait for the next chunk."""
        return len(self._batcher) > 0

    def add_tick(self, body: bytes) -> None:
        """Add a tick, given as the body of a record, to the next chunk."""
        if self.closed:
            self.lost += 1
            return
        misshapen_count_before = self._batcher.misshapen_ticks
        is_chunk_start = not self.has_pending_ticks
        t_ns = self._batcher.add_tick(body)
        self.ticks += 1
        if self._batcher.misshapen_ticks > misshapen_count_before == 0:
            self._report("misshapen", 1)
        if self._is_chunk_end(t_ns, is_chunk_start) or self._batcher.size > CHUNK_BYTES:
            self.flush()

    def add_snapshot(self, body: bytes) -> None:
        """Add a snapshot of the controller's state, given as the body of a record.

        The snapshot is written with the next chunk.
        """
        if self.closed:
            return
        k, t_ns, size = SNAPSHOT_HEAD_STRUCT.unpack_from(body)
        state = body[SNAPSHOT_HEAD_STRUCT.size :]
        data = state[:size] + json_from_serialized_bytes(state[size:])
        self._snapshots.append(self._topics.snapshot(t_ns, ControllerSnapshot(k, data)))

    def _is_chunk_end(self, t_ns: int, is_chunk_start: bool) -> bool:
        """Return True if this tick must be the last tick of the current chunk.

        In a lockstep run, the chunks end at fixed times. In a run that is not in lockstep, a chunk
        ends as soon as it spans CHUNK_SPAN_NS.
        """
        if self._header.deterministic:
            previous_mark = self._mark
            self._mark = t_ns // CHUNK_SPAN_NS
            return previous_mark != self._mark
        if is_chunk_start:
            self._mark = t_ns
        return t_ns - self._mark >= CHUNK_SPAN_NS

    def flush(self) -> None:
        """Write the collected ticks as one chunk."""
        if self.closed or not self.has_pending_ticks:
            return
        batch = self._batcher.take_batch()
        # Each tick number that does not occur in the log counts as a missed tick, even between two
        # chunks.
        first_tick = self._last_k + 1 if self._last_k >= 0 else int(batch.k[0])
        self._missed += max(int(batch.k[-1]) - first_tick + 1 - len(batch.k), 0)
        self._last_k = int(batch.k[-1])
        snapshots = self._snapshots
        self._snapshots = []
        try:
            self._container.write_chunk(
                self._topics.blocks(batch) + snapshots + self._clock_pair(int(batch.t_ns[-1]))
            )
        except OSError as error:
            self.lost += len(batch.k)
            self.ticks -= len(batch.k)
            self._close_after_failure(error)

    def _clock_pair(self, t_ns: int) -> list[MessageBlock]:
        """Return a message with new readings of the wall clock and the monotonic clock.

        If less than CLOCK_PAIR_PERIOD_NS has passed since the last readings, return no message.
        """
        if self._header.deterministic or t_ns < self._next_pair_ns:
            return []
        self._next_pair_ns = t_ns + CLOCK_PAIR_PERIOD_NS
        return [self._topics.clock_pair(t_ns, self._last_k, *self._clocks())]

    def sync(self) -> None:
        """Request a sync of the file to disk, and check the free disk space."""
        if self.closed:
            return
        try:
            self._to_disk(self._fd)
            # The file descriptor stays valid even if a user renames or deletes the log file during
            # the run.
            disk = os.fstatvfs(self._fd)
        except OSError as error:
            self._close_after_failure(error)
            return
        free_bytes = disk.f_bavail * disk.f_frsize
        if free_bytes < self._min_free_bytes:
            self._finish_log_early(free_bytes)
        elif free_bytes < 4 * self._min_free_bytes and not self._warned:
            self._warned = True
            self._report("disk_low", free_bytes)

    def _finish_log_early(self, free_bytes: int) -> None:
        """Finish the log early, because the disk is almost full."""
        self.flush()
        if not self.closed:
            self._report("disk_full", free_bytes)
            with suppress(OSError):
                self._write_end_of_file("disk full", 0)

    def _close_after_failure(self, error: OSError) -> None:
        """Close the file after a write has failed."""
        self.closed = True
        self._report("disk_full" if error.errno in _DISK_FULL_ERRNOS else "error", error.errno or 0)
        with suppress(OSError):
            self._container.cut_incomplete_record()
            self._write_end_of_file(f"write failed: {error.strerror}", 0)

    def _write_end_of_file(
        self, end_reason: str, dropped_records: int, final_metadata: Mapping[str, str] | None = None
    ) -> None:
        """Write the end of the log file: the end record, the summary and the footer.

        If a write fails, the file is cut off after the last complete record.
        """
        self.closed = True
        self._reserved.release()
        numbers = {
            "ticks": self.ticks,
            "missed": self._missed,
            "dropped": dropped_records,
            "misshapen": self._batcher.misshapen_ticks,
        }
        values = {
            **(final_metadata or {}),
            "reason": end_reason,
            "messages": str(self._container.message_count),
            "chain": self._topics.last_digest.hex(),
        }
        try:
            self._container.write_metadata(
                "handctl.end", values | {name: str(value) for name, value in numbers.items()}
            )
            self._container.write_summary_and_footer()
        except OSError:
            self._container.cut_incomplete_record()
            raise
        finally:
            os.fsync(self._fd)

    def finish(
        self, end_reason: str, dropped_records: int, final_metadata: Mapping[str, str] | None = None
    ) -> dict[str, object]:
        """Close the log file, and return a summary of the recording.

        Args:
            end_reason: reason why the run ended.
            dropped_records: number of records that the controller could not send to the recorder.
            final_metadata: facts about the run that are known only at its end, by the name of the fact.
        """
        self.flush()
        if not self.closed:
            try:
                self._write_end_of_file(end_reason, dropped_records, final_metadata)
            except OSError as error:
                self._report(
                    "disk_full" if error.errno in _DISK_FULL_ERRNOS else "error", error.errno or 0
                )
        os.close(self._fd)
        numbers = {
            "ticks": self.ticks,
            "lost": self.lost,
            "messages": self._container.message_count,
        }
        return numbers | {
            "bytes": self._container.complete_size,
            "path": str(self._path),
            "reason": end_reason,
        }
