"""A recorded run as data: arrays, ticks and events, from whole and from broken files."""

import functools
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from handctl.core.types import TELEMETRY_AXES, TELEMETRY_FIELDS
from handctl.errors import LogError
from handctl.log.batch import FIXED_DTYPE, columns, columns_of, layout_of
from handctl.log.header import RunHeader
from handctl.log.read.logfile import ChunkPlace, LogFile, Reading
from handctl.log.read.messages_in import Definitions, Rows, definitions, rows
from handctl.log.read.moments import Gap, LoggedEvent, PhaseChange
from handctl.log.read.scan import Scan, scan
from handctl.log.record import TickRecord, layout, unpack_tick, unpack_ticks
from handctl.log.topics.all import TICK_TOPIC, VALUES_TOPIC
from handctl.log.topics.chain import SIZE
from handctl.log.topics.chain import TOPIC as CHAIN_TOPIC
from handctl.log.topics.clock_pairs import TOPIC as CLOCK_TOPIC
from handctl.log.topics.clock_pairs import ClockPair, pair_of
from handctl.log.topics.snapshots import TOPIC as SNAPSHOT_TOPIC
from handctl.log.topics.snapshots import snapshot_of
from handctl.log.write.writer import SCHEMA
from handctl.printing import printable

Array = NDArray[np.float64]

_MAX_PHASES = 1000
VALUES_START = 4 + 8 + 8 + 8
"""Start of the values in a StatisticsValues: encapsulation, stamp, empty frame_id with padding, length with padding."""
VALUES_END = -4
"""Their end, before the version of the names."""
_CACHE_BYTES = 64 << 20


def _header(found: Scan) -> RunHeader:
    record = found.metadata["handctl.run"]
    if (schema := json.loads(record["schema"])) != SCHEMA:
        raise ValueError(f"log of version {schema}; this reader knows {SCHEMA}")
    attachments = {name: data for name, (_, _, data) in found.attachments.items()}
    return RunHeader.of_record(record, found.metadata, attachments)


_SEQUENCE = 0xFFFF_FFFF
"""Bits of a tick's number that are the sequence number of its messages."""


class _Index(NamedTuple):
    """What is known of all chunks.

    Attributes:
        fixed: (ticks,) constant parts of all ticks.
        first_of_chunk: (chunks + 1,) index of the first tick of each; the last is the number of ticks.
        snapshots: chunk of each snapshot, by its sequence number.
    """

    fixed: NDArray[np.void]
    first_of_chunk: NDArray[np.intp]
    snapshots: dict[int, int]


class _Snapshots(Mapping[int, bytes]):
    """Snapshots by their ticks; a day has more of them than fit into memory."""

    def __init__(self, chunks: dict[int, int], read: Callable[[int, int], bytes]) -> None:
        self._chunks, self._read = chunks, read

    def __getitem__(self, k: int) -> bytes:
        return self._read(k, self._chunks[k])

    def __iter__(self) -> Iterator[int]:
        return iter(self._chunks)

    def __len__(self) -> int:
        return len(self._chunks)


class RunLog:
    """One run; use as a context manager, or ``close``.

    Attributes:
        header: names, period, offset, gains, attachments.
        metadata: all metadata records.
        end: reason, ticks, messages, missed, dropped of a run that was closed; else empty.
        warning: why the file is not whole; empty if it is. What is there is complete up to then.
        found: where everything is in the file.
    """

    def __init__(self, path: Path, checked: bool = True) -> None:
        """Open a log.

        Args:
            path: of the file.
            checked: read all of it for its checksum; without, each chunk's own is compared when it is read.

        Raises:
            LogError: not a log of handctl, damaged, or beyond a limit. A file that only ends early is no error.
        """
        self._file = LogFile(path)
        self._latest: tuple[ChunkPlace, dict[int, list[Rows]]] | None = None
        try:
            found = Scan()
            scan(self._file, found, checked)
            self.found = found
            self._chunks, self.metadata, self.warning = found.chunks, found.metadata, found.problem
            if "handctl.run" not in found.metadata or not found.chunks:
                raise LogError("no run of handctl in it", self._file.name, "a log that handctl wrote")
            with Reading(self._file.name):
                self.header = _header(found)
            self.end = found.metadata.get("handctl.end", {})
            self._tick, self._values, self._others = self._channels()
        except LogError:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _channels(self) -> tuple[int, int, dict[str, int]]:
        """Channels of the ticks and of the telemetry, and those of all topics."""
        with Reading(self._file.at(self._chunks[0].offset)):
            found: Definitions = definitions(self._file.content(self._chunks[0]))
            topics = {topic: number for number, _, topic, _, _ in found.channels}
            return topics[TICK_TOPIC], topics[VALUES_TOPIC], topics

    def _rows(self, channel: int, chunks: slice = slice(None)) -> Iterator[tuple[ChunkPlace, Rows]]:
        for place in self._chunks[chunks]:
            yield from ((place, one) for one in self._rows_of(place, channel))

    def _rows_of(self, place: ChunkPlace, channel: int) -> list[Rows]:
        """Return a channel's messages of a chunk; who reads several channels side by side has them found once."""
        if self._latest is None or self._latest[0] is not place:
            content = self._file.content(place)
            found: dict[int, list[Rows]] = {}
            with Reading(self._file.at(place.offset)):
                for one in rows(content, place.end - place.data):
                    found.setdefault(one.channel, []).append(one)
            self._latest = place, found
        return self._latest[1].get(channel, [])

    @functools.cached_property
    def _index(self) -> _Index:
        """What one look at every chunk tells."""
        parts, counts, snapshots = [np.empty(0, FIXED_DTYPE)], [0], dict[int, int]()
        for i, place in enumerate(self._chunks):
            before = len(parts)
            for one in self._rows_of(place, self._tick):
                data = one.data()
                with Reading(self._file.at(place.offset)):
                    if data.shape[1] < 4 + FIXED_DTYPE.itemsize:
                        raise ValueError("a tick that is too short")
                    parts.append(np.ascontiguousarray(data[:, 4 : 4 + FIXED_DTYPE.itemsize]).view(FIXED_DTYPE)[:, 0])
            counts.append(sum(map(len, parts[before:])))
            for one in self._rows_of(place, self._others.get(SNAPSHOT_TOPIC, -1)):
                snapshots |= dict.fromkeys(one.sequence().tolist(), i)
        return _Index(np.concatenate(parts), np.cumsum(counts), snapshots)

    @property
    def _fixed(self) -> NDArray[np.void]:
        """(ticks,) constant parts of all ticks."""
        return self._index.fixed

    def __len__(self) -> int:
        """Number of ticks."""
        return len(self._fixed)

    @property
    def k(self) -> NDArray[np.int64]:
        """(ticks,) tick numbers."""
        return self._fixed["k"]

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """(ticks,) time since the start of the run [ns]."""
        return self._fixed["t_ns"]

    @property
    def times(self) -> Array:
        """(ticks,) time since the start of the run [s]."""
        return np.asarray(self.t_ns * 1e-9, np.float64)

    @property
    def late_ns(self) -> NDArray[np.int64]:
        """(ticks,) how late each tick began [ns]."""
        return self._fixed["late_ns"]

    @property
    def state_hash(self) -> NDArray[np.void]:
        """(ticks,) hash of the state after each tick, 8 bytes."""
        return self._fixed["state_hash"]

    @property
    def mode(self) -> NDArray[np.uint8]:
        """(ticks,) core.types.Mode."""
        return self._fixed["mode"]

    @property
    def action(self) -> NDArray[np.uint8]:
        """(ticks,) safety.action.Action."""
        return self._fixed["action"]

    @property
    def gaps(self) -> list[Gap]:
        """Where ticks are missing."""
        at = np.flatnonzero(np.diff(self.k) != 1)
        return [Gap(int(self.k[i]), int(self.k[i + 1])) for i in at]

    def field(self, name: str) -> Array:
        """(ticks, n) one field of the telemetry, NaN where nothing was known, or in a log that lacks it.

        Args:
            name: of ``core.types.TELEMETRY_FIELDS``.

        Raises:
            LogError: there is no such field, or the log is damaged.
        """
        if name not in TELEMETRY_FIELDS:
            raise LogError(f"no field {printable(name)!r}", self._file.name, "one of " + ", ".join(TELEMETRY_FIELDS))
        places = columns(self.header, self.fields)
        if name not in places:  # a log of an earlier version
            return np.full((len(self), len(self.names(name))), np.nan)
        if 8 * self._width * len(self) <= _CACHE_BYTES:
            return self._numbers[:, places[name]]
        return self._columns(places[name])

    @functools.cached_property
    def fields(self) -> tuple[str, ...]:
        """Fields of the telemetry in the file; logs of earlier versions lack the last of TELEMETRY_FIELDS."""
        for place, one in self._rows(self._values):
            with Reading(self._file.at(place.offset)):
                return layout_of(self.header, (one.data().shape[1] - VALUES_START + VALUES_END) // 8)
        return TELEMETRY_FIELDS

    @property
    def _width(self) -> int:
        return columns_of(self.header, self.fields)

    @functools.cached_property
    def _numbers(self) -> Array:
        return self._columns(slice(0, self._width))

    def _columns(self, place: slice) -> Array:
        """(ticks, columns) of the telemetry."""
        parts = [np.empty((0, place.stop - place.start))]
        sequence = [np.empty(0, np.uint32)]
        for data, numbers in self._values_parts():
            part = np.ascontiguousarray(data[:, 8 * place.start : 8 * place.stop])
            parts.append(part.view("<f8"))
            sequence.append(numbers)
        found = np.concatenate(sequence)
        if len(found) != len(self) or (found != (self.k & 0xFFFF_FFFF)).any():
            raise LogError("telemetry and ticks do not belong together", self._file.name, "an intact file")
        return np.concatenate(parts)

    def _values_parts(self, chunks: slice = slice(None)) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint32]]]:
        """Telemetry as (rows, bytes) with the sequence numbers of the rows, part by part."""
        size = VALUES_START + 8 * self._width + 4
        for chunk, one in self._rows(self._values, chunks):
            data = one.data()
            with Reading(self._file.at(chunk.offset)):
                if data.shape[1] != size:
                    raise ValueError("telemetry of another shape than the header says")
            yield data[:, VALUES_START:VALUES_END], one.sequence()

    def packed(self, chunks: slice = slice(None)) -> Iterator[bytes]:
        """Telemetry of each tick as ``Telemetry.packed`` gives it, without holding more than a part of the file.

        Args:
            chunks: of the file, all by default.
        """
        for data, _ in self._values_parts(chunks):
            yield from (row.tobytes() for row in data)

    def messages(self) -> Iterator[bytes]:
        """The Tick message of each tick as it is in the file."""
        yield from (message for _, message in self._messages())

    def digests(self) -> Iterator[bytes]:
        """The chain's hash of each tick; nothing in a log of a version that had none."""
        if CHAIN_TOPIC in self._others:
            for _, one in self._rows(self._others[CHAIN_TOPIC]):
                yield from (row[-SIZE:].tobytes() for row in one.data())

    @functools.cached_property
    def clock_pairs(self) -> list[ClockPair]:
        """The wall clock beside the monotonic one, every ten seconds; none of a lockstep run."""
        found = []
        if CLOCK_TOPIC in self._others:
            for place, one in self._rows(self._others[CLOCK_TOPIC]):
                with Reading(self._file.at(place.offset)):
                    found += [pair_of(row.tobytes(), self.header.offset_ns) for row in one.data()]
        return found

    @functools.cached_property
    def snapshots(self) -> Mapping[int, bytes]:
        """States of the controller by the ticks that they follow, one a second; each is read when it is asked for.

        Empty for a log of a version that did not keep them.
        """
        chunks = self._index.snapshots
        kept = self.k[np.isin(self.k & _SEQUENCE, list(chunks))].tolist()
        return _Snapshots({k: chunks[k & _SEQUENCE] for k in kept}, self._snapshot)

    def _snapshot(self, k: int, chunk: int) -> bytes:
        """Return the snapshot behind a tick out of its chunk.

        Raises:
            LogError: it is damaged.
        """
        place = self._chunks[chunk]
        with Reading(self._file.at(place.offset)):
            rows_of_it = self._rows_of(place, self._others[SNAPSHOT_TOPIC])
            found = dict(snapshot_of(row.tobytes()) for one in rows_of_it for row in one.data())
            return found[k]

    def names(self, field: str) -> tuple[str, ...]:
        """Names of the columns of a field."""
        return self.header.axis(TELEMETRY_AXES[field])

    def _messages(self) -> Iterator[tuple[ChunkPlace, bytes]]:
        for place, one in self._rows(self._tick):
            yield from ((place, message) for message in one.messages())

    @property
    def first_of_chunk(self) -> NDArray[np.intp]:
        """(chunks + 1,) index of the first tick of each chunk; the last is the number of ticks."""
        return self._index.first_of_chunk

    def ticks(self, chunks: slice = slice(None)) -> Iterator[TickRecord]:
        """All ticks in order, or those of some chunks, for re-execution."""
        for place in self._chunks[chunks]:
            with Reading(self._file.at(place.offset)):
                messages = [message for one in self._rows_of(place, self._tick) for message in one.messages()]
                ticks = unpack_ticks(messages)
            yield from ticks

    @functools.cached_property
    def _told(self) -> tuple[list[LoggedEvent], list[PhaseChange]]:
        """Events and phases; only a tick whose words are new is decoded."""
        events: list[LoggedEvent] = []
        phases: list[PhaseChange] = []
        quiet: dict[bytes, str] = {}
        for index, (place, message) in enumerate(self._messages()):
            with Reading(self._file.at(place.offset)):
                tail = message[layout(message).tail :]
                phase = quiet.get(tail)
                if phase is None:
                    tick = unpack_tick(message)
                    phase = tick.phase
                    events += [LoggedEvent(tick.tick_in.k, tick.tick_in.t_ns, event) for event in tick.events]
                    if not tick.events and len(quiet) < _MAX_PHASES:
                        quiet[tail] = phase
            if not phases or phases[-1].name != phase:
                phases.append(PhaseChange(int(self.k[index]), int(self.t_ns[index]), phase))
        return events, phases

    @property
    def events(self) -> list[LoggedEvent]:
        """What the controller had to say, in order."""
        return self._told[0]

    @property
    def phases(self) -> list[PhaseChange]:
        """When each grasp phase began."""
        return self._told[1]
