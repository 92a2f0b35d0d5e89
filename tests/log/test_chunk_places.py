"""The index of a log's chunks, as small as a day needs it."""

import random
import tracemalloc

import pytest

from handctl.log.chunk_table import BLOCK, ChunkEntry, ChunkTable


def at(k: int) -> ChunkEntry:
    return ChunkEntry(1000 * k, 700, 650, 2000, 250 * k, 250 * k + 249, 100)


def test_each_chunk_is_told_with_its_channels_where_they_are_in_the_file() -> None:
    places = ChunkTable()
    for k, behind in enumerate(({1: 0, 2: 40}, {}, {1: 0, 2: 40}, {2: 0})):
        places.add(at(k), behind)
    found = list(places.indexes())
    assert len(places) == 4
    assert [one.message_index_offsets for one in found] == [{1: 700, 2: 740}, {}, {1: 2700, 2: 2740}, {2: 3700}]
    last = found[-1]
    assert (last.chunk_start_offset, last.chunk_length, last.message_index_length) == (3000, 700, 100)
    assert (last.compression, last.compressed_size, last.uncompressed_size) == ("lz4", 650, 2000)
    assert (last.message_start_time, last.message_end_time) == (750, 999)


@pytest.mark.parametrize("chunks", [0, BLOCK - 1, BLOCK, 2 * BLOCK + 1])
def test_packing_changes_neither_their_order_nor_a_number(chunks: int) -> None:
    places = ChunkTable()
    for k in range(chunks):
        places.add(at(k), {1: k % 3})
    found = list(places.indexes())
    assert len(places) == len(found) == chunks
    for k, one in enumerate(found):
        assert (one.chunk_start_offset, one.message_start_time, one.message_end_time) == (
            1000 * k,
            250 * k,
            250 * k + 249,
        )
        assert one.message_index_offsets == {1: 1000 * k + 700 + k % 3}


def test_an_hour_of_chunks_is_less_than_half_a_megabyte() -> None:
    """A recorder grew by 30 MiB an hour for it; the soak allows one for all that there is."""
    chunks_an_hour, channels, chance = 4 * 3600, range(34), random.Random(1)
    start = 0
    tracemalloc.start()
    places = ChunkTable()
    for k in range(chunks_an_hour):
        size = chance.randrange(60_000, 90_000)
        times = (250_000_000 * k, 250_000_000 * k + 248_000_000)
        place = ChunkEntry(start, size, size - 40, 3 * size, *times, 4000)
        places.add(place, {channel: 50 * channel + k % 7 for channel in channels})
        start += size + 4000
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 2**19
    assert len(places) == chunks_an_hour
