"""Writer of files in the container format MCAP.

The writer receives messages in blocks, because one Python call for each message would take too
long. The package mcap encodes only the kinds of records that occur rarely in a file. Chunks and
message indexes are frequent. If the package also encoded the frequent records, their encoding would
take most of the writing time. Therefore this module encodes chunks and message indexes itself.
Chunks and message indexes have these layouts:

Chunk: opcode u8, length u64, first time u64 [ns], last time u64 [ns], uncompressed size u64, CRC-32
u32, compression as a text (u32 length), compressed size u64, compressed records. MessageIndex:
opcode u8, length u64, channel u16, size of the entries u32, entries (log time u64 [ns], offset in
the uncompressed chunk u64).

Source: MCAP specification, sections Records and Chunk.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from handctl.log.chunk_table import ChunkEntry, ChunkTable

MCAP_MAGIC = b"\x89MCAP0\r\n"
MESSAGE_STRUCT = struct.Struct("<BQHIQQ")
"""Layout of the start of a Message record: opcode, length, channel, sequence, log time [ns], publish time [ns]."""
_RECORD_STRUCT = struct.Struct("<BQ")
"""Layout of the start of every MCAP record: opcode, length."""
_CHUNK_STRUCT = struct.Struct("<QQQII3sQ")
"""Layout of the fields of a Chunk record after `_RECORD_STRUCT`, for the compression "lz4"."""
_MESSAGE_INDEX_STRUCT = struct.Struct("<BQHI")
"""Layout of the start of a MessageIndex record: opcode, length, channel, size of the entries."""
_INDEX_ENTRY_DTYPE = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class MessageBlock(NamedTuple):
    """Block of consecutive Message records of one channel.

    Attributes:
        channel: id of the channel.
        data: the records, as bytes. Each record begins with the layout `MESSAGE_STRUCT`.
        log_times: (n,) uint64, log time of each message [ns].
        offsets: (n,) start of each record within the data [bytes].
    """

    channel: int
    data: bytes | bytearray
    log_times: NDArray[np.uint64]
    offsets: NDArray[np.uint64]


def records_as_bytes(records: Iterable[McapRecord]) -> bytes:
    """Return MCAP records as bytes."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


@dataclass(slots=True)
class _SummarySection:
    """Contents of the summary section of a file.

    The contents of the summary section are collected while the file is written.
    """

    schemas: list[McapRecord] = field(default_factory=list)
    channels: list[McapRecord] = field(default_factory=list)
    chunks: ChunkTable = field(default_factory=ChunkTable)
    attachments: list[McapRecord] = field(default_factory=list)
    metadata: list[McapRecord] = field(default_factory=list)
    message_counts: Counter[int] = field(default_factory=Counter)
    first_log_time: int = 2**64 - 1
    last_log_time: int = 0


class McapContainer:
    """MCAP file that is being written. The class does not buffer data.

    Attributes:
        complete_size: length of the file up to the end of the last complete record [bytes].

    Raises:
        OSError: a write fails. Every method that writes to the file can raise this error. After an
            OSError, the caller is allowed to call only `cut_incomplete_record`.
    """

    def __init__(self, descriptor: int) -> None:
        """Write the header of the MCAP file.

        Args:
            descriptor: descriptor of a file that is open for writing, positioned at the start of
                the file.
        """
        self._fd = descriptor
        self._crc = 0
        self._at = 0
        self.complete_size = 0
        self._summary = _SummarySection()
        self._write_bytes(MCAP_MAGIC + records_as_bytes([Header("ros2", "handctl")]))

    @property
    def message_count(self) -> int:
        """Return the number of messages that were written to the file so far."""
        return self._summary.message_counts.total()

    def _write_bytes(self, data: bytes) -> int:
        """Write all bytes, and return the offset of the first byte in the file."""
        offset = self._at
        view = memoryview(data)
        while view:
            # A single call of ``os.write`` can write only a part of the bytes, for example if the
            # disk is almost full.
            written_size = os.write(self._fd, view)
            self._at += written_size
            view = view[written_size:]
        self._crc = zlib.crc32(data, self._crc)
        # The complete size increases only after the last byte of a record has been written.
        # Therefore `cut_incomplete_record` can remove an incomplete record.
        self.complete_size = self._at
        return offset

    def cut_incomplete_record(self) -> None:
        """Cut the file off after the last complete record.

        The call removes the remains of a failed write.
        """
        os.ftruncate(self._fd, self.complete_size)
        os.lseek(self._fd, self.complete_size, os.SEEK_SET)
        self._at = self.complete_size

    def write_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write an attachment."""
        raw_bytes = records_as_bytes([Attachment(time_ns, time_ns, name, media_type, data)])
        offset = self._write_bytes(raw_bytes)
        self._summary.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=len(raw_bytes),
                log_time=time_ns,
                create_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def write_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        raw_bytes = records_as_bytes([Metadata(name=name, metadata=values)])
        self._summary.metadata.append(
            MetadataIndex(offset=self._write_bytes(raw_bytes), length=len(raw_bytes), name=name)
        )

    def write_chunk(
        self,
        blocks: Sequence[MessageBlock],
        schemas: Sequence[Schema] = (),
        channels: Sequence[Channel] = (),
    ) -> None:
        """Write a compressed chunk, and then its message indexes.

        The chunk begins with the records of new schemas and channels.
        """
        head_records = records_as_bytes([*schemas, *channels])
        content = b"".join([head_records, *(block.data for block in blocks)])
        packed = lz4.frame.compress(content)
        first_time = min((int(block.log_times.min()) for block in blocks), default=0)
        last_time = max((int(block.log_times.max()) for block in blocks), default=0)
        fields = _CHUNK_STRUCT.pack(
            first_time, last_time, len(content), zlib.crc32(content), 3, b"lz4", len(packed)
        )
        chunk = _RECORD_STRUCT.pack(Opcode.CHUNK, len(fields) + len(packed)) + fields + packed
        indexes, index_offsets = _message_indexes(blocks, len(head_records))
        offset = self._write_bytes(chunk + indexes)
        chunk_entry = ChunkEntry(
            offset, len(chunk), len(packed), len(content), first_time, last_time, len(indexes)
        )
        self._summary.chunks.add_chunk(chunk_entry, index_offsets)
        self._summary.schemas += schemas
        self._summary.channels += channels
        for block in blocks:
            self._summary.message_counts[block.channel] += len(block.log_times)
        self._summary.first_log_time = min(first_time, self._summary.first_log_time)
        self._summary.last_log_time = max(last_time, self._summary.last_log_time)

    def write_summary_and_footer(self) -> None:
        """Write the summary section and the footer of the file."""
        self._write_bytes(records_as_bytes([DataEnd(self._crc)]))
        body, offset_start = self._summary_section(self._at)
        # The CRC covers the summary section and three fields of the footer: opcode, length (20),
        # and both offsets.
        fields = struct.pack("<BQQQ", Opcode.FOOTER, 20, self._at, offset_start)
        footer = records_as_bytes(
            [Footer(self._at, offset_start, zlib.crc32(fields, zlib.crc32(body)))]
        )
        self._write_bytes(body + footer + MCAP_MAGIC)

    def _statistics(self) -> Statistics:
        """Return the Statistics record of the file."""
        summary = self._summary
        return Statistics(
            attachment_count=len(summary.attachments),
            channel_count=len(summary.channels),
            channel_message_counts=dict(sorted(summary.message_counts.items())),
            chunk_count=len(summary.chunks),
            message_count=self.message_count,
            message_end_time=summary.last_log_time,
            message_start_time=summary.first_log_time if summary.message_counts else 0,
            metadata_count=len(summary.metadata),
            schema_count=len(summary.schemas),
        )

    def _summary_section(self, start_offset: int) -> tuple[bytes, int]:
        """Return the summary section, and the position of its SummaryOffset records in the file [bytes].

        Args:
            start_offset: offset of the summary section in the file [bytes].
        """
        summary = self._summary
        body = b""
        offsets: list[McapRecord] = []
        groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
            (Opcode.SCHEMA, summary.schemas),
            (Opcode.CHANNEL, summary.channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, summary.chunks.chunk_indexes()),
            (Opcode.ATTACHMENT_INDEX, summary.attachments),
            (Opcode.METADATA_INDEX, summary.metadata),
        ]
        for code, group in groups:
            raw_bytes = records_as_bytes(group)
            if raw_bytes:
                offsets.append(
                    SummaryOffset(
                        group_length=len(raw_bytes),
                        group_opcode=code,
                        group_start=start_offset + len(body),
                    )
                )
            body += raw_bytes
        return body + records_as_bytes(offsets), start_offset + len(body)


def _message_indexes(
    blocks: Sequence[MessageBlock], first_message_offset: int
) -> tuple[bytes, dict[int, int]]:
    """Return the message indexes that follow a chunk, and the offset of each index by the id of its channel.

    Args:
        blocks: messages of the chunk.
        first_message_offset: start of the first message in the uncompressed chunk [bytes].
    """
    entries: dict[int, list[NDArray[np.void]]] = {}
    for block in blocks:
        block_entries = np.empty(len(block.offsets), _INDEX_ENTRY_DTYPE)
        block_entries["log_time"] = block.log_times
        block_entries["offset"] = block.offsets + np.uint64(first_message_offset)
        entries.setdefault(block.channel, []).append(block_entries)
        first_message_offset += len(block.data)
    index_records = []
    offsets = {}
    offset = 0
    for channel, entry_arrays in entries.items():
        raw_bytes = b"".join(entry_array.tobytes() for entry_array in entry_arrays)
        offsets[channel] = offset
        index_records.append(
            _MESSAGE_INDEX_STRUCT.pack(
                Opcode.MESSAGE_INDEX, 6 + len(raw_bytes), channel, len(raw_bytes)
            )
            + raw_bytes
        )
        offset += len(index_records[-1])
    return b"".join(index_records), offsets
