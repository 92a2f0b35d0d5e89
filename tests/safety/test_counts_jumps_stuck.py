"""What is counted over time, steps that cannot be, and readings that stand; each rule from both sides."""

import numpy as np
import pytest

from handctl.safety.detectors import counts, jumps, stuck
from handctl.safety.detectors.counts import SHORT, WINDOW, Counts
from handctl.safety.detectors.jumps import Accepted
from handctl.safety.detectors.stuck import Stuck

NAN = np.nan
NOTHING = (False, False)


def bits(text: str) -> int:
    """Newest last, as one writes it."""
    return int(text, 2)


@pytest.mark.parametrize(("before", "now", "after"), [
    ((), (False, False), ()),
    ((), (True, False), (0b1, 0b0)),
    ((), (True, True), (0b1, 0b1)),
    ((0b1, 0b0), (False, True), (0b10, 0b1)),
    ((0b101, 0b1), (True, True), (0b1011, 0b11)),
    ((1 << (WINDOW - 1), 0), (False, False), ()),                # the last bit has left
    ((1 << (WINDOW - 1), 0), (True, False), (1, 0)),
    ((1 << (WINDOW - 2), 0), (False, False), (1 << (WINDOW - 1), 0)),
])  # fmt: skip
def test_a_window_moves_on_by_a_tick(before, now, after):
    assert counts.shift(before, now) == after


def test_as_many_bits_as_nodes():
    with pytest.raises(ValueError, match="zip"):
        counts.shift((1,), (True, True))


def test_how_many_of_the_window_and_of_late():
    assert counts.number((0b1011, 0, (1 << WINDOW) - 1)) == (3, 0, WINDOW)
    assert counts.number(()) == ()
    assert counts.lately(0b1011) == 3
    assert counts.lately(1 << SHORT | 0b1) == 1
    assert counts.lately(1 << (SHORT - 1)) == 1


@pytest.mark.parametrize(("pattern", "half"), [
    ("01" * 10, True), ("10" * 10, True), ("01" * 9 + "11", False), ("01" * 9 + "00", True), ("0" * 20, False),
    ("1" * 20, False), ("1" + "01" * 10, True), ("0011" * 5, False), ("01" * 7 + "000000", True),
    ("01" * 6 + "00000000", False), ("1" + "01" * 6 + "0000000", True), ("11" + "01" * 8 + "00", True),
    ("11" + "01" * 7 + "1100", False), ("1110" + "01" * 8, False),
    ("11" + "01" * 8 + "0000", True), ("01010010101010010101", True),
])  # fmt: skip
def test_every_second_tick(pattern, half):
    assert counts.halved(bits(pattern)) is half


def test_unknown_frames_leak_away_in_a_second():
    state = counts.step(Counts(), NOTHING, NOTHING, 3, 0, 0, 100.0)
    assert state == Counts(unknown=3.0)
    state = counts.step(state, NOTHING, NOTHING, 2, 0, 1, 100.0)
    assert state.unknown == pytest.approx(3.0 * 0.99 + 2.0)
    assert counts.step(Counts(unknown=1.02e-3), NOTHING, NOTHING, 0, 0, 2, 100.0).unknown > 0.0
    assert counts.step(Counts(unknown=1.01e-3), NOTHING, NOTHING, 0, 0, 2, 100.0) == Counts()
    assert counts.step(Counts(unknown=2e-3), NOTHING, NOTHING, 0, 0, 2, 2.0) == Counts(), "a thousandth is forgotten"


def test_refused_goals_are_those_of_the_last_second():
    state = counts.step(Counts(), NOTHING, NOTHING, 0, 2, 10, 100.0)
    assert state.refused == (10, 10)
    state = counts.step(state, NOTHING, NOTHING, 0, 1, 109, 100.0)
    assert state.refused == (10, 10, 109)
    state = counts.step(state, NOTHING, NOTHING, 0, 0, 110, 100.0)
    assert state.refused == (109,)
    assert counts.step(state, NOTHING, NOTHING, 0, 0, 209, 100.0) == Counts()


def test_lost_and_misshapen_are_counted_apart():
    state = counts.step(Counts(), (True, False), (False, True), 0, 0, 0, 100.0)
    assert state == Counts(lost=(1, 0), misshapen=(0, 1))
    assert counts.step(state, NOTHING, NOTHING, 0, 0, 1, 100.0) == Counts(lost=(2, 0), misshapen=(0, 2))


def sizes(told, n):
    """How far each jumped; nothing is told where none did."""
    return np.zeros(n) if told is None else told


def test_the_first_position_is_accepted_wherever_it_is():
    state, wrong = jumps.screen(Accepted.initial(3), np.array([5.0, -1e9, NAN]), np.full(3, 0.1))
    assert not sizes(wrong, 3).any()
    assert state.value[:2].tolist() == [5.0, -1e9]
    assert np.isnan(state.value[2])
    assert state.gap.tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(("value", "gap", "wrong"), [
    (1.1, 0, 0.0), (1.125, 0, 0.0), (1.13, 0, 0.13), (0.8, 0, 0.2),
    (1.25, 1, 0.0), (1.26, 1, 0.26),       # a reading was missed: twice as far
    (1.5, 3, 0.0), (1.51, 3, 0.51),
])  # fmt: skip
def test_a_step_that_cannot_be_is_dropped_and_the_next_may_be_longer(value, gap, wrong):
    before = Accepted(np.array([1.0]), np.array([float(gap)]), np.zeros(1))
    state, told = jumps.screen(before, np.array([value]), np.array([0.125]))
    assert sizes(told, 1)[0] == pytest.approx(wrong)
    assert state.value[0] == (1.0 if wrong else value)
    assert state.gap[0] == (gap + 1 if wrong else 0)


def test_a_missing_position_is_no_jump():
    before = Accepted(np.array([1.0]), np.array([2.0]), np.zeros(1))
    state, told = jumps.screen(before, np.array([NAN]), np.array([0.1]))
    assert (sizes(told, 1)[0], state.value[0], state.gap[0]) == (0.0, 1.0, 3.0)


def test_a_tick_in_which_nothing_was_measured():
    state = jumps.unread(Accepted(np.array([1.0, 2.0]), np.array([0.0, 3.0]), np.array([0.0, 2.0])))
    assert (state.value.tolist(), state.gap.tolist()) == ([1.0, 2.0], [1.0, 4.0])
    assert state.dropped.tolist() == [0.0, 2.0]


def test_readings_that_are_dropped_in_a_row_are_counted_and_a_missing_one_is_none():
    state, told = Accepted(np.zeros(2), np.zeros(2), np.zeros(2)), []
    for first, second in [(1.0, 0.0), (NAN, 0.0), (1.0, NAN), (NAN, 0.0), (0.1, NAN), (1.5, 2.0), (0.1, 0.0)]:
        state, _ = jumps.screen(state, np.array([first, second]), np.full(2, 0.125))
        told.append(state.dropped.tolist())
    assert [int(a) for a, _ in told] == [1, 1, 2, 2, 0, 1, 0]
    assert [int(b) for _, b in told] == [0, 0, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(("missed", "steps", "told"), [
    # steps of single readings, by what one period allows; which of them jumps. The first reading after skipped ticks
    # may answer a question of after or of before them, and the second is then late by as much.
    (0, (1.0, 1.0), (0, 0)), (0, (1.1, 0.9), (1, 0)), (0, (1.0, 1.1), (0, 1)),
    (1, (2.0, 1.0), (0, 0)), (1, (1.0, 2.0), (0, 0)), (1, (2.1, 0.0), (1, 0)), (1, (1.0, 2.1), (0, 1)),
    (1, (1.0, 2.0, 1.1), (0, 0, 1)), (4, (5.0, 5.0), (0, 0)), (4, (5.1, 0.0), (1, 0)), (4, (5.0, 5.1), (0, 1)),
])  # fmt: skip
def test_what_moves_goes_on_while_ticks_are_skipped(missed, steps, told):
    """Two positions alike, or one that was read and one that was not: the two ways through."""
    for other in (0.0, NAN):
        state, at, seen = Accepted(np.array([0.0, other]), np.zeros(2), np.zeros(2)), 0.0, []
        for k, step in enumerate(steps):
            at += step
            state, jumped = jumps.screen(state, np.array([at, other]), np.ones(2), 0 if k else missed)
            seen.append(int(sizes(jumped, 2)[0] > 0.0))
        assert tuple(seen) == told, other


def test_a_reading_that_is_missing_after_skipped_ticks_may_be_further_off_by_them():
    state = Accepted(np.array([1.0]), np.array([1.0]), np.zeros(1))
    assert jumps.screen(state, np.array([NAN]), np.array([0.1]), 3)[0].gap.tolist() == [5.0]
    assert jumps.unread(state, 3).gap.tolist() == [5.0]


def moved_on(state, value, witnesses):
    """One tick, and how far the witnesses have gone since the reading stands."""
    after = stuck.step(state, value, witnesses)
    return (after, stuck.away(after, witnesses)) if isinstance(after, Stuck) else after


def walk(values, witnesses):
    """Ticks, and how far each witness is away, after each tick."""
    state, seen = Stuck.initial(1, 2), []
    for value, (first, second) in zip(values, witnesses, strict=True):
        state, away = moved_on(state, np.array([value]), np.array([[first], [second]]))
        seen.append((int(state.ticks[0]), *away[:, 0].tolist()))
    return state, seen


def test_what_stands_counts_and_its_witnesses_go_away():
    _, seen = walk([1.0, 1.0, 1.0, 2.0, 2.0], [(0.0, 5.0), (0.5, 5.0), (-1.0, 7.0), (-1.0, 7.0), (-1.0, 8.0)])
    assert seen == [(0, 0.0, 0.0), (1, 0.5, 0.0), (2, 1.0, 2.0), (0, 0.0, 0.0), (1, 0.0, 1.0)]


def test_a_missing_reading_is_neither_the_same_nor_another_one():
    state, seen = walk([1.0, NAN, 1.0, NAN, 2.0], [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (3.0, 0.0)])
    assert [ticks for ticks, *_ in seen] == [0, 0, 1, 1, 0]
    assert [first for _, first, _ in seen] == [0.0, 1.0, 2.0, 3.0, 0.0]
    assert state.value[0] == 2.0


def test_a_witness_that_says_nothing_does_not_count_and_is_taken_when_it_speaks():
    _, seen = walk([1.0] * 4, [(NAN, 0.0), (5.0, NAN), (7.0, 3.0), (NAN, 1.0)])
    assert [first for _, first, _ in seen] == [0.0, 0.0, 2.0, 0.0]
    assert [second for _, _, second in seen] == [0.0, 0.0, 3.0, 1.0]


def test_a_first_witness_that_leaps_was_there_all_the_time():
    state, _ = moved_on(Stuck.initial(3, 2), np.zeros(3), np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    after = stuck.leapt(state, np.array([False, True]), np.array([10.0, 20.0]))
    assert after.anchor.tolist() == [[1.0, 22.0, 3.0], [4.0, 5.0, 6.0]]
    assert state.anchor.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "what was is another state"
    assert (after.value.tolist(), after.ticks.tolist()) == (state.value.tolist(), state.ticks.tolist())


def test_nothing_is_known_at_first():
    state = Stuck.initial(2, 3)
    assert state.anchor.shape == (3, 2)
    assert np.isnan(state.anchor).all()
    assert np.isnan(state.value).all()
    assert state.ticks.tolist() == [0, 0]
    assert state.ticks.dtype == np.int64
