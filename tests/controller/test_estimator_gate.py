"""Test the tension filter with outliers, missing readings, load-cell drift and large innovations."""

import numpy as np
import pytest

from handctl.core.estimation.consistency_events import consistency_events
from handctl.core.estimation.filter_types import STATE_COUNT, E, S, TendonRegime, V, X
from handctl.core.estimation.kalman import NIS_AVERAGING_TIME_S, SLACK_LENGTH_M
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent
from tests.controller.filter_runs import (
    FilterState,
    design_arrays_by_tendon,
    run_filter_tick,
    state_with_filter,
)
from tests.controller.synthetic_states import SyntheticEstimate, empty_readings

HOLD_TENSION_N = 20.0


class HandAtConstantTension:
    """A hand whose tendons have a constant tension.

    Each call of ``run_tick_with_tension`` gives one reading of every sensor to the tension filter.
    """

    def __init__(self, model: HandModel, regime: TendonRegime = TendonRegime.HELD) -> None:
        self.model, n = model, model.tendon_count
        x = np.zeros((n, STATE_COUNT))
        x[:, 2] = 2e-3
        x[:, X] = x[:, 2] + HOLD_TENSION_N / model.tendon_constants.stiffness
        self.travel = x[:, X]
        self.state = FilterState.tendons_in_regime(x.ravel(), regime, stopped=False)

    def run_tick_with_tension(
        self,
        cell_tension: float,
        *,
        saturated_tendons: tuple[int, ...] = (),
        extra_travel: float = 0.0,
    ) -> SyntheticEstimate:
        """Run one tick in which the load cell of tendon 0 reads ``cell_tension`` [N]."""
        model, n = self.model, self.model.tendon_count
        read = empty_readings(model)._replace(
            travel=self.travel + extra_travel, tension=np.full(n, HOLD_TENSION_N)
        )
        read = read._replace(saturated_tendons=saturated_tendons)
        read.tension[0] = cell_tension
        motor_force, zero_rates, contact = (
            np.full(n, HOLD_TENSION_N),
            np.zeros(n),
            (True,) * len(model.digits),
        )
        self.state, estimate = run_filter_tick(
            model, self.state, read, motor_force, zero_rates, contact
        )
        return estimate

    def settle(self) -> "HandAtConstantTension":
        """Run 200 ticks with correct readings, so that the filter settles, and return ``self``."""
        for _ in range(200):
            self.run_tick_with_tension(HOLD_TENSION_N)
        return self


def test_single_outlier_is_rejected(model: HandModel) -> None:
    quiet, disturbed_hand = (
        HandAtConstantTension(model).settle(),
        HandAtConstantTension(model).settle(),
    )
    tension_before = quiet.run_tick_with_tension(HOLD_TENSION_N).tension
    estimate_after = disturbed_hand.run_tick_with_tension(HOLD_TENSION_N + 60.0)
    np.testing.assert_allclose(estimate_after.tension, tension_before, atol=0.02)
    assert estimate_after.innovation[0] != estimate_after.innovation[0], "as if it had not come"
    np.testing.assert_allclose(
        disturbed_hand.run_tick_with_tension(HOLD_TENSION_N).tension,
        quiet.run_tick_with_tension(HOLD_TENSION_N).tension,
        atol=0.02,
    )


@pytest.mark.parametrize("tension_jump_N", [-8.0, 6.0, 30.0])
def test_two_outliers_in_a_row_are_accepted(model: HandModel, tension_jump_N: float) -> None:
    """If a load cell reads two equal outliers in a row, the filter takes them for a real impact.

    The filter follows the second of the two equal outliers at once.
    """
    hand = HandAtConstantTension(model).settle()
    hand.run_tick_with_tension(HOLD_TENSION_N + tension_jump_N)
    estimate = hand.run_tick_with_tension(HOLD_TENSION_N + tension_jump_N)
    assert abs(estimate.tension[0] - (HOLD_TENSION_N + tension_jump_N)) < 0.35 * abs(tension_jump_N)
    assert abs(estimate.tension[1] - HOLD_TENSION_N) < 0.1, "the others are left alone"


def test_two_outliers_on_opposite_sides_are_rejected(model: HandModel) -> None:
    hand = HandAtConstantTension(model).settle()
    for k in range(6):
        estimate = hand.run_tick_with_tension(HOLD_TENSION_N + (-1) ** k * 30.0)
        assert abs(estimate.tension[0] - HOLD_TENSION_N) < 0.1


def test_a_saturated_cell_is_no_measurement(model: HandModel) -> None:
    hand = HandAtConstantTension(model).settle()
    for _ in range(20):
        estimate = hand.run_tick_with_tension(243.9, saturated_tendons=(0,))
        assert np.isnan(estimate.innovation[0])
        assert abs(estimate.tension[0] - HOLD_TENSION_N) < 0.5
    assert not np.isnan(estimate.innovation[1:]).any()


def slack_tendon_estimate(
    hand: HandAtConstantTension, cell_error_N: float, slack_length_m: float, duration_s: float
) -> SyntheticEstimate:
    """Return the estimate of a hand whose tendons are slack.

    The load cell of tendon 0 reads ``cell_error_N`` [N], although tendon 0 has no tension.
    """
    model = hand.model
    x = np.zeros((model.tendon_count, STATE_COUNT))
    hand.travel = np.full(model.tendon_count, -slack_length_m)
    x[:, X] = hand.travel
    is_length_known = (True,) * model.tendon_count
    hand.state = FilterState.tendons_in_regime(
        x.ravel(), TendonRegime.SLACK, stopped=True
    )._replace(is_length_known=is_length_known)
    for _ in range(round(duration_s / model.period)):
        n = model.tendon_count
        read = empty_readings(model)._replace(travel=hand.travel, tension=np.zeros(n))
        read.tension[0] = cell_error_N
        no_touches = (False,) * len(model.digits)
        hand.state, estimate = run_filter_tick(
            model, hand.state, read, np.zeros(n), np.zeros(n), no_touches
        )
    return estimate


def test_a_slack_tendon_reveals_the_error_of_its_load_cell(model: HandModel) -> None:
    hand = HandAtConstantTension(model)
    estimate = slack_tendon_estimate(hand, 0.8, 2 * SLACK_LENGTH_M, 2.0)
    np.testing.assert_allclose(
        estimate.cell_error, [0.8] + [0.0] * (model.tendon_count - 1), atol=0.02
    )
    np.testing.assert_allclose(estimate.tension, 0.0, atol=1e-9)
    assert hand.state.regimes == (TendonRegime.SLACK,) * model.tendon_count


def test_a_nearly_taut_tendon_does_not_update_the_load_cell_error(model: HandModel) -> None:
    assert not slack_tendon_estimate(
        HandAtConstantTension(model), 0.8, 0.5 * SLACK_LENGTH_M, 1.0
    ).cell_error.any()


def test_the_error_stays_as_it_is_while_the_tendon_is_taut(model: HandModel) -> None:
    hand = HandAtConstantTension(model)
    x = hand.state.filter_states.copy()
    x[E] = 0.7
    hand.state = hand.state._replace(filter_states=x)
    for _ in range(300):
        estimate = hand.run_tick_with_tension(HOLD_TENSION_N + 0.7)
    np.testing.assert_allclose(estimate.cell_error[0], 0.7, atol=1e-3)
    np.testing.assert_allclose(estimate.tension, HOLD_TENSION_N, atol=0.1)


def test_a_model_that_does_not_fit_is_reported_once(model: HandModel) -> None:
    hand = HandAtConstantTension(model).settle()
    names, events = model.hand.tendon_names, list[TickEvent]()
    for k in range(round(3 * NIS_AVERAGING_TIME_S / model.period)):
        state_before = hand.state
        hand.run_tick_with_tension(HOLD_TENSION_N, extra_travel=4e-5 * (-1) ** k)
        events += consistency_events(
            model, state_with_filter(model, state_before), state_with_filter(model, hand.state)
        )
    assert sorted(event.where for event in events) == sorted(names), "every tendon, each once"
    assert {event.level for event in events} == {"warn"}
    for _ in range(round(5 * NIS_AVERAGING_TIME_S / model.period)):
        state_before = hand.state
        hand.run_tick_with_tension(HOLD_TENSION_N)
        events += consistency_events(
            model, state_with_filter(model, state_before), state_with_filter(model, hand.state)
        )
    assert [event.level for event in events].count("info") == len(names)
    assert len(events) == 2 * len(names)


@pytest.mark.parametrize(
    ("missed_ticks", "expected_prediction_s"), [(0, 0.0), (1, None), (4, None), (10_000, 0.05)]
)
def test_the_filter_predicts_every_tick_that_was_skipped(
    model, missed_ticks: int, expected_prediction_s: float | None
) -> None:
    """When ticks are skipped, the filter predicts the state with a constant motor force for up to 50 ms.

    When ticks are skipped, the filter applies the planned change of the tension for only one
    control period.
    """
    state, force = state_while_winding(model)
    rate, contact_flags = np.full(model.tendon_count, 50.0), (False,) * len(model.digits)
    state_after, estimate = run_filter_tick(
        model, state, empty_readings(model), force, rate, contact_flags, missed_ticks=missed_ticks
    )
    state_after_one_tick, _ = run_filter_tick(
        model, state, empty_readings(model), force, rate, contact_flags
    )
    F, B = (design_arrays_by_tendon(model, state_after_one_tick.regimes, name) for name in "FB")
    x, inputs = (
        state_after_one_tick.filter_states.reshape(-1, STATE_COUNT, 1),
        np.column_stack((force, np.zeros(model.tendon_count)))[..., None],
    )
    for _ in range(
        missed_ticks
        if expected_prediction_s is None
        else round(expected_prediction_s / model.period)
    ):
        x = F @ x + B @ inputs
    np.testing.assert_allclose(state_after.filter_states, x.ravel(), rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(estimate.travel, state_after.filter_states[X::STATE_COUNT])
    assert state_after[1:5] == state_after_one_tick[1:5], (
        "nothing else is judged of what nobody saw"
    )


def state_while_winding(model: HandModel) -> tuple[FilterState, np.ndarray]:
    """Return a filter state, and motor forces that balance the tensions [N].

    In the returned filter state, the digits are half closed, and the rotors turn. All tendons have
    a tension of 20 N.
    """
    x = np.zeros((model.tendon_count, STATE_COUNT))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), 0.5)
    x[:, X], x[:, V] = x[:, S] + 20.0 / model.tendon_constants.stiffness, 1e-3
    return FilterState.tendons_in_regime(x.ravel(), TendonRegime.HELD, stopped=False), np.full(
        model.tendon_count, 20.0
    )


@pytest.mark.parametrize("ticks_per_position", [5, 11, 30])
def test_occasional_positions_do_not_make_the_filter_oscillate(
    jamia: HandModel, ticks_per_position: int
) -> None:
    """The design of the filter gains assumes that each drive sends its position in every tick.

    However, a drive can send its position less often: after a reset, for example, only in every
    11th tick.
    """
    held_hand = HandAtConstantTension(jamia).settle()
    chance = np.random.default_rng(7)
    for k in range(100 * ticks_per_position):
        travel = 2e-5 * chance.standard_normal() if k % ticks_per_position == 0 else np.nan
        estimate = held_hand.run_tick_with_tension(HOLD_TENSION_N, extra_travel=travel)
        assert np.abs(estimate.travel - held_hand.travel).max() < 0.05, k
    for _ in range(200):
        estimate = held_hand.run_tick_with_tension(HOLD_TENSION_N)
    np.testing.assert_allclose(estimate.travel, held_hand.travel, atol=1e-4)
    np.testing.assert_allclose(estimate.tendon_speed, 0.0, atol=2e-3)
