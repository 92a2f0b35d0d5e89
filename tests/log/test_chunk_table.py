"""Test the compact table in which a recorder remembers the chunks of its log."""

import random
import tracemalloc

import pytest

from handctl.log.chunk_table import CHUNKS_PER_BLOCK, ChunkEntry, ChunkTable


def chunk_at(chunk_index: int) -> ChunkEntry:
    return ChunkEntry(
        1000 * chunk_index, 700, 650, 2000, 250 * chunk_index, 250 * chunk_index + 249, 100
    )


def test_each_chunk_has_its_position_and_those_of_its_message_indexes() -> None:
    table = ChunkTable()
    for k, behind in enumerate(({1: 0, 2: 40}, {}, {1: 0, 2: 40}, {2: 0})):
        table.add_chunk(chunk_at(k), behind)
    indexes = list(table.chunk_indexes())
    assert len(table) == 4
    assert [index.message_index_offsets for index in indexes] == [
        {1: 700, 2: 740},
        {},
        {1: 2700, 2: 2740},
        {2: 3700},
    ]
    last_index = indexes[-1]
    assert (
        last_index.chunk_start_offset,
        last_index.chunk_length,
        last_index.message_index_length,
    ) == (
        3000,
        700,
        100,
    )
    assert (last_index.compression, last_index.compressed_size, last_index.uncompressed_size) == (
        "lz4",
        650,
        2000,
    )
    assert (last_index.message_start_time, last_index.message_end_time) == (750, 999)


@pytest.mark.parametrize(
    "chunks", [0, CHUNKS_PER_BLOCK - 1, CHUNKS_PER_BLOCK, 2 * CHUNKS_PER_BLOCK + 1]
)
def test_packing_changes_neither_their_order_nor_a_number(chunks: int) -> None:
    table = ChunkTable()
    for k in range(chunks):
        table.add_chunk(chunk_at(k), {1: k % 3})
    indexes = list(table.chunk_indexes())
    assert len(table) == len(indexes) == chunks
    for k, index in enumerate(indexes):
        assert (index.chunk_start_offset, index.message_start_time, index.message_end_time) == (
            1000 * k,
            250 * k,
            250 * k + 249,
        )
        assert index.message_index_offsets == {1: 1000 * k + 700 + k % 3}


def test_an_hour_of_chunks_is_less_than_half_a_megabyte() -> None:
    """Reproduce a defect: an earlier table of chunks made the memory of a recorder grow by 30 MiB per hour.

    The soak test permits 1 MiB per hour for the whole recorder.
    """
    chunks_an_hour, channels, rng = 4 * 3600, range(34), random.Random(1)
    start = 0
    tracemalloc.start()
    table = ChunkTable()
    for k in range(chunks_an_hour):
        size = rng.randrange(60_000, 90_000)
        times = (250_000_000 * k, 250_000_000 * k + 248_000_000)
        chunk_entry = ChunkEntry(start, size, size - 40, 3 * size, *times, 4000)
        table.add_chunk(chunk_entry, {channel: 50 * channel + k % 7 for channel in channels})
        start += size + 4000
    memory, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert memory < 2**19
    assert len(table) == chunks_an_hour
