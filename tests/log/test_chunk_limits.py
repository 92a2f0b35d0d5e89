"""Test the limits on the computing work that a single chunk of an MCAP file can cause in a reader."""

import struct

import pytest

from handctl.log.read.chunk_reader import (
    BYTES_PER_BLOCK,
    MAX_CHANNELS,
    MIN_BLOCK_LIMIT,
    iter_messages,
)


def channel_record(channel_id: int) -> bytes:
    return struct.pack("<BQHHIIIB", 4, 17, channel_id, 0, 0, 0, 1, 0)


def message_record(channel_id: int) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22, channel_id, 0, 0, 0)


def test_a_chunk_may_define_so_many_channels_however_large_it_is() -> None:
    """The largest number of channels in a chunk does not depend on the size of the chunk.

    Earlier defect: `log check` took more than a second for a chunk with a million channels.
    """
    large_byte_limit = 1 << 30
    allowed = channel_record(7) * 2 * MAX_CHANNELS + message_record(7)
    assert [message.channel for message in iter_messages(allowed, large_byte_limit)] == [7]
    with pytest.raises(ValueError, match=f"more than {MAX_CHANNELS} channels"):
        list(iter_messages(channel_record(7) + allowed, large_byte_limit))


@pytest.mark.parametrize("packed", [0, 10 * BYTES_PER_BLOCK])
def test_a_chunk_may_have_runs_in_proportion_to_its_size_in_the_file(packed: int) -> None:
    limit = MIN_BLOCK_LIMIT + packed // BYTES_PER_BLOCK
    alternating_records = b"".join(message_record(number % 2) for number in range(limit))
    assert len(list(iter_messages(alternating_records, packed))) == limit
    with pytest.raises(ValueError, match="more messages than"):
        list(iter_messages(alternating_records + message_record(limit % 2), packed))
