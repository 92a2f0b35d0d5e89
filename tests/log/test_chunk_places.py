"""The index of a log's chunks, as small as a day needs it."""

import tracemalloc

from handctl.log.chunk_places import ChunkAt, ChunkPlaces


def at(k: int) -> ChunkAt:
    return ChunkAt(1000 * k, 700, 650, 2000, 250 * k, 250 * k + 249, 100)


def test_each_chunk_is_told_with_its_channels_where_they_are_in_the_file() -> None:
    places = ChunkPlaces()
    for k, behind in enumerate(({1: 0, 2: 40}, {}, {1: 0, 2: 40}, {2: 0})):
        places.add(at(k), behind)
    found = list(places.indexes())
    assert len(places) == 4
    assert [one.message_index_offsets for one in found] == [{1: 700, 2: 740}, {}, {1: 2700, 2: 2740}, {2: 3700}]
    last = found[-1]
    assert (last.chunk_start_offset, last.chunk_length, last.message_index_length) == (3000, 700, 100)
    assert (last.compression, last.compressed_size, last.uncompressed_size) == ("lz4", 650, 2000)
    assert (last.message_start_time, last.message_end_time) == (750, 999)


def test_an_hour_of_chunks_is_less_than_a_megabyte() -> None:
    """A recorder grew by 30 MiB an hour for it; the soak allows one."""
    chunks_an_hour, channels = 4 * 3600, range(34)
    tracemalloc.start()
    places = ChunkPlaces()
    for k in range(chunks_an_hour):
        places.add(at(k), {channel: 50 * channel + k % 7 for channel in channels})
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 2**20
    assert len(places) == chunks_an_hour
