"""Test whether a drive obeys its commands, by the correlation of reported and commanded torque.

If a drive obeys its commands, it reports the commanded torque. The report of the drive includes the
small changes that noise adds to every command. The reported torque does not follow the command in
three cases: the reports come from another drive, the torque acts on another joint, or the drive
obeys late. The difference between commands and reports is visible even if all motors pull with
equal force and no joint moves. The test compares the change a of the command from one tick to the
next with the change b of the report. Both changes are forces at the spool [N]. The test uses
low-passed products S of a and b:

    S_ab + 4 sqrt(S_aa S_bb / n) < 0.4 S_aa      n = 2 tau / T samples

Here tau is the time constant of the low-pass filter, and T is the control period. A drive fails the
test if it reports less than 40 % of the changes in the command. The test has a margin of four
standard deviations of the estimated fraction. If the changes a and b are uncorrelated, their sample
covariance has the variance S_aa S_bb / n. Source: Bartlett's formula for white noise.

When a digit touches an object, the changes of the command are a hundred times as large as in a
hold. Without a limit, the large changes of the command would dominate the products S for seconds
after the contact. The test limits the changes a and b to two counts of the torque. The limit keeps
the signs of a and b. If a drive obeys its commands, the change a of the command and the change b of
the report have equal signs.

The test uses the changes a and b only after ``MIN_TICKS_WITH_REPLY`` consecutive ticks in which the
drive replied in time. After a pause of the communication, a drive replies to all waiting commands
before it obeys the last command. After a pause of the communication, the next report of the drive
belongs to an older command. On a slow bus, a report can come a tick late, and then belongs to a
command that is one tick older. The test computes the correlation with and without a delay of one
tick, and uses the larger correlation.
"""

import math

from handctl.compiled import kernel_helper, square
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.detectors.residuals import COMMAND_DIFFERENCE
from handctl.core.state_block import StateTables
from handctl.safety.faults.node import (
    CONTRADICTORY_REPORT_FRACTION,
    CONTRADICTORY_REPORT_MEAN_N,
    CONTRADICTORY_REPORT_N,
    MIN_REPORTED_TORQUE_FRACTION,
    TORQUE_CORRELATION_TIME_S,
)

MIN_FILTER_RESPONSE = 0.9
"""Response of the low-pass filter to a constant input of 1, above which the test is made.

At a response of 0.9, the memory of the filter is 90 % filled.
"""
COVARIANCE_MARGIN_SIGMAS = 4.0
"""Margin of the test, in standard deviations of the estimated covariance."""
MIN_TICKS_WITH_REPLY = 3
"""Number of ticks in a row, each with a reply in time, after which reports are matched with commands.

A command takes effect a tick later, and an increment is the difference of two commands.
"""
MIN_INCREMENT_FRACTION = 1.0 / 4000.0
"""Smallest increment (rms) for the test, as a fraction of the largest force: half a count of a 12-bit torque.

Smaller increments of the torque consist mostly of rounding errors. If one torque count of a drive
is larger than a 12-bit count, half of the drive's count is used.
"""
MAX_INCREMENT_RATIO = 4.0
"""Limit of an increment, as a multiple of the smallest increment for the test.

In a hold, noise causes increments up to about the limit.
"""
COMPARED_COMMAND_COUNT = 3
"""Number of last commands whose range a single report is compared with."""
MIN_COMMAND_WINDOW_S = 6e-3
"""Shortest time of ``COMPARED_COMMAND_COUNT`` ticks in which a single report is compared [s].

A reply on a busy computer can be some milliseconds late.
"""
MIN_SERVO_INCREMENT_COUNTS = 0.75
"""Smallest increment (rms) for a drive that closes the position loop, in counts of position and speed.

The report contains a rounded position and speed, but the drive computes with unrounded values.
Rounded and unrounded values differ by 0.3 counts (rms).
"""
MIN_POSITION_COMMAND_FRACTION = 0.01
"""Fraction of ticks with a position loop closed by the drive, above which ``MIN_SERVO_INCREMENT_COUNTS`` applies."""
(
    COMMAND_SQUARED_ROW,
    COMMAND_REPORT_ROW,
    LATE_COMMAND_REPORT_ROW,
    REPORT_SQUARED_ROW,
    FILTER_RESPONSE_ROW,
) = range(5)
"""Rows of ``state_block.FORCE_INCREMENT_PRODUCTS``, low-passed products of increments.

The rows are: command squared, command times report, the earlier command times report (for a report
that comes a tick late), report squared, and the response of the filter to a constant 1.
"""


@kernel_helper
def update_correlation(x: StateTables, c: ConstantTables, missed_ticks: int) -> None:
    """Update the low-passed products a b, where a is a change of the command and b a change of the report.

    A drive replies to a command before it obeys the command, so the report of the present tick
    belongs to the command before the last command.

    Args:
        x: state tables.
        c: constants of the hand.
        missed_ticks: ticks missed before the present tick.
    """
    fraction = 1.0 - math.exp(-c.run[h.CONTROL_PERIOD] / TORQUE_CORRELATION_TIME_S)
    for n in range(x.tendon.shape[1]):
        # The last command and the three commands before it are stored, the newest first.
        command = x.tendon[s.COMMANDED_FORCE, n]
        first_force = x.tendon[s.RECENT_MOTOR_FORCES, n]
        second_force = x.tendon[s.RECENT_MOTOR_FORCES + 1, n]
        last_force = x.tendon[s.RECENT_MOTOR_FORCES + 2, n]
        if c.tendon_int[h.DRIVE_CLOSES_LOOP, n]:
            is_loop_closed = 1.0 if x.servo[s.LAST_SERVO_COMMAND + 2, n] > 0.0 else 0.0
            x.servo[s.POSITION_COMMAND_FRACTION, n] += fraction * (
                is_loop_closed - x.servo[s.POSITION_COMMAND_FRACTION, n]
            )
            last_force = second_force
            second_force = first_force
            first_force = x.servo[s.EXPECTED_SERVO_FORCE, n]
        report = x.tendon[s.MEASURED_FORCE, n]
        largest = MAX_INCREMENT_RATIO * _smallest_increment(x, c, n)
        a = _clipped_increment(first_force - second_force, largest)
        b = _clipped_increment(report - x.tendon[s.RECENT_MOTOR_FORCES + 3, n], largest)
        late_increment = _clipped_increment(second_force - last_force, largest)
        replies_on_time = 0.0
        if missed_ticks == 0 and math.isfinite(report):
            replies_on_time = x.tendon[s.REPLIES_ON_TIME, n] + 1.0
        if math.isfinite(a + b + late_increment) and replies_on_time > MIN_TICKS_WITH_REPLY:
            _low_pass_moment(x, n, COMMAND_SQUARED_ROW, fraction, a * a)
            _low_pass_moment(x, n, COMMAND_REPORT_ROW, fraction, a * b)
            _low_pass_moment(x, n, LATE_COMMAND_REPORT_ROW, fraction, late_increment * b)
            _low_pass_moment(x, n, REPORT_SQUARED_ROW, fraction, b * b)
            _low_pass_moment(x, n, FILTER_RESPONSE_ROW, fraction, 1.0)
        x.tendon[s.REPLIES_ON_TIME, n] = replies_on_time
        if c.tendon_int[h.DRIVE_CLOSES_LOOP, n]:
            # For a drive that closes its position loop, the predicted force of the report is stored
            # instead of the command. The stored forces of a drive that closes its position loop are
            # shifted by one tick.
            x.tendon[s.RECENT_MOTOR_FORCES, n] = first_force
            x.tendon[s.RECENT_MOTOR_FORCES + 1, n] = second_force
        else:
            x.tendon[s.RECENT_MOTOR_FORCES, n] = command
            x.tendon[s.RECENT_MOTOR_FORCES + 1, n] = first_force
            x.tendon[s.RECENT_MOTOR_FORCES + 2, n] = second_force
        x.tendon[s.RECENT_MOTOR_FORCES + 3, n] = report


@kernel_helper
def _smallest_increment(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the smallest change of a motor's torque that exceeds the rounding error, as a force at the spool [N]."""
    rounding_step = max(
        MIN_INCREMENT_FRACTION * c.tendon[h.DRIVE_TENSION_LIMIT, n],
        0.5 * c.tendon[h.TORQUE_STEP, n],
    )
    if (
        c.tendon_int[h.DRIVE_CLOSES_LOOP, n]
        and x.servo[s.POSITION_COMMAND_FRACTION, n] > MIN_POSITION_COMMAND_FRACTION
    ):
        rounding_step = max(
            rounding_step, MIN_SERVO_INCREMENT_COUNTS * c.tendon[h.SERVO_ROUNDING_FORCE, n]
        )
    return float(rounding_step)


@kernel_helper
def _clipped_increment(increment: float, largest: float) -> float:
    """Return a change of force, limited to plus or minus ``largest``.

    If the change of force is NaN, the result is NaN.
    """
    if increment > largest:
        return largest
    return -largest if increment < -largest else increment


@kernel_helper
def _low_pass_moment(
    x: StateTables, n: int, moment_row: int, fraction: float, value: float
) -> None:
    x.tendon[s.FORCE_INCREMENT_PRODUCTS + moment_row, n] += fraction * (
        value - x.tendon[s.FORCE_INCREMENT_PRODUCTS + moment_row, n]
    )


@kernel_helper
def is_torque_command_ignored(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if the torque that a motor reports does not follow its commanded torque."""
    aa = x.tendon[s.FORCE_INCREMENT_PRODUCTS + COMMAND_SQUARED_ROW, n]
    bb = x.tendon[s.FORCE_INCREMENT_PRODUCTS + REPORT_SQUARED_ROW, n]
    ab = max(
        x.tendon[s.FORCE_INCREMENT_PRODUCTS + COMMAND_REPORT_ROW, n],
        x.tendon[s.FORCE_INCREMENT_PRODUCTS + LATE_COMMAND_REPORT_ROW, n],
    )
    # The command and the report must both change by more than the rounding of the torque. A report
    # that stays constant is a sign of another fault.
    has_changed = min(aa, bb) > square(_smallest_increment(x, c, n))
    if (
        x.tendon[s.FORCE_INCREMENT_PRODUCTS + FILTER_RESPONSE_ROW, n] <= MIN_FILTER_RESPONSE
        or not has_changed
    ):
        return False
    return (
        ab
        + COVARIANCE_MARGIN_SIGMAS
        * math.sqrt(aa * bb * c.run[h.CONTROL_PERIOD] / (2.0 * TORQUE_CORRELATION_TIME_S))
        < MIN_REPORTED_TORQUE_FRACTION * aa
    )


@kernel_helper
def fraction_of_command_reported(x: StateTables, n: int) -> float:
    """Return the fraction of the changes in a motor's commands that the motor also reports.

    The fraction is 1 for a drive that obeys its commands.
    """
    ab = max(
        x.tendon[s.FORCE_INCREMENT_PRODUCTS + COMMAND_REPORT_ROW, n],
        x.tendon[s.FORCE_INCREMENT_PRODUCTS + LATE_COMMAND_REPORT_ROW, n],
    )
    # The lower bound of the divisor prevents a division by 0.
    return ab / max(x.tendon[s.FORCE_INCREMENT_PRODUCTS + COMMAND_SQUARED_ROW, n], 1e-300)


@kernel_helper
def does_report_contradict_commands(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if the force that a motor reports is outside the range of its last three commands.

    A single report outside the range is not sufficient. The low-passed difference between command
    and report must also be large. The sign of the difference must agree with the side of the range
    on which the report lies. If a drive obeys its commands, it reports one of the commands of the
    last three ticks, even after a lost frame. The report of a drive that obeys is within the range
    of the commands, even if the command changes fast. The test of the range finds some faults
    earlier than the low-passed difference alone, for example if two drives are exchanged.

    The test covers only motors of tendons without a load cell. If a tendon has a load cell, the
    module ``residuals`` detects a drive that makes a wrong force. On a busy computer, a reply of a
    drive can be older than the last three commands. Therefore a report is compared with the last
    three commands only if three ticks take at least ``MIN_COMMAND_WINDOW_S``.

    A drive that closes its position loop is not tested, because such a drive gets no torque
    commands. A drive that sends its torque in a separate frame is not tested either, because the
    torque can be older than the reply.
    """
    window = COMPARED_COMMAND_COUNT * c.run[h.CONTROL_PERIOD]
    if c.tendon_int[h.CELL_GROUP, n] >= 0 or window < MIN_COMMAND_WINDOW_S:
        return False
    if c.tendon_int[h.DRIVE_CLOSES_LOOP, n] or not c.tendon_int[h.HAS_SINGLE_ANSWER, n]:
        return False
    if x.tendon[s.REPLIES_ON_TIME, n] <= MIN_TICKS_WITH_REPLY:
        return False
    min_force = math.inf
    max_force = -math.inf
    for age in range(COMPARED_COMMAND_COUNT):
        command = x.tendon[s.RECENT_MOTOR_FORCES + age, n]
        if math.isnan(command):
            return False
        min_force = min(min_force, command)
        max_force = max(max_force, command)
    report = x.tendon[s.MEASURED_FORCE, n]
    mean = x.tendon[s.RESIDUAL + COMMAND_DIFFERENCE, n]
    distance_to_range = min_force - report if mean > 0.0 else report - max_force
    tolerance = CONTRADICTORY_REPORT_N + CONTRADICTORY_REPORT_FRACTION * max(
        abs(min_force), abs(max_force)
    )
    return abs(mean) > CONTRADICTORY_REPORT_MEAN_N and distance_to_range > tolerance
