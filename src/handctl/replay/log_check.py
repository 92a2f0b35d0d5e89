"""Integrity check of a log: tick numbers, gaps, clock, hashes."""

from collections.abc import Iterator

import numpy as np

from handctl.log.read.reader import RunLog
from handctl.log.topics.hash_chain import first_hash_of_run, tick_hash
from handctl.replay.controller_rebuild import logged_hand


def check_log(log: RunLog) -> list[str]:
    """Read every byte of a log, and return one line for each defect.

    Raises:
        LogError: a chunk of the log is damaged.
    """
    return [
        *_check_end(log),
        *_check_counters(log),
        *_check_clock(log),
        *_check_frame_time_stamps(log),
        *_check_hashes(log),
        *_check_hash_chain(log),
    ]


def _check_end(log: RunLog) -> Iterator[str]:
    """Check the end of the log and the number of ticks, and yield a line for each defect."""
    if log.warning:
        yield f"incomplete: {log.warning}"
    if log.end and int(log.end.get("ticks", len(log))) != len(log):
        yield f"{len(log)} ticks, but the end record states {log.end['ticks']}"
    if int(log.end.get("dropped", 0)):
        yield f"the recorder dropped {log.end['dropped']} ticks"
    rows = sum(1 for _ in log.packed_telemetry())
    if rows != len(log):
        yield f"{len(log)} ticks, but telemetry of {rows} ticks"


def _check_counters(log: RunLog) -> Iterator[str]:
    """Check the tick numbers, and yield a line for each defect."""
    steps = np.diff(log.k)
    if (steps < 1).any():
        yield f"tick {int(log.k[1:][steps < 1][0])} follows a later tick"
    for gap in log.gaps:
        if gap.first_tick_after <= gap.last_tick_before:
            continue
        missing_tick_count = gap.first_tick_after - gap.last_tick_before - 1
        yield f"gap: {missing_tick_count} ticks are missing between {gap.last_tick_before} and {gap.first_tick_after}"


def _check_clock(log: RunLog) -> Iterator[str]:
    """Check the times and the lateness of the ticks, and yield a line for each defect."""
    is_time_wrong = log.t_ns != log.k * log.header.period_ns
    if is_time_wrong.any():
        yield f"the time of tick {int(log.k[is_time_wrong][0])} is not its number times the period"
    invalid_ticks = (log.late_ns < 0) | (log.late_ns >= log.header.period_ns)
    if invalid_ticks.any():
        lateness = f"the lateness of tick {int(log.k[invalid_ticks][0])} is {int(log.late_ns[invalid_ticks][0])} ns"
        yield f"{lateness}; expected 0 to less than a period, {log.header.period_ns} ns"


def _check_frame_time_stamps(log: RunLog) -> Iterator[str]:
    """Yield a line if CAN frames have time stamps after the end of the tick that read the frames.

    A time stamp after the end of the tick does not come from the clock of the controller.
    """
    late_stamp_count = 0
    first_tick = -1
    for tick in log.ticks():
        tick_end_ns = tick.tick_in.t_ns + tick.tick_in.late_ns + log.header.period_ns
        late_stamps_in_tick = sum(frame.t_ns > tick_end_ns for frame in tick.tick_in.frames)
        if late_stamps_in_tick and not late_stamp_count:
            first_tick = tick.tick_in.k
        late_stamp_count += late_stamps_in_tick
    if late_stamp_count:
        yield f"{late_stamp_count} frames are stamped later than the tick that read them, first in tick {first_tick}"


def _check_hashes(log: RunLog) -> Iterator[str]:
    """Check the identity of the hand, and check that no two ticks have the same hash of the controller's state."""
    logged_identity = log.header.metadata.get("identity", "")
    computed_identity = logged_hand(log).identity
    if logged_identity != computed_identity:
        yield f"hand.toml has identity {computed_identity[:12]}, the header states {logged_identity[:12]}"
    hashes = {tick.state_hash for tick in log.ticks()}
    if len(hashes) != len(log):
        yield f"{len(log) - len(hashes)} state hashes are duplicates"


def _check_hash_chain(log: RunLog) -> Iterator[str]:
    """Check the hash chain of the log, and yield a line that names the first tick with a wrong hash."""
    hash_before = first_hash_of_run(log.header)
    broken_chunks = list[int]()
    ticks = zip(
        log.k.tolist(),
        log.tick_messages(),
        log.packed_telemetry(),
        log.tick_digests(),
        strict=False,
    )
    for k, message, numbers, digest in ticks:
        if tick_hash(hash_before, message, numbers) != digest:
            broken_chunks.append(k)
        # After a wrong hash, the check continues with the hash in the log. As a result, a single
        # changed tick is reported only once.
        hash_before = digest
    if broken_chunks:
        others_text = f", and {len(broken_chunks) - 1} more" if len(broken_chunks) > 1 else ""
        yield (
            f"the hash chain breaks at tick {broken_chunks[0]}{others_text}: this tick, "
            "or the hash before it, was changed"
        )
    final_hash = log.end.get("chain", "") if not log.warning and "recovered" not in log.end else ""
    if final_hash and final_hash != hash_before.hex():
        yield f"the hash chain ends with {hash_before.hex()}, the end record states {final_hash}"
