"""A file that may be cut, damaged or hostile: every size is checked before anything is allocated.

Source: the failures this guards against are in FAULTS I08 and I09.
"""

import os
import stat
import struct
import zlib
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from handctl.errors import LogError
from handctl.printing import printable

MAX_CHUNK = 32 << 20
"""Uncompressed; our own chunks stay below 8 MiB."""


DAMAGE = (
    ValueError, struct.error, LookupError, TypeError, ArithmeticError, RuntimeError, MemoryError, zstandard.ZstdError,
)  # fmt: skip
"""What a bad file causes where it is read."""


class Reading:
    """``with Reading(where)``: whatever a bad file causes becomes one LogError that says where.

    A class, not a generator: a log is read in thousands of pieces.
    """

    __slots__ = ("where",)

    def __init__(self, where: str) -> None:
        self.where = where

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or isinstance(error, LogError) or not isinstance(error, DAMAGE):
            return
        missing = isinstance(error, KeyError)
        what = f"{printable(repr(error.args[0]))} is missing" if missing else printable(str(error))
        raise LogError(f"damaged log: {what}", self.where, "an intact file") from error


class ChunkPlace(NamedTuple):
    """A chunk in the file.

    Attributes:
        offset: of its record.
        end: of its record.
        data: offset of the compressed bytes.
        first, last: times of its messages [ns].
        size: uncompressed.
        crc: of the uncompressed bytes; 0 none.
        compression: "", "lz4" or "zstd".
    """

    offset: int
    end: int
    data: int
    first: int
    last: int
    size: int
    crc: int
    compression: str


class LogFile:
    """An MCAP file open for reading.

    Raises:
        LogError: it is no regular file, or it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.name = printable(str(path))
        self._latest: tuple[ChunkPlace, bytes] | None = None
        try:
            self._fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | getattr(os, "O_CLOEXEC", 0))
        except OSError as error:
            raise LogError(f"cannot open: {error.strerror}", self.name, "a log") from error
        status = os.fstat(self._fd)
        self.size = status.st_size
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise LogError("not a file", self.name, "a log")

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)

    def at(self, offset: int) -> str:
        """A place in the file, for errors."""
        return f"{self.name}, byte {offset}"

    def read(self, offset: int, size: int) -> bytes:
        """Exactly size bytes.

        Raises:
            LogError: the file has become shorter.
        """
        data = os.pread(self._fd, size, offset)
        if len(data) != size:
            raise LogError("the file ends here", self.at(offset + len(data)), f"{size - len(data)} bytes more")
        return data

    def crc(self, start: int, end: int, value: int = 0) -> int:
        """CRC-32 of a part of the file."""
        while start < end:
            data = self.read(start, min(1 << 20, end - start))
            value, start = zlib.crc32(data, value), start + len(data)
        return value

    def content(self, place: ChunkPlace, checked: bool = True) -> bytes:
        """Uncompressed bytes of a chunk, never more than it declares.

        Args:
            place: of the chunk.
            checked: compare its checksum.

        Raises:
            LogError: they do not have the declared size or checksum.
        """
        if self._latest and self._latest[0] == place:
            return self._latest[1]
        with Reading(self.at(place.offset)):
            packed = self.read(place.data, place.end - place.data)
            content = _unpacked(packed, place)
            if len(content) != place.size:
                raise ValueError(f"chunk of {len(content)} bytes or more; declared are {place.size}")
            if checked and place.crc and zlib.crc32(content) != place.crc:
                raise ValueError("checksum of a chunk does not match")
        if checked:
            self._latest = (place, content)
        return content


def _unpacked(packed: bytes, place: ChunkPlace) -> bytes:
    if place.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=place.size + 1))
    if place.compression == "zstd":
        reader = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(packed)
        return reader.read(place.size + 1)
    return packed
