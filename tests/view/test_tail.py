"""The viewer reads a growing log to its end without lost or duplicate messages.

A growing log can grow in steps of any size.
"""

import random
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import Chunk
from rrd_entities import read_entities, run_info_of

from handctl.errors import LogError
from handctl.log.read.logfile import LogFile
from handctl.view.log_tail import LogTail
from handctl.view.rerun_conversion import chunks_of_log
from handctl.view.scene.topic_converters import TopicConverters


def growing_file_sizes(log_bytes: bytes, seed: int) -> list[int]:
    """Return the file sizes at which a growing log is read, in order.

    The first file size is 64 KiB, and the last file size is that of the whole log. All other file
    sizes are random.
    """
    source = random.Random(seed)
    first_size = 64 << 10
    return [
        first_size,
        *sorted(source.randrange(first_size, len(log_bytes)) for _ in range(12)),
        len(log_bytes),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_the_parts_of_a_growing_log_add_up_to_the_whole_log(
    seed: int, jamia_log_path: Path, tmp_path: Path
) -> None:
    whole_content, path, new_chunks_path = (
        jamia_log_path.read_bytes(),
        tmp_path / "run.mcap",
        tmp_path / "part.mcap",
    )
    run = run_info_of(jamia_log_path)
    converters, tail, chunks, times = TopicConverters(run), LogTail(path), list[Chunk](), 0
    for size in growing_file_sizes(whole_content, seed):
        path.write_bytes(whole_content[:size])
        assert not (tail.has_log_ended and size < 0.9 * len(whole_content))
        first_time_ns = tail.write_new_chunks(new_chunks_path)
        if first_time_ns is not None:
            chunks += chunks_of_log(new_chunks_path, converters, "part", first_time_ns)
            times += 1
    assert tail.has_log_ended
    assert tail.write_new_chunks(new_chunks_path) is None
    assert times > 4
    shown_entities, expected = (
        read_entities(chunks),
        read_entities(chunks_of_log(jamia_log_path, TopicConverters(run), "whole")),
    )
    assert shown_entities.keys() == expected.keys()
    for name in shown_entities.keys() - {"/tension/limit"}:
        if name == "/tf_static":  # a message of this topic is allowed to be sent twice
            assert set(map(repr, shown_entities[name].rows)) == set(map(repr, expected[name].rows))
            continue
        np.testing.assert_array_equal(
            shown_entities[name].times, expected[name].times, err_msg=name
        )
        assert repr(shown_entities[name].rows) == repr(expected[name].rows), name


def test_every_byte_of_growth_within_a_chunk_is_safe(jamia_log_path: Path, tmp_path: Path) -> None:
    whole_content, path, new_chunks_path = (
        jamia_log_path.read_bytes(),
        tmp_path / "run.mcap",
        tmp_path / "part.mcap",
    )
    tail, part_count = LogTail(path), 0
    first_size = len(whole_content) // 2
    for size in range(first_size, first_size + 60_000, 997):
        path.write_bytes(whole_content[:size])
        part_count += tail.write_new_chunks(new_chunks_path) is not None
    assert part_count > 1


def test_a_call_reads_no_record_again(
    jamia_log_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect: several times per second, the reader of a growing log read all records again."""
    whole_content, path, new_chunks_path = (
        jamia_log_path.read_bytes(),
        tmp_path / "run.mcap",
        tmp_path / "part.mcap",
    )
    offsets = list[int]()
    original_read_range = LogFile.read_range

    def read_and_record_offset(file: LogFile, offset: int, size: int) -> bytes:
        offsets.append(offset)
        return original_read_range(file, offset, size)

    monkeypatch.setattr(LogFile, "read_range", read_and_record_offset)
    path.write_bytes(whole_content[: len(whole_content) // 2])
    tail = LogTail(path)
    assert tail.write_new_chunks(new_chunks_path) is not None
    assert len(offsets) > 100
    offsets.clear()
    assert tail.write_new_chunks(new_chunks_path) is None
    assert len(offsets) <= 3, "the two magic texts, and the head of the incomplete record"
    path.write_bytes(whole_content)
    assert tail.write_new_chunks(new_chunks_path) is not None
    assert tail.has_log_ended
    offsets.clear()
    assert tail.write_new_chunks(new_chunks_path) is None
    assert offsets == []


def test_another_file_is_an_error(jamia_log_path: Path, tmp_path: Path) -> None:
    data, path = bytearray(jamia_log_path.read_bytes()), tmp_path / "run.mcap"
    data[0] = 0
    path.write_bytes(data)
    with pytest.raises(LogError, match="not an MCAP file"):
        LogTail(path).write_new_chunks(tmp_path / "part.mcap")
