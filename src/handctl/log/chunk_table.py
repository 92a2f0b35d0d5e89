"""Compact table of the chunks of a log that is being written.

A log of one day has about 350,000 chunks.

MCAP requires an index of all chunks behind the last chunk. As records of the mcap package the index
takes 2 KB per chunk, which is 30 MB per hour. Here a chunk takes 64 bytes, because few arrangements
of message indexes occur and each is stored once. Full blocks are compressed to a third, because
successive chunks have similar numbers.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from mcap.records import ChunkIndex

_CHUNK = struct.Struct("<QQQQQQQQ")
"""ChunkAt, then the number of the arrangement of message indexes."""
_CHANNEL = struct.Struct("<HQ")
"""Channel id, offset of its message index behind the chunk's end."""
BLOCK = 512
"""Chunks per compressed block."""


class ChunkEntry(NamedTuple):
    """One chunk.

    Attributes:
        start, length: position of its record in the file [bytes].
        packed, size: size of its messages, compressed and uncompressed [bytes].
        first, last: times of its messages [ns].
        indexes: length of the message indexes behind the chunk [bytes].
    """

    start: int
    length: int
    packed: int
    size: int
    first: int
    last: int
    indexes: int


class ChunkTable:
    """All chunks written so far, in the order of the file."""

    def __init__(self) -> None:
        """Start with an empty table."""
        self._packed: list[bytes] = []
        self._latest = bytearray()
        self._layouts: dict[bytes, int] = {}

    def __len__(self) -> int:
        """Return the number of chunks."""
        return BLOCK * len(self._packed) + len(self._latest) // _CHUNK.size

    def add(self, chunk: ChunkEntry, index_offsets: dict[int, int]) -> None:
        """Append a chunk.

        Args:
            chunk: the chunk.
            index_offsets: channel -> distance from the chunk's end to the message index of the
                channel [bytes].
        """
        layout = b"".join([_CHANNEL.pack(*item) for item in index_offsets.items()])
        # `setdefault` numbers the arrangements in the order of their first use.
        self._latest += _CHUNK.pack(*chunk, self._layouts.setdefault(layout, len(self._layouts)))
        if len(self._latest) == BLOCK * _CHUNK.size:
            self._packed.append(zlib.compress(self._latest))
            self._latest.clear()

    def indexes(self) -> Iterator[ChunkIndex]:
        """Yield the ChunkIndex record of each chunk."""
        layouts = [tuple(_CHANNEL.iter_unpack(layout)) for layout in self._layouts]
        for *fields, layout in self._rows():
            chunk = ChunkEntry(*fields)
            end = chunk.start + chunk.length
            yield ChunkIndex(
                chunk_length=chunk.length,
                chunk_start_offset=chunk.start,
                compression="lz4",
                compressed_size=chunk.packed,
                message_end_time=chunk.last,
                message_index_length=chunk.indexes,
                message_index_offsets={channel: end + at for channel, at in layouts[layout]},
                message_start_time=chunk.first,
                uncompressed_size=chunk.size,
            )

    def _rows(self) -> Iterator[tuple[int, ...]]:
        """Yield the stored numbers of each chunk."""
        for block in (*map(zlib.decompress, self._packed), bytes(self._latest)):
            yield from _CHUNK.iter_unpack(block)
