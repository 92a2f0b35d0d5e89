"""Ropes: taut, slack, snapped, and still pulled after the cut; each number of the rules from both sides."""

import math

import pytest

from handctl.safety.detectors import ropes
from handctl.safety.detectors.ropes import Ropes, cut, limp, slack, snapped, step

T = 0.002
NAN = math.nan


@pytest.mark.parametrize(("cell", "goal", "before", "after"), [
    # tension, wanted, (ticks since taut, ticks slack) before and after
    (2.6, 20.0, (-1, 0), (0, 0)),     # taut for the first time
    (2.6, 20.0, (7, 5), (0, 0)),      # taut again
    (2.5, 20.0, (-1, 0), (-1, 0)),    # never taut yet: nothing to be missed
    (0.0, 20.0, (-1, 0), (-1, 0)),
    (2.5, 20.0, (0, 0), (1, 0)),      # between slack and taut
    (2.0, 20.0, (3, 4), (4, 0)),      # just not slack: the count begins anew
    (1.9, 20.0, (3, 4), (4, 5)),
    (1.9, 2.5, (3, 4), (4, 0)),       # so little is wanted that it may hang
    (1.9, 2.6, (3, 4), (4, 5)),
    (1.9, NAN, (3, 4), (-1, 0)),      # a limp rope may hang, and is to be taut anew
    (30.0, NAN, (3, 4), (-1, 0)),
    (NAN, 20.0, (3, 4), (4, 0)),      # no sample: neither slack nor taut
])  # fmt: skip
def test_one_tick_of_a_rope(cell, goal, before, after):
    state = step(Ropes((before[0],), (before[1],)), [cell], [goal])
    assert state == Ropes((after[0],), (after[1],))


def test_ropes_count_apart_and_begin_as_never_taut():
    state = step(Ropes(), [20.0, 0.0, 1.0], [24.0, 24.0, NAN])
    assert state == Ropes((0, -1, -1), (0, 0, 0))
    state = step(state, [0.0, 20.0, 1.0], [24.0, 24.0, 24.0])
    assert state == Ropes((1, 0, -1), (1, 0, 0))


def test_slack_is_told_by_name_and_in_seconds():
    assert slack(Ropes((1, 9, 2), (0, 26, 1)), ("a", "b", "c"), T) == (("b", 26 * T), ("c", T))
    assert slack(Ropes((1,), (0,)), ("a",), T) == ()
    assert slack(Ropes(), ("a",), T) == ()


@pytest.mark.parametrize(("ago", "cell", "goal", "speed", "found"), [
    (0, 0.0, 24.0, 0.05, True),
    (49, 0.0, 24.0, 0.05, True),
    (50, 0.0, 24.0, 0.05, False),     # 100 ms ago
    (-1, 0.0, 24.0, 0.05, False),     # never taut
    (0, 4.7, 24.0, 0.05, True),
    (0, 4.81, 24.0, 0.05, False),     # a fifth is left
    (0, 4.0, 20.0, 0.05, False),      # exactly
    (0, 0.0, 8.0, 0.05, False),       # too little was wanted to tell
    (0, 0.0, 8.1, 0.05, True),
    (0, 0.0, 24.0, 0.03, False),      # the spool hardly runs
    (0, 0.0, 24.0, 0.031, True),
    (0, 0.0, 24.0, -0.05, False),     # it pays out
    (0, NAN, 24.0, 0.05, False),
    (0, 0.0, NAN, 0.05, False),
    (0, 0.0, 24.0, NAN, False),
])  # fmt: skip
def test_a_snapped_rope(ago, cell, goal, speed, found):
    state = Ropes((0, ago), (0, 0))
    told = snapped(state, ("a", "b"), [20.0, cell], [24.0, goal], [0.05, speed], T)  # the other one runs, and is taut
    assert told == ((("b", speed),) if found else ())


def test_nothing_snaps_before_anything_is_wanted():
    assert snapped(Ropes(), ("a",), [0.0], [24.0], [0.05], T) == ()


def test_the_cut_remembers_what_there_was_and_counts():
    state = cut(Ropes((0, 0), (0, 3)), [30.0, 20.0], [31.0, 21.0], T)
    assert state == Ropes((), (), 0, (30.0, 20.0))
    state = cut(state, [10.0, NAN], [31.0, 21.0], T)
    assert state == Ropes((), (), 1, (30.0, 20.0))
    assert cut(state, [10.0, 10.0], [31.0, 21.0], T).cut == 2


def test_a_sample_that_is_missing_at_the_cut_counts_as_the_last_one_before():
    state = cut(Ropes(), [NAN, 20.0], [31.0, NAN], T)
    assert state.cut_from == (31.0, 20.0)
    assert cut(state, [10.0, 10.0], [NAN, NAN], T).cut_from == (31.0, 20.0)


def test_a_rope_of_which_nothing_was_known_at_the_cut_counts_from_its_first_reading():
    state = cut(Ropes(), [NAN, 20.0], [NAN, NAN], T)
    assert math.isnan(state.cut_from[0])
    state = cut(state, [NAN, NAN], [40.0, 40.0], T)
    assert math.isnan(state.cut_from[0]), "what there was before the cut is asked for once"
    state = cut(state, [25.0, 5.0], [NAN, NAN], T)
    assert state.cut_from == (25.0, 20.0)
    assert cut(state, [24.0, 5.0], [NAN, NAN], T).cut_from == (25.0, 20.0)


@pytest.mark.parametrize(("ticks", "before", "now", "found"), [
    (49, 30.0, 30.0, False),          # its time is not over
    (50, 30.0, 30.0, True),
    (51, 30.0, 30.0, True),
    (50, 30.0, 15.1, True),
    (50, 30.0, 14.9, False),          # it fell by half
    (50, 24.0, 12.0, False),          # just by half
    (50, 10.0, 10.0, False),          # no more than springs and weight hold
    (50, 10.1, 10.1, True),
    (50, 5.0, 40.0, True),            # grown
    (50, 30.0, NAN, False),
    (50, NAN, 30.0, False),           # read for the first time in this tick, or never
])  # fmt: skip
def test_a_rope_that_somebody_still_pulls(ticks, before, now, found):
    state = Ropes((), (), ticks, (0.0, before), (0.0, now))
    assert limp(state, ("a", "b"), T) == ((("b", now),) if found else ())


def test_what_a_rope_bore_last_counts_where_the_latest_sample_is_missing():
    """From 80 ms after the cut on: what it bore before that says nothing of whether it was let go."""
    state = Ropes()
    for k in range(50):
        state = cut(state, [30.0 if k < 40 else NAN, 30.0 if k < 41 else NAN], [30.0, 30.0], T)
        assert state.bears == (() if k < 40 else pytest.approx((NAN, 30.0), nan_ok=True))
    assert limp(cut(state, [NAN, NAN], [NAN, NAN], T), ("a", "b"), T) == (("b", 30.0),)
    assert limp(cut(state, [NAN, 9.0], [NAN, NAN], T), ("a", "b"), T) == ()


def test_ropes_and_names_belong_together():
    with pytest.raises(ValueError, match="zip"):
        slack(Ropes((1,), (1,)), ("a", "b"), T)
    with pytest.raises(ValueError, match="zip"):
        cut(Ropes(), [30.0], [30.0, 20.0], T)
    with pytest.raises(ValueError, match="zip"):
        limp(Ropes((), (), 50, (30.0,), (30.0,)), ("a", "b"), T)


def test_thresholds_leave_room_between_slack_and_taut():
    assert ropes.SLACK_N < ropes.TAUT_N < ropes.SNAP_LEAST_N < ropes.LIMP_LEAST_N
