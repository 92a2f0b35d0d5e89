"""What safety remembers: residuals, readings that stand, jumps, counts, ropes; each against a case made by hand."""

from statistics import NormalDist

import numpy as np
import pytest

from handctl.safety.detectors import counts, residuals, ropes
from handctl.safety.detectors.residuals import Filtered, Rope, Rotor
from handctl.safety.faults.node import DISOBEYED_N
from handctl.safety.faults.tendon import FRICTION_WARN_N, RESIDUAL_WARN_N

T = 0.002
ROTOR: Rotor
RNG = np.random.default_rng(1)


@pytest.fixture(autouse=True)
def _rotor():
    """Made for each test: what is made while a module is imported, no mutation test reaches."""
    global ROTOR
    ROTOR = Rotor(np.array([5.2]), np.array([40.0]), np.array([3.0]), T, np.array([T]), T)


def filtered(seconds, tension, force, speed=lambda t: 0.0, asked=None, noise=0.5):
    """A rope's residuals after some time."""
    state = Filtered.initial(1)
    for k in range(round(seconds / T)):
        t = k * T
        made = np.array([force(t)])
        rope = Rope(
            np.array([0.0]), np.array([speed(t)]), np.array([tension(t) + noise * RNG.standard_normal()]), made,
            made if asked is None else np.array([asked(t)]), np.array([np.nan]),
        )  # fmt: skip
        state = residuals.step(ROTOR, state, rope)
    return state


@pytest.mark.parametrize("held", [0.0, 20.0, 100.0])
def test_a_rope_at_rest_leaves_nothing(held):
    state = filtered(2.0, lambda t: held, lambda t: held)
    assert residuals.unexplained(ROTOR, state)[0] == 0.0


def test_inertia_friction_and_damping_are_explained():
    """A rotor that swings by 10 mm/s twice a second, with the friction that the hand file says."""
    w, a = 2 * np.pi * 2.0, 0.01

    def speed(t):
        return a * np.sin(w * t)

    def force(t):
        return 20.0 + 5.2 * a * w * np.cos(w * t) + 40.0 * speed(t) + 3.0 * np.tanh(speed(t) / 1e-3)

    state = filtered(3.0, lambda t: 20.0, force, speed)
    assert residuals.unexplained(ROTOR, state)[0] == 0.0
    assert residuals.friction(state)[0] < 1.0


def test_what_accelerates_a_rotor_is_no_residual():
    """Ten metres a second squared for a tenth of a second: 52 N that the rope does not get."""

    def force(t):
        speed = 10.0 * t
        return 20.0 + 5.2 * 10.0 + 40.0 * speed + 3.0 * np.tanh(speed * 1e3)

    state = filtered(0.1, lambda t: 20.0, force, speed=lambda t: 10.0 * t, noise=0.0)
    assert abs(state.low[residuals.BALANCE][0]) < 0.2
    still = filtered(0.1, lambda t: 20.0, force, noise=0.0)
    assert still.low[residuals.BALANCE][0] > 10.0, "it would be, if the rotor stood"


@pytest.mark.parametrize("drift", [-20.0, 20.0])
def test_a_load_cell_that_is_wrong_is_seen_within_a_second(drift):
    state = filtered(1.0, lambda t: 24.0 + drift, lambda t: 24.0)
    assert residuals.unexplained(ROTOR, state)[0] > 10.0


def test_a_torque_constant_within_its_tolerance_is_no_fault():
    state = filtered(2.0, lambda t: 100.0, lambda t: 109.0)
    assert residuals.unexplained(ROTOR, state)[0] == 0.0


def test_friction_that_has_grown_is_seen_in_motion_only():
    """T09: a motor that needs 8 N more than the file says, turning to and fro for fifteen seconds."""
    w, a = 2 * np.pi, 0.02

    def speed(t):
        return a * np.sin(w * t)

    def force(t):
        return 20.0 + 5.2 * a * w * np.cos(w * t) + 40.0 * speed(t) + 11.0 * np.tanh(speed(t) / 1e-3)

    moving = filtered(15.0, lambda t: 20.0, force, speed)
    assert residuals.friction(moving)[0] > 3.0
    resting = filtered(15.0, lambda t: 20.0, lambda t: 28.0)
    assert residuals.friction(resting)[0] == 0.0


def test_torque_that_is_not_made_is_seen():
    """A motor that lets 24 N go is asked for some 39 N; to be seen within 22 ticks, its way included."""
    state = filtered(20 * T, lambda t: 0.0, lambda t: 0.0, asked=lambda t: 39.0)
    assert state.low[residuals.ASKED][0] > DISOBEYED_N
    state = filtered(0.5, lambda t: 0.0, lambda t: 0.0, asked=lambda t: 14.9)
    assert state.low[residuals.ASKED][0] < DISOBEYED_N


def test_noise_raises_nothing_in_ten_thousand_hours():
    """A load cell of three times the noise, hand at rest: what the filter leaves of it, against the warnings."""
    left = np.concatenate(
        [filtered(1.0, lambda t: 24.0, lambda t: 24.0, noise=1.5).low[residuals.BALANCE] for _ in range(40)]
    )
    chance = 1.0 / (10_000.0 * 3600.0 / T)
    rare = NormalDist(sigma=float(left.std())).inv_cdf(1.0 - chance / 2.0)
    assert 0.5 < rare < 1.5, "the noise was felt"
    assert rare < min(RESIDUAL_WARN_N, FRICTION_WARN_N, DISOBEYED_N)


def test_bits_count_what_was_lost():
    state = counts.Counts()
    for k in range(120):
        state = counts.step(state, (k % 2 == 0, False), (False, False), 0, 0, k, 500.0)
    assert counts.number(state.lost) == (50, 0)
    assert (counts.halved(state.lost[0]), counts.halved(state.lost[1])) == (True, False)
    for k in range(100):
        state = counts.step(state, (False, False), (False, False), 0, 0, k, 500.0)
    assert state == counts.Counts(), "as if nothing had been"


def test_unknown_frames_and_refused_goals_are_forgotten_after_a_second():
    state = counts.step(counts.Counts(), (False,), (False,), 100, 2, 0, 500.0)
    assert (state.unknown, len(state.refused)) == (100.0, 2)
    for k in range(1, 501):
        state = counts.step(state, (False,), (False,), 0, 0, k, 500.0)
    assert state.unknown == pytest.approx(100.0 / np.e, rel=0.01)
    assert state.refused == ()


def test_a_rope_that_was_never_taut_is_not_slack():
    state = ropes.Ropes()
    for _ in range(100):
        state = ropes.step(state, [0.0, 5.0], [5.0, 5.0])
    assert ropes.slack(state, ("a", "b"), T) == ()
    for _ in range(30):
        state = ropes.step(state, [0.0, 0.0], [5.0, 5.0])
    assert ropes.slack(state, ("a", "b"), T) == (("b", 30 * T),)
    assert ropes.slack(ropes.step(state, [0.0, 0.0], [5.0, np.nan]), ("a", "b"), T) == (), "a limp rope may hang"


def test_a_rope_snaps_if_it_was_taut_a_moment_ago():
    taut = ropes.step(ropes.Ropes(), [20.0], [24.0])
    gone = ropes.step(taut, [0.0], [24.0])
    assert ropes.snapped(gone, ("a",), [0.5], [24.0], [0.05], T) == (("a", 0.05),)
    assert ropes.snapped(gone, ("a",), [0.5], [24.0], [0.01], T) == (), "its spool does not run"
    assert ropes.snapped(gone, ("a",), [12.0], [24.0], [0.05], T) == (), "it bears something"
    for _ in range(60):
        gone = ropes.step(gone, [0.0], [24.0])
    assert ropes.snapped(gone, ("a",), [0.5], [24.0], [0.05], T) == (), "taking up a rope that has long been slack"


def test_a_rope_that_is_still_pulled_after_the_cut():
    state = ropes.cut(ropes.Ropes(), [30.0, 30.0], [30.0, 30.0], T)
    for _ in range(50):
        assert ropes.limp(state, ("a", "b"), T) == ()
        state = ropes.cut(state, [29.0, 8.0], [30.0, 30.0], T)
    assert ropes.limp(state, ("a", "b"), T) == (("a", 29.0),)


@pytest.mark.parametrize("speed", [-2e-3, 5e-4, 1e-3, 0.02])
def test_a_tick_takes_its_share_of_the_balance_to_the_last_digits(speed):
    begin = residuals.Filtered.initial(1)._replace(speed=np.array([speed]))
    one, force = np.array([0.0]), np.array([30.0])
    rope = Rope(one, np.array([speed]), np.array([20.0]), force, force, np.array([np.nan]))
    balance = 30.0 - 20.0 - ROTOR.damping[0] * speed - ROTOR.coulomb[0] * np.tanh(speed / 1e-3)
    share = -np.expm1(-T / residuals.SLOW_S)
    found = residuals.step(ROTOR, begin, rope).low[residuals.BALANCE][0]
    assert found == pytest.approx(share * balance, rel=1e-12)


@pytest.mark.parametrize(
    ("speed", "counts"), [(residuals.RUB_SPEED, False), (np.nextafter(residuals.RUB_SPEED, 1.0), True)]
)
def test_friction_is_told_from_beyond_the_speed_at_which_it_is_developed(speed, counts):
    begin = residuals.Filtered.initial(1)._replace(speed=np.array([speed]))
    force = np.array([30.0])
    rope = Rope(np.array([0.0]), np.array([speed]), np.array([20.0]), force, force, np.array([np.nan]))
    assert bool(residuals.step(ROTOR, begin, rope).low[residuals.RUB][0]) == counts
