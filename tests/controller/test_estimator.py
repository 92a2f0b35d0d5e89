"""The tension filter in motion: consistent with its own model, predicting what is missing, and honest about regimes."""

import tomllib
from typing import NamedTuple

import numpy as np
import pytest

from handctl.controller import estimator
from handctl.controller.estimator import Estimate, Measured
from handctl.controller.filter_design import MEASUREMENTS, STATES, E, O, Regime, S, V, X
from handctl.controller.filter_state import FilterState
from handctl.controller.gains import Gains
from handctl.controller.model import HandModel
from handctl.controller.statics import load_statics
from handctl.controller.take_up import SLACK_TICKS, TAUT_ABOVE_N
from handctl.hand.description import hand_from, hand_path
from tests.controller.oracle import SCALE, measurement_noise, over_one_period
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


def resting(model: HandModel, tension: float, closed: float) -> tuple[np.ndarray, np.ndarray]:
    """State (N, 7) of a hand at rest with all joints at ``closed`` [rad], and the motor forces that hold it there."""
    x = np.zeros((model.tendon_count, STATES))
    x[:, S] = model.hand.moment_arms @ np.full(len(model.hand.joints), closed)
    x[:, X] = x[:, S] + tension / model.space.stiffness
    return x, np.full(model.tendon_count, tension)


def step(
    model: HandModel, state: FilterState, measured: Measured, force: np.ndarray, contact: tuple[bool, ...]
) -> tuple[FilterState, Estimate]:
    """A tick in which no change of tension is intended."""
    return estimator.step(model, state, measured, force, np.zeros(model.tendon_count), contact)


class Course(NamedTuple):
    """What a run of the filter came to, after it settled: (ticks, N) each."""

    error: np.ndarray
    sigma: np.ndarray
    innovation: np.ndarray
    nis: np.ndarray
    regimes: set[tuple[int, ...]]


def monte_carlo(model: HandModel, regime: Regime, ticks: int, seed: int) -> Course:
    """Draw a truth from the filter's own model in one regime and let the filter follow it."""
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
    for _ in range(ticks):
        # the motor holds the rope as a controller would, and a plan keeps the tension from walking away
        tension = (tension_rows * truth).sum(axis=1)
        away = truth[:, X] - 40.0 / model.space.stiffness - model.hand.moment_arms.sum(axis=1) * closed
        force = (tension if free else 40.0) - model.space.motor_mass * (40.0 * truth[:, V] + 400.0 * free * away)
        rate = 5.0 * (40.0 - tension)
        z = truth @ model.filter.blocks[0][regime].H.T
        z[:, 1] = tension
        z += sigma * rng.normal(size=(n, MEASUREMENTS))
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


def readings(model: HandModel, x: np.ndarray, tension: np.ndarray, excursion: bool = False) -> Measured:
    """What noiseless sensors read of a state (N, 7) with these tensions; joint encoders only if asked."""
    return nothing_read(model)._replace(
        travel=x[:, X].copy(),
        tension=tension,
        excursion=x[:, S] if excursion else np.full(len(x), np.nan),
    )


def all_in(model: HandModel, regime: Regime, x: np.ndarray) -> FilterState:
    """Every tendon in one regime, digits off their stops."""
    return FilterState.of(x.ravel(), regime, stopped=False)


def nowhere(model: HandModel) -> tuple[bool, ...]:
    """No digit is in contact."""
    return (False,) * len(model.digits)


def test_a_second_filter_agrees_over_gaps(model: HandModel) -> None:
    """Tendon by tendon, in plain loops; a measurement that is missing leaves its innovation out."""
    rng, n = np.random.default_rng(3), model.tendon_count
    x, force = resting(model, 25.0, 0.6)
    state, second = all_in(model, Regime.FREE, x), x.copy()
    compared = 0
    for _ in range(300):
        z = np.column_stack((x[:, X], np.full(n, 25.0), x[:, S]))
        z += rng.normal(size=(n, 3)) * [1e-7, 0.02, 1e-6]
        z[rng.random((n, 3)) < 0.15] = np.nan
        push = force + 0.1 * rng.normal(size=n)
        state, _ = step(model, state, Measured(*z.T, nothing_read(model).joints), push, nowhere(model))
        if set(state.regimes) != {Regime.FREE}:
            break
        for i in range(n):
            block = model.filter.blocks[i][Regime.FREE]
            innovation = np.where(np.isnan(z[i]), 0.0, z[i] - block.H @ second[i])
            second[i] = second[i] + block.K @ innovation
        for i in range(n):
            block = model.filter.blocks[i][Regime.FREE]
            second[i] = block.F @ second[i] + block.B @ [push[i], 0.0]
        np.testing.assert_allclose(state.x.reshape(n, -1) / SCALE, second / SCALE, rtol=1e-7, atol=1e-7)
        compared += 1
    assert compared > 50


def test_without_any_measurement_the_tick_is_a_prediction(model: HandModel) -> None:
    x, force = resting(model, 25.0, 0.6)
    state = all_in(model, Regime.FREE, x)
    after, estimate = step(model, state, nothing_read(model), force, nowhere(model))
    for i, row in enumerate(after.x.reshape(-1, STATES)):
        block = model.filter.blocks[i][Regime.FREE]
        np.testing.assert_allclose(row / SCALE, (block.F @ x[i] + block.B @ [force[i], 0.0]) / SCALE, atol=1e-9)
    assert np.isnan(estimate.innovation).all()
    assert np.isnan(estimate.nis).all()
    assert not np.isnan(estimate.tension).any()


def test_a_lost_frame_of_one_tendon_leaves_the_others_alone(model: HandModel) -> None:
    x, force = resting(model, 25.0, 0.6)
    whole = readings(model, x, np.full(len(x), 26.0))
    holed = whole._replace(tension=whole.tension.copy())
    holed.tension[1] = np.nan
    results = [step(model, all_in(model, Regime.FREE, x), m, force, nowhere(model))[0].x for m in (whole, holed)]
    changed = np.abs(results[0] - results[1]).reshape(-1, STATES).max(axis=1) > 1e-12
    tendons = next(s for s in model.digit_tendons if s.start <= 1 < s.stop)
    assert changed[1]
    assert not changed[[i for i in range(len(x)) if not tendons.start <= i < tendons.stop]].any()


def test_it_starts_when_every_encoder_has_been_read(model: HandModel) -> None:
    n = model.tendon_count
    travel, cell = np.linspace(-3e-3, 2e-3, n), np.zeros(n)
    state, _ = step(model, FilterState.initial(n), readings_of(model, travel, cell), cell, nowhere(model))
    assert not state.started, "not by itself"
    partial = travel.copy()
    partial[n - 1] = np.nan
    assert estimator.start(model, state, partial) == state
    state = estimator.start(model, state, travel)
    assert state.started
    state, estimate = step(model, state, readings_of(model, partial, cell), cell, nowhere(model))
    np.testing.assert_allclose(estimate.travel, travel, atol=1e-6)
    np.testing.assert_allclose(estimate.tension, 0.0, atol=1e-9)


def readings_of(model: HandModel, travel: np.ndarray, cell: np.ndarray) -> Measured:
    return nothing_read(model)._replace(travel=travel, tension=cell)


def test_a_hand_that_is_under_tension_before_its_encoders_speak(model: HandModel) -> None:
    """The sensor node answers at once, a drive only after its registers were read."""
    n = model.tendon_count
    cell, state = np.full(n, 5.0), FilterState.initial(n)
    for _ in range(20):
        state, _ = step(model, state, nothing_read(model)._replace(tension=cell), np.zeros(n), nowhere(model))
    whole = readings_of(model, np.full(n, 2e-3), cell)
    state = estimator.start(model, state, whole.travel)
    for k in range(20):
        state, estimate = step(model, state, whole, cell, nowhere(model))
        assert np.abs(estimate.tension - (cell if k > SLACK_TICKS else cell / 2)).max() < 4.0, k


def rope(model: HandModel, cells: list[float]) -> list[set[int]]:
    """Regimes met while the load cells read a sequence of tensions, the motor standing still."""
    n = model.tendon_count
    x = np.zeros((n, STATES))
    state = all_in(model, Regime.SLACK, x)._replace(stopped=(True,) * n)
    met = []
    for cell in cells:
        measured = readings(model, x, np.full(n, cell))
        state, _ = step(model, state, measured, np.full(n, max(cell, 0.0) if cell == cell else 0.0), nowhere(model))
        met.append(set(state.regimes))
    return met


def test_noise_does_not_end_slack_and_tension_does(model: HandModel) -> None:
    assert rope(model, [2.4, -2.4, 0.0, 2.4, 2.4, -0.3, 0.9, 0.6]) == [{Regime.SLACK}] * 8
    assert rope(model, [TAUT_ABOVE_N + 0.1] * 8)[-1] == {Regime.HELD}, "taut, and the springs hold the digit open"
    assert rope(model, [np.nan] * 20)[-1] == {Regime.SLACK}


def test_a_small_tension_ends_slack_after_a_few_ticks(model: HandModel) -> None:
    """A rope that is wound up slowly is not to be called slack until it bears five standard deviations."""
    met = rope(model, [0.2, 0.9, 1.2, 1.6, 1.7, 1.7])
    assert met[2] == {Regime.SLACK}
    assert Regime.SLACK not in met[-1]


def test_slack_needs_a_few_ticks_in_a_row(model: HandModel) -> None:
    taut = [TAUT_ABOVE_N + 1.0] * 30
    once = rope(model, [*taut, 0.0, *taut[:5], 0.0, *taut[:5]])
    assert Regime.SLACK not in set().union(*once[len(taut) :]), "one low sample is noise"
    assert rope(model, [*taut, *[-0.5] * 60])[-1] == {Regime.SLACK}


def test_becoming_taut_takes_the_tension_from_the_load_cell(model: HandModel) -> None:
    n = model.tendon_count
    x = np.zeros((n, STATES))
    x[:, X] = np.linspace(-2e-3, 2e-3, n)
    state = all_in(model, Regime.SLACK, x)._replace(stopped=(True,) * n)
    cell = np.full(n, 4.0)
    estimates = []
    for _ in range(60):
        state, estimate = step(model, state, readings(model, x, cell), cell, nowhere(model))
        estimates.append(estimate.tension)
        assert ((np.abs(estimate.tension) < 1e-9) | (np.abs(estimate.tension - cell) < 2.0)).all(), "no overshoot"
    np.testing.assert_allclose(estimates[-1], cell, atol=0.5)
    np.testing.assert_allclose(estimate.offset, x[:, X] - cell / model.space.stiffness, atol=1e-5)
    np.testing.assert_allclose(estimate.excursion, 0.0, atol=2e-5)


def test_a_stretch_offset_is_kept(model: HandModel) -> None:
    """A hand that was not commissioned has millimetres of it, and they must not leak into the excursion."""
    n = model.tendon_count
    x, cell = np.zeros((n, STATES)), np.full(n, 4.0)
    x[:, X] = 2e-3
    state = all_in(model, Regime.SLACK, x)._replace(stopped=(True,) * n)
    for _ in range(round(1.5 / model.period)):
        state, estimate = step(model, state, readings(model, x, cell), cell, nowhere(model))
    np.testing.assert_allclose(estimate.excursion, 0.0, atol=2e-6)
    np.testing.assert_allclose(estimate.tension, cell, atol=0.01)


def test_contact_holds_a_digit_without_a_jump(model: HandModel) -> None:
    x, _ = resting(model, 20.0, 0.7)
    n = model.tendon_count
    for _ in range(3):
        balance = load_statics(model, x, x[:, X] - x[:, S]).resistance
        x[:, X] = x[:, S] + balance / model.space.stiffness
    measured = readings(model, x, balance)
    free, before = step(model, all_in(model, Regime.FREE, x), measured, balance, nowhere(model))
    held, after = step(model, all_in(model, Regime.FREE, x), measured, balance, (True,) * len(model.digits))
    assert set(free.regimes) == {Regime.FREE}
    assert set(held.regimes) == {Regime.HELD}
    assert np.abs(after.tension - before.tension).max() < 0.2
    assert np.abs(after.excursion - before.excursion).max() < 1e-6
    for state, contact, measured_now in ((held, (True,), measured), (held, (False,), measured)):
        told, now = step(model, state, measured_now, balance, contact * len(model.digits))
        assert np.abs(now.tension - balance).max() < 0.4
        assert set(told.regimes) == {Regime.HELD if contact[0] else Regime.FREE}
    assert n == len(after.tension)


def test_what_an_object_takes_is_called_external(model: HandModel) -> None:
    """A held digit pulled with more than its springs ask: the rest is contact."""
    x, _ = resting(model, 20.0, 0.7)
    n = model.tendon_count
    asked = load_statics(model, x, np.zeros(n)).resistance
    tension = asked + 10.0
    x[:, X] = x[:, S] + tension / model.space.stiffness
    state = all_in(model, Regime.HELD, x)
    for _ in range(40):
        state, estimate = step(model, state, readings(model, x, tension), tension, (True,) * len(model.digits))
    np.testing.assert_allclose(estimate.external, 10.0, atol=0.5)
    x0, rest = np.zeros((n, STATES)), np.full(n, 4.0)
    x0[:, X] = rest / model.space.stiffness
    state = all_in(model, Regime.HELD, x0)._replace(stopped=(True,) * n)
    state, estimate = step(model, state, readings(model, x0, rest), rest, nowhere(model))
    np.testing.assert_allclose(estimate.external, 0.0, err_msg="the open stop is no contact")


def test_joint_encoders_tell_excursion_from_offset(jamia11: HandModel) -> None:
    """Rope and load cell know only the sum of excursion and offset; the encoders part them."""
    x, _ = resting(jamia11, 20.0, 0.7)
    balance = load_statics(jamia11, x, np.zeros(len(x))).resistance
    x[:, X] = x[:, S] + balance / jamia11.space.stiffness
    ends = {}
    for with_encoders in (False, True):
        wrong = x.copy()
        wrong[:, S] += 2e-5
        wrong[:, O] -= 2e-5
        state = all_in(jamia11, Regime.HELD, wrong)
        for k in range(500):
            measured = readings(jamia11, x, balance, excursion=with_encoders and k % 4 == 0)
            state, estimate = step(jamia11, state, measured, balance, (True,) * len(jamia11.digits))
        ends[with_encoders] = np.abs(estimate.excursion - x[:, S])
    assert (ends[True] < 0.35 * ends[False]).all()


def test_unread_joints_give_no_excursion(jamia11: HandModel, jamia: HandModel) -> None:
    joints = np.full(len(jamia11.hand.joints), 0.3)
    np.testing.assert_allclose(jamia11.excursion_of(joints), jamia11.hand.moment_arms @ joints)
    joints[1] = np.nan
    unread = np.isnan(jamia11.excursion_of(joints))
    assert unread.tolist() == (jamia11.hand.moment_arms[:, 1] != 0).tolist()
    assert np.isnan(jamia.excursion_of(np.full(len(jamia.hand.joints), np.nan))).all()


def test_neither_state_nor_measurements_are_changed(model: HandModel) -> None:
    x, force = resting(model, 25.0, 0.6)
    state, measured = all_in(model, Regime.FREE, x), readings(model, x, np.full(len(x), 0.2))
    copies = [state.x.copy(), measured.travel.copy(), measured.tension.copy(), force.copy()]
    first = step(model, state, measured, force, nowhere(model))[0]
    second = step(model, state, measured, force, nowhere(model))[0]
    for now, before in zip((state.x, measured.travel, measured.tension, force), copies, strict=True):
        np.testing.assert_array_equal(now, before)
    np.testing.assert_array_equal(first.x, second.x)
    assert first.regimes == second.regimes


def test_a_digit_held_just_above_its_stop_is_not_on_it(model: HandModel) -> None:
    """Friction holds it there; taken for stopped, each return made its angle wrong by a little more."""
    x = np.zeros((model.tendon_count, STATES))
    x[:, S] = 1e-5
    cell = 0.9 * load_statics(model, x, np.zeros(len(x))).resistance
    x[:, X] = x[:, S] + cell / model.space.stiffness
    state, _ = step(model, all_in(model, Regime.FREE, x), readings(model, x, cell), cell, nowhere(model))
    assert not any(state.stopped)
