"""Several faults, in sequences: the largest action wins, latches outlive everything, more trouble is never less."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.safety.action import Action
from handctl.safety.calm import calm
from handctl.safety.faults.table import TABLE
from handctl.safety.judge import Latched, SafetyState, clear, judge
from handctl.safety.signals import Signals
from tests.safety.test_table import CALM, CASES, LIMITS, course

UNITED = {
    "drive_errors", "foreign", "io", "misshapen", "twice", "stale", "halved", "jumped", "jumping", "limp", "snapped",
    "slack", "stuck_motor", "stuck_joint", "stuck_cell", "mute", "replayed", "swinging", "railed", "unfollowed",
}  # fmt: skip
ARMED = [id_ for id_ in CASES if CASES[id_].present.armed]
PAIRS = list(pairwise([*ARMED, ARMED[0]])) + [(a, b) for a in ("B02", "T03", "N09b") for b in ARMED if a != b]


def merged(*signals: Signals) -> Signals:
    """Signals that show everything that each of these shows."""

    def pick(values: list[Any], calm: Any) -> Any:
        return max((v for v in values if v not in (calm, 0.0) and v == v), default=calm)

    def one(name: str, calm: Any) -> Any:
        values = [getattr(s, name) for s in signals]
        if name in UNITED:
            return tuple(dict.fromkeys(item for value in values for item in value))
        if not isinstance(calm, tuple):
            return pick(values, calm)
        return tuple(pick(list(column), default) for default, *column in zip(calm or (0,) * 3, *(
            value or (0,) * 3 for value in values), strict=True))  # fmt: skip

    return Signals(**{name: one(name, getattr(CALM, name)) for name in Signals._fields})


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_of_two_faults_at_once_the_larger_action_wins_and_both_are_told(first: str, second: str) -> None:
    a, b = CASES[first], CASES[second]
    both = merged(a.present, b.present)
    ticks = max(a.debounce, b.debounce)
    state, verdicts = course(*[both] * ticks)
    assert verdicts[-1].action >= max(a.action, b.action)
    told = {(f.fault.id, f.instance) for verdict in verdicts for f in verdict.findings}
    assert {(first, a.instance), (second, b.instance)} <= told
    for id_, case in ((first, a), (second, b)):
        assert (Latched(id_, case.instance) in state.latched) == case.latched


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_a_second_fault_neither_ends_nor_hides_the_first(first: str, second: str) -> None:
    """One comes and goes, then the other: what latched is still there, and the second is told though."""
    a, b = CASES[first], CASES[second]
    state, first_verdicts = course(*[a.present] * a.debounce, CALM)
    state, verdicts = course(*[b.present] * b.debounce, state=state)
    expected = max(b.action, a.action if a.latched else Action.PASS)
    assert verdicts[-1].action >= expected
    told = [f.fault.id for verdict in (*first_verdicts, *verdicts) for f in verdict.findings]
    assert second in told
    state, (after,) = course(CALM, state=state)
    left = [case.action for case in (a, b) if case.latched]
    assert after.action >= max(left, default=Action.PASS)
    cleared, (calm,) = course(CALM, state=clear(state))
    assert calm.action == Action.PASS
    assert cleared.latched == ()


def test_the_same_fault_of_two_instances_is_two_faults() -> None:
    state, (one,) = course(CALM._replace(motor_age=(6, 0)))
    state, (two,) = course(CALM._replace(motor_age=(0, 6)), state=state)
    assert [f.instance for f in one.findings if f.fault.id == "B02"] == ["m0"]
    assert [f.instance for f in two.findings if f.fault.id == "B02"] == ["m1"]
    assert [mark.instance for mark in state.latched if mark.id == "B02"] == ["m0", "m1"]


def test_instances_do_not_help_each_other_over_the_debounce() -> None:
    left, right = (CALM._replace(tension=t) for t in ((244.0, 0.0), (0.0, 244.0)))
    _, verdicts = course(left, right, left, right, left, right, only="T06")
    assert {verdict.action for verdict in verdicts} == {Action.PASS}


def test_two_events_of_one_bus_in_one_tick_are_one_tick() -> None:
    twice = CALM._replace(io=(("enobufs", "can0", 1), ("enobufs", "can0", 2)))
    _, verdicts = course(twice, only="B15")
    assert verdicts[0].action == Action.PASS
    _, verdicts = course(twice, twice, only="B15")
    assert verdicts[-1].action == Action.RELAX
    assert len(verdicts[-1].findings) == 1


rows = st.lists(st.sampled_from(ARMED), max_size=4)
faulty = rows.map(lambda ids: merged(CALM, *(CASES[i].present for i in ids)))
course_of_faults = st.lists(st.tuples(faulty, rows, st.booleans()), max_size=30)


@given(course_of_faults)
def test_more_trouble_is_never_less_action(ticks: list[tuple[Signals, list[str], bool]]) -> None:
    """Two runs, one with additional faults in some ticks, cleared at the same times."""
    less = more = SafetyState()
    for signals, extra, cleared in ticks:
        if cleared:
            less, more = clear(less), clear(more)
        less, mild = judge(less, LIMITS, signals)
        more, wild = judge(more, LIMITS, merged(signals, *(CASES[i].present for i in extra)))
        assert wild.action >= mild.action
        assert set(less.latched) <= set(more.latched)


@given(course_of_faults)
def test_latches_only_grow_between_clearings(ticks: list[tuple[Signals, list[str], bool]]) -> None:
    state, told = SafetyState(), list[tuple[str, str]]()
    for signals, _, cleared in ticks:
        before = () if cleared else state.latched
        state = clear(state) if cleared else state
        state, verdict = judge(state, LIMITS, signals)
        assert state.latched[: len(before)] == before, "in the order in which they came"
        assert len(set(state.latched)) == len(state.latched)
        actions = {fault.id: fault.action for fault in TABLE}
        assert verdict.action >= max((actions[mark.id] for mark in state.latched), default=Action.PASS)
        told += [(f.fault.id, f.instance) for f in verdict.findings]
        assert {(mark.id, mark.instance) for mark in state.latched} <= set(told), "nothing latches in silence"


def test_actions_are_ordered() -> None:
    assert Action.PASS < Action.WARN < Action.HOLD < Action.RELAX < Action.CUT


near = st.sampled_from(
    [0.0, 2.9, 3.1, 5.1, 6.1, 10.1, 15.1, 49.9, 50.1, 60.1, 70.1, 85.1, 139.0, 141.0, 243.9, 244.0, -5.1]
)
both = st.tuples(near, near)
counts = st.sampled_from([0, 1, 3, 5, 6])


@given(
    st.booleans(), faulty, both, both, st.tuples(counts, counts), st.tuples(counts, counts), counts, near, near,
    st.sampled_from([0, 64, 65]),
)  # fmt: skip
def test_what_is_calm_shows_no_fault_to_any_row(
    armed: bool, rare: Signals, tension: Any, warm: Any, motor: Any, sensor: Any, missed: int, unknown: float,
    late: float, frames: int,
) -> None:  # fmt: skip
    quiet = Signals(armed, missed, late / 100.0, motor, sensor, tension, warm, frames, True, unknown)
    for signals in (quiet, quiet._replace(missed=0), rare, rare._replace(armed=armed)):
        if calm(LIMITS, signals):
            assert not [fault.id for fault in TABLE if fault.detect(LIMITS, signals)]


@pytest.mark.parametrize("id_", CASES)
def test_no_fault_is_calm(id_: str) -> None:
    assert not calm(LIMITS, CASES[id_].present)


def test_a_good_tick_is_calm() -> None:
    assert calm(LIMITS, Signals(armed=True, motor_age=(0, 0), sensor_age=(0, 0), tension=(20.0, 20.0), frames=64))
