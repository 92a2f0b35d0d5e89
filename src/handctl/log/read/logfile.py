"""Access to a log file, even if the file is truncated, damaged, or malicious.

The reader checks every size that the file declares before it allocates memory of this size.

Source: the faults of damaged and of malicious log files (I08, I09) in the catalogue of faults.
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
from handctl.printing import printable_text

MAX_CHUNK_BYTES = 32 << 20
"""Largest accepted uncompressed size of a chunk [bytes]. The recorder writes chunks below 8 MiB."""


ERRORS_OF_DAMAGED_FILES = (
    ValueError, struct.error, LookupError, TypeError, ArithmeticError, RuntimeError, MemoryError, zstandard.ZstdError,
)  # fmt: skip
"""Exceptions that a damaged or malicious file can cause in the code that reads it."""


class LogErrorContext:
    """Context `with LogErrorContext(where)`.

    If a bad file causes an exception inside the context, the context replaces this exception by a
    LogError. The LogError contains the position in the file. A log is read in thousands of pieces,
    and each piece needs a context. This class is faster than a generator function with
    `contextmanager`.
    """

    __slots__ = ("where",)

    def __init__(self, log_name: str) -> None:
        """Store the position in the file, which an error message will contain."""
        self.where = log_name

    def __enter__(self) -> None:
        """Enter the context for one piece of the file."""

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Raise a LogError in place of an exception that a bad file has caused."""
        if (
            error is None
            or isinstance(error, LogError)
            or not isinstance(error, ERRORS_OF_DAMAGED_FILES)
        ):
            return
        is_missing = isinstance(error, KeyError)
        problem = (
            f"{printable_text(repr(error.args[0]))} is missing"
            if is_missing
            else printable_text(str(error))
        )
        raise LogError(f"damaged log: {problem}", self.where, "an intact file") from error


class ChunkLocation(NamedTuple):
    """Location and checksum of a chunk in the file.

    Attributes:
        offset, end: start and end of the chunk's record [bytes].
        data_offset: offset of the compressed bytes in the file.
        first_ns, last_ns: times of the first and last message of the chunk [ns].
        size: uncompressed size of the chunk [bytes].
        crc: CRC-32 of the uncompressed bytes, or 0 if the file gives no checksum for the chunk.
        compression: name of the compression: "", "lz4" or "zstd".
    """

    offset: int
    end: int
    data_offset: int
    first_ns: int
    last_ns: int
    size: int
    crc: int
    compression: str


class LogFile:
    """MCAP file that is open for reading.

    Attributes:
        name: path of the file, for error messages.
        size: size of the file [bytes].
    """

    def __init__(self, path: Path) -> None:
        """Open a file for reading.

        Raises:
            LogError: the path is not a regular file, or the file cannot be opened.
        """
        self.name = printable_text(str(path))
        self._latest: tuple[ChunkLocation, bytes] | None = None
        try:
            # Without O_NONBLOCK, opening a named pipe that has no writer would wait forever.
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

    def position_text(self, offset: int) -> str:
        """Return a position in the file as text for an error message."""
        return f"{self.name}, byte {offset}"

    def read_range(self, offset: int, size: int) -> bytes:
        """Read exactly `size` bytes of the file.

        Raises:
            LogError: the file has become shorter since it was opened.
        """
        data = os.pread(self._fd, size, offset)
        if len(data) != size:
            raise LogError(
                "the file ends here",
                self.position_text(offset + len(data)),
                f"{size - len(data)} bytes more",
            )
        return data

    def range_crc(self, start: int, end: int, value: int = 0) -> int:
        """Return the CRC-32 of a part of the file, calculated piece by piece.

        If ``value`` is the CRC-32 of the preceding bytes, the result is the CRC-32 of these bytes
        and the part together.

        Args:
            start: start of the part [bytes].
            end: end of the part [bytes].
            value: CRC-32 of the bytes before the part, or 0.
        """
        while start < end:
            data = self.read_range(start, min(1 << 20, end - start))
            value = zlib.crc32(data, value)
            start += len(data)
        return value

    def chunk_content(self, chunk: ChunkLocation, is_checked: bool = True) -> bytes:
        """Return the uncompressed bytes of a chunk.

        The result never has more bytes than the chunk declares.

        Args:
            chunk: location of the chunk.
            is_checked: True to check the checksum of the chunk.

        Raises:
            LogError: the size or the checksum of the chunk differs from the declared one.
        """
        if self._latest and self._latest[0] == chunk:
            return self._latest[1]
        with LogErrorContext(self.position_text(chunk.offset)):
            compressed_bytes = self.read_range(chunk.data_offset, chunk.end - chunk.data_offset)
            content = _decompress_chunk(compressed_bytes, chunk)
            if len(content) != chunk.size:
                raise ValueError(
                    f"chunk of {len(content)} bytes or more; declared are {chunk.size}"
                )
            if is_checked and chunk.crc and zlib.crc32(content) != chunk.crc:
                raise ValueError("checksum of a chunk does not match")
        if is_checked:
            self._latest = (chunk, content)
        return content


def _decompress_chunk(compressed_bytes: bytes, chunk: ChunkLocation) -> bytes:
    """Return the decompressed bytes of a chunk.

    The result is at most one byte longer than ``chunk.size``, the size that the chunk declares.
    """
    # One additional byte shows that a chunk is longer than it declares. The rest of a chunk that is
    # too long need not be decompressed.
    if chunk.compression == "lz4":
        return bytes(
            lz4.frame.LZ4FrameDecompressor().decompress(compressed_bytes, max_length=chunk.size + 1)
        )
    if chunk.compression == "zstd":
        reader = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES).stream_reader(
            compressed_bytes
        )
        return reader.read(chunk.size + 1)
    return compressed_bytes
