"""Test the hash chain over the ticks of a log, and pairs of simultaneous readings of two clocks."""

import itertools
from pathlib import Path

import synthetic_run

from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.topics.clock_pair_topic import ClockPair, ClockStep, clock_steps
from handctl.log.topics.hash_chain import first_hash_of_run, tick_hash
from handctl.log.write.log_writer import LogWriter


def _write_log(
    log_path: Path, clock_readings: list[tuple[int, int]], duration_s: float, deterministic: bool
) -> Path:
    run = synthetic_run.synthetic_header(rate_hz=10, deterministic=deterministic)
    remaining_readings = iter(clock_readings)
    writer = LogWriter(log_path, run, lambda *arguments: None, 1, lambda: next(remaining_readings))
    for tick in synthetic_run.SyntheticRunTicks(run, duration_s):
        writer.add_tick(pack_tick_record(*tick)[RECORD_FRAMING_STRUCT.size :])
    writer.finish("finished", 0)
    return log_path


def test_each_digest_is_that_of_the_tick_s_bytes_and_the_digest_before(small_log: Path) -> None:
    with RunLog(small_log) as log:
        hash_before, digests = first_hash_of_run(log.header), list(log.tick_digests())
        assert len(digests) == len(log) == len(set(digests))
        for message, numbers, digest in zip(
            log.tick_messages(), log.packed_telemetry(), digests, strict=True
        ):
            assert digest == tick_hash(hash_before, message, numbers)
            hash_before = digest
        assert log.end["chain"] == hash_before.hex()


def test_a_step_of_the_wall_clock_shows_in_the_pairs(tmp_path: Path) -> None:
    """The log of this test lasts half a minute.

    The log contains readings of the wall clock and of the monotonic clock at the same moments.
    After the second reading of both clocks, the wall clock is set forward by an hour.
    """
    start, hour = 1_800_000_000_000_000_000, 3_600_000_000_000
    clocks = [(start + n * 10**10 + (hour if n > 1 else 0), 5 + n * 10**10) for n in range(4)]
    with RunLog(_write_log(tmp_path / "a.mcap", clocks, 35.0, deterministic=False)) as log:
        assert [pair[1:] for pair in log.clock_pairs] == clocks
        clock_pair_times_ns = [pair.t_ns for pair in log.clock_pairs]
        assert clock_pair_times_ns[0] <= 300_000_000
        assert all(
            10_000_000_000 <= b - a < 10_300_000_000
            for a, b in itertools.pairwise(clock_pair_times_ns)
        )
        assert list(clock_steps(log.clock_pairs)) == [
            ClockStep(clock_pair_times_ns[2] * 1e-9, 3600.0)
        ]


def test_a_slewed_clock_has_no_step() -> None:
    slewed_clock_pairs = [
        ClockPair(n * 10**10, n * (10**10 + 5_000_000), n * 10**10) for n in range(100)
    ]
    assert list(clock_steps(slewed_clock_pairs)) == []


def test_a_lockstep_run_reads_no_clock(tmp_path: Path) -> None:
    with RunLog(_write_log(tmp_path / "a.mcap", [], 12.0, deterministic=True)) as log:
        assert log.clock_pairs == []
