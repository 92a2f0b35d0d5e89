"""Reader of the messages in an uncompressed chunk of a log.

The reader returns blocks. A block contains consecutive messages of equal length.

Layout of a Message record: opcode u8 = 5, length u64, channel u16, sequence u32, log time u64 [ns],
publish time u64 [ns], data.
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

MAX_CHANNELS = 1000
"""Largest accepted number of schemas in a chunk, and largest accepted number of channels."""
MIN_BLOCK_LIMIT = 128
"""Number of message blocks that a chunk of any size is allowed to have."""
BYTES_PER_BLOCK = 16
"""Number of compressed bytes of a chunk for which the chunk is allowed to have one further message block."""
LINEAR_SEARCH_LIMIT = 4
"""Largest number of records of a block that are compared one by one.

The end of a longer block is found with numpy.
"""
_RECORD_STRUCT = struct.Struct("<BQ")
"""Layout of the start of every MCAP record: opcode, length."""
_CHANNEL_STRUCT = struct.Struct("<H")
MESSAGE_OPCODE = int(Opcode.MESSAGE)
_MESSAGE_HEAD_BYTES = 11
"""Number of bytes that are equal in all messages of a block: opcode, length and channel."""
_RECORD_HEADERS = np.dtype(f"V{_MESSAGE_HEAD_BYTES}")
_MESSAGE_DATA_OFFSET = 31
"""Offset of the data in a Message record [bytes]."""


class MessageRows(NamedTuple):
    """Consecutive messages of a chunk with the same channel and the same length.

    Attributes:
        channel: id of the channel.
        start: offset of the first record in the chunk [bytes].
        records: (n, size of a record) bytes of all records.
    """

    channel: int
    start: int
    records: NDArray[np.uint8]

    def messages(self) -> list[bytes]:
        """Return the data of each message as bytes, in order."""
        size = self.records.shape[1]
        content = self.records.tobytes()
        return [
            content[offset + _MESSAGE_DATA_OFFSET : offset + size]
            for offset in range(0, len(content), size)
        ]

    def data(self) -> NDArray[np.uint8]:
        """Return the data of the messages as an array (n, size of a message)."""
        return self.records[:, _MESSAGE_DATA_OFFSET:]

    def sequence(self) -> NDArray[np.uint32]:
        """Return the sequence numbers of the messages (n,)."""
        return np.ascontiguousarray(self.records[:, 11:15]).view("<u4")[:, 0]

    def log_times(self) -> NDArray[np.uint64]:
        """Return the log times of the messages (n,) [ns]."""
        return np.ascontiguousarray(self.records[:, 15:23]).view("<u8")[:, 0]


class ChunkDefinitions(NamedTuple):
    """Schemas and channels that are defined in a chunk.

    Attributes:
        schemas: (id, name, encoding, data) of each schema.
        channels: (id, schema id, topic, encoding, metadata) of each channel.
    """

    schemas: list[tuple[int, str, str, bytes]]
    channels: list[tuple[int, int, str, str, dict[str, str]]]


def iter_messages(
    content: bytes, compressed_size: int, channels: frozenset[int] | None = None
) -> Iterator[MessageRows]:
    """Yield the messages of the given channels, or of all channels, in blocks.

    Args:
        content: the uncompressed chunk.
        compressed_size: size of the compressed chunk [bytes]. The compressed size limits the number
            of blocks, so that a small file cannot cause a lot of work.
        channels: ids of the channels to read. If ``channels`` is None, all channels are read.

    Raises:
        ValueError: the chunk is damaged.
        struct.error: the chunk ends within a record.
    """
    raw_bytes = np.frombuffer(content, np.uint8)
    offset = 0
    definition_count = 0
    remaining = MIN_BLOCK_LIMIT + compressed_size // BYTES_PER_BLOCK
    while offset < len(content):
        remaining -= 1
        if remaining < 0:
            raise ValueError("more messages than a chunk of this size may contain")
        code, length = _RECORD_STRUCT.unpack_from(content, offset)
        size = _RECORD_STRUCT.size + length
        if offset + size > len(content):
            raise ValueError("a record extends beyond the end of its chunk")
        count = 1
        if code == MESSAGE_OPCODE:
            if size < _MESSAGE_DATA_OFFSET:
                raise ValueError("a message that is too short")
            count = _count_similar_records(content, offset, size)
            (channel,) = _CHANNEL_STRUCT.unpack_from(content, offset + 9)
            if channels is None or channel in channels:
                yield MessageRows(
                    channel, offset, raw_bytes[offset : offset + count * size].reshape(count, size)
                )
        elif code in (Opcode.SCHEMA, Opcode.CHANNEL):
            definition_count += 1
            if definition_count > 2 * MAX_CHANNELS:
                raise ValueError(f"more than {MAX_CHANNELS} channels")
        else:
            raise ValueError(f"a record of kind {code} in a chunk")
        offset += count * size


def _count_similar_records(content: bytes, offset: int, size: int) -> int:
    """Count the consecutive records with the same size and channel as the first record.

    Args:
        content: the uncompressed chunk.
        offset: offset of the first record in the chunk [bytes].
        size: size of a record [bytes].
    """
    max_count = (len(content) - offset) // size
    count = 1
    step = 16
    message_head = content[offset : offset + _MESSAGE_HEAD_BYTES]
    next_offset = offset + size
    while count < min(LINEAR_SEARCH_LIMIT, max_count):
        if content[next_offset : next_offset + _MESSAGE_HEAD_BYTES] != message_head:
            return count
        count += 1
        next_offset += size
    # Each pass of the loop compares four times as many records as the pass before. As a result, a
    # long block of records needs few comparisons. An `ndarray` with a stride reads only the first
    # bytes of each record.
    while count < max_count:
        number = min(step, max_count - count)
        record_heads = np.ndarray(
            number, _RECORD_HEADERS, content, offset + count * size, (size,)
        ).tobytes()
        equal_count = (
            number
            if record_heads == message_head * number
            else _count_equal_heads(record_heads, message_head, number)
        )
        count += equal_count
        step *= 4
        if equal_count < number:
            return count
    return count


def _count_equal_heads(head_bytes: bytes, message_head: bytes, count_limit: int) -> int:
    """Count how many consecutive elements of `head_bytes`, from the first on, equal `message_head`.

    The function expects that at least one of the compared elements differs from `message_head`.
    """
    low = 0
    while count_limit - low > 1:
        tried_count = (low + count_limit) // 2
        if head_bytes[: tried_count * _MESSAGE_HEAD_BYTES] == message_head * tried_count:
            low = tried_count
        else:
            count_limit = tried_count
    return low


def schemas_and_channels(content: bytes) -> ChunkDefinitions:
    """Return the schemas and channels whose definitions are at the start of a chunk.

    This function raises the same errors as `iter_messages`.
    """
    result = ChunkDefinitions([], [])
    offset = 0
    while offset < len(content):
        code, length = _RECORD_STRUCT.unpack_from(content, offset)
        body = content[offset + _RECORD_STRUCT.size : offset + _RECORD_STRUCT.size + length]
        if code == Opcode.SCHEMA:
            result.schemas.append(_decode_schema(body))
        elif code == Opcode.CHANNEL:
            result.channels.append(_decode_channel(body))
        else:
            break
        if max(len(result.schemas), len(result.channels)) > MAX_CHANNELS:
            raise ValueError(f"more than {MAX_CHANNELS} channels")
        offset += _RECORD_STRUCT.size + length
    return result


def _read_text(body: bytes, offset: int) -> tuple[str, int]:
    """Read a string of a record. Return the string, and the offset of the first byte after the string."""
    raw_bytes, offset = _read_bytes(body, offset)
    return raw_bytes.decode(), offset


def _read_bytes(body: bytes, offset: int) -> tuple[bytes, int]:
    """Read a byte array of a record. Return the array, and the offset of the first byte after the array."""
    (size,) = struct.unpack_from("<I", body, offset)
    if offset + 4 + size > len(body):
        raise ValueError("a text extends beyond the end of its record")
    return body[offset + 4 : offset + 4 + size], offset + 4 + size


def _decode_schema(body: bytes) -> tuple[int, str, str, bytes]:
    """Decode a Schema record with the fields id u16, name, encoding, data."""
    (number,) = struct.unpack_from("<H", body)
    name, offset = _read_text(body, 2)
    encoding, offset = _read_text(body, offset)
    return number, name, encoding, _read_bytes(body, offset)[0]


def _decode_channel(body: bytes) -> tuple[int, int, str, str, dict[str, str]]:
    """Decode a Channel record with the fields id u16, schema id u16, topic, encoding, metadata (texts by key)."""
    number, schema = struct.unpack_from("<HH", body)
    topic, offset = _read_text(body, 4)
    encoding, offset = _read_text(body, offset)
    raw_bytes, _ = _read_bytes(body, offset)
    metadata = {}
    offset = 0
    while offset < len(raw_bytes):
        key, offset = _read_text(raw_bytes, offset)
        metadata[key], offset = _read_text(raw_bytes, offset)
    return number, schema, topic, encoding, metadata
