"""Test the tension residual: the measured tension minus the part that torque, inertia and friction explain.

The expected residuals were computed by hand.
"""

from collections.abc import Callable
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest

from handctl.core.detectors import residuals
from handctl.core.detectors.residuals import (
    BALANCE,
    COMMAND_DIFFERENCE,
    EXCESS_FRICTION,
    FULL_FRICTION_SPEED_M_S,
    RESIDUAL_TIME_CONSTANTS_S,
    TENSION,
)
from handctl.core.tick_types import HandMode
from handctl.safety.faults.node import TORQUE_DIFFERENCE_LIMIT_N
from handctl.safety.faults.tendon import (
    EXCESS_FRICTION_WARN_N,
    EXCESS_TENSION_TRIP_N,
    RESIDUAL_WARN_N,
)
from tests.safety.synthetic_monitor import (
    NOW_NS,
    PERIOD_NS,
    PERIOD_S,
    SyntheticMonitor,
    call_interpreted,
    synthetic_limits,
)

MOTOR_MASS, MOTOR_DAMPING, COULOMB_FRICTION_N = 5.2, 40.0, 3.0
NOISE_RNG = np.random.default_rng(1)
TimeFunction = Callable[[float], float]


class MotorWithTendon(SyntheticMonitor):
    """One motor and its tendon, with residuals that start at zero."""

    def __init__(self, **value_by_field: Any) -> None:
        super().__init__(
            synthetic_limits(1),
            motor_mass=MOTOR_MASS,
            motor_damping=MOTOR_DAMPING,
            coulomb=COULOMB_FRICTION_N,
        )
        self.set_state_values({"residual": 0.0, **value_by_field})

    def run_tick(
        self, tension: float, force: float, speed: float = 0.0, commanded_force: float | None = None
    ) -> None:
        """Run one tick with a measured tension, a reported motor force, a speed and a commanded force."""
        commanded = force if commanded_force is None else commanded_force
        self.tick(speed=speed, measured_tension=tension, measured_force=force, asked=commanded)

    def filtered_residual(self, residual_kind: int) -> float:
        """Return the filtered residual of one kind from the field ``residual``."""
        return float(self.view("residual")[residual_kind, 0])

    @property
    def unexplained_tension(self) -> float:
        """Return the part of the tension that motor, inertia, friction and tolerances leave unexplained [N]."""
        return float(
            call_interpreted(residuals.unexplained_tension, self.state_tables, self.hand_tables, 0)
        )

    @property
    def excess_tension(self) -> float:
        """Return the measured tension minus the largest tension that the motor can explain [N].

        The returned tension is filtered with a time constant of 20 ms.
        """
        return float(
            call_interpreted(residuals.excess_tension, self.state_tables, self.hand_tables, 0)
        )

    @property
    def excess_friction(self) -> float:
        """Return by how much the friction of the motor exceeds the friction of the model [N]."""
        return float(call_interpreted(residuals.excess_friction, self.state_tables, 0))


def residuals_after(
    duration_s: float, tension_at: TimeFunction, force_at: TimeFunction, speed_at: TimeFunction = lambda t: 0.0,
    commanded_force: TimeFunction | None = None,
    noise_N: float = 0.5,
) -> MotorWithTendon:  # fmt: skip
    """Return a motor and its tendon after a simulation of ``duration_s`` seconds.

    The arguments for tension, force and speed are functions of time.
    """
    rotor = MotorWithTendon()
    for k in range(round(duration_s / PERIOD_S)):
        t = k * PERIOD_S
        cell_reading = tension_at(t) + noise_N * NOISE_RNG.standard_normal()
        rotor.run_tick(
            cell_reading,
            force_at(t),
            speed_at(t),
            None if commanded_force is None else commanded_force(t),
        )
    return rotor


@pytest.mark.parametrize("tension_is_held", [0.0, 20.0, 100.0])
def test_a_tendon_at_rest_leaves_no_residual(tension_is_held):
    state = residuals_after(2.0, lambda t: tension_is_held, lambda t: tension_is_held)
    assert state.unexplained_tension == 0.0


def test_inertia_friction_and_damping_are_explained():
    """In this test, the tendon speed oscillates by 10 mm/s at 2 Hz.

    The simulated friction equals the friction in the hand file.
    """
    w, a = 2 * np.pi * 2.0, 0.01

    def speed(t):
        return a * np.sin(w * t)

    def force(t):
        return 20.0 + 5.2 * a * w * np.cos(w * t) + 40.0 * speed(t) + 3.0 * np.tanh(speed(t) / 1e-3)

    state = residuals_after(3.0, lambda t: 20.0, force, speed)
    assert state.unexplained_tension == 0.0
    assert state.excess_friction < 1.0


def test_acceleration_torque_is_no_residual():
    """In this test, a rotor accelerates with 10 m/s2 for 0.1 s.

    The motor needs 52 N of its force to accelerate its rotor. The force that accelerates the rotor
    must not appear in the residual.
    """

    def force(t):
        speed = 10.0 * t
        return 20.0 + 5.2 * 10.0 + 40.0 * speed + 3.0 * np.tanh(speed * 1e3)

    state = residuals_after(0.1, lambda t: 20.0, force, speed_at=lambda t: 10.0 * t, noise_N=0.0)
    assert abs(state.filtered_residual(BALANCE)) < 0.2
    rotor_at_rest = residuals_after(0.1, lambda t: 20.0, force, noise_N=0.0)
    assert rotor_at_rest.filtered_residual(BALANCE) > 10.0, "it would be, if the rotor stood"


@pytest.mark.parametrize("cell_drift_N", [-20.0, 20.0])
def test_a_load_cell_that_is_wrong_is_seen_within_a_second(cell_drift_N):
    state = residuals_after(1.0, lambda t: 24.0 + cell_drift_N, lambda t: 24.0)
    assert state.unexplained_tension > 10.0


@pytest.mark.parametrize(
    ("excess_tension_N", "found"), [(35.0, False), (45.0, True), (-45.0, False)]
)
def test_a_tendon_pulled_much_harder_than_commanded_is_found_within_20_ms(
    excess_tension_N: float, found: bool
) -> None:
    """The output of the filter reaches 63 % of a tension step after 20 ms.

    Friction explains 3 N of the tension, and the tolerance of the torque constant explains 1.5 N. A
    tension that is too small does not count as excess tension.
    """
    state = residuals_after(0.02, lambda t: 24.0 + excess_tension_N, lambda t: 24.0, noise_N=0.0)
    assert (state.excess_tension > EXCESS_TENSION_TRIP_N) == found


def test_the_reading_of_a_saturated_load_cell_is_no_excess_tension() -> None:
    """A saturated load-cell reading does not count as excess tension.

    Otherwise, the fault T04b (a load cell is wrong) would be reported before the fault T06 (a load
    cell is saturated).
    """
    rotor = MotorWithTendon(saturated=1)
    for _ in range(10):
        rotor.run_tick(250.0, 24.0)
    assert rotor.excess_tension == 0.0


def test_a_torque_constant_within_its_tolerance_is_no_fault():
    state = residuals_after(2.0, lambda t: 100.0, lambda t: 109.0)
    assert state.unexplained_tension == 0.0


def test_friction_that_has_grown_is_seen_in_motion_only():
    """In this test, the friction is 8 N higher than in the hand file.

    After 15 s of motion to and fro, the monitor reports the fault T09 (friction has grown).
    """
    w, a = 2 * np.pi, 0.02

    def speed(t):
        return a * np.sin(w * t)

    def force(t):
        return (
            20.0 + 5.2 * a * w * np.cos(w * t) + 40.0 * speed(t) + 11.0 * np.tanh(speed(t) / 1e-3)
        )

    moving_residuals = residuals_after(15.0, lambda t: 20.0, force, speed)
    assert moving_residuals.excess_friction > 3.0
    resting_residuals = residuals_after(15.0, lambda t: 20.0, lambda t: 28.0)
    assert resting_residuals.excess_friction == 0.0


def test_missing_torque_is_detected():
    """If the motor force is 39 N below the command, the limit of a fault is exceeded within 20 ticks.

    If the motor force is 14.9 N below the command, no limit is exceeded.
    """
    state = residuals_after(
        20 * PERIOD_S, lambda t: 0.0, lambda t: 0.0, commanded_force=lambda t: 39.0
    )
    assert state.filtered_residual(COMMAND_DIFFERENCE) > TORQUE_DIFFERENCE_LIMIT_N
    state = residuals_after(0.5, lambda t: 0.0, lambda t: 0.0, commanded_force=lambda t: 14.9)
    assert state.filtered_residual(COMMAND_DIFFERENCE) < TORQUE_DIFFERENCE_LIMIT_N


def test_noise_causes_no_fault_in_ten_thousand_hours():
    """The filtered noise of a hand at rest stays below all warning limits, even with triple load-cell noise."""
    simulated_residuals = np.array(
        [
            residuals_after(1.0, lambda t: 24.0, lambda t: 24.0, noise_N=1.5).filtered_residual(
                BALANCE
            )
            for _ in range(40)
        ]
    )
    chance = 1.0 / (10_000.0 * 3600.0 / PERIOD_S)
    rare_residual_N = NormalDist(sigma=float(simulated_residuals.std())).inv_cdf(1.0 - chance / 2.0)
    assert 0.5 < rare_residual_N < 1.5, "the noise was felt"
    assert rare_residual_N < min(RESIDUAL_WARN_N, EXCESS_FRICTION_WARN_N, TORQUE_DIFFERENCE_LIMIT_N)


def test_losses_of_every_second_reply_are_counted():
    monitor = SyntheticMonitor(synthetic_limits(2))
    for k in range(120):
        findings = monitor.tick(feedback_ns=[NOW_NS - PERIOD_NS * (k % 2 == 0), NOW_NS])
    assert findings["B03a"] == {"m0": 50.0}
    assert findings["N15"] == {"m0": 0.5}
    for _ in range(100):
        findings = monitor.tick(feedback_ns=NOW_NS)
    assert not monitor.view("lost").any(), "as if nothing had been"
    assert findings == {}


def test_unknown_frames_are_forgotten_after_a_second():
    monitor = SyntheticMonitor(synthetic_limits(1))
    assert monitor.tick(strange=100)["B10"] == {"bus": 100.0}
    for _ in range(1, 501):
        monitor.tick(strange=0)
    assert monitor.view("unknown").item() == pytest.approx(100.0 / np.e, rel=0.01)


def test_a_tendon_that_was_never_taut_is_not_slack():
    monitor = SyntheticMonitor(synthetic_limits(2), residual_fraction=0.0)

    def slack_faults(tension, wanted):
        return monitor.tick(residual={TENSION: tension}, wanted=wanted).get("T02a", {})

    for _ in range(100):
        assert slack_faults([0.0, 5.0], [5.0, 5.0]) == {}
    for _ in range(30):
        faults = slack_faults([0.0, 0.0], [5.0, 5.0])
    assert faults == {"t1": 30 * PERIOD_S}
    assert slack_faults([0.0, 0.0], [5.0, np.nan]) == {}, "a limp tendon may hang"


def test_a_tendon_snaps_if_it_was_taut_a_moment_ago():
    def snap_faults_after(ticks, cell=0.5, speed=0.05):
        monitor = SyntheticMonitor(synthetic_limits(1), residual_fraction=0.0)
        monitor.tick(wanted=24.0)
        for _ in range(ticks):
            findings = monitor.tick(
                residual={TENSION: 0.0}, wanted=24.0, measured_tension=cell, speed=speed
            )
        return findings.get("T01", {})

    assert snap_faults_after(1) == {"t0": 0.05}
    assert snap_faults_after(1, speed=0.01) == {}, "its spool does not run"
    assert snap_faults_after(1, cell=12.0) == {}, "it bears something"
    assert snap_faults_after(61) == {}, "taking up a tendon that has long been slack"


def test_a_tendon_still_pulled_after_the_cut_is_detected():
    monitor = SyntheticMonitor(synthetic_limits(2))
    monitor.tick(measured_tension=30.0)
    assert "N16" not in monitor.tick(mode=int(HandMode.CUT), measured_tension=[30.0, 30.0])
    for _ in range(49):
        assert "N16" not in monitor.tick(measured_tension=[29.0, 8.0], measured_force=0.0)
    assert monitor.tick(measured_tension=[29.0, 8.0], measured_force=0.0)["N16"] == {"t0": 29.0}


@pytest.mark.parametrize("spool_speed", [-2e-3, 5e-4, 1e-3, 0.02])
def test_the_residual_filter_takes_the_exact_share_per_tick(spool_speed):
    rotor = MotorWithTendon(last_speed=spool_speed)
    rotor.run_tick(20.0, 30.0, spool_speed)
    balance = (
        30.0 - 20.0 - MOTOR_DAMPING * spool_speed - COULOMB_FRICTION_N * np.tanh(spool_speed / 1e-3)
    )
    filter_gain = -np.expm1(-PERIOD_S / RESIDUAL_TIME_CONSTANTS_S[BALANCE])
    assert rotor.filtered_residual(BALANCE) == pytest.approx(filter_gain * balance, rel=1e-12)


@pytest.mark.parametrize(
    ("spool_speed", "friction_is_judged"),
    [(FULL_FRICTION_SPEED_M_S, False), (np.nextafter(FULL_FRICTION_SPEED_M_S, 1.0), True)],
)
def test_friction_is_judged_above_the_speed_of_full_friction(spool_speed, friction_is_judged):
    rotor = MotorWithTendon(last_speed=spool_speed)
    rotor.run_tick(20.0, 30.0, spool_speed)
    assert bool(rotor.filtered_residual(EXCESS_FRICTION)) == friction_is_judged
