"""The tension filter against its own model: as good as it says, and no worse where measurements are missing."""

import tomllib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from handctl.core.estimation import covariance, estimator
from handctl.core.estimation.estimator import Measured
from handctl.core.estimation.filter_stack import MEASUREMENTS, STATES, E, Regime, S, V, X
from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.hand.load import hand_from, hand_path
from tests.controller.filter_runs import all_in, nowhere, readings, resting, step
from tests.controller.oracle import SCALE, assumed_measurements, measurement_noise, over_one_period
from tests.controller.synthetic import nothing_read


def plain_hand(name: str, rate_hz: float) -> HandModel:
    """A hand whose filter model is exact: no friction, no weight."""
    content = tomllib.loads(hand_path(name).read_text())
    content["mount"]["gravity_m_s2"] = [0.0, 0.0, 0.0]
    for tendon in content["tendon"]:
        tendon["friction_coefficient"] = 0.0
    return HandModel.of(hand_from(content, "plain"), Gains(), rate_hz)


@pytest.fixture(scope="module")
def plain_jamia() -> HandModel:
    return plain_hand("jamia", 500.0)


@pytest.fixture(scope="module")
def plain_jamia11() -> HandModel:
    return plain_hand("jamia11", 200.0)


@pytest.fixture(params=["jamia", "jamia11"])
def plain(request: pytest.FixtureRequest) -> HandModel:
    found: HandModel = request.getfixturevalue(f"plain_{request.param}")
    return found


Missing = Callable[[int, np.random.Generator], np.ndarray]


class Course(NamedTuple):
    """What a run of the filter came to, after it settled: (ticks, N) each."""

    error: np.ndarray
    sigma: np.ndarray
    innovation: np.ndarray
    nis: np.ndarray
    regimes: set[tuple[int, ...]]


def monte_carlo(model: HandModel, regime: Regime, ticks: int, seed: int, missing: Missing | None = None) -> Course:
    """Draw a truth from the filter's own model in one regime and let the filter follow it.

    ``missing`` says of a tick which encoders (first row) and load cells (second row) are not read in it, (2, N).
    """
    rng, n = np.random.default_rng(seed), model.tendon_count
    parts = [over_one_period(model, i, regime) for i in range(n)]
    root = np.array([np.linalg.cholesky(Q + 1e-18 * np.eye(STATES)) for _, _, Q in parts])
    root[:, E] = 0.0
    F = np.array([F * SCALE[:, None] / SCALE for F, _, _ in parts])
    B = np.array([G * SCALE[:, None] for _, G, _ in parts])
    sigma = np.array([[*measurement_noise(model, i), 0.0] for i in range(n)])
    closed, free = 0.5, regime == Regime.FREE
    truth, _ = resting(model, 40.0, closed)
    state = all_in(model, regime, truth)
    contact = (not free,) * len(model.digits)
    rows: list[tuple[np.ndarray, ...]] = []
    regimes = set()
    tension_rows = np.array([blocks[regime].tension_row for blocks in model.filter.blocks])
    for k in range(ticks):
        # the motor holds the rope as a controller would, and a plan keeps the tension from walking away
        tension = (tension_rows * truth).sum(axis=1)
        away = truth[:, X] - 40.0 / model.space.stiffness - model.hand.moment_arms.sum(axis=1) * closed
        force = (tension if free else 40.0) - model.space.motor_mass * (40.0 * truth[:, V] + 400.0 * free * away)
        rate = 5.0 * (40.0 - tension)
        z = truth @ model.filter.blocks[0][regime].H.T
        z[:, 1] = tension
        z += sigma * rng.normal(size=(n, MEASUREMENTS))
        if missing is not None:
            z[:, :2][missing(k, rng).T] = np.nan
        measured = nothing_read(model)._replace(travel=z[:, 0], tension=z[:, 1])
        state, estimate = estimator.step(model, state, measured, force, rate, contact)
        noise = (root @ rng.normal(size=(n, STATES, 1)))[..., 0] * SCALE
        inputs = np.column_stack((force, rate))
        truth = (F @ truth[..., None])[..., 0] + (B @ inputs[..., None])[..., 0] + noise
        error = estimate.tension - (tension_rows * truth).sum(axis=1)
        rows.append((error, estimate.sigma, estimate.innovation, estimate.nis))
        regimes.add(state.regimes)
    kept = rows[ticks // 10 :]
    return Course(*(np.array([row[i] for row in kept]) for i in range(4)), regimes=regimes)


@pytest.mark.parametrize("regime", [Regime.FREE, Regime.HELD])
def test_consistent_with_its_own_model(plain: HandModel, regime: Regime) -> None:
    course = monte_carlo(plain, regime, 2500, seed=5)
    assert course.regimes == {(int(regime),) * plain.tendon_count}, "the run stayed in its regime"
    gains = plain.gains.filter
    drift = gains.cell_drift_N**2 * gains.cell_tared_s / gains.cell_drift_time_s
    ratio = np.sqrt((course.error**2).mean() / (course.sigma**2 - drift).mean())
    assert 0.9 < ratio < 1.1
    assert abs(course.nis.mean() - 2.0) < 0.1, "encoder and load cell: two degrees of freedom"
    scaled = course.innovation / course.innovation.std(axis=0)
    assert abs((scaled[1:] * scaled[:-1]).mean()) < 0.1, "innovations are white"
    assert (course.sigma**2 - drift).mean() < 0.5**2, "better than the load cell alone"


SPARSE: dict[str, Missing] = {
    "every second position": lambda k, rng: np.array([[k % 2 == 1], [False]]),
    "every fourth position": lambda k, rng: np.array([[k % 4 > 0], [False]]),
    "every third load cell": lambda k, rng: np.array([[False], [k % 3 > 0]]),
    "a third of all": lambda k, rng: rng.random((2, 1)) < 0.33,
}


@pytest.mark.parametrize("regime", [Regime.FREE, Regime.HELD])
@pytest.mark.parametrize("what", SPARSE)
def test_consistent_with_its_own_model_though_measurements_are_missing(
    plain: HandModel, regime: Regime, what: str
) -> None:
    """The error is as large as the filter says, and no larger by more than what is not known explains."""
    missing = SPARSE[what]
    course = monte_carlo(
        plain, regime, 2500, 5, lambda k, rng: np.broadcast_to(missing(k, rng), (2, plain.tendon_count))
    )
    gains = plain.gains.filter
    drift = gains.cell_drift_N**2 * gains.cell_tared_s / gains.cell_drift_time_s
    ratio = np.sqrt((course.error**2).mean() / (course.sigma**2 - drift).mean())
    assert 0.85 < ratio < 1.15
    assert abs(np.nanmean(course.nis) - 2.0) < 0.15


def test_the_covariance_is_carried_along_only_until_it_is_steady_again(model: HandModel) -> None:
    x, force = resting(model, 25.0, 0.6)
    state, sigma = all_in(model, Regime.FREE, x), []
    for k in range(300):
        measured = readings(model, x, np.full(model.tendon_count, 25.0))
        if 20 <= k < 25:
            measured.travel[0] = np.nan
        state, estimate = step(model, state, measured, force, nowhere(model))
        if state.covariance is not None:
            assert k == 20 + len(sigma), "in one piece, from the first that is missing on"
            sigma.append(estimate.sigma)
    steady = model.filter.stacked(state.regimes).sigma
    assert 5 < len(sigma) < 200
    assert sigma[4][0] > 1.01 * steady[0]
    assert max(each[0] for each in sigma) == max(sigma[4][0], sigma[5][0]), "it grows as long as nothing is read"
    np.testing.assert_allclose([each[1:] for each in sigma], [steady[1:]] * len(sigma), rtol=1e-3)
    np.testing.assert_allclose(sigma[-1], steady, rtol=0.02)


@pytest.mark.parametrize(("column", "regime", "counts"), [
    (None, Regime.FREE, False), (0, Regime.FREE, True), (1, Regime.FREE, True), (2, Regime.FREE, False),
    (0, Regime.SLACK, True), (1, Regime.SLACK, False), (1, Regime.HELD, True),
])  # fmt: skip
def test_what_is_missing(model: HandModel, column: int | None, regime: Regime, counts: bool) -> None:
    """Joint encoders are read when they come; the load cell of a loose rope says nothing of its tendon."""
    z = np.arange(3.0 * model.tendon_count).reshape(-1, 3)
    if column is not None:
        z[-1, column] = np.nan
    filters = model.filter.stacked((int(Regime.FREE),) * (model.tendon_count - 1) + (int(regime),))
    assert covariance.missing(filters, z.ravel()) is counts


def test_a_tendon_whose_regime_changes_begins_with_the_steady_covariance(model: HandModel) -> None:
    regimes = (int(Regime.FREE),) * model.tendon_count
    spread = model.filter.spread(regimes)
    worth = covariance.update(spread, None, np.full(3 * model.tendon_count, np.nan))
    P = covariance.carried(spread, worth.after, [1], 5)
    assert P is not None
    np.testing.assert_array_equal(P[1], spread.P[1])
    once = covariance.carried(spread, worth.after, [], 1)
    assert once is not None
    assert P[0, X, X] > once[0, X, X] > spread.P[0, X, X], "what is not read is known less with every period"
    again = covariance.update(spread, P, np.zeros(3 * model.tendon_count)).gain
    first = covariance.update(spread, None, np.zeros(3 * model.tendon_count)).gain
    np.testing.assert_allclose(again[1], first[1])
    assert again[0, X, 0] > first[0, X, 0], "and a reading is believed more"


@pytest.mark.parametrize(("missed", "predicted_s"), [(1, None), (4, None), (10_000, 0.05)])
def test_over_ticks_that_were_skipped_less_is_known(model: HandModel, missed: int, predicted_s: float | None) -> None:
    """For as long as the motors are known to hold what they were told."""
    x, force = resting(model, 25.0, 0.6)
    measured, none = readings(model, x, force), np.zeros(model.tendon_count)
    state = all_in(model, Regime.FREE, x)
    after, _ = estimator.step(model, state, measured, force, none, nowhere(model), missed=missed)
    assert set(after.regimes) == {Regime.FREE}
    spread = model.filter.spread(after.regimes)
    P = covariance.update(spread, None, np.zeros(3 * model.tendon_count)).after
    for _ in range(1 + (missed if predicted_s is None else round(predicted_s / model.period))):
        P = spread.F @ P @ spread.F.transpose(0, 2, 1) + spread.Q
    assert after.covariance is not None
    np.testing.assert_allclose(after.covariance, P, rtol=1e-9, atol=1e-30)


def test_a_second_filter_agrees_over_gaps(model: HandModel) -> None:
    """Tendon by tendon, in plain loops; a measurement that is missing is no row of the update."""
    rng, n = np.random.default_rng(3), model.tendon_count
    x, force = resting(model, 25.0, 0.6)
    state, second = all_in(model, Regime.FREE, x), x.copy()
    blocks = [blocks[Regime.FREE] for blocks in model.filter.blocks]
    P = [block.P.copy() for block in blocks]
    compared = 0
    for _ in range(300):
        z = np.column_stack((x[:, X], np.full(n, 25.0), x[:, S]))
        z += rng.normal(size=(n, 3)) * [1e-7, 0.02, 1e-6]
        z[rng.random((n, 3)) < 0.15] = np.nan
        push = force + 0.1 * rng.normal(size=n)
        state, _ = step(model, state, Measured(*z.T, nothing_read(model).joints), push, nowhere(model))
        if set(state.regimes) != {Regime.FREE}:
            break
        for i, block in enumerate(blocks):
            H, here = assumed_measurements(block, Regime.FREE), ~np.isnan(z[i, :2])
            H, R = H[here], np.diag(block.R[here])
            gain = np.linalg.solve(H @ P[i] @ H.T + R, H @ P[i]).T
            gain[E] = 0.0
            P[i] = (np.eye(STATES) - gain @ H) @ P[i] @ (np.eye(STATES) - gain @ H).T + gain @ R @ gain.T
            P[i] = block.F @ P[i] @ block.F.T + block.Q
            innovation = z[i] - block.H @ second[i]
            read = 0.0 if np.isnan(z[i, 2]) else innovation[2]
            second[i] = second[i] + gain @ innovation[:2][here] + block.K[:, 2] * read
            second[i] = block.F @ second[i] + block.B @ [push[i], 0.0]
        if state.covariance is None:
            P = [block.P.copy() for block in blocks]
        np.testing.assert_allclose(state.x.reshape(n, -1) / SCALE, second / SCALE, rtol=1e-7, atol=1e-7)
        compared += 1
    assert compared > 50
