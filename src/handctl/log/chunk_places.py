"""Where the chunks of a log are, kept small until its end: a log of a day has a third of a million of them.

MCAP wants an index of all chunks behind the last one. As records of the mcap package they took 2 KB each, which is
30 MB an hour; here a chunk takes 64 bytes, for how its channels lie behind it repeats itself, and a third of that from
the next full block on: its numbers hardly differ from those of the chunk before.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from mcap.records import ChunkIndex

_CHUNK = struct.Struct("<QQQQQQQQ")
_CHANNEL = struct.Struct("<HQ")
BLOCK = 512
"""Chunks that are packed together."""


class ChunkAt(NamedTuple):
    """One chunk.

    Attributes:
        start, length: of its record. packed, size: bytes of its messages, compressed and not.
        first, last: times of its messages [ns]. indexes: length of the message indexes behind it.
    """

    start: int
    length: int
    packed: int
    size: int
    first: int
    last: int
    indexes: int


class ChunkPlaces:
    """All chunks so far, in the order of the file."""

    def __init__(self) -> None:
        self._packed: list[bytes] = []
        self._latest = bytearray()
        self._layouts: dict[bytes, int] = {}

    def __len__(self) -> int:
        return BLOCK * len(self._packed) + len(self._latest) // _CHUNK.size

    def add(self, chunk: ChunkAt, behind: dict[int, int]) -> None:
        """One more chunk.

        Args:
            chunk: where it is.
            behind: by channel, how far behind the chunk's end its message index begins.
        """
        layout = b"".join([_CHANNEL.pack(*one) for one in behind.items()])
        self._latest += _CHUNK.pack(*chunk, self._layouts.setdefault(layout, len(self._layouts)))
        if len(self._latest) == BLOCK * _CHUNK.size:
            self._packed.append(zlib.compress(self._latest))
            self._latest.clear()

    def indexes(self) -> Iterator[ChunkIndex]:
        """The record of each."""
        layouts = [tuple(_CHANNEL.iter_unpack(layout)) for layout in self._layouts]
        for *fields, layout in self._rows():
            chunk = ChunkAt(*fields)
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
        for block in (*map(zlib.decompress, self._packed), bytes(self._latest)):
            yield from _CHUNK.iter_unpack(block)
