"""Test how the report counts the late frames and the lost frames in a log.

The tests delay or remove frames in copies of a golden log.
"""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import pytest

from handctl.controller.run_setup import make_sensors
from handctl.core.tick_types import IoEvent
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.log.tick_record import TickRecord
from handctl.report.frame_counts import frame_counts

GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"

JAMIA_HAND = load_hand("jamia")
TICK_COUNT = 600


@pytest.fixture(scope="module")
def golden_ticks() -> list[TickRecord]:
    with RunLog(GOLDEN_FOLDER / "jamia-grasp.mcap") as log:
        return list(islice(log.ticks(), TICK_COUNT))


def count_frames(golden_ticks: list[TickRecord]) -> tuple[int, ...]:
    def read() -> Iterator[TickRecord]:
        yield from golden_ticks

    return tuple(frame_counts(SimpleNamespace(ticks=read), JAMIA_HAND))  # type: ignore[arg-type]


def remove_tension_frame(
    golden_ticks: list[TickRecord], tick_index: int
) -> tuple[list[TickRecord], object]:
    """Remove the first load-cell frame of one tick. Return the changed ticks of the log and the removed frame."""
    first_tension_id = make_sensors(JAMIA_HAND).ids[0]
    entry = golden_ticks[tick_index].tick_in
    [removed_frame] = [frame for frame in entry.frames if frame.can_id == first_tension_id][:1]
    remaining_frames = tuple(frame for frame in entry.frames if frame != removed_frame)
    changed_tick = golden_ticks[tick_index]._replace(
        tick_in=entry._replace(frames=remaining_frames)
    )
    return [
        *golden_ticks[:tick_index],
        changed_tick,
        *golden_ticks[tick_index + 1 :],
    ], removed_frame


def test_a_run_without_faults_has_no_lost_and_no_late_frame(golden_ticks: list[TickRecord]) -> None:
    assert count_frames(golden_ticks) == (0, 0, 0)


def test_a_frame_that_never_comes_is_lost(golden_ticks: list[TickRecord]) -> None:
    for tick_index in (300, 310, 320):
        golden_ticks, _ = remove_tension_frame(golden_ticks, tick_index)
    assert count_frames(golden_ticks) == (0, 3, 0)


def test_a_frame_of_the_tick_before_is_late(golden_ticks: list[TickRecord]) -> None:
    golden_ticks, frame = remove_tension_frame(golden_ticks, 300)
    entry = golden_ticks[301].tick_in
    golden_ticks[301] = golden_ticks[301]._replace(
        tick_in=entry._replace(frames=(frame, *entry.frames))
    )
    assert count_frames(golden_ticks) == (1, 0, 0)


def test_a_refused_frame_is_lost(golden_ticks: list[TickRecord]) -> None:
    entry = golden_ticks[300].tick_in
    refused_tick = golden_ticks[300]._replace(
        tick_in=entry._replace(io_events=(IoEvent("enobufs", "can0", 2),))
    )
    assert count_frames([*golden_ticks[:300], refused_tick, *golden_ticks[301:]]) == (0, 2, 0)


def test_a_paused_simulator_causes_a_tick_without_frames(golden_ticks: list[TickRecord]) -> None:
    """If the simulator pauses, the replies of a tick arrive in the next tick."""
    entry, following = golden_ticks[300].tick_in, golden_ticks[301].tick_in
    golden_ticks = [*golden_ticks]
    golden_ticks[300] = golden_ticks[300]._replace(tick_in=entry._replace(frames=()))
    golden_ticks[301] = golden_ticks[301]._replace(
        tick_in=following._replace(frames=(*entry.frames, *following.frames))
    )
    assert count_frames(golden_ticks) == (1, 0, 1)
