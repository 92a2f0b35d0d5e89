"""Two control laws for a tendon-driven digit: computed torque for a motion, and a tension loop for tension goals.

Motion: inverse dynamics gives the joint torques that the trajectory requires. The tensions f of the
tendons must produce the required joint torques. The motor force u has three parts: the tension f_0
at the load cell, the feedback, and the force for the inertia and friction of the motor.

    f = allocate(M theta_d'' + h(theta_d, theta_d'))    f_0 = f / efficiency
    u = f_0 + (m_m + m_l) (k (s_d - s) + d (s_d' - v))
        + c_i m_m s_d'' + c_f (b_m v + friction(s_d'))
        - c_d disturbance + K_f (f_0 - f_hat)

The tendon excursions are s = R_r theta. If moment arms depend on the joint angles q, the excursions
are s = e(q). The acceleration of the excursions is then s'' = R q'' + R' q'^2. The speed v is the
speed of the tendon at its spool, so the feedback of v damps the rotor, and does not damp the digit.
The gains contain the fractions of inertia (c_i), friction (c_f) and disturbance (c_d) that the
motor force compensates. The mass m_m of the rotor is about twenty times the mass m_l of the finger.
The feedback has to accelerate both the rotor and the finger.

Tension: the tension loop is a state feedback of the tension error and the tendon speed, with a slow
integral. If the digit is expected to follow a trajectory, the speed of the tendon and the force for
the rotor's inertia are fed forward. Source: LQR of ``motion_design``.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import (
    LIMP,
    MOTION,
    NO_TRAJECTORY,
    TENSION,
    follows_streamed_angles,
    is_target_stream_running,
)
from handctl.core.control_law.friction_band import (
    predict_tension_of_moving_tendon,
    update_friction_state,
)
from handctl.core.control_law.null_space import INTEGRAL_LIMIT_N, raise_goals_to_tension_floor
from handctl.core.control_law.servo_commands import (
    begin_servo_commands,
    command_torque_only,
    is_loop_closed_by_drive,
    servo_force,
    write_servo_command,
)
from handctl.core.estimation.blocked_digits import MAX_BLOCKED_EXTRA_TENSION_N
from handctl.core.estimation.filter_types import SLACK_REGIME
from handctl.core.estimation.slack_detection import MAX_SLACK_TENSION_N
from handctl.core.estimation.spool_pair import net_tension_at_spool
from handctl.core.estimation.statics import project_onto_digit_motion, winding_efficiency
from handctl.core.estimation.varying_moment_arms import (
    carrier_excursion,
    joint_excursion,
    moment_arm,
    moment_arm_slope,
    motor_speed,
)
from handctl.core.state_block import StateTables
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED_M_S
from handctl.safety.faults.tendon import SNAP_MIN_COMMAND_N

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MOTOR_FRICTION_SPEED_M_S = 2.5e-3
"""Tendon speed at which motor friction is fully developed [m/s]: 0.5 rad/s of a spool with a radius of 5 mm."""
MAX_UNWINDING_FORCE_FRACTION = 0.3
"""Largest motor force that pays out a tendon, as a fraction of the torque limit.

A motor force of 0.3 times the torque limit can brake a rotor, but cannot throw a tendon off its
spool.
"""
TRIM_DECAY_TIME_S = 0.2
"""Time constant with which the trim, an added motor force, fades after a change of gains [s].

The motion feedback and the tension loop are faster than the decay of the trim, so they can
compensate the decay.
"""
MIN_TRIM_N = 1e-3
"""Smallest trim (added motor force) that is not set to 0 [N].

When the trims of all tendons are smaller than ``MIN_TRIM_N``, all trims are set to 0. A trim of 1
mN is 0.02 torque counts of the drive with the finest torque resolution.
"""
HOLD_MARGIN_N = 1.0
"""Margin [N] by which the tension limit during a hold exceeds the tension at the start of the hold.

The margin of the tension limit is about as large as the error of the estimated tension.
"""
ENVELOPE_ROUNDING_FACTOR = 1.0 - 1e-12
"""Factor on the force envelope of a relaxing hand, so that rounding errors cannot raise a constant envelope."""
SLACK_TAKE_UP_TENSION_N = SNAP_MIN_COMMAND_N
"""Tension with which a stream of tensions takes up a slack tendon if the tension setpoint is lower [N].

With 8 N, a spool of the hand ``n_plus_1`` winds up a slack tendon at 17 mm/s instead of 9 mm/s.
With a higher tension, the spool would be so fast that the fault detectors would report a torn
tendon.
"""
MAX_INTEGRATION_SPEED_M_S = 0.005
INTEGRAL_DECAY_S = 0.02
"""Tendon speed above which a stream does not integrate the tension error [m/s], and decay time of the integral [s]."""
SLACK_TAKE_UP_SPEED_M_S = 0.02
"""Speed of a spool that takes up the slack of its tendon during a motion [m/s].

The take-up speed is so low that the fault detectors do not mistake a slack tendon for a snapped
tendon.
"""
MIN_RELAXED_TENSION_N = 5.0
"""Tendon tension in a relaxed hand that is opened by springs [N]."""


@kernel_helper
def command_zero_torque(x: StateTables, c: ConstantTables) -> None:
    """Command zero torque for every motor.

    The tension setpoints follow the present tensions. When a tension loop begins, its first
    setpoint is thus the present tension.
    """
    begin_servo_commands(x, c)
    for n in range(x.tendon.shape[1]):
        x.tendon[s.TENSION_SETPOINT, n] = x.tendon[s.TENSION, n]
        x.tendon[s.TENSION_INTEGRAL, n] = x.tendon[s.FILTER_INPUT_FORCE, n] = x.tendon[
            s.PLANNED_TENSION, n
        ] = x.tendon[s.PLANNED_TENSION_RATE, n] = 0.0
        x.tendon[s.TRIM_FORCE, n] = x.tendon[s.COMMANDED_TORQUE, n] = 0.0
        x.tendon[s.TENSION_GOAL, n] = x.tendon[s.FRICTION_STATE, n] = math.nan
        x.tendon[s.FRICTION_SLIDER, n] = math.nan
    for j in range(x.joint.shape[1]):
        x.joint[s.JOINT_TORQUE, j] = 0.0
        x.joint[s.Q_GOAL, j] = x.joint[s.DQ_GOAL, j] = math.nan
    x.run_int[s.TRIM_ACTIVE] = x.run_int[s.SAFETY_HOLD_ACTIVE] = 0


@kernel_helper
def update_hold_limits(x: StateTables, c: ConstantTables, hold: bool) -> None:
    """Begin a hold of the hand when the safety monitor demands a hold, and end the hold afterwards.

    During a hold, the limit of each tension is the tension at the beginning of the hold plus
    ``HOLD_MARGIN_N``.

    Args:
        x: state tables.
        c: constants of the hand.
        hold: True if the safety monitor demands the hold.
    """
    if hold and not x.run_int[s.SAFETY_HOLD_ACTIVE]:
        for n in range(x.tendon.shape[1]):
            held_tension = max(x.tendon[s.TENSION, n], c.tendon[h.TENSION_FLOOR, n])
            if c.tendon_int[h.IS_SPOOL_PAIR, n]:
                held_tension = abs(x.tendon[s.TENSION, n])
            x.tendon[s.HOLD_TENSION_LIMIT, n] = held_tension + HOLD_MARGIN_N
    x.run_int[s.SAFETY_HOLD_ACTIVE] = hold


@kernel_helper
def temporary_tension_limits(x: StateTables, c: ConstantTables) -> Vector:
    """Return the temporary tension limit of each tendon [N], shape (N,).

    The temporary limits apply in addition to the limits of the hand file. At the soft temperature
    limit of a drive, the tension limit is the tension ceiling. At the hard temperature limit of a
    drive, the tension limit is the tension floor. Between the soft and the hard temperature limit,
    the tension limit falls linearly. If a digit is blocked, the tension limit is
    ``MAX_BLOCKED_EXTRA_TENSION_N`` above the tension that the trajectory requires. During a hold by
    the safety monitor, the tension limit is ``HOLD_MARGIN_N`` above the tension at the beginning of
    the hold. For a spool pair, the tension limit applies to the net tension in both directions.
    """
    limit = np.full(x.tendon.shape[1], math.inf)
    is_any_drive_warm = False
    for n in range(len(limit)):
        is_any_drive_warm |= x.tendon[s.TEMPERATURE, n] > c.run[h.DERATING_START_TEMPERATURE]
    for n in range(len(limit)):
        if is_any_drive_warm:
            limit[n] = _derated_tension(x, c, n)
        planned_tension = x.tendon[s.PLANNED_TENSION, n]
        if c.tendon_int[h.IS_SPOOL_PAIR, n]:
            planned_tension = abs(planned_tension)
        if x.digit_int[s.IS_BLOCKED, c.tendon_int[h.DIGIT_OF_TENDON, n]] and planned_tension > 0.0:
            limit[n] = min(limit[n], planned_tension + MAX_BLOCKED_EXTRA_TENSION_N)
        if x.run_int[s.SAFETY_HOLD_ACTIVE]:
            limit[n] = min(limit[n], x.tendon[s.HOLD_TENSION_LIMIT, n])
    return limit


@kernel_helper
def _derated_tension(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the largest tension that the temperature of a drive allows [N].

    A drive that reports no temperature counts as cool.
    """
    soft_limit = c.run[h.DERATING_START_TEMPERATURE]
    hard_limit = c.run[h.DERATING_END_TEMPERATURE]
    temperature = x.tendon[s.TEMPERATURE, n]
    if math.isnan(temperature):
        temperature = soft_limit
    fraction = min(max((hard_limit - temperature) / (hard_limit - soft_limit), 0.0), 1.0)
    low = 0.0 if c.tendon_int[h.IS_SPOOL_PAIR, n] else c.tendon[h.TENSION_FLOOR, n]
    high = c.tendon[h.TENSION_CEILING, n]
    return low + fraction * (high - low)


@kernel_helper
def write_motor_torques(
    x: StateTables,
    c: ConstantTables,
    trajectory: Matrix,
    relax_rate: float,
    open_loop: bool,
    elapsed_periods: int,
) -> None:
    """Write the motor torques of the tick, and the state of the control law for the next tick.

    Args:
        x: state tables.
        c: constants of the hand.
        trajectory: (3, J) angles, rates and accelerations of the joints on the trajectories.
        relax_rate: rate at which the envelope (the upper bound of the motor forces) falls while the
            hand relaxes [N/s]. The value is 0 in all modes except the relaxing mode.
        open_loop: True if the motor forces of a relaxing hand are the envelope itself, without
            feedback.
        elapsed_periods: number of control periods since the last tick, which is 1 if no tick was missed.
    """
    begin_servo_commands(x, c)
    limit = temporary_tension_limits(x, c)
    count = x.tendon.shape[1]
    load = np.zeros(count)
    winding_direction, motion_terms, null_space_terms = _motion_force_terms(x, c, trajectory, limit)
    for n in range(count):
        kind = x.tendon_int[s.GOAL_KIND, n]
        _, own_rate, acceleration = _tendon_motion_on_trajectory(c, n, trajectory)
        carried_rate, carried_acceleration = _tendon_motion_by_carriers(c, n, trajectory)
        rate = own_rate + carried_rate
        acceleration += carried_acceleration
        force = 0.0
        x.tendon[s.TENSION_GOAL, n] = math.nan
        setpoint = x.tendon[s.TENSION, n]
        integral = 0.0
        is_drive_controlled = _is_position_controlled_by_drive(x, c, n)
        if kind == MOTION:
            force = _motion_force(
                x, c, n, motion_terms[0, n], motion_terms[1, n], rate, acceleration
            )
            if c.tendon_int[h.IS_REDUNDANT_DIGIT, n]:
                integral = null_space_terms[1, n]
                force += null_space_terms[0, n] + integral
            load[n] = x.tendon[s.REQUIRED_TENSION, n]
        if kind == TENSION:
            force, setpoint, integral = _tension_force(x, c, n, limit[n])
            force += _carrier_feedforward_force(c, n, carried_rate, carried_acceleration)
            load[n] = x.tendon[s.TENSION_GOAL, n] = setpoint
        if kind != LIMP:
            force += x.tendon[s.TRIM_FORCE, n]
        tension_limit = (
            min(limit[n], c.tendon[h.TENSION_CEILING, n]) if is_drive_controlled else limit[n]
        )
        command_force = _limited_force(c, n, force, tension_limit)
        if relax_rate > 0.0:
            command_force = _force_during_relaxation(
                x,
                c,
                n,
                command_force,
                _relaxation_envelope(x, c, n, relax_rate, elapsed_periods),
                open_loop,
            )
        _write_force_for_tension_filter(x, c, n, command_force, carried_acceleration)
        x.tendon[s.COMMANDED_TORQUE, n] = command_force * c.tendon[h.SPOOL_RADIUS, n]
        if is_drive_controlled:
            write_servo_command(x, c, n, own_rate, force - motion_terms[1, n], command_force)
        elif n < x.servo.shape[1]:
            command_torque_only(x, n)
        x.tendon[s.TENSION_SETPOINT, n] = setpoint
        x.tendon[s.TENSION_INTEGRAL, n] = integral
        if kind == MOTION:
            predict_tension_of_moving_tendon(x, c, n, rate, winding_direction[n])
            update_friction_state(x, c, n, winding_direction[n])
        else:
            x.tendon[s.PLANNED_TENSION, n] = x.tendon[s.PLANNED_TENSION_RATE, n] = 0.0
            x.tendon[s.FRICTION_STATE, n] = x.tendon[s.FRICTION_SLIDER, n] = math.nan
    _decay_trim_forces(x, c)
    _write_joint_torques(x, c, trajectory, load)


@kernel_helper
def _limited_force(c: ConstantTables, n: int, force: float, limit: float) -> float:
    """Limit a motor force to the range of the motor and by the tension limit, and return the limited force [N].

    Args:
        c: constants of the hand.
        n: index of the tendon.
        force: motor force [N].
        limit: present tension limit [N].
    """
    force = min(max(force, c.tendon[h.MIN_MOTOR_FORCE, n]), c.tendon[h.MAX_MOTOR_FORCE, n])
    # The largest motor force is the tension limit plus the friction that the motor has to overcome.
    bound = limit + c.tendon[h.MOTOR_COULOMB_FRICTION, n]
    force = min(force, bound)
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        force = max(force, -bound)
    return force


@kernel_helper
def _write_force_for_tension_filter(
    x: StateTables, c: ConstantTables, n: int, force: float, carrier_acceleration: float
) -> None:
    """Write the motor force that the tension filter uses to predict the motion of the rotor.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        force: motor force during the coming control period [N].
        carrier_acceleration: acceleration of the tendon that is caused by the trajectories of the
            digits that carry the tendon's digit [m/s2].
    """
    x.tendon[s.FILTER_INPUT_FORCE, n] = force - _motor_friction(x, c, n, force)
    if c.run_int[h.HAS_CARRIER_ARMS]:
        # The spool travel in the tension filter does not include the motion of carrying digits, so
        # the force for the motion of carrying digits is subtracted.
        x.tendon[s.FILTER_INPUT_FORCE, n] -= c.tendon[h.MOTOR_MASS, n] * carrier_acceleration
        x.tendon[s.FILTER_INPUT_FORCE, n] -= c.tendon[h.MOTOR_DAMPING, n] * carrier_excursion(
            c, n, x.joint[s.DQ]
        )


@kernel_helper
def _write_joint_torques(
    x: StateTables, c: ConstantTables, trajectory: Matrix, load: Vector
) -> None:
    """Write the joint torques of the planned tensions, and the goals of joints that follow a trajectory.

    Args:
        x: state tables.
        c: constants of the hand.
        trajectory: (3, J) angles, rates and accelerations of the joints on the trajectories.
        load: (N,) tensions at the joints [N].
    """
    joints = x.joint.shape[1]
    for j in range(joints):
        x.joint[s.JOINT_TORQUE, j] = 0.0
        x.joint[s.Q_GOAL, j] = x.joint[s.DQ_GOAL, j] = math.nan
    for n in range(len(load)):
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            x.joint[s.JOINT_TORQUE, j] += load[n] * c.tendon_joint_table[h.MOMENT_ARMS, n, j]
            if (
                x.tendon_int[s.GOAL_KIND, n] == MOTION
                and c.tendon_joint_table[h.MOMENT_ARMS, n, j] != 0.0
            ):
                x.joint[s.Q_GOAL, j] = trajectory[0, j]
                x.joint[s.DQ_GOAL, j] = trajectory[1, j]
        if c.run_int[h.HAS_CARRIER_ARMS]:
            for j in range(joints):
                x.joint[s.JOINT_TORQUE, j] += load[n] * c.tendon_joint_table[h.CARRIER_ARMS, n, j]


@kernel_helper
def _force_during_relaxation(
    x: StateTables, c: ConstantTables, n: int, force: float, ceiling: float, open_loop: bool
) -> float:
    """Return the motor force of a tendon while the hand relaxes [N].

    The motor force is at most the envelope (the upper bound of the motor forces). In open loop, the
    motor force is the envelope itself.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        force: motor force from the control law [N].
        ceiling: envelope, the largest motor force [N].
        open_loop: True to return the envelope itself.
    """
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        last_force = x.tendon[s.COMMANDED_FORCE, n]
        sign = -1.0 if last_force < 0.0 else 1.0
        return sign * ceiling if open_loop else sign * min(max(sign * force, 0.0), ceiling)
    return ceiling if open_loop else min(max(force, 0.0), ceiling)


@kernel_helper
def _motion_force_terms(
    x: StateTables, c: ConstantTables, trajectory: Matrix, limit: Vector
) -> tuple[Vector, Matrix, Matrix]:
    """Return for each tendon the pulley efficiency, and four forces of the motion loop [N].

    The first result has the efficiencies (N,). The second result (2, N) has the tension goals and
    the feedback forces. The third result (2, N) has the forces against tension errors in the null
    space, and the integrals of these tension errors. The feedback has to accelerate both the rotor
    and the digit. For tendons that follow no trajectory, all force terms are 0.

    Args:
        x: state tables.
        c: constants of the hand.
        trajectory: (3, J) angles, rates and accelerations of the joints on the trajectories.
        limit: (N,) present tension limits [N].
    """
    count = x.tendon.shape[1]
    efficiency = np.ones(count)
    motion_terms = np.zeros((2, count))
    null_space_terms = np.zeros((2, count))
    has_surplus = False
    for n in range(count):
        if x.tendon_int[s.GOAL_KIND, n] != MOTION:
            continue
        efficiency[n] = winding_efficiency(c, n, trajectory[0])
        excursion, rate, _ = _tendon_motion_on_trajectory(c, n, trajectory)
        measured_excursion = x.tendon[s.EXCURSION, n]
        if c.tendon_int[h.IS_REDUNDANT_DIGIT, n]:
            has_surplus = True
            # A part of the excursions that no motion of the digit can cause is an error of the
            # tendon lengths. The feedback ignores errors of the tendon lengths.
            measured_excursion = (
                project_onto_digit_motion(c, n, x.tendon[s.EXCURSION])
                + c.tendon[h.EXCURSION_MODEL_OFFSET, n]
            )
        feedback = (
            x.tendon[s.STIFFNESS_FRACTION, n]
            * c.tendon[h.EXCURSION_GAIN, n]
            * (excursion - measured_excursion)
        )
        feedback += (
            x.tendon[s.DAMPING_FRACTION, n]
            * c.tendon[h.SPEED_GAIN, n]
            * (rate - x.tendon[s.SPOOL_SPEED, n])
        )
        friction_fraction = c.run[h.FRICTION_FRACTION]
        # Tension behind the pulleys, divided by the tension before the pulleys. The quotient is the
        # efficiency while the tendon is wound up, and 1 / efficiency while the tendon is paid out.
        winding_direction = math.tanh(
            (rate + _tendon_motion_by_carriers(c, n, trajectory)[0]) / CAPSTAN_FRICTION_SPEED_M_S
        )
        transmitted_ratio = (1.0 - friction_fraction) + friction_fraction * math.pow(
            efficiency[n], winding_direction
        )
        ceiling = min(c.tendon[h.TENSION_CEILING, n], limit[n])
        if c.tendon_int[h.IS_SPOOL_PAIR, n]:
            required = net_tension_at_spool(
                x.tendon[s.REQUIRED_TENSION, n], c.tendon[h.PRETENSION, n], transmitted_ratio
            )
            motion_terms[0, n] = min(max(required, -ceiling), ceiling)
        else:
            motion_terms[0, n] = min(
                max(
                    x.tendon[s.REQUIRED_TENSION, n] / transmitted_ratio,
                    c.tendon[h.TENSION_FLOOR, n],
                ),
                ceiling,
            )
        motion_terms[1, n] = c.tendon[h.FEEDBACK_MASS, n] * feedback
        if _is_position_controlled_by_drive(x, c, n):
            motion_terms[1, n] = servo_force(x, c, n, excursion, rate, motion_terms[0, n])
    if has_surplus:
        raise_goals_to_tension_floor(x, c, limit, motion_terms, null_space_terms)
    _take_up_slack(x, c, trajectory, motion_terms, null_space_terms)
    return efficiency, motion_terms, null_space_terms


@kernel_helper
def _takes_up_slack(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if a tendon is slack and the digit of the tendon follows streamed angles.

    A spool pair (two antagonistic tendons on one spool) never counts as slack.
    """
    if c.tendon_int[h.IS_SPOOL_PAIR, n] or not follows_streamed_angles(x, c, n):
        return False
    return (
        x.tendon_int[s.REGIME, n] == SLACK_REGIME
        or x.tendon[s.MEASURED_TENSION, n] < MAX_SLACK_TENSION_N
    )


@kernel_helper
def _is_position_controlled_by_drive(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if the drive of a tendon controls the position, and no slack is being taken up."""
    return is_loop_closed_by_drive(x, c, n) and not _takes_up_slack(x, c, n)


@kernel_helper
def _slack_take_up_speed(rate: float) -> float:
    """Return the speed at which a spool takes up slack [m/s].

    The argument ``rate`` is the rate of the tendon on the trajectory [m/s].
    """
    return max(rate, 0.0) + SLACK_TAKE_UP_SPEED_M_S


@kernel_helper
def _take_up_slack(
    x: StateTables,
    c: ConstantTables,
    trajectory: Matrix,
    motion_terms: Matrix,
    null_space_terms: Matrix,
) -> None:
    """Replace the position feedback for slack tendons.

    With the new feedback, the spool of a slack tendon winds up the tendon at a low speed. A slack
    tendon does not move its digit. Position feedback could pay out more of the slack tendon, or
    could pull the tendon taut with a jerk that looks like a torn tendon. A feedback force that pays
    out a nearly slack tendon is reduced, so that springs or the antagonist can open the digit. The
    low winding speed and the reduced feedback apply to digits that follow streamed angles. In
    motions without streamed angles, the position feedback is replaced only if it would pay out a
    slack tendon, see ``_would_pay_out_slack_tendon``.

    Args:
        x: state tables.
        c: constants of the hand.
        trajectory: (3, J) angles, rates and accelerations of the joints on their trajectories.
        motion_terms: (2, N) tension goals and feedback forces of the motion loop [N], modified in place.
        null_space_terms: (2, N) forces in the null space, and integrals of the tension errors [N], modified
            in place.
    """
    for n in range(x.tendon.shape[1]):
        if _would_pay_out_slack_tendon(x, c, n, motion_terms[1, n]):
            motion_terms[1, n] = c.tendon[h.FEEDBACK_MASS, n] * c.tendon[h.SPEED_GAIN, n]
            motion_terms[1, n] *= SLACK_TAKE_UP_SPEED_M_S - x.tendon[s.SPOOL_SPEED, n]
        if c.tendon_int[h.IS_SPOOL_PAIR, n] or not follows_streamed_angles(x, c, n):
            continue
        floor = c.tendon[h.TENSION_FLOOR, n]
        if _takes_up_slack(x, c, n):
            _, rate, _ = _tendon_motion_on_trajectory(c, n, trajectory)
            motion_terms[0, n] = floor
            motion_terms[1, n] = c.tendon[h.FEEDBACK_MASS, n] * c.tendon[h.SPEED_GAIN, n]
            motion_terms[1, n] *= _slack_take_up_speed(rate) - x.tendon[s.SPOOL_SPEED, n]
            null_space_terms[0, n] = null_space_terms[1, n] = 0.0
        elif motion_terms[1, n] < 0.0:
            motion_terms[1, n] *= min(max(2.0 * x.tendon[s.TENSION, n] / floor - 1.0, 0.0), 1.0)


@kernel_helper
def _would_pay_out_slack_tendon(x: StateTables, c: ConstantTables, n: int, feedback: float) -> bool:
    """Return True if the position feedback would pay out a slack tendon.

    If the digit follows streamed angles, the result is False. No measurement corrects the estimated
    excursion of a slack tendon. If the estimated excursion is too large, the position feedback
    would pay out more and more of the tendon. In a digit with more tendons than coordinates, the
    excursion of a slack tendon follows from the other tendons.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        feedback: feedback force of the errors of excursion and speed [N].
    """
    return bool(
        feedback < 0.0
        and x.tendon_int[s.GOAL_KIND, n] == MOTION
        and x.tendon_int[s.REGIME, n] == SLACK_REGIME
        and not c.tendon_int[h.IS_REDUNDANT_DIGIT, n]
        and not c.tendon_int[h.IS_SPOOL_PAIR, n]
        and not follows_streamed_angles(x, c, n)
    )


@kernel_helper
def _tendon_motion_on_trajectory(
    c: ConstantTables, n: int, trajectory: Matrix
) -> tuple[float, float, float]:
    """Return a tendon's excursion [m], rate [m/s] and acceleration [m/s2] on the joint trajectories."""
    excursion = 0.0
    rate = 0.0
    acceleration = 0.0
    has_varying_arm = c.tendon_int[h.HAS_VARYING_ARM, n] == 1
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        arm = moment_arm(c, n, j, trajectory[0, j])
        excursion += joint_excursion(c, n, j, trajectory[0, j])
        rate += arm * trajectory[1, j]
        acceleration += arm * trajectory[2, j]
        if has_varying_arm:
            acceleration += (
                moment_arm_slope(c, n, j, trajectory[0, j]) * trajectory[1, j] * trajectory[1, j]
            )
    return excursion, rate, acceleration


@kernel_helper
def _tendon_motion_by_carriers(
    c: ConstantTables, n: int, trajectory: Matrix
) -> tuple[float, float]:
    """Return a tendon's rate [m/s] and acceleration [m/s2] caused by the digits that carry the tendon's digit."""
    if not c.run_int[h.HAS_CARRIER_ARMS]:
        return 0.0, 0.0
    return carrier_excursion(c, n, trajectory[1]), carrier_excursion(c, n, trajectory[2])


@kernel_helper
def _carrier_feedforward_force(
    c: ConstantTables, n: int, rate: float, acceleration: float
) -> float:
    """Return the feedforward motor force for the motion of the digits that carry a tendon's digit [N].

    The feedforward force makes a tension-controlled tendon follow the digits that carry the
    tendon's digit.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        rate: rate of the tendon that the carrying digits cause [m/s].
        acceleration: acceleration of the tendon that the carrying digits cause [m/s2].
    """
    if not c.run_int[h.HAS_CARRIER_ARMS]:
        return 0.0
    friction = c.tendon[h.MOTOR_COULOMB_FRICTION, n] * math.tanh(rate / MOTOR_FRICTION_SPEED_M_S)
    return (
        friction
        + c.tendon[h.MOTOR_DAMPING, n] * rate
        + c.tendon[h.FEEDFORWARD_MASS, n] * acceleration
    )


@kernel_helper
def _motion_force(
    x: StateTables,
    c: ConstantTables,
    n: int,
    tension: float,
    feedback: float,
    rate: float,
    acceleration: float,
) -> float:
    """Compute the motor force of a tendon on a trajectory [N], and write the tension goal.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        tension: tension goal at the load cell [N].
        feedback: feedback force of the errors of excursion and speed [N].
        rate: rate of the tendon at its spool on the trajectory [m/s].
        acceleration: acceleration of the tendon at its spool on the trajectory [m/s2].
    """
    speed = motor_speed(x, c, n)
    friction_fraction = c.run[h.FRICTION_FRACTION]
    x.tendon[s.TENSION_GOAL, n] = tension
    if _takes_up_slack(x, c, n):
        rate = _slack_take_up_speed(rate)
    # If a drive closes the position loop, the commanded position includes the planned stretch of
    # the tendon, so that the position loop of the drive also controls the tension.
    tension_feedback_gain = (
        0.0 if _is_position_controlled_by_drive(x, c, n) else c.run[h.TENSION_FEEDBACK]
    )
    return (
        tension
        + feedback
        + c.tendon[h.FEEDFORWARD_MASS, n] * acceleration
        - x.tendon[s.STIFFNESS_FRACTION, n]
        * c.run[h.DISTURBANCE_REJECTION]
        * x.tendon[s.MOTOR_DISTURBANCE, n]
        + tension_feedback_gain * (tension - x.tendon[s.TENSION, n])
        + friction_fraction * c.tendon[h.MOTOR_DAMPING, n] * speed
        + friction_fraction
        * c.tendon[h.MOTOR_COULOMB_FRICTION, n]
        * math.tanh(rate / MOTOR_FRICTION_SPEED_M_S)
    )


@kernel_helper
def _tension_force(
    x: StateTables, c: ConstantTables, n: int, limit: float
) -> tuple[float, float, float]:
    """Return three values of a tendon's tension loop: motor force, setpoint and integral of the error [N].

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        limit: largest allowed tension [N].
    """
    target = min(x.tendon[s.TENSION_TARGET, n], limit)
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        target = max(target, -limit)
    step = x.tendon[s.TENSION_SETPOINT_STEP, n]
    last_setpoint = x.tendon[s.TENSION_SETPOINT, n]
    setpoint = last_setpoint + min(max(target - last_setpoint, -step), step)
    error = setpoint - x.tendon[s.TENSION, n]
    is_slack = x.tendon_int[s.REGIME, n] == SLACK_REGIME
    integral = 0.0 if is_slack else _tension_integral(x, c, n, error)
    force = (
        setpoint
        + c.tendon[h.TENSION_GAIN, n] * error
        - c.tendon[h.TENSION_SPEED_GAIN, n] * x.tendon[s.SPOOL_SPEED, n]
        + integral
        - c.run[h.DISTURBANCE_REJECTION] * x.tendon[s.MOTOR_DISTURBANCE, n]
    )
    if is_slack and setpoint > 0.0:
        # The small tension error of a slack tendon cannot overcome the friction of a motor at rest.
        force += c.tendon[h.MOTOR_COULOMB_FRICTION, n]
        if is_target_stream_running(x):
            # Streamed tensions move a digit fast, so the spools must take up the slack tendons of
            # the digit fast.
            tension_increase = max(SLACK_TAKE_UP_TENSION_N - setpoint, 0.0)
            force += (1.0 + c.tendon[h.TENSION_GAIN, n]) * tension_increase
    if x.digit_int[s.TRAJECTORY_KIND, c.tendon_int[h.DIGIT_OF_TENDON, n]] != NO_TRAJECTORY:
        force += _feedforward_force(x, c, n)
    max_force = x.tendon[s.FORCE_LIMIT, n]
    return min(max(force, -max_force), max_force), setpoint, integral


@kernel_helper
def _tension_integral(x: StateTables, c: ConstantTables, n: int, error: float) -> float:
    """Return the integral of the tension error of a taut tendon [N].

    The integral of the tension error compensates the friction of a rotor at rest. A digit without
    contact cannot resist arbitrary streamed tensions, so the digit moves and the tension errors
    persist. If the function integrated the persistent errors without a decay, the digit would
    oscillate between its stops. During a stream of tensions, the tension integral of a moving
    tendon decays, so that the digit does not oscillate.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        error: tension error [N].
    """
    integral = x.tendon[s.TENSION_INTEGRAL, n]
    if is_target_stream_running(x) and abs(x.tendon[s.SPOOL_SPEED, n]) > MAX_INTEGRATION_SPEED_M_S:
        return integral * max(1.0 - c.run[h.CONTROL_PERIOD] / INTEGRAL_DECAY_S, 0.0)
    integral += c.run[h.INTEGRAL_GAIN] * error
    return min(max(integral, -INTEGRAL_LIMIT_N), INTEGRAL_LIMIT_N)


@kernel_helper
def _feedforward_force(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the feedforward motor force of a tension-controlled tendon whose digit should follow a trajectory [N]."""
    speed = 0.0
    acceleration = 0.0
    for k in range(x.coordinate.shape[1]):
        speed += c.tendon_coordinate_table[h.REDUCED_ARMS, n, k] * x.coordinate[s.TRAJECTORY + 1, k]
        acceleration += (
            c.tendon_coordinate_table[h.REDUCED_ARMS, n, k] * x.coordinate[s.TRAJECTORY + 2, k]
        )
    friction = c.tendon[h.MOTOR_COULOMB_FRICTION, n] * math.tanh(speed / MOTOR_FRICTION_SPEED_M_S)
    feedforward = friction + c.tendon[h.MOTOR_MASS, n] * acceleration
    return feedforward + (c.tendon[h.TENSION_SPEED_GAIN, n] + c.tendon[h.MOTOR_DAMPING, n]) * speed


@kernel_helper
def _relaxation_envelope(
    x: StateTables, c: ConstantTables, n: int, rate: float, elapsed_periods: int
) -> float:
    """Return the largest motor force while the hand relaxes [N], see ``controller.relaxation``."""
    last_force = x.tendon[s.COMMANDED_FORCE, n]
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        last_force = abs(last_force)
    last_force = 0.0 if math.isnan(last_force) else max(last_force, 0.0)
    lowered_limit = max(last_force - rate * c.run[h.CONTROL_PERIOD] * elapsed_periods, 0.0)
    return (
        max(min(last_force, c.tendon[h.RELAXED_TENSION, n]), lowered_limit)
        * ENVELOPE_ROUNDING_FACTOR
    )


@kernel_helper
def _motor_friction(x: StateTables, c: ConstantTables, n: int, command_force: float) -> float:
    """Return the Coulomb friction of a motor, averaged over the coming control period [N].

    The friction is computed by the implicit midpoint rule, so friction can stop a motor within a
    period, but cannot reverse the motion of the motor.
    """
    speed_without_friction = motor_speed(x, c, n) + c.tendon[h.HALF_PERIOD_SPEED, n] * (
        command_force - x.tendon[s.TENSION, n]
    )
    return c.tendon[h.MOTOR_COULOMB_FRICTION, n] * math.tanh(
        speed_without_friction / c.tendon[h.FRICTION_STOP_SPEED, n]
    )


@kernel_helper
def _decay_trim_forces(x: StateTables, c: ConstantTables) -> None:
    """Reduce the trim of each tendon.

    The trim is a small force that is added to the motor force after a change of gains. Set all
    trims to 0 when the largest trim is negligible.
    """
    if not x.run_int[s.TRIM_ACTIVE]:
        return
    largest = 0.0
    for n in range(x.tendon.shape[1]):
        x.tendon[s.TRIM_FORCE, n] *= c.run[h.TRIM_DECAY]
        largest = max(largest, abs(x.tendon[s.TRIM_FORCE, n]))
    if largest <= MIN_TRIM_N:
        x.run_int[s.TRIM_ACTIVE] = 0
        for n in range(x.tendon.shape[1]):
            x.tendon[s.TRIM_FORCE, n] = 0.0
