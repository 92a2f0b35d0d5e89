"""Compare the simulated tendon and its pulleys with the formulas of the model.

The tests compute the formulas of the model with their own code.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.description.hand_description import TendonSpec, load_hand
from firmware_sim.plant.drivetrain import step_drivetrain, tensions
from firmware_sim.plant.motor import Motor
from firmware_sim.plant.tendon import TendonRouting

JAMIA_HAND = load_hand("jamia")
TENDON_SPEC = JAMIA_HAND.tendons[0]
INDEX_JOINTS = ["index_j1", "index_j2", "index_j3"]
REST_ANGLES_RAD = [0.0, 0.0, 0.0]


class TendonOnSpool:
    """One simulated tendon on its spool."""

    def __init__(self, spec: TendonSpec = TENDON_SPEC) -> None:
        routing = TendonRouting([spec], INDEX_JOINTS, [spec.motor], [0.005], is_compiled=False)
        self.motor, (self.row,) = Motor(JAMIA_HAND.motors[0], 0.5e-3), routing.tendons
        self.parts = routing.rows, routing.joints, routing.arms, [self.motor]

    def elastic_tension(self, stretch: float) -> float:
        return self.tension_at(REST_ANGLES_RAD, REST_ANGLES_RAD, stretch / 0.005, 0.0)

    def tension_at(self, q: list[float], dq: list[float], theta: float, omega: float) -> float:
        self.motor.theta, self.motor.omega = theta, omega
        out = [0.0]
        tensions(*self.parts, q, dq, out)
        return out[0]

    def step_tension(
        self, q: list[float], dq: list[float], theta: float, omega: float, torque: list[float]
    ) -> float:
        """Compute one simulation step of the tendon, and return its tension.

        Write the torques of the pulleys to ``torque``. The simulator adds a torque that compensates
        the damping of the physics engine. The function subtracts this torque.
        """
        self.motor.theta, self.motor.omega = theta, omega
        self.motor.steps_alone, total = True, [0.0] * 3
        step_drivetrain(*self.parts, q, dq, total, [0.0], False)
        tension_rate = self.row.slope * self.row.speed
        torque[:] = [
            earlier_torque + total_torque - 0.003 * tension_rate
            for earlier_torque, total_torque in zip(torque, total, strict=True)
        ]
        return self.row.tension


def make_tendon() -> TendonOnSpool:
    return TendonOnSpool()


def test_linear_up_to_the_knee_then_softer_without_a_kink() -> None:
    elastic_tension = make_tendon().elastic_tension
    assert elastic_tension(1e-3) == pytest.approx(100.0)
    assert elastic_tension(2e-3) == pytest.approx(200.0)
    x = np.linspace(0.1e-3, 5e-3, 20001)
    stiffness = np.gradient([elastic_tension(float(value)) for value in x], x)
    assert stiffness[:7000].max() == pytest.approx(1e5, rel=1e-6)
    assert np.abs(np.diff(stiffness)).max() < 200.0, "the stiffness jumps"
    assert stiffness[-1] == pytest.approx(0.4e5, rel=1e-3)
    # Above a tension of 200 N, the tendon is softer. If a tendon with a tension of 200 N is
    # stretched further by x, its tension is 200 + k2 x + (k - k2) w (1 - exp(-x/w)). In this test,
    # x is 1 mm.
    assert elastic_tension(3e-3) == pytest.approx(
        200.0 + 40.0 + 6e4 * 0.3e-3 * (1 - math.exp(-1 / 0.3))
    )


@given(
    st.floats(-3.0, 3.0),
    st.floats(-60.0, 60.0),
    st.lists(st.floats(-0.2, 1.8), min_size=3, max_size=3),
)
def test_a_tendon_never_pushes(theta: float, omega: float, q: list[float]) -> None:
    torque = [0.0] * 3
    tendon = make_tendon()
    tension = tendon.step_tension(q, REST_ANGLES_RAD, theta, omega, torque)
    assert tension >= 0.0
    assert tension == tendon.tension_at(q, REST_ANGLES_RAD, theta, omega)
    assert min(torque) >= 0.0
    if 0.005 * theta < 0.003 * sum(q):
        assert tension == 0.0
        assert torque == [0.0] * 3


def test_damping_does_not_push_when_the_tendon_goes_slack() -> None:
    torque = [0.0] * 3
    assert make_tendon().step_tension(REST_ANGLES_RAD, REST_ANGLES_RAD, 0.01, -50.0, torque) == 0.0
    assert torque == [0.0] * 3


def test_at_rest_every_pulley_has_the_tension_of_the_load_cell() -> None:
    torque = [0.0] * 3
    tension = make_tendon().step_tension([0.3, 0.2, 0.1], REST_ANGLES_RAD, 0.5, 0.0, torque)
    stretch = 0.005 * 0.5 - 0.003 * 0.6
    assert tension == pytest.approx(1e5 * stretch)
    assert torque == pytest.approx([0.003 * tension] * 3)


@pytest.mark.parametrize(("spool_speed", "motion_sign"), [(10.0, 1.0), (-10.0, -1.0)])
def test_capstan_ratio_from_pulley_to_pulley(spool_speed: float, motion_sign: float) -> None:
    q, torque = [0.4, 0.5, 0.6], [0.0] * 3
    tendon = make_tendon()
    tension = tendon.step_tension(q, [spool_speed, 0.0, 0.0], 1.0, 6.0 * motion_sign, torque)
    angles = math.pi / 2 + np.cumsum(q)
    assert np.array(torque) / 0.003 / tension == pytest.approx(
        np.exp(-motion_sign * 0.08 * angles), rel=1e-5
    )
    loads = [torque[1] / torque[0], torque[2] / torque[1]]
    assert loads == pytest.approx(
        [math.exp(-motion_sign * 0.08 * 0.5), math.exp(-motion_sign * 0.08 * 0.6)], rel=1e-5
    )


def test_friction_grows_with_speed_as_tanh() -> None:
    q, torque = [0.0, 0.0, 0.0], [0.0] * 3
    tension = make_tendon().step_tension(q, [0.5e-3 / 0.003, 0.0, 0.0], 0.2, 0.0, torque)
    assert torque[0] / 0.003 == pytest.approx(
        tension * math.exp(-0.08 * math.pi / 2 * math.tanh(0.5)), rel=1e-3
    )


@given(st.floats(-0.2, 0.2), st.lists(st.floats(0.0, 1.7), min_size=3, max_size=3))
def test_friction_dissipates_energy_and_the_slope_matches(
    spool_speed: float, q: list[float]
) -> None:
    """The friction of a tendon never adds power to its motion.

    At each pulley, friction changes the tension by at most ``slope`` times the spool speed.
    """
    dq = [spool_speed / 0.009] * 3
    torque = [0.0] * 3
    tendon = make_tendon()
    theta = (0.003 * sum(q) + 0.3e-3) / 0.005
    tension = tendon.step_tension(q, dq, theta, spool_speed / 0.005, torque)
    power = sum(t * v for t, v in zip(torque, dq, strict=True)) - tension * spool_speed
    assert power <= 1e-9
    largest_tension_change = max(abs(0.003 * tension - t) / 0.003 for t in torque)
    assert tendon.row.slope * abs(spool_speed) >= largest_tension_change - 1e-6


def test_slope_is_continuous_at_zero_speed() -> None:
    slopes = []
    for speed in (0.99e-6, 1.01e-6):
        tendon = make_tendon()
        tendon.step_tension([0.2] * 3, [speed / 0.009] * 3, 0.6, 0.0, [0.0] * 3)
        slopes.append(tendon.row.slope)
    assert slopes[0] == pytest.approx(slopes[1], rel=2e-3)
