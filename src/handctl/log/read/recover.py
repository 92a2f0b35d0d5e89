"""Recovery of a damaged log.

The undamaged parts of the file are copied into a new, complete file.
"""

import enum
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from handctl.errors import LogError
from handctl.log.mcap_container import McapContainer, MessageBlock
from handctl.log.read.chunk_reader import iter_messages, schemas_and_channels
from handctl.log.read.logfile import ChunkLocation, LogErrorContext, LogFile
from handctl.log.read.record_scan import RecordScan, scan_records
from handctl.output_files import atomic_path


class RecoveryStatus(enum.IntEnum):
    """Result of the recovery of a log.

    The integer value of a status is also the exit code of ``handctl log recover``.
    """

    WHOLE = 0
    """The old file was complete. The new file has the same content."""
    NOTHING = 1
    """The old file has no intact chunk. No new file was written."""
    LOSSY = 3
    """The old file was broken. The new file has the intact chunks of the old file."""


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """Report about the recovery of a log.

    Attributes:
        status: result of the recovery.
        chunks, messages: number of copied chunks and messages.
        lost_ranges: (start, end) of each part of the old file that was not copied [bytes].
        problem: description of a defect of the old file, or an empty text if there is no defect.
    """

    status: RecoveryStatus
    chunks: int = 0
    messages: int = 0
    lost_ranges: tuple[tuple[int, int], ...] = ()
    problem: str = ""


def recover_log(path: Path, output_path: Path) -> RecoveryReport:
    """Copy all undamaged chunks, attachments and metadata of a log into a new file.

    Args:
        path: path of a complete or damaged log.
        output_path: path of the new file. If the log has no undamaged chunk, no file is written.

    Raises:
        LogError: the file at `path` cannot be opened or is not an MCAP file.
        ConfigError: the new file cannot be created.
        OSError: the new file cannot be written.
    """
    file = LogFile(path)
    scan = RecordScan()
    try:
        problem = scan_damaged(file, scan)
        if not scan.chunks:
            return RecoveryReport(
                RecoveryStatus.NOTHING, lost_ranges=((0, file.size),), problem=problem
            )
        with atomic_path(output_path, must_be_new=True) as temporary_path:
            descriptor = os.open(temporary_path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
            try:
                recovery = _copy_intact_parts(file, scan, problem, McapContainer(descriptor))
            finally:
                os.close(descriptor)
            if recovery.status == RecoveryStatus.NOTHING:
                temporary_path.unlink()
        return recovery
    finally:
        file.close()


def scan_damaged(file: LogFile, scan: RecordScan) -> str:
    """Scan a file like `scan_records`.

    If the file has a defect, return a text that describes the defect. An error is raised only if
    the file does not begin like an MCAP file.

    After the call, `scan` contains the intact records. Intact records after a damaged record are
    included if the end of the damaged record is known.
    """
    try:
        scan_records(file, scan, skip_chunk_content=True)
    except LogError as error:
        if scan.end == 0:
            raise
        return scan.problem or str(error)
    return scan.problem


def _copy_intact_parts(
    file: LogFile, scan: RecordScan, problem_text: str, new_container: McapContainer
) -> RecoveryReport:
    """Copy the undamaged parts of a file into the new file, and write the end of the new file."""
    for name, (media_type, time_ns, data) in scan.attachments.items():
        new_container.write_attachment(name, media_type, data, time_ns)
    for name, values in scan.metadata.items():
        # The end record is written last, as in a log that was finished without errors.
        if name != "handctl.end":
            new_container.write_metadata(name, values)
    lost_ranges = scan.skipped_ranges.copy()
    copied = 0
    for chunk in scan.chunks:
        try:
            _copy_chunk(file, chunk, new_container)
            copied += 1
        except LogError as error:
            problem_text = problem_text or str(error)
            lost_ranges.append((chunk.offset, chunk.end))
    if not scan.is_complete and scan.end < file.size:
        lost_ranges.append((scan.end, file.size))
    new_container.write_metadata("handctl.end", _end_record(scan, problem_text))
    new_container.write_summary_and_footer()
    status = (
        RecoveryStatus.NOTHING
        if not copied
        else RecoveryStatus.LOSSY
        if lost_ranges or not scan.is_complete
        else RecoveryStatus.WHOLE
    )
    return RecoveryReport(
        status, copied, new_container.message_count, tuple(sorted(lost_ranges)), problem_text
    )


def _end_record(scan: RecordScan, problem_text: str) -> dict[str, str]:
    """Return the end record of the new file. The record describes the defect of the old file."""
    end = scan.metadata.get("handctl.end", {"reason": "not closed"})
    return end | {"recovered": problem_text} if problem_text else end


def _copy_chunk(file: LogFile, chunk: ChunkLocation, new_container: McapContainer) -> None:
    """Copy the messages of one chunk unchanged.

    Raises:
        LogError: the chunk is damaged.
    """
    content = file.chunk_content(chunk)
    with LogErrorContext(file.position_text(chunk.offset)):
        chunk_definitions = schemas_and_channels(content)
        schemas = [
            Schema(number, data, encoding, name)
            for number, name, encoding, data in chunk_definitions.schemas
        ]
        channels = [
            Channel(number, topic, encoding, metadata, schema)
            for number, schema, topic, encoding, metadata in chunk_definitions.channels
        ]
        blocks = [
            MessageBlock(
                rows.channel,
                rows.records.tobytes(),
                rows.log_times(),
                _message_offsets(rows.records.shape),
            )
            for rows in iter_messages(content, chunk.end - chunk.data_offset)
        ]
    new_container.write_chunk(blocks, schemas, channels)


def _message_offsets(shape: tuple[int, ...]) -> "np.ndarray[tuple[int], np.dtype[np.uint64]]":
    """Return the offsets (n,) [bytes] in a block at which n messages of equal length begin."""
    return np.arange(shape[0], dtype=np.uint64) * np.uint64(shape[1])
