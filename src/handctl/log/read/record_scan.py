"""Scan of the outer records of an MCAP file.

The scan does not use the index at the end of the file. The scan checks the checksums of the
attachments, the data section and the summary.

Each record consists of an opcode u8, a length u64 and the content. The data section ends with the
record DataEnd, which contains the CRC-32 of all bytes before this record. The summary and the
footer come after the data section. The footer has 29 bytes: opcode u8, length u64, two offsets u64,
CRC-32 u32. The file begins and ends with MCAP_MAGIC.

Source: MCAP specification.
"""

import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode

from handctl.errors import LogError
from handctl.log.mcap_container import MCAP_MAGIC
from handctl.log.read.logfile import MAX_CHUNK_BYTES, ChunkLocation, LogErrorContext, LogFile

MAX_ATTACHMENT_BYTES = 16 << 20
"""Largest accepted size of one attachment [bytes]."""
MAX_TOTAL_ATTACHMENT_BYTES = 64 << 20
"""Largest accepted total size of the attachments of a file [bytes]."""
MAX_METADATA_BYTES = 1 << 20
"""Largest accepted size of a metadata record [bytes]."""
MAX_RECORDS = 1000
"""Largest accepted number of attachments.

The same limit applies to metadata records, to unknown records, and to damaged records.
"""
MAX_COMPRESSION_RATIO = 64
"""Largest accepted ratio of the uncompressed size of all chunks to the size of the file.

The log of a hand at rest has the ratio 15, far below this limit.
"""

_RECORD_STRUCT = struct.Struct("<BQ")
_CHUNK_STRUCT = struct.Struct("<QQQII")
"""Start of a Chunk record: first and last time [ns], uncompressed size, CRC-32, length of the compression's name."""
_MESSAGE_INDEX_OPCODE = int(Opcode.MESSAGE_INDEX)
_LENGTHS: dict[int, int] = {
    Opcode.HEADER: 8,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
}
"""Smallest valid length of a record [bytes], by opcode."""


@dataclass(slots=True)
class RecordScan:
    """Result of the scan of an MCAP file.

    Attributes:
        chunks: locations of all complete chunks.
        attachments: (media type, time, bytes) of each attachment, by name.
        metadata: values of each metadata record, by name.
        end: offset after the last complete record of the data section.
        size: size of the file [bytes].
        is_complete: True if the data section has an end record with the correct checksum.
        problem: description of a defect of the file, or an empty text if there is no defect.
        skipped_ranges: (start, end) of every damaged record that the scan has skipped [bytes].
        unknown_record_count: number of records with an unknown opcode.
    """

    chunks: list[ChunkLocation] = field(default_factory=list)
    attachments: dict[str, tuple[str, int, bytes]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    end: int = 0
    size: int = 0
    is_complete: bool = False
    problem: str = ""
    skipped_ranges: list[tuple[int, int]] = field(default_factory=list)
    unknown_record_count: int = 0


class _RecordFieldReader:
    """Reader for the fields of one record, in order."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def read_number(self, code: str) -> int:
        """Read a number with the given format character of `struct`."""
        value = struct.unpack_from("<" + code, self._data, self._at)[0]
        self._at += struct.calcsize("<" + code)
        return int(value)

    def read_bytes(self, size: int) -> bytes:
        """Read `size` bytes."""
        if self._at + size > len(self._data):
            raise ValueError("a field extends beyond the end of its record")
        self._at += size
        return self._data[self._at - size : self._at]

    def read_string(self) -> str:
        """Read a string."""
        return self.read_bytes(self.read_number("I")).decode()

    def count_unread_bytes(self) -> int:
        """Return the number of unread bytes."""
        return len(self._data) - self._at


def scan_records(
    file: LogFile, scan: RecordScan, is_checked: bool = True, skip_chunk_content: bool = False
) -> None:
    """Read the outermost records of a file, and add their content to a scan.

    A file that ends early raises no error. After the scan of a file that ends early, `scan`
    contains all complete records, and `scan.problem` gives the position of the end.

    Args:
        file: the MCAP file.
        scan: empty scan to be filled, or an earlier scan of the same file, when the file was
            shorter. An earlier scan continues at ``scan.end``. If an error is raised, the scan
            contains the records before the damage.
        is_checked: True to read the whole file and to check the checksum of the data section.
        skip_chunk_content: True to skip damaged records if their ends are known. If
            ``skip_chunk_content`` is False, a damaged record raises an error.

    Raises:
        LogError: the file is not an MCAP file, is damaged before the end, or exceeds a limit.
    """
    scan.size = file.size
    if file.size < len(MCAP_MAGIC) or file.read_range(0, len(MCAP_MAGIC)) != MCAP_MAGIC:
        raise LogError("not an MCAP file", file.position_text(0), "a log that handctl wrote")
    is_finished = (
        file.size >= 2 * len(MCAP_MAGIC)
        and file.read_range(file.size - len(MCAP_MAGIC), len(MCAP_MAGIC)) == MCAP_MAGIC
    )
    scan.end = max(scan.end, len(MCAP_MAGIC))
    # If the earlier scan skipped no records, its only possible problem is the early end of the
    # file, which was shorter at that time.
    scan.problem = scan.problem if scan.skipped_ranges else ""
    uncompressed_size = sum(chunk.size for chunk in scan.chunks)
    while scan.end + _RECORD_STRUCT.size <= file.size:
        offset = scan.end
        code, length = _RECORD_STRUCT.unpack(file.read_range(offset, _RECORD_STRUCT.size))
        end = offset + _RECORD_STRUCT.size + length
        # The opcode 0 is never valid. However, after a power failure, a log file can end with
        # zeros.
        if code == 0 or end > file.size:
            if is_finished:
                raise LogError(
                    "damaged log: no record here", file.position_text(offset), "an intact file"
                )
            break
        if code == _MESSAGE_INDEX_OPCODE and length >= _LENGTHS[_MESSAGE_INDEX_OPCODE]:
            scan.end = end  # most records are message indexes, whose content the scan does not use
            continue
        if code == Opcode.DATA_END:
            _check_end_record(file, scan, offset, end, is_checked)
            return
        try:
            with LogErrorContext(file.position_text(offset)):
                uncompressed_size += _add_record(file, scan, code, offset, end)
        except LogError as error:
            if not skip_chunk_content:
                raise
            scan.problem = scan.problem or str(error)
            scan.skipped_ranges.append((offset, end))
        scan.unknown_record_count += code not in Opcode.__members__.values()
        with LogErrorContext(file.position_text(offset)):
            _check_limits(scan, uncompressed_size)
        scan.end = end
    scan.problem = (
        scan.problem
        or f"ends at byte {file.size} without an end mark; complete up to byte {scan.end}"
    )


def scan_path(path: Path) -> RecordScan:
    """Scan a file without a check of the checksum of the data section, and return the scan.

    This function raises the same errors as `scan_records`.
    """
    file = LogFile(path)
    scan = RecordScan()
    try:
        scan_records(file, scan, is_checked=False)
    finally:
        file.close()
    return scan


def _check_limits(scan: RecordScan, unpacked_bytes: int) -> None:
    """Raise an error if a file has too many records or too much uncompressed data."""
    if unpacked_bytes > MAX_COMPRESSION_RATIO * scan.size + MAX_CHUNK_BYTES:
        raise ValueError(f"chunks of more than {unpacked_bytes} bytes")
    if (
        max(
            scan.unknown_record_count,
            len(scan.attachments),
            len(scan.metadata),
            len(scan.skipped_ranges),
        )
        > MAX_RECORDS
    ):
        raise ValueError(f"more than {MAX_RECORDS} records of a kind")
    if sum(len(data) for _, _, data in scan.attachments.values()) > MAX_TOTAL_ATTACHMENT_BYTES:
        raise ValueError(f"more than {MAX_TOTAL_ATTACHMENT_BYTES} bytes of attachments")


def _add_record(file: LogFile, scan: RecordScan, opcode: int, offset: int, end_offset: int) -> int:
    """Add one record of the file to a scan.

    Return the uncompressed size of a chunk, and 0 for other records.
    """
    start = offset + _RECORD_STRUCT.size
    length = end_offset - offset - _RECORD_STRUCT.size
    if length < _LENGTHS.get(opcode, 0):
        raise ValueError("a record that is too short")
    if opcode == Opcode.CHUNK:
        scan.chunks.append(_decode_chunk_head(file, offset, end_offset))
        return scan.chunks[-1].size
    if opcode == Opcode.ATTACHMENT:
        _decode_attachment(
            scan, file.read_range(start, _checked_size(length, MAX_ATTACHMENT_BYTES))
        )
    elif opcode == Opcode.METADATA:
        fields = _RecordFieldReader(
            file.read_range(start, _checked_size(length, MAX_METADATA_BYTES))
        )
        name = fields.read_string()
        scan.metadata[name] = _read_string_map(fields)
    elif opcode == Opcode.MESSAGE:
        raise ValueError("a message outside a chunk")
    return 0


def _checked_size(size: int, limit: int) -> int:
    """Check that the size of a record does not exceed a limit, and return the size."""
    if size > limit:
        raise ValueError(f"a record of {size} bytes; at most {limit} are allowed")
    return size


def _decode_chunk_head(file: LogFile, offset: int, end_offset: int) -> ChunkLocation:
    """Decode the first fields of a Chunk record, but do not read the data of the chunk."""
    # 80 bytes are enough for the fields of constant size (41 bytes), the name of the compression
    # (at most 8 bytes) and the compressed size (8 bytes).
    head_bytes = file.read_range(offset, min(end_offset - offset, 80))
    first_time, last_time, size, crc, name = _CHUNK_STRUCT.unpack_from(
        head_bytes, _RECORD_STRUCT.size
    )
    _checked_size(size, MAX_CHUNK_BYTES)
    start = _RECORD_STRUCT.size + _CHUNK_STRUCT.size
    compression = head_bytes[start : start + _checked_size(name, 8)].decode()
    if compression not in ("", "lz4", "zstd"):
        raise ValueError(f"unknown compression {compression!r}")
    (packed,) = struct.unpack_from("<Q", head_bytes, start + name)
    data = offset + start + name + 8
    if data + _checked_size(packed, MAX_CHUNK_BYTES) != end_offset:
        raise ValueError("the length of a chunk contradicts itself")
    return ChunkLocation(offset, end_offset, data, first_time, last_time, size, crc, compression)


def _decode_attachment(scan: RecordScan, data: bytes) -> None:
    """Decode an attachment, and check the checksum of the attachment."""
    fields = _RecordFieldReader(data)
    time_ns = fields.read_number("Q")
    fields.read_number("Q")  # the time at which the attachment was created
    name = fields.read_string()
    media_type = fields.read_string()
    content = fields.read_bytes(fields.read_number("Q"))
    crc = fields.read_number("I")
    # The checksum covers all fields of the attachment that come before it. The checksum itself is
    # in the last four bytes of the attachment.
    if crc and crc != zlib.crc32(data[: -4 - fields.count_unread_bytes()]):
        raise ValueError("checksum of an attachment does not match")
    scan.attachments[name] = (media_type, time_ns, content)


def _read_string_map(fields: _RecordFieldReader) -> dict[str, str]:
    """Decode a map in a record. The keys and values of the map are texts."""
    map_reader = _RecordFieldReader(fields.read_bytes(fields.read_number("I")))
    values = {}
    while map_reader.count_unread_bytes():
        key = map_reader.read_string()
        values[key] = map_reader.read_string()
    return values


def _check_end_record(
    file: LogFile, scan: RecordScan, offset: int, end_offset: int, is_checked: bool
) -> None:
    """Compare the checksums of the data section and of the summary with the content of the file."""
    (crc,) = struct.unpack("<I", file.read_range(offset + _RECORD_STRUCT.size, 4))
    if end_offset != offset + _RECORD_STRUCT.size + 4 or (
        is_checked and crc and crc != file.range_crc(0, offset)
    ):
        raise LogError(
            "damaged log: checksum of the data does not match",
            file.position_text(offset),
            "an intact file",
        )
    scan.is_complete = True
    footer = file.size - len(MCAP_MAGIC) - 29
    if (
        footer < end_offset
        or file.read_range(file.size - len(MCAP_MAGIC), len(MCAP_MAGIC)) != MCAP_MAGIC
    ):
        scan.problem = scan.problem or "ends within its summary"
        return
    raw_bytes = file.read_range(footer, 29)
    (expected,) = struct.unpack_from("<I", raw_bytes, 25)
    if raw_bytes[0] != Opcode.FOOTER or (
        expected and expected != zlib.crc32(raw_bytes[:25], file.range_crc(end_offset, footer))
    ):
        scan.problem = scan.problem or "the summary is damaged; the data is intact"
