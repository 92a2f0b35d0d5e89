"""What safety remembers, at its very limits: they are judged as they are written, to the last bit."""

import numpy as np
import pytest

from handctl.safety import watch
from handctl.safety.detectors import residuals, ropes
from handctl.safety.detectors.stuck import Stuck
from handctl.safety.watch import CELL_FORCE_N, CELL_TICKS, DEG, SLIP_SETTLE_S, STUCK_JOINT_DEG, STUCK_S, Watcher
from tests.safety.test_watch import ARMED, T, made, seen

SOFT = 5e3
"""A rope that stretches by four millimetres under 20 N [N/m]."""
READ = {"excursion": 0.0, "joints": 0.0, "read": True}
"""Joint encoders at zero."""


@pytest.fixture
def watcher() -> Watcher:
    return made(SOFT)


def test_what_a_rope_stretches_turns_no_joint(watcher: Watcher) -> None:
    """The spool winds as far as the rope gives way under a tension that has grown."""
    low = watcher.start.filtered.low.copy()
    low[residuals.TENSION] = 20.0
    filtered = watcher.start.filtered._replace(low=low)
    turned = watch._witnesses(watcher, watcher.start, filtered, seen(travel=20.0 / SOFT, **READ))
    np.testing.assert_allclose(turned[0, 4:], 0.0, atol=1e-12)
    turned = watch._witnesses(watcher, watcher.start, filtered, seen(travel=[20.0 / SOFT + 1e-3, 20.0 / SOFT], **READ))
    np.testing.assert_allclose(turned[0, 4:], [0.05, 0.0], atol=1e-12)
    assert np.isnan(turned[1, 2:]).all(), "the second witness of cells and joints says nothing"


@pytest.mark.parametrize(("tension", "taut"), [(ropes.SLACK_N, 1.0), (ropes.SLACK_N - 1e-9, 0.0), (ropes.TAUT_N, 1.0),
                                               (ropes.TAUT_N + 1e-9, 1.0 + T)])  # fmt: skip
def test_between_slack_and_taut_time_stands(watcher: Watcher, tension: float, taut: float) -> None:
    state = watcher.start._replace(taut=(1.0, 1.0))
    found, _, _ = watch._slip(watcher, state, seen(tension=tension, **READ), [tension, tension])
    assert found == (taut, taut)


def test_joint_and_spool_are_not_compared_before_the_rope_has_settled(watcher: Watcher) -> None:
    for since, settled in ((SLIP_SETTLE_S, False), (np.nextafter(SLIP_SETTLE_S, 1.0), True)):
        state = watcher.start._replace(taut=(float(since), 1.0), slip_from=np.zeros(2))
        now = seen(**READ | {"tension": 2.2, "excursion": [0.0, 1e-3]})
        _, begin, slip = watch._slip(watcher, state, now, [2.2, 2.2])
        assert np.isnan(begin[0]) != settled
        assert np.isnan(slip[0]) != settled
        assert slip[1] == pytest.approx((-2.2 / SOFT - 1e-3) / watcher.arms[1] * DEG)


def names(watcher: Watcher, ticks: list[int], value: float, away: list[list[float]]) -> dict[str, list[str]]:
    stands = Stuck(np.full(6, value), np.array(ticks), np.zeros((2, 6)))
    told = watch._stuck_signals(watcher, stands, np.array(away))
    return {kind: [name for name, _ in found] for kind, found in told.items()}


def test_what_stands_is_told_beyond_its_limits_and_not_at_them(watcher: Watcher) -> None:
    long = int(STUCK_S / T)
    calm = [[0.0] * 6, [0.0] * 6]
    assert not any(names(watcher, [9999] * 6, 20.0, calm).values())
    at = [[watch.STUCK_GOAL_MM / 1e3, 0.0, CELL_FORCE_N, 9.0, STUCK_JOINT_DEG / DEG, 0.1],
          [0.0, watch.STUCK_TENSION_N, 0.0, 0.0, 0.0, 0.0]]  # fmt: skip
    assert at[0][0] * 1e3 == watch.STUCK_GOAL_MM
    assert at[0][4] * DEG == STUCK_JOINT_DEG
    found = names(watcher, [9999] * 6, 20.0, at)
    assert found == {"stuck_motor": [], "stuck_joint": [], "stuck_cell": ["b"]}
    beyond = [[value * 1.01 for value in row] for row in at]
    assert names(watcher, [long + 1] * 6, 20.0, beyond) == {
        "stuck_motor": ["ma", "mb"], "stuck_joint": ["ja"], "stuck_cell": ["a", "b"],
    }  # fmt: skip
    assert names(watcher, [long] * 6, 20.0, beyond)["stuck_motor"] == []
    assert names(watcher, [long] * 6, 20.0, beyond)["stuck_joint"] == []


def test_a_cell_may_repeat_itself_one_tick_less_than_the_row_says(watcher: Watcher) -> None:
    pushed = [[0.0, 0.0, 9.0, 9.0, 0.0, 0.0], [0.0] * 6]
    assert names(watcher, [CELL_TICKS] * 6, 20.0, pushed)["stuck_cell"] == ["a", "b"]
    assert names(watcher, [CELL_TICKS - 1] * 6, 20.0, pushed)["stuck_cell"] == []
    assert names(watcher, [CELL_TICKS] * 6, ropes.TAUT_N, pushed)["stuck_cell"] == [], "a slack rope's cell may rest"


def test_a_cell_that_repeats_itself_is_told_in_the_very_tick(watcher: Watcher) -> None:
    state = watcher.start._replace(asked=np.full(2, 20.0), wanted=np.full(2, 20.0), goal=np.zeros(2))
    for k in range(CELL_TICKS + 2):
        state, told = watch.watched(watcher, state, ARMED, seen(force=20.0 if k == 0 else 60.0, tension=20.0))
        assert bool(told.stuck_cell) == (state.stuck.ticks[2] >= CELL_TICKS), k
    assert state.stuck.ticks[2] > CELL_TICKS


def test_a_joint_is_off_its_pulley_beyond_the_limit_and_not_at_it(
    watcher: Watcher, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = watcher.start._replace(taut=(9.0, 9.0), slip_from=np.zeros(2))
    now = seen(**READ | {"excursion": 5e-3})
    slip = np.abs(watch._slip(watcher, state, now, [20.0, 20.0])[2])
    for limit, counted in ((slip[0], 0.0), (np.nextafter(slip[0], 0.0), 1.0)):
        monkeypatch.setattr(watch, "DERAILED_DEG", limit)
        assert watch.watched(watcher, state, ARMED, now)[0].derailed[0] == counted
