"""Recovery: a new, complete file from the intact parts of a broken file."""

import enum
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from handctl.errors import LogError
from handctl.log.container import Container, Run
from handctl.log.read.logfile import ChunkPlace, LogFile, Reading
from handctl.log.read.messages_in import definitions, rows
from handctl.log.read.scan import Scan, scan
from handctl.output import whole


class Status(enum.IntEnum):
    """Result of a recovery. The numbers are exit codes."""

    WHOLE = 0
    """The file was complete. The new file is equivalent."""
    NOTHING = 1
    """The file has no complete chunk."""
    LOSSY = 3
    """The new file has the complete chunks of the old file."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """Report on a recovery.

    Attributes:
        status: see Status.
        chunks, messages: number of copied chunks and messages.
        lost: (start, end) of each range of the old file that was not copied [bytes].
        problem: defect of the old file, else empty.
    """

    status: Status
    chunks: int = 0
    messages: int = 0
    lost: tuple[tuple[int, int], ...] = ()
    problem: str = ""


def recover(path: Path, out: Path) -> Recovery:
    """Copy all intact chunks, attachments and metadata into a new file.

    Args:
        path: a log, complete or broken.
        out: a new file. It is not written if the log has no intact chunk.

    Raises:
        LogError: path cannot be opened or is not an MCAP file.
        ConfigError: out cannot be created.
        OSError: out cannot be written.
    """
    file = LogFile(path)
    found = Scan()
    try:
        problem = scan_all(file, found)
        if not found.chunks:
            return Recovery(Status.NOTHING, lost=((0, file.size),), problem=problem)
        with whole(out, new=True) as part:
            descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
            try:
                recovery = _copy(file, found, problem, Container(descriptor))
            finally:
                os.close(descriptor)
            if recovery.status == Status.NOTHING:
                part.unlink()
        return recovery
    finally:
        file.close()


def scan_all(file: LogFile, found: Scan) -> str:
    """Scan a file as `scan` does, and return its defect instead of raising.

    The intact records before and behind a damaged one are in `found`.
    """
    try:
        scan(file, found, skip=True)
    except LogError as error:
        if found.end == 0:
            raise
        return found.problem or str(error)
    return found.problem


def _copy(file: LogFile, found: Scan, problem: str, new: Container) -> Recovery:
    """Copy the intact parts of a file and write the end of the new file."""
    for name, (media, time_ns, data) in found.attachments.items():
        new.attach(name, media, data, time_ns)
    for name, values in found.metadata.items():
        # The end record is written last, as in a log that was closed.
        if name != "handctl.end":
            new.metadata(name, values)
    lost = found.skipped.copy()
    kept = 0
    for place in found.chunks:
        try:
            _copy_chunk(file, place, new)
            kept += 1
        except LogError as error:
            problem = problem or str(error)
            lost.append((place.offset, place.end))
    if not found.complete and found.end < file.size:
        lost.append((found.end, file.size))
    new.metadata("handctl.end", _end(found, problem))
    new.finish()
    status = Status.NOTHING if not kept else Status.LOSSY if lost or not found.complete else Status.WHOLE
    return Recovery(status, kept, new.messages, tuple(sorted(lost)), problem)


def _end(found: Scan, problem: str) -> dict[str, str]:
    """Return the end record of the new file, with the defect of the old file."""
    end = found.metadata.get("handctl.end", {"reason": "not closed"})
    return end | {"recovered": problem} if problem else end


def _copy_chunk(file: LogFile, place: ChunkPlace, new: Container) -> None:
    """Copy one chunk. Its messages are written unchanged.

    Raises:
        LogError: the chunk is damaged.
    """
    content = file.content(place)
    with Reading(file.at(place.offset)):
        known = definitions(content)
        schemas = [Schema(number, data, encoding, name) for number, name, encoding, data in known.schemas]
        channels = [
            Channel(number, topic, encoding, metadata, schema)
            for number, schema, topic, encoding, metadata in known.channels
        ]
        runs = [
            Run(one.channel, one.records.tobytes(), one.log_times(), _offsets(one.records.shape))
            for one in rows(content, place.end - place.data)
        ]
    new.chunk(runs, schemas, channels)


def _offsets(shape: tuple[int, ...]) -> "np.ndarray[tuple[int], np.dtype[np.uint64]]":
    """Return the start of each message in a block (n,) [bytes]."""
    return np.arange(shape[0], dtype=np.uint64) * np.uint64(shape[1])
