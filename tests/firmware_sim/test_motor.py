"""Compare the motion of the simulated rotor with closed-form solutions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_sim.description.hand_description import load_hand
from firmware_sim.plant.drivetrain import COULOMB_SPEED_RAD_PER_S, ENCODER_STEP_RAD
from firmware_sim.plant.motor import CURRENT_LAG_S, Motor

MOTOR_SPEC = load_hand("jamia").motors[0]
FRICTIONLESS_SPEC = replace(MOTOR_SPEC, coulomb=0.0, viscous=0.0)
STEP_S = 0.5e-3


def spin_motor(motor: Motor, duration_s: float, load_torque: float = 0.0) -> None:
    for _ in range(round(duration_s / STEP_S)):
        motor.advance(load_torque)


def test_constant_torque_gives_constant_acceleration_after_the_current_lag() -> None:
    motor = Motor(FRICTIONLESS_SPEC, STEP_S)
    motor.servo.torque, motor.servo.limit = 0.02, 1.0
    spin_motor(motor, 0.5)
    exact_value = 0.02 / MOTOR_SPEC.inertia * (0.5 - CURRENT_LAG_S)
    assert motor.omega == pytest.approx(exact_value, rel=1e-3)
    assert motor.theta == pytest.approx(exact_value * 0.5 / 2, rel=2e-3)


def test_viscous_friction_sets_the_final_speed() -> None:
    motor = Motor(replace(MOTOR_SPEC, coulomb=0.0), STEP_S)
    motor.servo.torque, motor.servo.limit = 0.02, 1.0
    spin_motor(motor, 2.0)
    assert motor.omega == pytest.approx(0.02 / MOTOR_SPEC.viscous, rel=1e-5)


@pytest.mark.parametrize("torque_sign", [1.0, -1.0])
def test_a_rotor_creeps_below_coulomb_friction_and_accelerates_above(torque_sign: float) -> None:
    motor = Motor(replace(MOTOR_SPEC, viscous=0.0), STEP_S)
    motor.servo.torque, motor.servo.limit = torque_sign * 0.5 * MOTOR_SPEC.coulomb, 1.0
    spin_motor(motor, 0.5)
    assert motor.omega == pytest.approx(
        torque_sign * COULOMB_SPEED_RAD_PER_S * math.atanh(0.5), rel=1e-6
    )
    motor = Motor(replace(MOTOR_SPEC, viscous=0.0), STEP_S)
    motor.servo.torque, motor.servo.limit = torque_sign * 2.0 * MOTOR_SPEC.coulomb, 1.0
    spin_motor(motor, 0.5)
    assert motor.omega == pytest.approx(
        torque_sign * MOTOR_SPEC.coulomb / MOTOR_SPEC.inertia * 0.5, rel=0.01
    )


def test_friction_stops_a_fast_rotor_without_reversing_it() -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    motor.omega = 10.0
    speeds = []
    for _ in range(2000):
        motor.advance(0.0)
        speeds.append(motor.omega)
    assert min(speeds) >= 0.0
    assert speeds[-1] < 1e-6
    # A rotor with inertia J and initial speed w comes to rest after t = J/b ln(1 + b w / tau_c).
    # In this formula, tau_c is the Coulomb friction, and b is the viscous friction.
    exact_value = (
        MOTOR_SPEC.inertia
        / MOTOR_SPEC.viscous
        * math.log(1 + MOTOR_SPEC.viscous * 10.0 / MOTOR_SPEC.coulomb)
    )
    assert np.argmax(np.array(speeds) < COULOMB_SPEED_RAD_PER_S) * STEP_S == pytest.approx(
        exact_value, rel=0.05
    )


def test_the_current_follows_with_its_lag() -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    motor.servo.torque, motor.servo.limit = 0.5, 1.0
    motor.advance(0.0)
    assert motor.torque == pytest.approx(0.5 * (1 - math.exp(-STEP_S / CURRENT_LAG_S)))


def test_the_torque_stays_within_the_limit() -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    motor.servo.kp, motor.servo.position, motor.servo.limit = 500.0, 100.0, 0.8
    for _ in range(200):
        motor.advance(0.0)
        assert abs(motor.torque) <= 0.8
    motor.servo.position = -100.0
    for _ in range(200):
        motor.advance(0.0)
        assert abs(motor.torque) <= 0.8


@pytest.mark.parametrize(("kp", "kd"), [(5.0, 0.05), (500.0, 5.0), (0.5, 5.0)])
def test_gains_of_the_whole_range_are_stable(kp: float, kd: float) -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    servo = motor.servo
    servo.kp, servo.kd, servo.position, servo.limit = kp, kd, 0.5, 1.25
    spin_motor(motor, 2.0)
    theta_before = motor.theta
    spin_motor(motor, 0.05)
    assert abs(motor.omega) < 2.0
    assert abs(motor.theta - theta_before) < 0.02


@pytest.mark.parametrize("target_speed", [4.0, -15.0])
def test_a_moving_target_is_followed_as_a_mass_on_a_spring(target_speed: float) -> None:
    """In this test, a rotor starts at rest and follows a target that moves with constant speed.

    The position error e of the rotor obeys J e'' + kd e' + kp e = 0, with the inertia J and the
    gains kp and kd.
    """
    kp, kd, step_s = 0.5, 0.004, 1e-5
    motor = Motor(FRICTIONLESS_SPEC, step_s)
    servo = motor.servo
    servo.kp, servo.kd, servo.velocity, servo.target_speed, servo.limit = (
        kp,
        kd,
        target_speed,
        target_speed,
        100.0,
    )
    decay_rate = 0.5 * kd / MOTOR_SPEC.inertia
    omega = math.sqrt(kp / MOTOR_SPEC.inertia - decay_rate**2)
    largest = 0.0
    for k in range(1, 10001):
        motor.advance(0.0)
        # The motor current follows the command with a lag.
        t = k * step_s - CURRENT_LAG_S
        exact_value = target_speed / omega * math.exp(-decay_rate * t) * math.sin(omega * t)
        error = target_speed * k * step_s - motor.theta
        assert servo.position == pytest.approx(target_speed * k * step_s, rel=1e-9)
        if k > 500:
            largest = max(largest, abs(error - exact_value))
    assert largest < 0.05 * abs(target_speed) / omega + ENCODER_STEP_RAD
    assert abs(target_speed) / omega > 10.0 * ENCODER_STEP_RAD


def test_a_fixed_target_does_not_move() -> None:
    motor = Motor(FRICTIONLESS_SPEC, STEP_S)
    servo = motor.servo
    servo.kp, servo.kd, servo.position, servo.velocity, servo.limit = 0.5, 0.004, 0.3, 5.0, 1.0
    spin_motor(motor, 0.1)
    assert servo.position == 0.3
    servo.target_speed = 5.0
    servo.release()
    spin_motor(motor, 0.1)
    assert servo.position == 0.0


def test_a_released_servo_makes_no_torque() -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    servo = motor.servo
    servo.kp, servo.kd, servo.position, servo.torque, servo.limit = 5.0, 0.1, 1.0, 0.3, 1.0
    spin_motor(motor, 0.1)
    servo.release()
    spin_motor(motor, 0.02)
    assert abs(motor.torque) < 1e-12


def test_the_torque_gain_changes_the_true_torque_only() -> None:
    motor_with_gain, plain_motor = (
        Motor(replace(FRICTIONLESS_SPEC, torque_gain=1.2), STEP_S),
        Motor(FRICTIONLESS_SPEC, STEP_S),
    )
    for motor in (motor_with_gain, plain_motor):
        motor.servo.torque, motor.servo.limit = 0.05, 1.0
        spin_motor(motor, 0.1)
    assert motor_with_gain.torque == plain_motor.torque
    assert motor_with_gain.omega == pytest.approx(1.2 * plain_motor.omega)


def test_heat_is_torque_squared_over_time() -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    motor.servo.torque, motor.servo.limit = 0.5, 1.0
    spin_motor(motor, 1.0, load_torque=0.5)
    assert motor.heat == pytest.approx(0.25, rel=2e-3)


def test_the_encoder_has_fourteen_bits() -> None:
    motor = Motor(MOTOR_SPEC, STEP_S)
    for theta in np.linspace(-3, 3, 1000):
        motor.theta = float(theta)
        assert 0.0 <= motor.theta - motor.encoder() < ENCODER_STEP_RAD
    assert pytest.approx(2 * math.pi / 16384) == ENCODER_STEP_RAD


@pytest.mark.parametrize("torque", [-0.03, 0.045])
def test_friction_does_not_add_inertia(torque: float) -> None:
    """At any speed, the acceleration of a turning rotor is (torque - friction) / inertia."""
    motor = Motor(replace(MOTOR_SPEC, viscous=0.0), STEP_S)
    motor.omega, motor.torque = 2.0, torque
    motor.servo.torque, motor.servo.limit = torque, 1.0
    spin_motor(motor, 0.005)
    assert (motor.omega - 2.0) / 0.005 == pytest.approx(
        (torque - MOTOR_SPEC.coulomb) / MOTOR_SPEC.inertia, rel=1e-3
    )


def test_friction_stops_a_slow_rotor_without_reversing_it() -> None:
    for start in np.linspace(0.005, 0.5, 100):
        motor = Motor(MOTOR_SPEC, STEP_S)
        motor.omega = float(start)
        spin_motor(motor, 0.02)
        assert -1e-3 <= motor.omega <= 1e-3 + 0.2 * start
