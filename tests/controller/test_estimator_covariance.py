"""Test the tension filter with data that the model of the filter generates.

The covariance of the filter matches the actual errors of its estimates, even while measurements are
missing.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from handctl.core.constants import constant_tables
from handctl.core.estimation.filter_types import (
    MEASUREMENT_COUNT,
    STATE_COUNT,
    E,
    S,
    TendonRegime,
    V,
    X,
)
from handctl.core.estimation.kalman import _is_measurement_missing
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.hand.hand_loading import hand_content, hand_from_content
from tests.controller.filter_oracle import (
    FILTER_STATE_UNITS,
    assert_same_covariance,
    assumed_measurements,
    integrate_one_period,
    joseph_update,
    measurement_noise,
)
from tests.controller.filter_runs import (
    corrected_state,
    design_arrays_by_tendon,
    flags_without_contact,
    noiseless_readings,
    run_filter_tick,
    run_filter_tick_without_plan,
    state_at_rest,
    state_in_regime,
)
from tests.controller.synthetic_states import (
    SensorReadings,
    active_state,
    constant_args_of,
    empty_readings,
    uncompiled_function,
)


def frictionless_model_of(hand_name: str, rate_hz: float) -> HandModel:
    """Return a hand without friction and weight, for which the filter's model is exact."""
    content = hand_content(hand_name)
    content["mount"]["gravity_m_s2"] = [0.0, 0.0, 0.0]
    for tendon in content["tendon"]:
        tendon["friction_coefficient"] = 0.0
    return HandModel.from_hand(hand_from_content(content, "plain"), Gains(), rate_hz)


@pytest.fixture(scope="module")
def frictionless_jamia() -> HandModel:
    return frictionless_model_of("jamia", 500.0)


@pytest.fixture(scope="module")
def frictionless_jamia11() -> HandModel:
    return frictionless_model_of("jamia11", 200.0)


@pytest.fixture(params=["jamia", "jamia11"])
def frictionless_model(request: pytest.FixtureRequest) -> HandModel:
    parametrised_model: HandModel = request.getfixturevalue(f"frictionless_{request.param}")
    return parametrised_model


MissingMeasurements = Callable[[int, np.random.Generator], np.ndarray]


class FilterRun(NamedTuple):
    """Errors of a settled filter's estimates, and the standard deviations that the filter computes.

    Each array of errors or standard deviations has the shape (ticks, tendons).
    """

    estimate_error: np.ndarray
    estimate_sigma: np.ndarray
    innovation: np.ndarray
    nis: np.ndarray
    regimes: set[tuple[int, ...]]


def run_monte_carlo(
    model: HandModel,
    regime: TendonRegime,
    tick_count: int,
    seed: int,
    missing_measurements: MissingMeasurements | None = None,
) -> FilterRun:
    """Draw a random true trajectory from the filter's model in one regime: free, held or slack.

    Simulate measurements of the trajectory, and run the filter with these measurements.

    ``missing_measurements`` is a function that returns a mask (2, tendons) for each tick. The first
    row of the mask marks missing encoder readings, and the second row marks missing load-cell
    readings.
    """
    rng, n = np.random.default_rng(seed), model.tendon_count
    design_arrays_by_tendon = [integrate_one_period(model, i, regime) for i in range(n)]
    root = np.array(
        [np.linalg.cholesky(Q + 1e-18 * np.eye(STATE_COUNT)) for _, _, Q in design_arrays_by_tendon]
    )
    root[:, E] = 0.0
    F = np.array(
        [
            F * FILTER_STATE_UNITS[:, None] / FILTER_STATE_UNITS
            for F, _, _ in design_arrays_by_tendon
        ]
    )
    B = np.array([G * FILTER_STATE_UNITS[:, None] for _, G, _ in design_arrays_by_tendon])
    sigma = np.array([[*measurement_noise(model, i), 0.0] for i in range(n)])
    closed, free = 0.5, regime == TendonRegime.FREE
    truth, _ = state_at_rest(model, 40.0, closed)
    state = state_in_regime(model, regime, truth)
    contact = (not free,) * len(model.digits)
    rows: list[tuple[np.ndarray, ...]] = []
    regimes = set()
    tension_rows = np.array([blocks[regime].tension_row for blocks in model.filter_design.blocks])
    for k in range(tick_count):
        # The motor of this test holds the tendon as a controller would. The planned rate of change
        # of the tension prevents a drift of the tension.
        tension = (tension_rows * truth).sum(axis=1)
        travel_error = (
            truth[:, X]
            - 40.0 / model.tendon_constants.stiffness
            - model.hand.moment_arms.sum(axis=1) * closed
        )
        force = (tension if free else 40.0) - model.tendon_constants.motor_mass * (
            40.0 * truth[:, V] + 400.0 * free * travel_error
        )
        rate = 5.0 * (40.0 - tension)
        z = truth @ model.filter_design.blocks[0][regime].H.T
        z[:, 1] = tension
        z += sigma * rng.normal(size=(n, MEASUREMENT_COUNT))
        if missing_measurements is not None:
            z[:, :2][missing_measurements(k, rng).T] = np.nan
        measured = empty_readings(model)._replace(travel=z[:, 0], tension=z[:, 1])
        state, estimate = run_filter_tick(model, state, measured, force, rate, contact)
        noise = (root @ rng.normal(size=(n, STATE_COUNT, 1)))[..., 0] * FILTER_STATE_UNITS
        inputs = np.column_stack((force, rate))
        truth = (F @ truth[..., None])[..., 0] + (B @ inputs[..., None])[..., 0] + noise
        error = estimate.tension - (tension_rows * truth).sum(axis=1)
        rows.append((error, estimate.tension_sigma, estimate.innovation, estimate.nis))
        regimes.add(state.regimes)
    evaluated_rows = rows[tick_count // 10 :]
    return FilterRun(
        *(np.array([row[i] for row in evaluated_rows]) for i in range(4)), regimes=regimes
    )


@pytest.mark.parametrize("regime", [TendonRegime.FREE, TendonRegime.HELD])
def test_estimator_is_consistent_with_its_own_model(
    frictionless_model: HandModel, regime: TendonRegime
) -> None:
    filter_run = run_monte_carlo(frictionless_model, regime, 2500, seed=5)
    assert filter_run.regimes == {(int(regime),) * frictionless_model.tendon_count}, (
        "the run stayed in its regime"
    )
    gains = frictionless_model.gains.filter
    drift = gains.cell_drift_N**2 * gains.cell_tared_s / gains.cell_drift_time_s
    ratio = np.sqrt(
        (filter_run.estimate_error**2).mean() / (filter_run.estimate_sigma**2 - drift).mean()
    )
    assert 0.9 < ratio < 1.1
    assert abs(filter_run.nis.mean() - 2.0) < 0.1, "encoder and load cell: two degrees of freedom"
    scaled = filter_run.innovation / filter_run.innovation.std(axis=0)
    assert abs((scaled[1:] * scaled[:-1]).mean()) < 0.1, "innovations are white"
    assert (filter_run.estimate_sigma**2 - drift).mean() < 0.5**2, "better than the load cell alone"


SPARSE_MEASUREMENTS: dict[str, MissingMeasurements] = {
    "every second position": lambda k, rng: np.array([[k % 2 == 1], [False]]),
    "every fourth position": lambda k, rng: np.array([[k % 4 > 0], [False]]),
    "every third load cell": lambda k, rng: np.array([[False], [k % 3 > 0]]),
    "a third of all": lambda k, rng: rng.random((2, 1)) < 0.33,
}


@pytest.mark.parametrize("regime", [TendonRegime.FREE, TendonRegime.HELD])
@pytest.mark.parametrize("missing_pattern", SPARSE_MEASUREMENTS)
def test_consistent_with_its_own_model_though_measurements_are_missing(
    frictionless_model: HandModel, regime: TendonRegime, missing_pattern: str
) -> None:
    """The errors of the filter are as large as its covariance predicts.

    Actual and predicted errors are allowed to differ by 15 %, because the statistics of a limited
    number of ticks are uncertain.
    """
    missing = SPARSE_MEASUREMENTS[missing_pattern]
    filter_run = run_monte_carlo(
        frictionless_model,
        regime,
        2500,
        5,
        lambda k, rng: np.broadcast_to(missing(k, rng), (2, frictionless_model.tendon_count)),
    )
    gains = frictionless_model.gains.filter
    drift = gains.cell_drift_N**2 * gains.cell_tared_s / gains.cell_drift_time_s
    ratio = np.sqrt(
        (filter_run.estimate_error**2).mean() / (filter_run.estimate_sigma**2 - drift).mean()
    )
    assert 0.85 < ratio < 1.15
    assert abs(np.nanmean(filter_run.nis) - 2.0) < 0.15


def test_the_covariance_is_updated_only_until_it_is_steady(model: HandModel) -> None:
    x, force = state_at_rest(model, 25.0, 0.6)
    state, sigma = state_in_regime(model, TendonRegime.FREE, x), []
    for k in range(300):
        measured = noiseless_readings(model, x, np.full(model.tendon_count, 25.0))
        if 20 <= k < 25:
            measured.travel[0] = np.nan
        state, estimate = run_filter_tick_without_plan(
            model, state, measured, force, flags_without_contact(model)
        )
        if state.covariance is not None:
            assert k == 20 + len(sigma), "in one piece, from the first that is missing on"
            sigma.append(estimate.tension_sigma)
    steady_state_sigma = np.sqrt(design_arrays_by_tendon(model, state.regimes, "tension_variance"))
    assert 5 < len(sigma) < 200
    assert sigma[4][0] > 1.01 * steady_state_sigma[0]
    assert max(sample[0] for sample in sigma) == max(sigma[4][0], sigma[5][0]), (
        "it grows as long as nothing is read"
    )
    np.testing.assert_allclose(
        [sample[1:] for sample in sigma], [steady_state_sigma[1:]] * len(sigma), rtol=1e-3
    )
    np.testing.assert_allclose(sigma[-1], steady_state_sigma, rtol=0.02)


@pytest.mark.parametrize(("missing_column", "regime", "is_detected"), [
    (None, TendonRegime.FREE, False), (0, TendonRegime.FREE, True), (1, TendonRegime.FREE, True),
    (2, TendonRegime.FREE, False),
    (0, TendonRegime.SLACK, True), (1, TendonRegime.SLACK, False), (1, TendonRegime.HELD, True),
])  # fmt: skip
def test_missing_measurement_is_detected_in_each_regime(
    model: HandModel, missing_column: int | None, regime: TendonRegime, is_detected: bool
) -> None:
    """The filter ignores missing readings of joint encoders, and missing load-cell readings of slack tendons."""
    z = np.arange(3.0 * model.tendon_count).reshape(-1, 3)
    if missing_column is not None:
        z[-1, missing_column] = np.nan
    state = active_state(model)
    state.view("regime")[-1] = regime
    x = uncompiled_function(state_tables)(state.block, state.layout.offsets)
    assert (
        uncompiled_function(_is_measurement_missing)(
            x, uncompiled_function(constant_tables)(*constant_args_of(model)), z
        )
        is is_detected
    )


def test_a_tendon_whose_regime_changes_begins_with_the_steady_covariance(model: HandModel) -> None:
    """In a tick without encoder readings, the first digit comes into contact.

    In this test, only the first digit touches an object, and the last digit stays without contact.
    """
    x, force = state_at_rest(model, 25.0, 0.6)
    state, digit_contact = (
        state_in_regime(model, TendonRegime.FREE, x),
        (True, *flags_without_contact(model)[1:]),
    )
    readings_without_travel, zero_vector = (
        empty_readings(model)._replace(tension=force),
        np.zeros(model.tendon_count),
    )
    state_after, _ = run_filter_tick(
        model, state, readings_without_travel, force, zero_vector, digit_contact, missed_ticks=4
    )
    first_tendon, last_tendon = 0, model.tendon_count - 1
    assert (state_after.regimes[first_tendon], state_after.regimes[last_tendon]) == (
        int(TendonRegime.HELD),
        int(TendonRegime.FREE),
    )
    assert state_after.covariance is not None
    steady_state_covariances = [
        model.filter_design.blocks[n][state_after.regimes[n]].P for n in range(model.tendon_count)
    ]
    np.testing.assert_array_equal(
        state_after.covariance[first_tendon], steady_state_covariances[first_tendon]
    )
    state_after_one_tick, _ = run_filter_tick(
        model, state, readings_without_travel, force, zero_vector, digit_contact
    )
    assert state_after_one_tick.covariance is not None
    tension_variances = [
        state_after.covariance[last_tendon, X, X],
        state_after_one_tick.covariance[last_tendon, X, X],
        steady_state_covariances[last_tendon][X, X],
    ]
    assert tension_variances == sorted(tension_variances, reverse=True), (
        "what is not read is known less with every period"
    )
    assert tension_variances[0] > tension_variances[1] > tension_variances[2]
    answers = []
    for covariance in (state_after.covariance, None):
        state_with_covariance = state_after._replace(filter_states=x.ravel(), covariance=covariance)
        samples = (
            noiseless_readings(model, x, force)._replace(travel=x[:, X] + travel_step)
            for travel_step in (0.0, 1e-7)
        )
        moved = [
            corrected_state(model, state_with_covariance, sample).view("travel")
            for sample in samples
        ]
        answers.append(moved[1] - moved[0])
    np.testing.assert_allclose(answers[0][first_tendon], answers[1][first_tendon], rtol=1e-6)
    assert answers[0][last_tendon] > answers[1][last_tendon], "and a reading is believed more"


MISSING_SAMPLES: dict[str, MissingMeasurements] = {
    "an encoder": lambda k, rng: np.array([[k < 3], [False]]),
    "a load cell": lambda k, rng: np.array([[False], [k < 3]]),
    "both": lambda k, rng: np.array([[k < 3], [k < 3]]),
    "now one, now the other": lambda k, rng: np.array([[k % 2 == 0], [k % 3 == 0]]),
    "a third of all": lambda k, rng: rng.random((2, 1)) < 0.33,
}


@pytest.mark.parametrize("regime", TendonRegime)
@pytest.mark.parametrize("missing_pattern", MISSING_SAMPLES)
def test_the_covariance_is_that_of_a_plain_joseph_update(
    model: HandModel, regime: TendonRegime, missing_pattern: str
) -> None:
    """The covariances of the filter agree with a Joseph update that numpy computes.

    For a slack tendon, the filter updates the covariance only while encoder readings are missing.
    """
    rng, n = np.random.default_rng(9), model.tendon_count
    slack = regime == TendonRegime.SLACK
    x, force = state_at_rest(model, 0.0 if slack else 25.0, 0.0 if slack else 0.6)
    x[:, X] -= slack * 1e-3
    state = state_in_regime(model, regime, x)._replace(is_length_known=(True,) * n)
    blocks = [blocks_of_tendon[regime] for blocks_of_tendon in model.filter_design.blocks]
    P, compared_count = np.array([block.P for block in blocks]), 0
    for k in range(40):
        missing = np.broadcast_to(MISSING_SAMPLES[missing_pattern](k, rng), (2, n))
        z = np.where(missing, np.nan, (x[:, X], force))
        read = noiseless_readings(model, x, z[1])._replace(travel=z[0])
        state_before = state
        state, _ = run_filter_tick_without_plan(
            model, state, read, force, (regime == TendonRegime.HELD,) * len(model.digits)
        )
        assert set(state.regimes) == {regime}
        if state_before.covariance is None and state.covariance is None:
            continue
        for i, block in enumerate(blocks):
            updated_covariance = joseph_update(block, P[i], missing[:, i])[1]
            P[i] = block.F @ updated_covariance @ block.F.T + block.Q
        if state.covariance is None:
            P = np.array([block.P for block in blocks])
            continue
        assert_same_covariance(state.covariance, P)
        compared_count += 1
    assert (
        compared_count == 0 if slack and missing_pattern == "a load cell" else compared_count >= 3
    )


@pytest.mark.parametrize(
    ("missed_ticks", "prediction_time_s"), [(1, None), (4, None), (10_000, 0.05)]
)
def test_covariance_grows_over_skipped_ticks(
    model: HandModel, missed_ticks: int, prediction_time_s: float | None
) -> None:
    """In missed ticks, the covariance of the filter grows.

    The filter predicts the covariance at most over the time for which the motors hold the last
    command. During longer gaps, the covariance therefore stops growing.
    """
    x, force = state_at_rest(model, 25.0, 0.6)
    measured, zero_vector = noiseless_readings(model, x, force), np.zeros(model.tendon_count)
    state = state_in_regime(model, TendonRegime.FREE, x)
    state_after, _ = run_filter_tick(
        model,
        state,
        measured,
        force,
        zero_vector,
        flags_without_contact(model),
        missed_ticks=missed_ticks,
    )
    assert set(state_after.regimes) == {TendonRegime.FREE}
    F, Q = (design_arrays_by_tendon(model, state_after.regimes, name) for name in "FQ")
    read = np.zeros(2, dtype=bool)
    P = np.array(
        [
            joseph_update(
                blocks_of_tendon[TendonRegime.FREE], blocks_of_tendon[TendonRegime.FREE].P, read
            )[1]
            for blocks_of_tendon in model.filter_design.blocks
        ]
    )
    for _ in range(
        1 + (missed_ticks if prediction_time_s is None else round(prediction_time_s / model.period))
    ):
        P = F @ P @ F.transpose(0, 2, 1) + Q
    assert state_after.covariance is not None
    assert_same_covariance(state_after.covariance, P)


def test_an_independent_filter_agrees_over_gaps(model: HandModel) -> None:
    """The second filter of this test computes the estimates of each tendon with plain loops.

    The measurement matrix of the second filter has no row for a missing measurement.
    """
    rng, n = np.random.default_rng(3), model.tendon_count
    x, force = state_at_rest(model, 25.0, 0.6)
    state, second = state_in_regime(model, TendonRegime.FREE, x), x.copy()
    blocks = [blocks[TendonRegime.FREE] for blocks in model.filter_design.blocks]
    P = [block.P.copy() for block in blocks]
    compared_count = 0
    for _ in range(300):
        z = np.column_stack((x[:, X], np.full(n, 25.0), x[:, S]))
        z += rng.normal(size=(n, 3)) * [1e-7, 0.02, 1e-6]
        z[rng.random((n, 3)) < 0.15] = np.nan
        push = force + 0.1 * rng.normal(size=n)
        state, _ = run_filter_tick_without_plan(
            model,
            state,
            SensorReadings(*z.T, empty_readings(model).joints),
            push,
            flags_without_contact(model),
        )
        if set(state.regimes) != {TendonRegime.FREE}:
            break
        for i, block in enumerate(blocks):
            H, is_measured = assumed_measurements(block, TendonRegime.FREE), ~np.isnan(z[i, :2])
            H, R = H[is_measured], np.diag(block.R[is_measured])
            gain = np.linalg.solve(H @ P[i] @ H.T + R, H @ P[i]).T
            gain[E] = 0.0
            P[i] = (np.eye(STATE_COUNT) - gain @ H) @ P[i] @ (
                np.eye(STATE_COUNT) - gain @ H
            ).T + gain @ R @ gain.T
            P[i] = block.F @ P[i] @ block.F.T + block.Q
            innovation = z[i] - block.H @ second[i]
            read = 0.0 if np.isnan(z[i, 2]) else innovation[2]
            second[i] = second[i] + gain @ innovation[:2][is_measured] + block.K[:, 2] * read
            second[i] = block.F @ second[i] + block.B @ [push[i], 0.0]
        if state.covariance is None:
            P = [block.P.copy() for block in blocks]
        np.testing.assert_allclose(
            state.filter_states.reshape(n, -1) / FILTER_STATE_UNITS,
            second / FILTER_STATE_UNITS,
            rtol=1e-7,
            atol=1e-7,
        )
        compared_count += 1
    assert compared_count > 50
