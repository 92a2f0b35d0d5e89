"""Conversion of received readings to the measurements of a tick.

Impossible positions are rejected.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.kalman import write_free_angles
from handctl.core.estimation.varying_moment_arms import carrier_excursion, joint_excursion
from handctl.core.state_block import StateTables


@kernel_helper
def write_measurements(x: StateTables, c: ConstantTables) -> None:
    """Write the readings that arrived in the present tick as measurements.

    Missing readings become NaN.
    """
    for n in range(x.tendon.shape[1]):
        x.tendon[s.MEASURED_POSITION, n] = math.nan
        if x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n] > 0:
            x.tendon[s.MEASURED_POSITION, n] = x.tendon[s.POSITION, n] - c.tendon[h.MOTOR_ZERO, n]
        x.tendon[s.MEASURED_TENSION, n] = math.nan
        x.tendon_int[s.IS_CELL_SATURATED, n] = 0
        if x.tendon_int[s.HAS_NEW_CELL_READING, n]:
            cell_reading = x.tendon[s.CELL_READING, n]
            is_saturated = not c.run[h.MIN_CELL_RANGE] < cell_reading < c.run[h.MAX_CELL_RANGE]
            if is_saturated:
                # When a load cell is overloaded, its amplifier can send NaN, or a number far
                # outside of the range.
                cell_reading = (
                    c.run[h.MAX_CELL_RANGE]
                    if cell_reading >= c.run[h.MAX_CELL_RANGE]
                    else c.run[h.MIN_CELL_RANGE]
                )
            x.tendon[s.MEASURED_TENSION, n] = cell_reading - (
                c.tendon[h.CELL_TARE, n] + x.tendon[s.TARE_MEASURED_BY_PROGRAM, n]
            )
            x.tendon_int[s.IS_CELL_SATURATED, n] = is_saturated
    x.run_int[s.HAS_ANY_JOINT_READING] = 0
    for j in range(x.joint.shape[1]):
        x.joint[s.MEASURED_JOINT, j] = math.nan
        if x.joint_int[s.HAS_NEW_JOINT_READING, j]:
            x.run_int[s.HAS_ANY_JOINT_READING] = 1
            x.joint[s.MEASURED_JOINT, j] = x.joint[s.JOINT_ANGLE, j]


@kernel_helper
def reject_outliers(x: StateTables, c: ConstantTables, missed_ticks: int) -> None:
    """Reject positions that a motor or a joint cannot have reached since the last accepted position.

    Args:
        x: state tables.
        c: constants of the hand.
        missed_ticks: ticks missed before the present tick. The hand moved on in the missed ticks,
            and a reading can be the reply to an older request.
    """
    for n in range(x.tendon.shape[1]):
        _reject_outlier(
            x.tendon, n, s.MEASURED_POSITION, s.ACCEPTED_POSITION, s.ACCEPTED_POSITION_AGE, s.REJECTED_MOTOR_STEP,
            s.REJECTED_POSITION_COUNT, c.tendon[h.MOTOR_STEP_LIMIT, n], missed_ticks,
        )  # fmt: skip
    for j in range(x.joint.shape[1]):
        _reject_outlier(
            x.joint, j, s.MEASURED_JOINT, s.ACCEPTED_JOINT_ANGLE, s.ACCEPTED_ANGLE_AGE, s.REJECTED_JOINT_STEP,
            s.REJECTED_ANGLE_COUNT, c.joint[h.JOINT_STEP_LIMIT, j], missed_ticks,
        )  # fmt: skip


@kernel_helper
def _reject_outlier(
    position_table: NDArray[np.float64],
    i: int,
    measured_row: int,
    accepted_row: int,
    gap_ticks_row: int,
    rejected_step_row: int,
    rejection_count_row: int,
    limit: float,
    missed_ticks: int,
) -> None:
    """Reject a position that is too far from the last accepted position of the same sensor.

    Args:
        position_table: table of the position, (rows, n).
        i: column of the position in the table.
        measured_row: row of the measured position.
        accepted_row: row of the last accepted position.
        gap_ticks_row: row of the largest possible number of ticks between the measurement of the
            accepted position and the last tick.
        rejected_step_row: row for the size of the rejected position step.
        rejection_count_row: row for the number of consecutive rejections.
        limit: largest possible change of the position in a control period [rad].
        missed_ticks: see ``reject_outliers``.
    """
    value = position_table[measured_row, i]
    # A comparison with NaN is False, so no position is rejected if the measured or the accepted
    # position is missing.
    step = abs(value - position_table[accepted_row, i])
    gap = position_table[gap_ticks_row, i] + 1.0 + missed_ticks
    position_table[rejected_step_row, i] = 0.0
    if step > limit * gap:
        position_table[rejected_step_row, i] = step
        position_table[rejection_count_row, i] += 1.0
        position_table[measured_row, i] = math.nan
    elif not math.isnan(value):
        position_table[accepted_row, i] = value
        position_table[rejection_count_row, i] = 0.0
        gap = float(missed_ticks)
    position_table[gap_ticks_row, i] = gap


@kernel_helper
def reset_rejected_steps(x: StateTables) -> None:
    """Set the sizes of all rejected position steps to 0.

    The caller calls this function while no motor makes torque, because positions are then not
    tested.
    """
    for n in range(x.tendon.shape[1]):
        x.tendon[s.REJECTED_MOTOR_STEP, n] = 0.0
    for j in range(x.joint.shape[1]):
        x.joint[s.REJECTED_JOINT_STEP, j] = 0.0


@kernel_helper
def convert_positions(x: StateTables, c: ConstantTables) -> None:
    """Compute the measured travel, motor force and excursion of each tendon from accepted positions."""
    for n in range(x.tendon.shape[1]):
        spool = c.tendon[h.SPOOL_RADIUS, n]
        x.tendon[s.MEASURED_TRAVEL, n] = x.tendon[s.MEASURED_POSITION, n] * spool
        if c.run_int[h.HAS_CARRIER_ARMS]:
            # The last tick predicted the estimated joint angles to the time of the present
            # measurement.
            x.tendon[s.MEASURED_TRAVEL, n] -= carrier_excursion(c, n, x.joint[s.Q])
        is_measured = not math.isnan(x.tendon[s.MEASURED_TRAVEL, n])
        # A drive reports the torque that an ideal motor would make. The real motor makes the
        # reported torque multiplied by ``TORQUE_GAIN``.
        motor_torque = x.tendon[s.REPORTED_TORQUE, n] * c.tendon[h.TORQUE_GAIN, n]
        x.tendon[s.MEASURED_FORCE, n] = motor_torque / spool if is_measured else math.nan
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        excursion = 0.0
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            if c.tendon_joint_table[h.MOMENT_ARMS, n, j] != 0.0:
                excursion += joint_excursion(c, n, j, x.joint[s.MEASURED_JOINT, j])
        x.tendon[s.MEASURED_EXCURSION, n] = excursion


@kernel_helper
def is_cell_saturated(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if a load cell is at an end of its range.

    A load cell counts as saturated if its raw reading is at an end of the range, or if its tared
    reading is beyond any possible tension. Both the raw and the tared reading are tested, because
    the tare can hide a saturation in either reading.
    """
    tension = x.tendon[s.MEASURED_TENSION, n]
    is_out_of_range = tension >= c.run[h.CELL_SATURATION] or tension <= c.run[h.MIN_CELL_READING]
    return bool(is_out_of_range or x.tendon_int[s.IS_CELL_SATURATED, n])


@kernel_helper
def monitored_tension(x: StateTables, c: ConstantTables, n: int, is_tared: bool) -> float:
    """Return the tension that the detectors judge [N].

    The tension is the load-cell reading. For a tendon without load cell, the result is the
    estimated tension.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        is_tared: True if the zeros of the load cells are known.
    """
    if c.tendon_int[h.CELL_GROUP, n] < 0:
        return x.tendon[s.TENSION, n]
    return x.tendon[s.MEASURED_TENSION, n] if is_tared else math.nan


@kernel_helper
def start_filter(x: StateTables, c: ConstantTables) -> None:
    """Start the tension filter as soon as all encoders and load cells have been read.

    The first state of the filter assumes that the hand is open and its tendons are slack.
    """
    for n in range(x.tendon.shape[1]):
        group = c.tendon_int[h.CELL_GROUP, n]
        if (group >= 0 and x.group_int[s.GROUP_FRAME_COUNT, group] == 0) or math.isnan(
            x.tendon[s.POSITION, n]
        ):
            return
    for n in range(x.tendon.shape[1]):
        for state in range(7):
            x.tendon[s.SPOOL_TRAVEL + state, n] = 0.0
        x.tendon[s.EXCURSION, n] = c.tendon[h.OPEN_EXCURSION, n]
        x.tendon_int[s.DIGIT_ON_OPEN_STOP, n] = c.tendon_int[h.HAS_RETURN_SPRINGS, n]
        x.tendon[s.SPOOL_TRAVEL, n] = (
            x.tendon[s.POSITION, n] - c.tendon[h.MOTOR_ZERO, n]
        ) * c.tendon[h.SPOOL_RADIUS, n]
        if c.run_int[h.HAS_CARRIER_ARMS]:
            # The tendons of a digit that carries other digits come before the tendons of the
            # carried digits, so the joint angles of the carrying digit are known here.
            write_free_angles(x, c, s.EXCURSION, x.joint[s.Q])
            x.tendon[s.SPOOL_TRAVEL, n] -= carrier_excursion(c, n, x.joint[s.Q])
        if c.tendon_int[h.IS_SPOOL_PAIR, n]:
            x.tendon[s.EXCURSION, n] = x.tendon[s.SPOOL_TRAVEL, n]  # no stretch at zero net tension
    x.run_int[s.FILTER_STARTED] = 1
