"""Reader of telemetry arrays, ticks and events from the log of a run.

The reader also accepts an incomplete or damaged log file.
"""

import functools
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TELEMETRY_AXES, TELEMETRY_FIELDS
from handctl.errors import LogError
from handctl.log.header import RunHeader
from handctl.log.read.chunk_reader import (
    ChunkDefinitions,
    MessageRows,
    iter_messages,
    schemas_and_channels,
)
from handctl.log.read.logfile import ChunkLocation, LogErrorContext, LogFile
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.log.read.timeline import LoggedEvent, PhaseChange, TickGap
from handctl.log.tick_batch import TICK_HEAD_DTYPE, column_count, columns_of_fields, row_field_names
from handctl.log.tick_record import TickRecord, message_layout, unpack_tick, unpack_ticks
from handctl.log.topics.clock_pair_topic import CLOCK_PAIRS_TOPIC as CLOCK_TOPIC
from handctl.log.topics.clock_pair_topic import ClockPair, decode_clock_pair
from handctl.log.topics.hash_chain import HASH_CHAIN_TOPIC as HASH_CHAIN_TOPIC
from handctl.log.topics.hash_chain import HASH_SIZE
from handctl.log.topics.snapshot_topic import SNAPSHOT_TOPIC as SNAPSHOT_TOPIC
from handctl.log.topics.snapshot_topic import decode_snapshot
from handctl.log.topics.topic_set import TICK_TOPIC, VALUES_TOPIC
from handctl.log.write.log_writer import LOG_SCHEMA_VERSION
from handctl.printing import printable_text

Array = NDArray[np.float64]

_MAX_CACHED_MESSAGE_TAILS = 1000
"""Largest number of ends of Tick messages in the cache. The cache contains only message ends without events."""
VALUES_START_OFFSET = 4 + 8 + 8 + 8
"""Offset of the values in a StatisticsValues message [bytes].

Encapsulation, stamp, empty frame_id and length precede the values.
"""
VALUES_END_OFFSET = -4
"""End of the values in a StatisticsValues message, counted from the end of the message [bytes].

The field names_version follows the values.
"""
_CACHE_BYTES = 64 << 20
"""Largest amount of telemetry, and largest size of all chunks, that the reader keeps in memory [bytes]."""
_BLOCK_BYTES = 400
"""Memory that a block of messages needs in addition to its data [bytes]. A malicious chunk can have many blocks."""


def _read_header(scan: RecordScan) -> RunHeader:
    """Return the header of the run from a file that has been scanned."""
    record = scan.metadata["handctl.run"]
    if (schema := json.loads(record["schema"])) != LOG_SCHEMA_VERSION:
        raise ValueError(f"log of version {schema}; this reader reads version {LOG_SCHEMA_VERSION}")
    attachments = {name: data for name, (_, _, data) in scan.attachments.items()}
    return RunHeader.from_record(record, scan.metadata, attachments)


_SEQUENCE_MASK = 0xFFFF_FFFF
"""Mask of the low 32 bits of a tick number. The low 32 bits of a tick number are the sequence number of a message."""


class _ChunkIndex(NamedTuple):
    """Index of the chunks of a log.

    Attributes:
        tick_heads: (ticks,) first part of each Tick message, from k to action. This part has a
            constant length.
        first_tick_of_chunk: (chunks + 1,) index of the first tick in each chunk. The last element
            is the number of all ticks.
        snapshots: index of the chunk that contains each snapshot. The keys are the sequence numbers
            of the snapshot messages.
    """

    tick_heads: NDArray[np.void]
    first_tick_of_chunk: NDArray[np.intp]
    snapshots: dict[int, int]


class _SnapshotMapping(Mapping[int, bytes]):
    """Mapping from the number of a tick to a snapshot of the controller's state after this tick.

    A snapshot is read from the file only when it is used, because the snapshots of a day do not fit
    into memory.
    """

    def __init__(self, chunks: dict[int, int], read: Callable[[int, int], bytes]) -> None:
        """Store the function that reads a snapshot.

        `chunks` gives the index of the chunk with the snapshot of each tick.
        """
        self._chunks = chunks
        self._read = read

    def __getitem__(self, k: int) -> bytes:
        """Read the snapshot of the controller's state after tick k."""
        return self._read(k, self._chunks[k])

    def __iter__(self) -> Iterator[int]:
        """Yield the number of each tick that has a snapshot."""
        return iter(self._chunks)

    def __len__(self) -> int:
        """Return the number of snapshots."""
        return len(self._chunks)


class RunLog:
    """Log of one run. Use the log as a context manager, or call `close` at the end.

    Attributes:
        header: header of the run with names, period, offset, gains, attachments and other data.
        metadata: all metadata records of the file.
        end: data that the recorder has written at the end of the run (reason, ticks, messages,
            missed, dropped and others). If the log was not finished, this mapping is empty.
        warning: description of a defect of the file, or an empty text if there is no defect. The
            data before the defect can be used.
        scan: positions of all records in the log file.
    """

    def __init__(self, path: Path, verify_checksums: bool = True) -> None:
        """Open a log.

        Args:
            path: path of the log file.
            verify_checksums: True to read the whole file at once and check its checksum. If it is False, the
                checksum of each chunk is checked when the chunk is read.

        Raises:
            LogError: the file is not a log of handctl, is damaged, or exceeds a limit. A log file
                that ends early causes no error.
        """
        self._file = LogFile(path)
        self._kept_chunks: dict[int, tuple[int, dict[int, list[MessageRows]]]] = {}
        self._kept_bytes = 0
        try:
            scan = RecordScan()
            scan_records(self._file, scan, verify_checksums)
            self.scan = scan
            self._chunks = scan.chunks
            self.metadata = scan.metadata
            self.warning = scan.problem
            if "handctl.run" not in scan.metadata or not scan.chunks:
                raise LogError(
                    "no run of handctl in the file", self._file.name, "a log that handctl wrote"
                )
            with LogErrorContext(self._file.name):
                self.header = _read_header(scan)
            self.end = scan.metadata.get("handctl.end", {})
            self._tick, self._values, self._others = self._read_channel_ids()
        except LogError:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        """Return the log."""
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the log file."""
        self.close()

    def close(self) -> None:
        """Close the log file."""
        self._file.close()

    def _read_channel_ids(self) -> tuple[int, int, dict[str, int]]:
        """Return the channel id of the Tick messages, the channel id of the telemetry, and all channel ids by topic."""
        with LogErrorContext(self._file.position_text(self._chunks[0].offset)):
            definitions_of_log: ChunkDefinitions = schemas_and_channels(
                self._file.chunk_content(self._chunks[0])
            )
            topics = {topic: number for number, _, topic, _, _ in definitions_of_log.channels}
            return topics[TICK_TOPIC], topics[VALUES_TOPIC], topics

    def _message_rows(
        self, channel: int, chunks: slice = slice(None)
    ) -> Iterator[tuple[ChunkLocation, MessageRows]]:
        """Yield the blocks of messages of a channel, each with the location of its chunk."""
        for chunk in self._chunks[chunks]:
            yield from ((chunk, rows) for rows in self._message_rows_of_chunk(chunk, channel))

    def _message_rows_of_chunk(self, chunk: ChunkLocation, channel: int) -> list[MessageRows]:
        """Return the blocks of messages of one channel in one chunk.

        The latest chunk stays in memory, for callers that read several channels of the same chunk.
        The first chunks stay in memory, too, for callers that read the log several times.
        """
        if chunk.offset not in self._kept_chunks:
            content = self._file.chunk_content(chunk)
            rows_by_channel: dict[int, list[MessageRows]] = {}
            with LogErrorContext(self._file.position_text(chunk.offset)):
                for rows in iter_messages(content, chunk.end - chunk.data_offset):
                    rows_by_channel.setdefault(rows.channel, []).append(rows)
            block_count = sum(map(len, rows_by_channel.values()))
            size = chunk.size + _BLOCK_BYTES * block_count
            self._kept_bytes += size
            # The chunk that was read last makes room for the next chunk. A program that reads a long
            # log again from the start still finds the first chunks in memory.
            while self._kept_chunks and self._kept_bytes > _CACHE_BYTES:
                _, (removed_size, _) = self._kept_chunks.popitem()
                self._kept_bytes -= removed_size
            self._kept_chunks[chunk.offset] = size, rows_by_channel
        return self._kept_chunks[chunk.offset][1].get(channel, [])

    @functools.cached_property
    def _chunk_index(self) -> _ChunkIndex:
        """Read the file once, and return the index of all chunks."""
        index_arrays = [np.empty(0, TICK_HEAD_DTYPE)]
        counts = [0]
        snapshots = dict[int, int]()
        for i, chunk in enumerate(self._chunks):
            part_count_before = len(index_arrays)
            for rows in self._message_rows_of_chunk(chunk, self._tick):
                data = rows.data()
                with LogErrorContext(self._file.position_text(chunk.offset)):
                    if data.shape[1] < 4 + TICK_HEAD_DTYPE.itemsize:
                        raise ValueError("a tick that is too short")
                    # In each message, four bytes (the CDR encapsulation) come before the first
                    # part, whose length is constant.
                    index_arrays.append(
                        np.ascontiguousarray(data[:, 4 : 4 + TICK_HEAD_DTYPE.itemsize]).view(
                            TICK_HEAD_DTYPE
                        )[:, 0]
                    )
            counts.append(sum(map(len, index_arrays[part_count_before:])))
            for rows in self._message_rows_of_chunk(chunk, self._others.get(SNAPSHOT_TOPIC, -1)):
                snapshots |= dict.fromkeys(rows.sequence().tolist(), i)
        return _ChunkIndex(np.concatenate(index_arrays), np.cumsum(counts), snapshots)

    @property
    def _tick_heads(self) -> NDArray[np.void]:
        """Return the first part (ticks,) of each Tick message. The first part has a constant length."""
        return self._chunk_index.tick_heads

    def __len__(self) -> int:
        """Return the number of ticks in the log."""
        return len(self._tick_heads)

    @property
    def k(self) -> NDArray[np.int64]:
        """Return the number of each tick (ticks,)."""
        return self._tick_heads["k"]

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """Return the time (ticks,) [ns] of each tick since the start of the run."""
        return self._tick_heads["t_ns"]

    @property
    def times(self) -> Array:
        """Return the time (ticks,) [s] of each tick since the start of the run."""
        return np.asarray(self.t_ns * 1e-9, np.float64)

    @property
    def late_ns(self) -> NDArray[np.int64]:
        """Return the lateness (ticks,) [ns] of each tick."""
        return self._tick_heads["late_ns"]

    @property
    def state_hash(self) -> NDArray[np.void]:
        """Return the 8-byte hashes (ticks,) of the controller's state after each tick."""
        return self._tick_heads["state_hash"]

    @property
    def mode(self) -> NDArray[np.uint8]:
        """Return the mode of the hand in each tick (ticks,), as a `core.tick_types.HandMode`."""
        return self._tick_heads["mode"]

    @property
    def action(self) -> NDArray[np.uint8]:
        """Return the reaction to faults in each tick (ticks,), as a `safety.safety_action.SafetyAction`."""
        return self._tick_heads["action"]

    @property
    def gaps(self) -> list[TickGap]:
        """Return the gaps in the tick numbers of the log. In a gap, one or more ticks are missing."""
        last_ticks_before_gaps = np.flatnonzero(np.diff(self.k) != 1)
        return [TickGap(int(self.k[i]), int(self.k[i + 1])) for i in last_ticks_before_gaps]

    def field(self, name: str) -> Array:
        """Return a field of the telemetry (ticks, n).

        Unknown values are NaN. If a log of an earlier version does not contain the field, the
        function returns only NaN.

        Args:
            name: name of the field, one of `core.tick_types.TELEMETRY_FIELDS`.

        Raises:
            LogError: the telemetry has no field of this name, or the log is damaged.
        """
        if name not in TELEMETRY_FIELDS:
            raise LogError(
                f"no field {printable_text(name)!r}",
                self._file.name,
                "one of " + ", ".join(TELEMETRY_FIELDS),
            )
        slices = columns_of_fields(self.header, self.fields)
        if (
            name not in slices
        ):  # the version of handctl that wrote the log did not have the requested field
            return np.full((len(self), len(self.names(name))), np.nan)
        if 8 * self._telemetry_column_count * len(self) <= _CACHE_BYTES:
            return self._all_telemetry[:, slices[name]]
        return self._columns(slices[name])

    @functools.cached_property
    def fields(self) -> tuple[str, ...]:
        """Return the names of the telemetry fields that the file contains.

        Logs of earlier versions of handctl do not contain the last fields of TELEMETRY_FIELDS.
        """
        for chunk, rows in self._message_rows(self._values):
            with LogErrorContext(self._file.position_text(chunk.offset)):
                return row_field_names(
                    self.header,
                    (rows.data().shape[1] - VALUES_START_OFFSET + VALUES_END_OFFSET) // 8,
                )
        return TELEMETRY_FIELDS

    @property
    def _telemetry_column_count(self) -> int:
        """Return the number of telemetry columns in the file."""
        return column_count(self.header, self.fields)

    @functools.cached_property
    def _all_telemetry(self) -> Array:
        """Return the whole telemetry of all ticks (ticks, columns)."""
        return self._columns(slice(0, self._telemetry_column_count))

    def _columns(self, columns: slice) -> Array:
        """Read the given columns of the telemetry (ticks, columns).

        Raises:
            LogError: the sequence numbers of the telemetry messages differ from those of the tick
                messages.
        """
        column_arrays = [np.empty((0, columns.stop - columns.start))]
        sequence = [np.empty(0, np.uint32)]
        for data, numbers in self._telemetry_blocks():
            chunk_columns = np.ascontiguousarray(data[:, 8 * columns.start : 8 * columns.stop])
            column_arrays.append(chunk_columns.view("<f8"))
            sequence.append(numbers)
        sequence_numbers = np.concatenate(sequence)
        if len(sequence_numbers) != len(self) or (sequence_numbers != (self.k & 0xFFFF_FFFF)).any():
            raise LogError(
                "telemetry and ticks do not belong together", self._file.name, "an intact file"
            )
        return np.concatenate(column_arrays)

    def _telemetry_blocks(
        self, chunks: slice = slice(None)
    ) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint32]]]:
        """Yield the telemetry in blocks.

        A block consists of two arrays: the bytes of its rows (rows, bytes), and the sequence
        numbers of these rows.
        """
        size = VALUES_START_OFFSET + 8 * self._telemetry_column_count + 4
        for chunk, rows in self._message_rows(self._values, chunks):
            data = rows.data()
            with LogErrorContext(self._file.position_text(chunk.offset)):
                if data.shape[1] != size:
                    raise ValueError("telemetry of another shape than in the header")
            yield data[:, VALUES_START_OFFSET:VALUES_END_OFFSET], rows.sequence()

    def packed_telemetry(self, chunks: slice = slice(None)) -> Iterator[bytes]:
        """Yield the telemetry of each tick in the layout of `Telemetry.to_bytes`.

        The chunks are read one by one, so that the whole telemetry is never in memory.

        Args:
            chunks: chunks of the file to read. By default, all chunks are read.
        """
        for data, _ in self._telemetry_blocks(chunks):
            size = data.shape[1]
            content = data.tobytes()
            yield from (content[start : start + size] for start in range(0, len(content), size))

    def tick_messages(self) -> Iterator[bytes]:
        """Yield the bytes of the Tick message of each tick, as the file contains them."""
        yield from (message for _, message in self._located_messages())

    def tick_digests(self) -> Iterator[bytes]:
        """Yield the hash of each tick in the hash chain.

        Logs of earlier versions contain no hash chain.
        """
        if HASH_CHAIN_TOPIC in self._others:
            for _, rows in self._message_rows(self._others[HASH_CHAIN_TOPIC]):
                yield from (row[-HASH_SIZE:].tobytes() for row in rows.data())

    @functools.cached_property
    def clock_pairs(self) -> list[ClockPair]:
        """Return all readings of the wall clock and the monotonic clock in the log.

        The recorder reads the wall clock and the monotonic clock at the same moment, every ten
        seconds.

        The log of a lockstep run has no readings of clocks.
        """
        pairs = []
        if CLOCK_TOPIC in self._others:
            for chunk, rows in self._message_rows(self._others[CLOCK_TOPIC]):
                with LogErrorContext(self._file.position_text(chunk.offset)):
                    pairs += [
                        decode_clock_pair(row.tobytes(), self.header.offset_ns)
                        for row in rows.data()
                    ]
        return pairs

    @functools.cached_property
    def snapshots(self) -> Mapping[int, bytes]:
        """Return the snapshots of the controller's state, by the number of the tick.

        A log contains a snapshot for each half second of the run. A snapshot is read from the file
        only when it is used.

        Logs of earlier versions contain no snapshots.
        """
        chunks = self._chunk_index.snapshots
        ticks = self.k[np.isin(self.k & _SEQUENCE_MASK, list(chunks))].tolist()
        return _SnapshotMapping({k: chunks[k & _SEQUENCE_MASK] for k in ticks}, self._snapshot)

    def _snapshot(self, k: int, chunk: int) -> bytes:
        """Read the snapshot of the controller's state after a tick from a chunk.

        Raises:
            LogError: the snapshot is damaged.
        """
        location = self._chunks[chunk]
        with LogErrorContext(self._file.position_text(location.offset)):
            rows_of_chunk = self._message_rows_of_chunk(location, self._others[SNAPSHOT_TOPIC])
            snapshots = dict(
                decode_snapshot(row.tobytes()) for rows in rows_of_chunk for row in rows.data()
            )
            return snapshots[k]

    def names(self, field: str) -> tuple[str, ...]:
        """Return the names of the columns of a telemetry field."""
        return self.header.axis_names(TELEMETRY_AXES[field])

    def _located_messages(self) -> Iterator[tuple[ChunkLocation, bytes]]:
        """Yield each Tick message, together with the location of its chunk."""
        for chunk, rows in self._message_rows(self._tick):
            yield from ((chunk, message) for message in rows.messages())

    @property
    def first_tick_of_chunk(self) -> NDArray[np.intp]:
        """Return the indices (chunks + 1,) of the first tick in each chunk.

        The last element is the number of all ticks.
        """
        return self._chunk_index.first_tick_of_chunk

    def ticks(self, chunks: slice = slice(None)) -> Iterator[TickRecord]:
        """Yield the ticks of the given chunks in order.

        By default, the ticks of all chunks are yielded.
        """
        for chunk in self._chunks[chunks]:
            with LogErrorContext(self._file.position_text(chunk.offset)):
                messages = [
                    message
                    for rows in self._message_rows_of_chunk(chunk, self._tick)
                    for message in rows.messages()
                ]
                ticks = unpack_ticks(messages)
            yield from ticks

    @functools.cached_property
    def _events_and_phases(self) -> tuple[list[LoggedEvent], list[PhaseChange]]:
        """Return the events of the controller, and the starts of the grasp phases.

        A Tick message ends with the phase and the events. Most messages without events end with the
        same bytes, which the function decodes only once.
        """
        events: list[LoggedEvent] = []
        phases: list[PhaseChange] = []
        phase_of_tail: dict[bytes, str] = {}
        for index, (chunk, message) in enumerate(self._located_messages()):
            with LogErrorContext(self._file.position_text(chunk.offset)):
                # All messages of one phase that have no events end with the same bytes: the phase
                # and empty lists. The cache `phase_of_tail` contains the phase of each end that has
                # been decoded.
                tail_bytes = message[message_layout(message).tail_offset :]
                phase = phase_of_tail.get(tail_bytes)
                if phase is None:
                    tick = unpack_tick(message)
                    phase = tick.phase
                    events += [
                        LoggedEvent(tick.tick_in.k, tick.tick_in.t_ns, event)
                        for event in tick.events
                    ]
                    if not tick.events and len(phase_of_tail) < _MAX_CACHED_MESSAGE_TAILS:
                        phase_of_tail[tail_bytes] = phase
            if not phases or phases[-1].name != phase:
                phases.append(PhaseChange(int(self.k[index]), int(self.t_ns[index]), phase))
        return events, phases

    @property
    def events(self) -> list[LoggedEvent]:
        """Return the controller's events, in the order of their times."""
        return self._events_and_phases[0]

    @property
    def phases(self) -> list[PhaseChange]:
        """Return the starts of the grasp phases, in the order of their times."""
        return self._events_and_phases[1]
