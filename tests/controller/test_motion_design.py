"""Test that the LQR gains make the motion loop and the tension loop stable.

The motion loop and the tension loop have the stability margins of an LQR, as far as the control
rate permits.
"""

import numpy as np
import pytest
from scipy.signal import cont2discrete

from handctl.core.gains.gains import Gains, MotionGains, TensionGains
from handctl.core.gains.motion_design import design_motion
from handctl.core.hand_model import HandModel

CONTROL_RATES_HZ = [200.0, 500.0, 1000.0]


def motion_plant(mass_kg: float, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the discrete model of a mass on which a force acts.

    The states of the model are the excursion [m] and its rate [m/s].
    """
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0 / mass_kg]])
    F, G, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), period_s)
    return F, G


def tension_plant(
    model: HandModel, tendon_index: int, period_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the discrete model of a rotor that winds a tendon with a fixed far end.

    The states of the model are tension [N] and speed [m/s].
    """
    space = model.tendon_constants
    m, k, c = (
        space.motor_mass[tendon_index],
        space.stiffness[tendon_index],
        space.damping[tendon_index] + space.motor_damping[tendon_index],
    )
    A, B = np.array([[0.0, k], [-1.0 / m, -c / m]]), np.array([[0.0], [1.0 / m]])
    F, G, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), period_s)
    return F, G


def control_loops(
    model: HandModel, gains: Gains, period_s: float
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the matrices (F, G, K) of the motion loop and the tension loop, for the first and the last tendon.

    F and G describe the plant, and the control law is: force = -K state.
    """
    design, control_loops_of_motion = design_motion(model.tendon_constants, gains, period_s), []
    for i in (0, model.tendon_count - 1):
        mass = model.tendon_constants.motor_mass[i] + model.tendon_constants.load_mass[i]
        K = np.array([[design.stiffness[i] * mass, design.damping[i] * mass]])
        control_loops_of_motion.append((*motion_plant(mass, period_s), K))
        control_loops_of_motion.append(
            (
                *tension_plant(model, i, period_s),
                np.array([[design.tension[i], design.tension_speed[i]]]),
            )
        )
    return control_loops_of_motion


def spectral_radius(transition: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(transition)).max())


@pytest.mark.parametrize("rate_hz", CONTROL_RATES_HZ)
def test_both_loops_are_stable_with_margins(model: HandModel, rate_hz: float) -> None:
    """The motion loop and the tension loop stay stable if their gains are multiplied by 0.5 or by 1.5.

    The phase margin of both control loops at each gain crossover is above 30 degrees.
    """
    for F, G, K in control_loops(model, Gains(), 1.0 / rate_hz):
        for factor in (0.5, 1.0, 1.5):
            assert spectral_radius(F - factor * G @ K) < 1.0
        w = np.linspace(1e-3, np.pi, 4000)
        z = np.exp(1j * w)
        turn = np.array([(K @ np.linalg.solve(z_value * np.eye(2) - F, G))[0, 0] for z_value in z])
        assert np.abs(1.0 + turn).min() > 0.4, "distance of the open loop from -1"
        gain_crossings = np.flatnonzero(np.diff(np.sign(np.abs(turn) - 1.0)))
        lag = np.degrees(np.pi - np.abs(np.angle(turn[gain_crossings])))
        assert len(gain_crossings)
        assert lag.min() > 30.0


@pytest.mark.parametrize("rate_hz", [50.0, 100.0])
def test_slow_rates_are_stable_too(model: HandModel, rate_hz: float) -> None:
    """The motion loop and the tension loop stay stable at a control rate near the natural frequency of a tendon.

    At a low control rate, the stability margins of the control loops are smaller than those of an
    LQR.
    """
    for F, G, K in control_loops(model, Gains(), 1.0 / rate_hz):
        assert spectral_radius(F - G @ K) < 1.0


@pytest.mark.parametrize("rate_hz", CONTROL_RATES_HZ)
def test_the_gains_are_optimal(model: HandModel, rate_hz: float) -> None:
    """Small changes of the LQR gains do not reduce the LQR cost of a motion from any of several initial states.

    The LQR cost of a motion is summed over the ticks of the motion.
    """
    gains, force_weight_fraction = Gains(), min(1.0, (rate_hz / 500.0) ** 0.5)
    weights = [
        (
            gains.motion.position_error_m,
            gains.motion.speed_error_m_s,
            force_weight_fraction * gains.motion.force_N,
        ),
        (
            gains.tension.tension_error_N,
            gains.tension.speed_error_m_s,
            force_weight_fraction * gains.tension.force_N,
        ),
    ]

    def lqr_cost(
        F: np.ndarray, G: np.ndarray, K: np.ndarray, weight: tuple[float, float, float]
    ) -> float:
        closed_loop = F - G @ K
        stage = np.diag([1 / weight[0] ** 2, 1 / weight[1] ** 2]) + K.T @ K / weight[2] ** 2
        total, power = np.zeros((2, 2)), np.eye(2)
        for _ in range(6000):
            total += power.T @ stage @ power
            power = closed_loop @ power
            if np.abs(power).max() < 1e-9:
                break
        scale = np.diag(weight[:2])
        return float(np.trace(scale @ total @ scale))

    for which, (F, G, K) in enumerate(control_loops(model, gains, 1.0 / rate_hz)[:2]):
        best = lqr_cost(F, G, K, weights[which])
        for change in ((1.02, 1.0), (0.98, 1.0), (1.0, 1.02), (1.0, 0.98)):
            assert lqr_cost(F, G, K * np.array(change), weights[which]) > best


def test_each_weight_changes_the_gain_of_its_name(jamia: HandModel) -> None:
    period = jamia.period
    default_design = design_motion(jamia.tendon_constants, Gains(), period)
    design_with_small_position_error = design_motion(
        jamia.tendon_constants, Gains(motion=MotionGains(position_error_m=2e-4)), period
    )
    gentle_design = design_motion(
        jamia.tendon_constants, Gains(motion=MotionGains(force_N=5.0)), period
    )
    assert (design_with_small_position_error.stiffness > default_design.stiffness).all()
    assert (gentle_design.stiffness < default_design.stiffness).all()
    design_with_small_tension_error = design_motion(
        jamia.tendon_constants, Gains(tension=TensionGains(tension_error_N=1.0)), period
    )
    assert (design_with_small_tension_error.tension > default_design.tension).all()
    assert (default_design.damping > 0).all()
    assert (default_design.tension_speed > 0).all()
