"""Test small functions of the tension filter at their limits, and with both signs of their arguments."""

import numpy as np
import pytest

from handctl.core.estimation.filter_types import STATE_COUNT, O, S, TendonRegime, W, X
from handctl.core.estimation.kalman import (
    MAX_PULL_TO_COME_TO_REST,
    MAX_PULL_TO_STAY_AT_REST,
    MAX_STOP_DISTANCE_TO_COME_TO_REST_M,
    MAX_STOP_DISTANCE_TO_STAY_AT_REST_M,
    SLACK_LENGTH_M,
    _is_at_stop,
    _usable_measurements,
)
from handctl.core.estimation.slack_detection import (
    CERTAINLY_TAUT_POINTS,
    LIKELY_TAUT_ABOVE_N,
    LIKELY_TAUT_POINTS,
    MIN_TAUT_TENSION_N,
    NEARLY_TAUT_FACTOR,
    NEARLY_TAUT_M,
    POSSIBLY_TAUT_ABOVE_N,
    POSSIBLY_TAUT_POINTS,
    TAUT_POINTS,
)
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from tests.controller.filter_runs import (
    FilterState,
    corrected_state,
    filter_state_of,
    run_filter_tick_without_plan,
    state_with_filter,
    write_readings,
)
from tests.controller.synthetic_states import (
    SensorReadings,
    SyntheticEstimate,
    empty_readings,
    uncompiled_function,
)

SLACK_EVIDENCE_POINTS = (
    (MIN_TAUT_TENSION_N, CERTAINLY_TAUT_POINTS),
    (LIKELY_TAUT_ABOVE_N, LIKELY_TAUT_POINTS),
    (POSSIBLY_TAUT_ABOVE_N, POSSIBLY_TAUT_POINTS),
)


@pytest.mark.parametrize("was_at_stop", [False, True])
def test_a_digit_is_on_its_stop_below_its_limits_and_not_at_them(was_at_stop: bool) -> None:
    band, max_tension = (
        (MAX_STOP_DISTANCE_TO_STAY_AT_REST_M, 10.0 * MAX_PULL_TO_STAY_AT_REST)
        if was_at_stop
        else (MAX_STOP_DISTANCE_TO_COME_TO_REST_M, 10.0 * MAX_PULL_TO_COME_TO_REST)
    )
    is_at_stop = uncompiled_function(_is_at_stop)
    assert is_at_stop(was_at_stop, np.nextafter(band, 0.0), np.nextafter(max_tension, 0.0), 10.0)
    assert not is_at_stop(was_at_stop, band, 0.0, 10.0)
    assert not is_at_stop(was_at_stop, 0.0, max_tension, 10.0)


def filter_state(model: HandModel, regime: TendonRegime, **state_values: float) -> FilterState:
    """Return a filter state with one regime (free, held or slack) for all tendons, and with no digit at its stop.

    Each keyword argument sets one of the seven states of all tendons to a value.
    """
    x = np.zeros((model.tendon_count, STATE_COUNT))
    for name, value in state_values.items():
        x[:, {"X": X, "S": S, "W": W, "O": O}[name]] = value
    return FilterState.tendons_in_regime(x.ravel(), regime, stopped=False)


def estimated_contact_tension(
    model: HandModel, regime: TendonRegime, tendon_speed: float
) -> np.ndarray:
    """Return the part of each tension [N] that the filter explains with a contact.

    All tendons have a tension of 20 N and move with the speed ``tendon_speed`` [m/s]. The filter
    gets no sensor readings.
    """
    stretch = (
        20.0 + model.tendon_constants.damping * tendon_speed
    ) / model.tendon_constants.stiffness
    state = filter_state(model, regime, S=2e-3, W=tendon_speed)
    x = state.filter_states.reshape(-1, STATE_COUNT).copy()
    x[:, X] = x[:, S] + stretch
    return corrected_state(
        model, state._replace(filter_states=x.ravel()), empty_readings(model)
    ).view("external")


def test_damping_of_a_moving_digit_is_no_contact(model: HandModel) -> None:
    tension_at_rest, tension_in_motion = (
        estimated_contact_tension(model, TendonRegime.FREE, rate) for rate in (0.0, 0.05)
    )
    np.testing.assert_allclose(
        tension_in_motion - tension_at_rest, -0.05 * model.tendon_constants.load_damping, rtol=1e-9
    )
    assert tension_at_rest.all(), "20 N are more than springs ask here"


def test_a_slack_tendon_bears_no_contact_wherever_its_digit_is(model: HandModel) -> None:
    assert not estimated_contact_tension(model, TendonRegime.SLACK, 0.0).any()


def used_measurements(model: HandModel, state: FilterState, measured: SensorReadings) -> np.ndarray:
    """Return the measurements that the filter uses in a given state, as an array (tendons, 3).

    A measurement that the filter does not use is NaN.
    """
    run = state_with_filter(model, state)
    write_readings(run, measured)
    return uncompiled_function(_usable_measurements)(
        uncompiled_function(state_tables)(run.block, run.layout.offsets)
    )


@pytest.mark.parametrize(
    ("digit_excursion_m", "spool_travel_m", "stretch_offset_m"),
    [(-3e-4, 0.0, 0.0), (-1e-4, 3e-4, 0.0), (-1e-4, 0.0, 3e-4)],
)
def test_slack_length_is_digit_excursion_minus_spool_travel(
    model: HandModel, digit_excursion_m: float, spool_travel_m: float, stretch_offset_m: float
) -> None:
    """The slack length is the excursion of the digit minus the travel of the spool.

    The load cell of a slack tendon reads only the error of the load cell.
    """
    n = model.tendon_count
    measured = empty_readings(model)._replace(travel=np.zeros(n), tension=np.full(n, 0.3))
    for added_length, usable in ((0.0, True), (SLACK_LENGTH_M + 1e-5, False)):
        state = filter_state(
            model,
            TendonRegime.SLACK,
            X=digit_excursion_m + added_length,
            S=spool_travel_m,
            O=stretch_offset_m,
        )._replace(is_length_known=(True,) * n)
        assert np.isfinite(used_measurements(model, state, measured)[:, 1]).all() == usable
    state = filter_state(
        model, TendonRegime.SLACK, X=digit_excursion_m, S=spool_travel_m, O=stretch_offset_m
    )
    assert np.isnan(used_measurements(model, state, measured)[:, 1]).all(), (
        "its length is not known"
    )


def regimes_after_sample(model: HandModel, state: FilterState, cell_tension: float) -> FilterState:
    """Return the filter state after all load cells have read ``cell_tension`` [N].

    In the returned filter state, no digit touches an object.
    """
    return filter_state_of(
        corrected_state(
            model,
            state,
            empty_readings(model)._replace(tension=np.full(model.tendon_count, cell_tension)),
        )
    )


@pytest.mark.parametrize(
    ("slack_length_m", "is_length_known", "is_taut_afterwards"),
    [(0.0, True, True), (2 * NEARLY_TAUT_M, True, False), (0.0, False, False)],
)
def test_a_tendon_that_is_about_to_be_taut_by_its_encoder_is_so_at_a_sample(
    model: HandModel, slack_length_m: float, is_length_known: bool, is_taut_afterwards: bool
) -> None:
    """If the length of a tendon is known, the motor encoder alone shows that the tendon will soon be taut.

    The filter knows the length of a slack tendon if this tendon has been taut before.

    The filter adds up the evidence that a slack tendon becomes taut. When a tendon counts as taut,
    the filter resets the sum of this evidence to zero.
    """
    n = model.tendon_count
    lower_tension = next(
        lower_tension
        for lower_tension, worth in SLACK_EVIDENCE_POINTS
        if worth * NEARLY_TAUT_FACTOR >= TAUT_POINTS > worth
    )
    state = filter_state(model, TendonRegime.SLACK, X=2e-3 - slack_length_m, S=2e-3)._replace(
        is_length_known=(is_length_known,) * n
    )
    regimes_after = regimes_after_sample(model, state, lower_tension + 1e-6)
    assert (
        regimes_after.regimes
        == ((TendonRegime.FREE if is_taut_afterwards else TendonRegime.SLACK),) * n
    )
    assert (regimes_after.regime_change_evidence == (0,) * n) == is_taut_afterwards
    assert regimes_after.is_length_known == (is_length_known,) * n


def test_a_tendon_that_became_taut_has_a_known_length(model: HandModel) -> None:
    n = model.tendon_count
    state = filter_state(model, TendonRegime.SLACK, S=2e-3)
    for _ in range(TAUT_POINTS):
        state = regimes_after_sample(model, state, SLACK_EVIDENCE_POINTS[0][0] + 1.0)
    assert (state.regimes, state.is_length_known) == ((TendonRegime.FREE,) * n, (True,) * n)


def test_a_digit_on_its_stop_is_at_zero_when_its_tendon_becomes_taut(model: HandModel) -> None:
    state = filter_state(model, TendonRegime.SLACK, S=1e-4)._replace(
        stopped=(True,) * model.tendon_count
    )
    regimes_after = regimes_after_sample(model, state, SLACK_EVIDENCE_POINTS[0][0] + 1e-6)
    assert regimes_after.stopped == state.stopped
    assert (regimes_after.filter_states[S::STATE_COUNT] == 0.0).all()
    assert (state.filter_states[S::STATE_COUNT] == 1e-4).all(), (
        "of the state before nothing is changed"
    )


def test_an_estimate_has_every_column_before_the_first_reading(model: HandModel) -> None:
    n, j = model.tendon_count, len(model.hand.joints)
    no = (False,) * len(model.digits)
    _, estimate = run_filter_tick_without_plan(
        model, FilterState.initial_filter_state(n), empty_readings(model), np.zeros(n), no
    )
    shapes = {
        name: np.shape(value)
        for name, value in zip(SyntheticEstimate._fields, estimate, strict=True)
    }
    assert {name for name, shape in shapes.items() if shape == (j,)} >= {"q", "dq"}
    assert all(shape in ((n,), (j,), (len(model.digits),)) for shape in shapes.values()), shapes
