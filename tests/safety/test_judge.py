"""Several faults, in sequences: the largest action wins, latches outlive everything, more trouble is never less."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.safety.action import Action
from handctl.safety.judge import Latched, SafetyState, clear, judge
from handctl.safety.table import TABLE, Signals
from tests.safety.test_table import CALM, CASES, LIMITS, course

PAIRS = list(pairwise([*CASES, next(iter(CASES))])) + [(a, b) for a in ("B02", "T03", "N09b") for b in CASES if a != b]


def merged(*signals: Signals) -> Signals:
    """Signals that show everything that each of these shows."""

    def unlike_calm(name: str) -> tuple[float, ...]:
        columns = zip(getattr(CALM, name), *(getattr(s, name) for s in signals), strict=True)
        return tuple(next((v for v in values if v not in (calm, 0.0) and v == v), calm) for calm, *values in columns)

    return Signals(
        armed=any(s.armed for s in signals),
        missed=max(s.missed for s in signals),
        late=max(s.late for s in signals),
        motor_age=tuple(max(ages) for ages in zip(*(s.motor_age for s in signals), strict=True)),
        sensor_age=tuple(max(ages) for ages in zip(*(s.sensor_age for s in signals), strict=True)),
        tension=unlike_calm("tension"),
        drive_errors=tuple(dict.fromkeys(error for s in signals for error in s.drive_errors)),
        temperature=unlike_calm("temperature"),
        foreign=tuple(dict.fromkeys(name for s in signals for name in s.foreign)),
        io=tuple(dict.fromkeys(event for s in signals for event in s.io)),
    )


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
    state, _ = course(*[a.present] * a.debounce, CALM)
    state, verdicts = course(*[b.present] * b.debounce, state=state)
    expected = max(b.action, a.action if a.latched else Action.PASS)
    assert verdicts[-1].action >= expected
    assert any(f.fault.id == second for f in verdicts[-1].findings)
    state, (after,) = course(CALM, state=state)
    left = [case.action for case in (a, b) if case.latched]
    assert after.action >= max(left, default=Action.PASS)
    cleared, (calm,) = course(CALM, state=clear(state))
    assert calm.action == Action.PASS
    assert cleared.latched == ()


def test_the_same_fault_of_two_instances_is_two_faults() -> None:
    state, (one,) = course(replace(CALM, motor_age=(6, 0)))
    state, (two,) = course(replace(CALM, motor_age=(0, 6)), state=state)
    assert [f.instance for f in one.findings if f.fault.id == "B02"] == ["m0"]
    assert [f.instance for f in two.findings if f.fault.id == "B02"] == ["m1"]
    assert [mark.instance for mark in state.latched] == ["m0", "m1"]


def test_instances_do_not_help_each_other_over_the_debounce() -> None:
    left, right = (replace(CALM, tension=t) for t in ((244.0, 0.0), (0.0, 244.0)))
    _, verdicts = course(left, right, left, right, left, right, only="T06")
    assert {verdict.action for verdict in verdicts} == {Action.PASS}


def test_two_events_of_one_bus_in_one_tick_are_one_tick() -> None:
    twice = replace(CALM, io=(("enobufs", "can0", 1), ("enobufs", "can0", 2)))
    _, verdicts = course(twice, only="B15")
    assert verdicts[0].action == Action.PASS
    _, verdicts = course(twice, twice, only="B15")
    assert verdicts[-1].action == Action.RELAX
    assert len(verdicts[-1].findings) == 1


rows = st.lists(st.sampled_from(list(CASES)), max_size=4)
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
