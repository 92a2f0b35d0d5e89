"""Test the counts of late and lost frames in a log. Frames of a golden run are delayed or removed."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import pytest

from handctl.controller.setup import make_sensors
from handctl.core.types import IoEvent
from handctl.hand.load import load_hand
from handctl.log.read.reader import RunLog
from handctl.log.tick_record import TickRecord
from handctl.report.frame_counts import frame_counts

GOLDEN = Path(__file__).parents[2] / "logs" / "golden"

HAND = load_hand("jamia")
TICKS = 600


@pytest.fixture(scope="module")
def ticks() -> list[TickRecord]:
    with RunLog(GOLDEN / "jamia-grasp.mcap") as log:
        return list(islice(log.ticks(), TICKS))


def counted(ticks: list[TickRecord]) -> tuple[int, ...]:
    def read() -> Iterator[TickRecord]:
        yield from ticks

    return tuple(frame_counts(SimpleNamespace(ticks=read), HAND))  # type: ignore[arg-type]


def without(ticks: list[TickRecord], at: int) -> tuple[list[TickRecord], object]:
    """Return ticks of which one has lost its first tension frame, and this frame."""
    first_tension_frame = make_sensors(HAND).ids[0]
    entry = ticks[at].tick_in
    [lost] = [frame for frame in entry.frames if frame.can_id == first_tension_frame][:1]
    rest = tuple(frame for frame in entry.frames if frame != lost)
    changed = ticks[at]._replace(tick_in=entry._replace(frames=rest))
    return [*ticks[:at], changed, *ticks[at + 1 :]], lost


def test_a_run_without_faults_has_no_lost_and_no_late_frame(ticks: list[TickRecord]) -> None:
    assert counted(ticks) == (0, 0, 0)


def test_a_frame_that_never_comes_is_lost(ticks: list[TickRecord]) -> None:
    for at in (300, 310, 320):
        ticks, _ = without(ticks, at)
    assert counted(ticks) == (0, 3, 0)


def test_a_frame_of_the_tick_before_is_late(ticks: list[TickRecord]) -> None:
    ticks, frame = without(ticks, 300)
    entry = ticks[301].tick_in
    ticks[301] = ticks[301]._replace(tick_in=entry._replace(frames=(frame, *entry.frames)))
    assert counted(ticks) == (1, 0, 0)


def test_a_refused_frame_is_lost(ticks: list[TickRecord]) -> None:
    entry = ticks[300].tick_in
    refused = ticks[300]._replace(
        tick_in=entry._replace(io_events=(IoEvent("enobufs", "can0", 2),))
    )
    assert counted([*ticks[:300], refused, *ticks[301:]]) == (0, 2, 0)


def test_a_paused_simulator_causes_a_tick_without_frames(ticks: list[TickRecord]) -> None:
    """The replies of a tick arrive in the next tick."""
    entry, following = ticks[300].tick_in, ticks[301].tick_in
    ticks = [*ticks]
    ticks[300] = ticks[300]._replace(tick_in=entry._replace(frames=()))
    ticks[301] = ticks[301]._replace(
        tick_in=following._replace(frames=(*entry.frames, *following.frames))
    )
    assert counted(ticks) == (1, 0, 1)
