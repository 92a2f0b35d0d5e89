"""Every row of the fault table: when it counts, when it just does not, what it demands, and who may end it."""

import math
from dataclasses import replace
from typing import NamedTuple

import pytest

from handctl.drives.causes import Cause
from handctl.safety.action import Action
from handctl.safety.faults.fault import Fault
from handctl.safety.faults.table import TABLE
from handctl.safety.judge import SafetyState, Verdict, clear, judge
from handctl.safety.signals import Limits, Signals, ticks_for

LIMITS = Limits(
    tendons=("t0", "t1"), tension_trip=(140.0, 50.0), tension_rail=244.0, motors=("m0", "m1"),
    silent_ticks=6, stalled_ticks=5, temperature_soft=70.0, temperature_hard=85.0, tension_low=-5.0,
    drive_limit=(160.0, 60.0), frames_most=64, noise_most=1e-4,
)  # fmt: skip
ZERO = (0.0, 0.0)
CALM = Signals(
    armed=True, motor_age=(0, 0), sensor_age=(0, 0), tension=(20.0, 20.0), temperature=(40.0, math.nan),
    residual=ZERO, disobeyed=ZERO, friction=ZERO, slip=ZERO, derailed=ZERO, noise=ZERO,
)  # fmt: skip


class Case(NamedTuple):
    """A fault as it should be.

    Attributes:
        present: signals that show it. almost: signals that just do not.
        instance: who has it. debounce: ticks until it counts. action: what it demands. latched: ends by a person only.
        asleep: whether it does not count while nothing is armed.
    """

    present: Signals
    almost: Signals
    instance: str
    debounce: int
    action: Action
    latched: bool
    asleep: bool = False


def io(kind: str, where: str = "can0", number: int = 1) -> Signals:
    return CALM._replace(io=((kind, where, number),))


def tensions(*values: float) -> Signals:
    return CALM._replace(tension=values)


def heat(*values: float) -> Signals:
    return CALM._replace(temperature=values)


def with_(**signals: object) -> Signals:
    return CALM._replace(**signals)  # type: ignore[arg-type]


def error(cause: Cause, code: int = 9) -> Signals:
    return with_(drive_errors=(("m1", code, cause),))


ACK = ("error_frame", "can0 no acknowledge", 3)
CASES = {
    "B01": Case(with_(motor_age=(0, 1)), CALM, "m1", 1, Action.WARN, False, True),
    "B02": Case(with_(motor_age=(6, 0)), with_(motor_age=(5, 5)), "m0", 1, Action.RELAX, True, True),
    "B03a": Case(with_(lost=(0, 21, 0)), with_(lost=(20, 20, 20)), "m1", 1, Action.HOLD, False, True),
    "B03b": Case(with_(lost=(0, 0, 41)), with_(lost=(40, 40, 40)), "load cells", 1, Action.RELAX, True, True),
    "B04": Case(with_(stale=(("load cells", 0.0),)), CALM, "load cells", 1, Action.WARN, False, True),
    "B05": Case(with_(twice=(("m0", 0.0),)), CALM, "m0", 1, Action.WARN, False, True),
    "B06": Case(with_(twice=(("m0", 1.0),)), with_(twice=(("m0", 0.0),)), "m0", 1, Action.RELAX, True, True),
    "B07": Case(with_(stale=(("load cells", 1.0),)), CALM, "load cells", 1, Action.WARN, False, True),
    "B08": Case(with_(misshapen=(("m1", 3.0),)), with_(misshapen=(("m1", 2.0),)), "m1", 1, Action.RELAX, True, True),
    "B09": Case(with_(misshapen=(("m1", 1.0),)), CALM, "m1", 1, Action.WARN, False, True),
    "B10": Case(with_(unknown=50.1), with_(unknown=50.0), "bus", 1, Action.WARN, False),
    "B11a": Case(with_(frames=65), with_(frames=64), "bus", 2, Action.RELAX, True, True),
    "B11b": Case(with_(frames=65), with_(frames=128, missed=1), "bus", 10, Action.CUT, True, True),
    "B12": Case(io("bus_off"), io("bus_on"), "can0", 1, Action.CUT, True),
    "B13a": Case(io("error_warning"), io("error_active"), "can0", 1, Action.WARN, False),
    "B13b": Case(io("error_passive"), io("error_warning"), "can0", 20, Action.RELAX, True),
    "B14": Case(io("enetdown"), io("enobufs"), "can0", 1, Action.CUT, True),
    "B15": Case(io("enobufs"), io("dropped"), "can0", 2, Action.RELAX, True),
    "B16": Case(io("enodev"), io("enetdown"), "can0", 1, Action.CUT, True),
    "B17": Case(with_(motor_age=(4, 0)), with_(motor_age=(4, 4)), "m0", 1, Action.RELAX, True, True),
    "B18": Case(
        with_(armed=False, heard=False, io=(ACK,)), with_(armed=False, io=(ACK,)),
        "can0 no acknowledge", 20, Action.RELAX, True,
    ),
    "N01": Case(error(Cause.DROPPED_OUT), error(Cause.OTHER), "m1", 1, Action.RELAX, True, True),
    "N02": Case(with_(sensor_age=(0, 6)), with_(sensor_age=(5, 5)), "t1", 1, Action.RELAX, True, True),
    "N02b": Case(with_(mute=(("j1", 0.1),)), CALM, "j1", 1, Action.RELAX, True, True),
    "N04": Case(with_(stuck_motor=(("m0", 0.6),)), CALM, "m0", 1, Action.RELAX, True),
    "N05a": Case(with_(jumped=(("m0", 0.4),)), CALM, "m0", 1, Action.WARN, False),
    "N05b": Case(with_(jumping=(("m0", 0.4),)), with_(jumped=(("m0", 0.4),)), "m0", 1, Action.RELAX, True),
    "N06a": Case(with_(slip=(0.0, 3.1)), with_(slip=(3.0, 0.0)), "t1", 1, Action.WARN, False),
    "N06b": Case(with_(slip=(6.1, 0.0)), with_(slip=(0.0, 6.0)), "t0", 1, Action.RELAX, True),
    "N07": Case(with_(noise=(0.0, 1.1e-4)), with_(noise=(1e-4, 0.0)), "m1", 1, Action.HOLD, False),
    "N08": Case(error(Cause.WATCHDOG), error(Cause.VOLTAGE), "m1", 1, Action.RELAX, True, True),
    "N09a": Case(heat(70.1, 0), heat(70.0, 0), "m0", 20, Action.WARN, False),
    "N09b": Case(heat(0, 85.1), heat(0, 85.0), "m1", 20, Action.RELAX, True),
    "N10": Case(error(Cause.VOLTAGE), error(Cause.HOT), "m1", 1, Action.RELAX, True, True),
    "N11": Case(error(Cause.OTHER), CALM, "m1", 1, Action.RELAX, True, True),
    "N11b": Case(error(Cause.UNKNOWN), error(Cause.OTHER), "m1", 1, Action.CUT, True, True),
    "N12": Case(error(Cause.MISMATCH), error(Cause.OTHER), "m1", 1, Action.CUT, True, True),
    "N13": Case(with_(twice=(("m0", 0.0),)), CALM, "m0", 3, Action.RELAX, True, True),
    "N14": Case(with_(disobeyed=(15.1, 0.0)), with_(disobeyed=(0.0, 15.0)), "m0", 1, Action.RELAX, True),
    "N14b": Case(with_(swinging=(("t1", 9.0),)), CALM, "t1", 1, Action.RELAX, True),
    "N15": Case(with_(halved=("m1",)), CALM, "m1", 1, Action.WARN, False),
    "N16": Case(with_(limp=(("t0", 30.0),)), CALM, "t0", 1, Action.CUT, True),
    "N17": Case(with_(unfollowed=(("m1", 0.1),)), CALM, "m1", 1, Action.RELAX, True),
    "T01": Case(with_(snapped=(("t0", 0.1),)), CALM, "t0", 2, Action.RELAX, True),
    "T02a": Case(with_(slack=(("t0", 0.051),)), with_(slack=(("t0", 0.05),)), "t0", 1, Action.WARN, False),
    "T02b": Case(with_(slack=(("t0", 0.51),)), with_(slack=(("t0", 0.5),)), "t0", 1, Action.RELAX, True),
    "T03": Case(tensions(20.0, 50.1), tensions(139.9, 50.0), "t1", 1, Action.RELAX, True),
    "T03b": Case(tensions(20.0, 60.1), tensions(159.9, 60.0), "t1", 1, Action.CUT, True),
    "T03c": Case(
        tensions(20.0, 50.1)._replace(relaxed=True), tensions(139.9, 50.0)._replace(relaxed=True),
        "t1", 1, Action.CUT, True,
    ),
    "T04a": Case(with_(residual=(5.1, 0.0)), with_(residual=(0.0, 5.0)), "t0", 1, Action.WARN, False),
    "T04b": Case(with_(residual=(0.0, 10.1)), with_(residual=(10.0, 0.0)), "t1", 1, Action.RELAX, True),
    "T05": Case(with_(stuck_cell=(("t1", 6.0),)), CALM, "t1", 1, Action.RELAX, True),
    "T05b": Case(with_(replayed=(("t0", 16.0),)), CALM, "t0", 1, Action.RELAX, True),
    "T06": Case(tensions(244.0, 20.0), tensions(243.9, -4.9), "t0", 3, Action.RELAX, True, True),
    "T08": Case(with_(derailed=(0.0, 15.1)), with_(derailed=(15.0, 0.0)), "t1", 1, Action.RELAX, True),
    "T09": Case(with_(friction=(3.1, 0.0)), with_(friction=(0.0, 3.0)), "t0", 1, Action.WARN, False),
    "H01": Case(with_(late=0.26), with_(late=0.25), "loop", 1, Action.PASS, False),
    "H02": Case(with_(missed=1), CALM, "loop", 1, Action.WARN, False),
    "H03": Case(with_(missed=5), with_(missed=4), "loop", 1, Action.RELAX, True, True),
    "H04": Case(io("suspended", "host", 900), io("recorder", "host"), "host", 1, Action.RELAX, True),
    "H08": Case(io("recorder", "disk_full"), io("recorder", "misshapen"), "disk_full", 1, Action.WARN, False),
    "H09": Case(io("recorder", "dropped"), io("dropped", "dropped"), "dropped", 1, Action.WARN, False),
    "H10": Case(io("recorder", "gone"), io("recorder", "misshapen"), "gone", 1, Action.WARN, False),
    "H13": Case(with_(foreign=("0x001",)), CALM, "0x001", 1, Action.RELAX, True),
    "I07a": Case(with_(refused=1), CALM, "goal", 1, Action.WARN, False, True),
    "I07b": Case(with_(refused=3), with_(refused=2), "goal", 1, Action.RELAX, True, True),
}  # fmt: skip
OTHER_SIGNS = {
    "B16": [io("ebadf")],
    "N04": [with_(stuck_joint=(("j0", 11.0),))],
    "N11": [error(Cause.HOT), error(Cause.LOST)],
    "T06": [
        tensions(-5.0, 0.0),
        tensions(300.0, 0.0),
        with_(railed=(("t0", -3.0),)),
        with_(tension=(), railed=(("t0", 9.0),)),
    ],
    "H08": [io("recorder", "disk_low")],
    "H09": [io("recorder", "filling")],
    "H10": [io("recorder", "error")],
}


def row(id_: str) -> Fault:
    return next(fault for fault in TABLE if fault.id == id_)


def course(*ticks: Signals, state: SafetyState | None = None, only: str = "") -> tuple[SafetyState, list[Verdict]]:
    """Judge ticks one after the other; with ``only``, by that row alone."""
    state, verdicts = state or SafetyState(), []
    table = (row(only),) if only else TABLE
    for signals in ticks:
        state, verdict = judge(state, LIMITS, signals, table)
        verdicts.append(verdict)
    return state, verdicts


def test_every_row_has_a_case_and_is_there_once() -> None:
    assert [fault.id for fault in TABLE] == list(CASES)


def test_nothing_is_wrong_with_a_calm_hand() -> None:
    state, verdicts = course(*[CALM] * 50)
    assert state == SafetyState()
    assert {verdict.action for verdict in verdicts} == {Action.PASS}
    assert not any(verdict.findings for verdict in verdicts)


@pytest.mark.parametrize("id_", CASES)
def test_it_counts_at_its_tick_and_is_told_once(id_: str) -> None:
    case = CASES[id_]
    _, verdicts = course(*[case.present] * (case.debounce + 5), only=id_)
    actions = [verdict.action for verdict in verdicts]
    assert actions == [Action.PASS] * (case.debounce - 1) + [case.action] * 6
    told = [(f.fault.id, f.instance) for verdict in verdicts for f in verdict.findings]
    assert told == [(id_, case.instance)]
    assert verdicts[case.debounce - 1].findings, "in the tick in which it begins to count"


@pytest.mark.parametrize("id_", CASES)
def test_just_below_its_threshold_it_never_counts(id_: str) -> None:
    _, verdicts = course(*[CASES[id_].almost] * 100, only=id_)
    assert {verdict.action for verdict in verdicts} == {Action.PASS}
    assert not any(verdict.findings for verdict in verdicts)


@pytest.mark.parametrize("id_", OTHER_SIGNS)
def test_other_signs_of_the_same_fault(id_: str) -> None:
    for signals in OTHER_SIGNS[id_]:
        _, verdicts = course(*[signals] * CASES[id_].debounce, only=id_)
        assert verdicts[-1].action == CASES[id_].action


@pytest.mark.parametrize("id_", CASES)
def test_interrupted_it_begins_to_count_anew(id_: str) -> None:
    case = CASES[id_]
    if case.debounce == 1:
        return
    almost = [case.present] * (case.debounce - 1)
    _, verdicts = course(*almost, CALM, *almost, CALM, only=id_)
    assert {verdict.action for verdict in verdicts} == {Action.PASS}


@pytest.mark.parametrize("id_", CASES)
def test_what_latches_stays_until_a_person_clears_it(id_: str) -> None:
    case = CASES[id_]
    state, _ = course(*[case.present] * case.debounce, only=id_)
    for _ in range(100):
        state, (verdict,) = course(CALM, state=state, only=id_)
        assert verdict.action == (case.action if case.latched else Action.PASS)
        assert not verdict.findings
    state = clear(state)
    state, (verdict,) = course(CALM, state=state, only=id_)
    assert verdict.action == Action.PASS
    state, verdicts = course(*[case.present] * case.debounce, state=state, only=id_)
    assert verdicts[-1].action == case.action, "it can come again"
    assert [f.fault.id for f in verdicts[-1].findings] == [id_], "and is told again"


@pytest.mark.parametrize("id_", [id_ for id_, case in CASES.items() if case.latched])
def test_clearing_what_is_still_there_does_not_help(id_: str) -> None:
    case = CASES[id_]
    state, _ = course(*[case.present] * (case.debounce + 3), only=id_)
    _, (verdict,) = course(case.present, state=clear(state), only=id_)
    assert verdict.action == case.action


@pytest.mark.parametrize("id_", CASES)
def test_without_torque_silence_is_no_fault(id_: str) -> None:
    case = CASES[id_]
    unarmed = case.present._replace(armed=False)
    _, verdicts = course(*[unarmed] * (case.debounce + 1), only=id_)
    assert verdicts[-1].action == (Action.PASS if case.asleep else case.action)


def test_a_missing_sample_is_neither_tension_nor_temperature() -> None:
    nothing = CALM._replace(tension=(math.nan, math.nan), temperature=(math.nan, math.nan))
    _, verdicts = course(*[nothing] * 30)
    assert {verdict.action for verdict in verdicts} == {Action.PASS}


def test_each_row_is_one_line_for_a_person() -> None:
    for fault in TABLE:
        assert fault.title
        assert fault.detection
        assert "\n" not in fault.title + fault.detection
        assert fault.clears in ("a person", "by itself")
        assert fault.latched == CASES[fault.id].latched
        assert fault.action < Action.RELAX or fault.latched, "only a person ends a relax or a cut"


@pytest.mark.parametrize(("seconds", "period", "least", "ticks"), [
    (0.030, 0.005, 4, 6), (0.030, 0.002, 4, 15), (0.030, 0.01, 4, 4), (0.025, 0.002, 3, 13), (0.025, 0.02, 3, 3),
])  # fmt: skip
def test_times_as_ticks(seconds: float, period: float, least: int, ticks: int) -> None:
    assert ticks_for(seconds, period, least) == ticks


def trace(id_: str, table: tuple[Fault, ...]) -> list[tuple[Action, int]]:
    """Actions and number of findings over the fault's onset, its end, and a clearing."""
    case, state, seen = CASES[id_], SafetyState(), []
    for signals in [case.almost, *[case.present] * (case.debounce + 1), CALM]:
        state, verdict = judge(state, LIMITS, signals, table)
        seen.append((verdict.action, len(verdict.findings)))
    return seen


@pytest.mark.parametrize("id_", CASES)
def test_a_changed_row_would_be_noticed(id_: str) -> None:
    """Each number and word of a row, one step away, gives another course: the cases above can fail."""
    fault = row(id_)
    other = "by itself" if fault.latched else "a person"
    changed = [replace(fault, debounce=fault.debounce + 1), replace(fault, clears=other)]
    changed += [replace(fault, debounce=fault.debounce - 1)] if fault.debounce > 1 else []
    changed += [replace(fault, action=Action(fault.action + step)) for step in (-1, 1) if 0 <= fault.action + step <= 4]
    right = trace(id_, (fault,))
    for mutant in changed:
        if (mutant.action, mutant.latched) == (Action.PASS, True) or fault.action == mutant.action == Action.PASS:
            continue  # a latched PASS is no action
        assert trace(id_, (mutant,)) != right, mutant


THRESHOLDS = {
    "B02": {"silent_ticks": 1}, "N02": {"silent_ticks": 1}, "H03": {"stalled_ticks": 1},
    "N09a": {"temperature_soft": 0.2}, "N09b": {"temperature_hard": 0.2},
    "T06": {"tension_rail": 0.1},
}  # fmt: skip


@pytest.mark.parametrize("id_", THRESHOLDS)
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_moved_threshold_would_be_noticed(id_: str, sign: int) -> None:
    name, step = next(iter(THRESHOLDS[id_].items()))
    moved = replace(LIMITS, **{name: getattr(LIMITS, name) + sign * step})
    case = CASES[id_]
    signals = case.present if sign > 0 else case.almost
    state = SafetyState()
    for _ in range(case.debounce):
        state, verdict = judge(state, moved, signals, (row(id_),))
    assert verdict.action == (Action.PASS if sign > 0 else case.action)
