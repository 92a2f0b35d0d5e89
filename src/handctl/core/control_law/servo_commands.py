"""Commands to drives that close the position loop of a moving digit.

A command to a drive with a position loop consists of a position p_d, a velocity v_d, a stiffness
kp, a damping kd and a torque t. Many times within a tick, the drive measures the position p and the
velocity v, and computes its torque:

    kp (p_d - p) + kd (v_d - v) + t

The spool radius r times the commanded position is a sum of three lengths. The lengths are the
planned excursion s_d, the stretch under the planned tension f_0, and the estimated stretch offset
o. The estimated tension is f_hat = k (r p - s - o), with the stiffness k of the tendon and the
motor position p. The position error of the drive contains the errors of excursion and tension:

    r p_d = s_d + f_0 / k + o
    r (p_d - p) = (s_d - s) + (f_0 - f_hat) / k

The controller does not know the torque that the drive will make, so the controller estimates p and
v half a control period ahead. From the estimated position and velocity, the controller predicts the
mean motor torque of the coming period. The controller limits the predicted torque in the same way
as a torque command. The controller chooses the commanded position with which the drive would make
the limited torque. The torque limits of the controller limit not only the torque, but also the
distance between the commanded position and the motor position.

Most drives keep the commanded position unchanged until the next command. If a drive keeps the
commanded position unchanged, the commanded position includes the planned motion of half a control
period. Other drives change the commanded position continuously, at the commanded velocity. If a
drive changes the commanded position continuously, a command contains the commanded position at the
start of the control period. If the host fails, a moving commanded position continues to change
until the watchdog of the drive fires. If a drive changes the commanded position, the command also
contains a torque limit slightly above the predicted torque.

In commands for a digit that moves freely on its trajectory, kp and kd are above 0. In commands for
any other digit, kp and kd are 0, and t is the whole torque. Commands with kp = kd = 0 are torque
commands. Torque commands are sent while the digit touches an object or relaxes, and while the
tendon takes up slack. Torque commands are also sent while the safety monitor makes the hand hold
its position, and in a tick without a measured motor position.
"""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import MOTION
from handctl.core.estimation.filter_types import SLACK_REGIME
from handctl.core.estimation.varying_moment_arms import carrier_excursion
from handctl.core.state_block import StateTables
from handctl.core.tick_types import ACTIVE_MODE

MAX_LOOP_PHASE_RAD = 0.3
"""Largest product of the natural frequency of a drive's position loop and the control period [rad].

The tension filter assumes that the motor force is constant within a period. In simulation, position
loops with a larger product oscillated. Examples are position loops with 0.5 rad on the hand
``jamia`` at 100 Hz and on the hand ``orca_like`` at 250 Hz.
"""
SERVO_COMMAND_ROW_COUNT = 6
"""Number of rows of a command: position, velocity, kp, kd, torque, limit."""
TORQUE_LIMIT_MARGIN_N = 10.0
"""Force [N] by which the torque limit in a command exceeds the predicted motor force.

In free motions, the motor force changes by less than 1 N within a control period.
"""


@kernel_helper
def begin_servo_commands(x: StateTables, c: ConstantTables) -> None:
    """Store the commands of the last tick, and set the commands of the present tick to 0.

    If a drive changes the commanded position continuously, at the commanded velocity, the stored
    position is the present commanded position in the drive.
    """
    elapsed_s = c.run[h.CONTROL_PERIOD] * (1 + x.run_int[s.MISSED_TICKS])
    for n in range(x.servo.shape[1]):
        for row in range(SERVO_COMMAND_ROW_COUNT):
            x.servo[s.LAST_SERVO_COMMAND + row, n] = x.servo[s.SERVO_POSITION + row, n]
            x.servo[s.SERVO_POSITION + row, n] = 0.0
        if c.tendon_int[h.DRIVE_MOVES_TARGET, n]:
            x.servo[s.LAST_SERVO_COMMAND, n] += elapsed_s * x.servo[s.LAST_SERVO_COMMAND + 1, n]


@kernel_helper
def command_torque_only(x: StateTables, n: int) -> None:
    """Replace the command of a drive by a command that contains only a torque.

    The table of the servo commands is empty if no drive of the hand closes a position loop.
    """
    x.servo[s.SERVO_KP, n] = x.servo[s.SERVO_KD, n] = 0.0
    x.servo[s.SERVO_TORQUE, n] = x.tendon[s.COMMANDED_TORQUE, n]


@kernel_helper
def is_loop_closed_by_drive(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if the drive of a tendon controls the position itself in the present tick."""
    if not c.tendon_int[h.DRIVE_CLOSES_LOOP, n] or x.tendon_int[s.GOAL_KIND, n] != MOTION:
        return False
    if x.run_int[s.HAND_MODE] != ACTIVE_MODE or x.run_int[s.SAFETY_HOLD_ACTIVE]:
        return False
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    if (
        x.digit_int[s.IS_BLOCKED, d]
        or x.digit_int[s.PLANNED_CONTACT, d]
        or math.isnan(x.tendon[s.MEASURED_TRAVEL, n])
    ):
        return False
    return (
        c.tendon_int[h.IS_SPOOL_PAIR, n] == 1 or x.tendon_int[s.REGIME, n] != SLACK_REGIME
    ) and servo_stiffness(x, c, n) > 0.0


@kernel_helper
def servo_stiffness(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the stiffness kp of a drive's position loop for the present goal [N m/rad].

    The stiffness is rounded to the resolution with which a command frame transmits kp.
    """
    step = c.tendon[h.SERVO_KP_STEP, n]
    stiffness = x.tendon[s.STIFFNESS_FRACTION, n] * max(c.tendon[h.SERVO_STIFFNESS, n], step)
    return step * math.floor(min(stiffness, c.tendon[h.SERVO_KP_MAX, n]) / step + 0.5)


@kernel_helper
def servo_damping(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the damping kd of a drive's position loop for the present goal [N m s/rad].

    The damping is rounded to the resolution with which a command frame transmits kd.
    """
    step = c.tendon[h.SERVO_KD_STEP, n]
    damping = x.tendon[s.DAMPING_FRACTION, n] * c.tendon[h.SERVO_DAMPING, n]
    return step * math.floor(min(damping, c.tendon[h.SERVO_KD_MAX, n]) / step + 0.5)


@kernel_helper
def servo_speed_force(x: StateTables, c: ConstantTables, n: int, rate: float) -> float:
    """Return the mean force that the speed error causes in a drive's position loop [N].

    The result is the mean force over the coming control period. Within a control period, the speed
    error increases the position error, on average by the speed error times half a control period.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        rate: rate of the digit's excursion on the trajectory [m/s].
    """
    gain = servo_damping(x, c, n) + 0.5 * c.run[h.CONTROL_PERIOD] * servo_stiffness(x, c, n)
    return (
        gain
        / (c.tendon[h.SPOOL_RADIUS, n] * c.tendon[h.SPOOL_RADIUS, n])
        * (rate - x.tendon[s.SPOOL_SPEED, n])
    )


@kernel_helper
def servo_force(
    x: StateTables, c: ConstantTables, n: int, excursion: float, rate: float, tension: float
) -> float:
    """Return the predicted mean force of a drive's position loop in the coming period [N].

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        excursion: excursion of the digit on the trajectory [m].
        rate: rate of the digit's excursion on the trajectory [m/s].
        tension: planned tension at the load cell [N].
    """
    error = (
        excursion
        - x.tendon[s.EXCURSION, n]
        + (tension - x.tendon[s.TENSION, n]) / c.tendon[h.TENDON_STIFFNESS, n]
    )
    stiffness = servo_stiffness(x, c, n) / (
        c.tendon[h.SPOOL_RADIUS, n] * c.tendon[h.SPOOL_RADIUS, n]
    )
    return stiffness * error + servo_speed_force(x, c, n, rate)


@kernel_helper
def write_servo_command(
    x: StateTables, c: ConstantTables, n: int, rate: float, feedforward: float, force: float
) -> None:
    """Write the position command with which a drive makes a given mean force in the coming period.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        rate: rate of the digit's excursion on the trajectory [m/s].
        feedforward: motor force without the force of the drive's position loop [N].
        force: motor force after the limits, including the force of the drive's position loop [N].
    """
    spool = c.tendon[h.SPOOL_RADIUS, n]
    kp = servo_stiffness(x, c, n)
    feedforward_force = min(
        max(feedforward, c.tendon[h.MIN_MOTOR_FORCE, n]), c.tendon[h.MAX_MOTOR_FORCE, n]
    )
    position_lead = (
        (force - feedforward_force - servo_speed_force(x, c, n, rate)) * spool * spool / kp
    )
    travel = x.tendon[s.SPOOL_TRAVEL, n]
    speed = rate
    if c.run_int[h.HAS_CARRIER_ARMS]:
        # The commanded position and speed include the estimated motion of carrying digits, so that
        # errors of this motion have no effect.
        travel += carrier_excursion(c, n, x.joint[s.Q])
        speed += carrier_excursion(c, n, x.joint[s.DQ])
    motion_in_half_period = (
        0.0 if c.tendon_int[h.DRIVE_MOVES_TARGET, n] else 0.5 * c.run[h.CONTROL_PERIOD] * speed
    )
    travel += position_lead + motion_in_half_period
    x.servo[s.SERVO_POSITION, n] = travel / spool + c.tendon[h.MOTOR_ZERO, n]
    x.servo[s.SERVO_VELOCITY, n] = speed / spool
    x.servo[s.SERVO_KP, n] = kp
    x.servo[s.SERVO_KD, n] = servo_damping(x, c, n)
    x.servo[s.SERVO_TORQUE, n] = feedforward_force * spool
    if c.tendon_int[h.DRIVE_MOVES_TARGET, n]:
        x.servo[s.SERVO_TORQUE_LIMIT, n] = (
            min(abs(force) + TORQUE_LIMIT_MARGIN_N, c.tendon[h.MAX_MOTOR_FORCE, n]) * spool
        )


@kernel_helper
def predict_reported_forces(x: StateTables, c: ConstantTables) -> None:
    """Write the force [N] that each drive should report in the present tick.

    A report contains position, speed and torque at one instant. When a drive sends its report, the
    drive still obeys the command before the last command. The expected torque follows from the
    command before the last command, and from the position and speed in the report.
    """
    for n in range(x.servo.shape[1]):
        torque = x.servo[s.LAST_SERVO_COMMAND + 4, n]
        kp = x.servo[s.LAST_SERVO_COMMAND + 2, n]
        if kp > 0.0:
            torque += kp * (x.servo[s.LAST_SERVO_COMMAND, n] - x.tendon[s.POSITION, n])
            torque += x.servo[s.LAST_SERVO_COMMAND + 3, n] * (
                x.servo[s.LAST_SERVO_COMMAND + 1, n] - x.tendon[s.VELOCITY, n]
            )
        limit = c.tendon[h.MAX_MOTOR_FORCE, n]
        if kp > 0.0 and c.tendon_int[h.DRIVE_MOVES_TARGET, n]:
            limit = x.servo[s.LAST_SERVO_COMMAND + 5, n] / c.tendon[h.SPOOL_RADIUS, n]
        is_known = math.isfinite(x.tendon[s.COMMANDED_FORCE, n]) and math.isfinite(
            x.tendon[s.MEASURED_FORCE, n]
        )
        x.servo[s.EXPECTED_SERVO_FORCE, n] = (
            min(max(torque / c.tendon[h.SPOOL_RADIUS, n], -limit), limit) if is_known else math.nan
        )
