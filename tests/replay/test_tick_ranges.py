"""Test the distribution of the ticks of a log among processes."""

import multiprocessing
import tempfile
from collections.abc import Iterator
from typing import IO, Any

import pytest

from handctl.replay.tick_ranges import TickRanges

SEGMENT_STARTS = [100, 200, 300, 400, 500]
END = 560


@pytest.fixture
def lock_file() -> Iterator[IO[Any]]:
    with tempfile.TemporaryFile() as file:
        yield file


def remaining_segments(ranges: TickRanges, process: int) -> list[int]:
    """Take all segments of a process, and return the ends of the segments."""
    return list(iter(lambda: ranges.take_segment(process) or 0, 0))


def test_a_process_takes_the_segments_of_its_range_in_order(lock_file: IO[Any]) -> None:
    ranges = TickRanges([30, 300], END, SEGMENT_STARTS, lock_file)
    assert remaining_segments(ranges, 0) == [100, 200, 300]
    assert remaining_segments(ranges, 1) == [400, 500, 560]
    assert ranges.take_over_range(0) is None


def test_a_process_without_ticks_takes_over_the_later_half_of_the_longest_range(
    lock_file: IO[Any],
) -> None:
    ranges = TickRanges([0, 100, 200], END, SEGMENT_STARTS, lock_file)
    assert remaining_segments(ranges, 0) == [100]
    assert ranges.take_over_range(0) == 400
    assert remaining_segments(ranges, 2) == [300, 400]
    assert remaining_segments(ranges, 0) == [500, 560]


def test_a_single_segment_that_has_not_begun_can_be_taken_over(lock_file: IO[Any]) -> None:
    ranges = TickRanges([0, 400], END, SEGMENT_STARTS, lock_file)
    assert remaining_segments(ranges, 0) == [100, 200, 300, 400]
    assert ranges.take_segment(1) == 500
    assert ranges.take_over_range(0) == 500
    assert ranges.take_segment(1) is None
    assert remaining_segments(ranges, 0) == [560]


def test_the_first_ticks_of_a_log_stay_with_their_process(lock_file: IO[Any]) -> None:
    """No snapshot precedes the first tick, so no other process could start there."""
    ranges = TickRanges([0, 100], END, [100], lock_file)
    assert remaining_segments(ranges, 1) == [560]
    assert ranges.take_over_range(1) is None
    assert remaining_segments(ranges, 0) == [100]


def test_concurrent_processes_execute_every_tick_exactly_once(lock_file: IO[Any]) -> None:
    """Four processes take segments at the same time, and no tick is missing or taken twice."""
    segment_starts = list(range(10, 4000, 10))
    ranges = TickRanges([0, 10, 20, 30], 4000, segment_starts, lock_file)
    fork = multiprocessing.get_context("fork")
    results = fork.SimpleQueue()
    # Without the barrier, the first process sometimes takes all ticks before another process starts.
    first_segments_taken = fork.Barrier(4)

    def take_ticks(process: int) -> None:
        taken_ranges = []
        start: int | None = process * 10
        while start is not None:
            while (end := ranges.take_segment(process)) is not None:
                taken_ranges.append((start, end))
                start = end
                ranges.add_executed_ticks(process, 1)
                if len(taken_ranges) == 1:
                    first_segments_taken.wait()
            start = ranges.take_over_range(process)
        results.put(taken_ranges)

    processes = [fork.Process(target=take_ticks, args=(i,)) for i in range(4)]
    for process in processes:
        process.start()
    taken_by_process = [results.get() for _ in processes]
    for process in processes:
        process.join()
    taken = sorted(pair for taken_ranges in taken_by_process for pair in taken_ranges)
    starts, ends = zip(*taken, strict=True)
    assert [*starts, 4000] == [0, *ends]
    assert ranges.executed_tick_count == len(taken)
    assert sorted(taken_ranges[0][0] for taken_ranges in taken_by_process) == [0, 10, 20, 30]
