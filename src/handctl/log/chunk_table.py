"""Compact table of the chunks in a log that is being written.

A log of one day has about 350,000 chunks. After the last chunk, an MCAP file must have an index of
all chunks. The records of the mcap package would need 2 KB of memory for each chunk, or 30 MB for
each hour of a run. The compact table needs 64 bytes for each chunk. Each chunk is followed by the
message indexes of one or more channels. After most chunks, the same channels have message indexes,
at the same distances from the end of the chunk. The table stores each such arrangement of message
indexes only once. Full blocks of the table are compressed to a third of their size, because
successive chunks have similar numbers.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from mcap.records import ChunkIndex

_CHUNK_ROW_STRUCT = struct.Struct("<QQQQQQQQ")
"""Layout of a row in the table: the fields of ChunkEntry, then the number of the arrangement of message indexes."""
_CHANNEL_STRUCT = struct.Struct("<HQ")
"""Layout of one channel in an arrangement: channel id, distance from the chunk's end to the channel's message index."""
CHUNKS_PER_BLOCK = 512
"""Number of chunks in one compressed block of the table."""


class ChunkEntry(NamedTuple):
    """Position, size and times of one chunk of a log.

    Attributes:
        start, length: start and length of the chunk's record in the file [bytes].
        packed_size, size: size of the messages with and without compression [bytes].
        first_ns, last_ns: times of the first and last message [ns].
        index_size: length of the message indexes after the chunk [bytes].
    """

    start: int
    length: int
    packed_size: int
    size: int
    first_ns: int
    last_ns: int
    index_size: int


class ChunkTable:
    """Table of all chunks that a file contains so far, in the order of the file."""

    def __init__(self) -> None:
        """Start with an empty table."""
        self._packed: list[bytes] = []
        self._latest = bytearray()
        self._layouts: dict[bytes, int] = {}

    def __len__(self) -> int:
        """Return the number of chunks in the table."""
        return CHUNKS_PER_BLOCK * len(self._packed) + len(self._latest) // _CHUNK_ROW_STRUCT.size

    def add_chunk(self, chunk: ChunkEntry, index_offsets: dict[int, int]) -> None:
        """Append a chunk to the table.

        Args:
            chunk: position, size and times of the chunk.
            index_offsets: distance from the end of the chunk to the message index of each channel
                [bytes], by channel id.
        """
        layout = b"".join(
            [
                _CHANNEL_STRUCT.pack(*channel_and_offset)
                for channel_and_offset in index_offsets.items()
            ]
        )
        # `setdefault` numbers the arrangements of message indexes in the order in which they are
        # first used.
        self._latest += _CHUNK_ROW_STRUCT.pack(
            *chunk, self._layouts.setdefault(layout, len(self._layouts))
        )
        if len(self._latest) == CHUNKS_PER_BLOCK * _CHUNK_ROW_STRUCT.size:
            self._packed.append(zlib.compress(self._latest))
            self._latest.clear()

    def chunk_indexes(self) -> Iterator[ChunkIndex]:
        """Yield the MCAP record ChunkIndex of each chunk."""
        layouts = [tuple(_CHANNEL_STRUCT.iter_unpack(layout)) for layout in self._layouts]
        for *fields, layout in self._chunk_rows():
            chunk = ChunkEntry(*fields)
            end = chunk.start + chunk.length
            yield ChunkIndex(
                chunk_length=chunk.length,
                chunk_start_offset=chunk.start,
                compression="lz4",
                compressed_size=chunk.packed_size,
                message_end_time=chunk.last_ns,
                message_index_length=chunk.index_size,
                message_index_offsets={channel: end + at for channel, at in layouts[layout]},
                message_start_time=chunk.first_ns,
                uncompressed_size=chunk.size,
            )

    def _chunk_rows(self) -> Iterator[tuple[int, ...]]:
        """Yield one tuple of stored numbers for each chunk, in the order of the file."""
        for block in (*map(zlib.decompress, self._packed), bytes(self._latest)):
            yield from _CHUNK_ROW_STRUCT.iter_unpack(block)
