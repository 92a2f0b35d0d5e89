"""Detectors of the faults of tendons and load cells, rows T01 to T09 of the catalogue, see ``safety.faults.tendon``."""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import (
    NO_TRAJECTORY,
    TENSION,
    follows_streamed_angles,
    is_target_stream_running,
)
from handctl.core.detectors import residuals, stuck_sensors
from handctl.core.detectors.bus_faults import EvidenceTable
from handctl.core.detectors.replayed_readings import age_of_repeated_readings
from handctl.core.detectors.tendon_slip import derailment_threshold
from handctl.core.estimation.measurements import is_cell_saturated, monitored_tension
from handctl.core.estimation.varying_moment_arms import moment_arm
from handctl.core.state_block import StateTables
from handctl.core.tick_types import RELAX_MODE
from handctl.safety.faults.tendon import (
    DERAILED_READING_COUNT,
    EXCESS_FRICTION_WARN_N,
    EXCESS_TENSION_TRIP_N,
    FREE_SPOOL_SPEED_FRACTION,
    MIN_SNAP_SPOOL_SPEED,
    RELAXING_TIME_S,
    RESIDUAL_TRIP_N,
    RESIDUAL_WARN_N,
    SLACK_TRIP_S,
    SLACK_WARN_S,
    SNAP_MIN_COMMAND_N,
    SNAP_SPOOL_SPEED_M_PER_S,
    SNAP_SPOOL_SPEED_WITHOUT_CELL,
    SNAP_TENSION_FRACTION,
    STUCK_CELL_FORCE_RANGE_N,
    STUCK_CELL_READINGS,
    T01_SNAPPED_TENDON,
    T02A_SLACK_TENDON,
    T02B_LASTING_SLACK,
    T03_OVER_TENSION,
    T03B_TENSION_ABOVE_DRIVE_LIMIT,
    T03C_TENSION_AFTER_RELAXING,
    T04A_DRIFTING_LOAD_CELL,
    T04B_WRONG_LOAD_CELL,
    T05_STUCK_LOAD_CELL,
    T05B_OLD_LOAD_CELL_READINGS,
    T06_SATURATED_LOAD_CELL,
    T08_TENDON_OFF_PULLEY,
    T09_GROWN_FRICTION,
    TAUT_BEFORE_SNAP_TIME_S,
    TAUT_TENSION_N,
)


@kernel_helper
def detect_tendon_faults(
    x: StateTables, c: ConstantTables, is_armed: bool, evidence: EvidenceTable
) -> None:
    """Run the detectors that also work without motor torque, and write their results into the evidence table."""
    saturation_tension = c.run[h.CELL_SATURATION]
    time_in_mode_s = x.run_int[s.TICK_TIME_NS] * 1e-9 - x.run[s.MODE_START_TIME]
    is_hand_relaxed = x.run_int[s.HAND_MODE] == RELAX_MODE and time_in_mode_s > RELAXING_TIME_S
    for n in range(x.tendon.shape[1]):
        # The load-cell reading is tested even before the tare of the load cell is known.
        tension = monitored_tension(x, c, n, True)
        if c.tendon_int[h.IS_SPOOL_PAIR, n]:
            tension = abs(tension)  # both directions of a spool pair have the same limit
        if c.tendon[h.TENSION_TRIP, n] < tension < saturation_tension:
            evidence[T03_OVER_TENSION, n] = tension
        # A measured tension above the drive's torque limit proves that the drive does not obey this
        # limit. An estimated tension is no proof that the drive disobeys its torque limit.
        if (
            c.tendon[h.DRIVE_TENSION_LIMIT, n] < tension < saturation_tension
            and c.tendon_int[h.CELL_GROUP, n] >= 0
        ):
            evidence[T03B_TENSION_ABOVE_DRIVE_LIMIT, n] = tension
        if is_hand_relaxed and tension > c.tendon[h.TENSION_TRIP, n]:
            evidence[T03C_TENSION_AFTER_RELAXING, n] = tension
        if is_armed and is_cell_saturated(x, c, n):
            evidence[T06_SATURATED_LOAD_CELL, n] = tension


@kernel_helper
def detect_tendon_faults_under_torque(
    x: StateTables, c: ConstantTables, evidence: EvidenceTable
) -> None:
    """Run the detectors that work only with motor torque, and write their results into the evidence table."""
    for n in range(x.tendon.shape[1]):
        _detect_slack(x, c, n, evidence)
        unexplained_tension = residuals.unexplained_tension(x, c, n)
        excess_friction = residuals.excess_friction(x, n)
        if unexplained_tension > RESIDUAL_WARN_N:
            evidence[T04A_DRIFTING_LOAD_CELL, n] = unexplained_tension
        excess_tension = residuals.excess_tension(x, c, n)
        if unexplained_tension > RESIDUAL_TRIP_N or excess_tension > EXCESS_TENSION_TRIP_N:
            evidence[T04B_WRONG_LOAD_CELL, n] = max(unexplained_tension, excess_tension)
        if excess_friction > EXCESS_FRICTION_WARN_N:
            evidence[T09_GROWN_FRICTION, n] = excess_friction
        force_change = stuck_sensors.change_since_reading(
            x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE + 1, n],
            x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE, n],
        )
        is_reading_constant = x.tendon_int[s.CELL_UNCHANGED_COUNT, n] >= STUCK_CELL_READINGS
        if (
            is_reading_constant
            and force_change > STUCK_CELL_FORCE_RANGE_N
            and x.tendon[s.STUCK_TEST_TENSION, n] > TAUT_TENSION_N
        ):
            evidence[T05_STUCK_LOAD_CELL, n] = force_change
        age = age_of_repeated_readings(x, n)
        if age > 0:
            evidence[T05B_OLD_LOAD_CELL_READINGS, n] = age
        slip = abs(x.tendon[s.TENDON_SLIP, n])
        if x.tendon[
            s.DERAILED_READING_COUNT, n
        ] >= DERAILED_READING_COUNT and slip > derailment_threshold(c, n):
            evidence[T08_TENDON_OFF_PULLEY, n] = slip


@kernel_helper
def _planned_speed(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the speed of a tendon on the streamed trajectory of its joints [m/s].

    For a digit without a stream, the speed is 0. The detector subtracts the planned speed of a
    stream from the speed of the spool. The detector does not subtract the slow speed of a task's
    move, because the spool of a torn tendon follows the move. If the speed of a task's move were
    also subtracted, a torn tendon would be found half a second later, as a slack tendon (fault
    T02b).
    """
    speed = 0.0
    if not follows_streamed_angles(x, c, n):
        return speed
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        if not math.isnan(x.joint[s.DQ_GOAL, j]):
            speed += moment_arm(c, n, j, x.joint[s.Q_GOAL, j]) * x.joint[s.DQ_GOAL, j]
    return speed


@kernel_helper
def _snapped_speed_threshold(
    x: StateTables, c: ConstantTables, n: int, commanded_tension: float
) -> float:
    """Return the spool speed above which a tendon without tension counts as snapped [m/s].

    In a hold, the commanded tension is f, the tension gain is K, and the speed gain is K_v. A torn
    tendon has no tension. After a tear of the tendon, the tension loop makes the force f + K (f -
    0) - K_v v on the spool. The spool approaches the speed v at which the force of the tension loop
    equals the Coulomb friction c of the motor:

        v = ((1 + K) f - c) / K_v.

    For a small commanded tension, such as that of an extensor in a grasp, the speed v is below
    ``SNAP_SPOOL_SPEED_M_PER_S``. If v is below ``SNAP_SPOOL_SPEED_M_PER_S``, the threshold is a
    fraction of v. In a motion, the spool of a torn tendon has no final speed, because the position
    feedback also moves the spool. In a stream of tensions, the spool has no final speed either,
    because the targets can change in every tick.

    For a tendon without load cell, the tension is an estimate that follows the commanded tension
    with a delay. The threshold for a tendon without a load cell is larger. Without a load cell, two
    events look like a torn tendon for some ticks. A joint can overcome its friction and slip, or a
    target can reverse the direction of a spool pair.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        commanded_tension: commanded tension, positive [N].
    """
    if c.tendon_int[h.CELL_GROUP, n] < 0:
        return SNAP_SPOOL_SPEED_WITHOUT_CELL
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    is_holding = x.tendon_int[s.GOAL_KIND, n] == TENSION
    if (
        not is_holding
        or x.digit_int[s.TRAJECTORY_KIND, d] != NO_TRAJECTORY
        or is_target_stream_running(x)
    ):
        return SNAP_SPOOL_SPEED_M_PER_S
    damping = c.tendon[h.TENSION_SPEED_GAIN, n]
    force = (1.0 + c.tendon[h.TENSION_GAIN, n]) * commanded_tension - c.tendon[
        h.MOTOR_COULOMB_FRICTION, n
    ]
    # The comparison has no division, because the damping can be zero.
    if FREE_SPOOL_SPEED_FRACTION * force >= SNAP_SPOOL_SPEED_M_PER_S * damping:
        return SNAP_SPOOL_SPEED_M_PER_S
    return max(FREE_SPOOL_SPEED_FRACTION * force / damping, MIN_SNAP_SPOOL_SPEED)


@kernel_helper
def _detect_slack(x: StateTables, c: ConstantTables, n: int, evidence: EvidenceTable) -> None:
    """Find a tendon that does not have its commanded tension.

    After some time without tension, a tendon counts as slack (T02). If the spool of a tendon
    without tension turns fast, the tendon counts as snapped (T01).
    """
    period = c.run[h.CONTROL_PERIOD]
    commanded_tension = x.tendon[s.COMMANDED_TENSION, n]
    speed = x.tendon[s.SPOOL_SPEED, n]
    slack_time = x.tendon_int[s.SLACK_TICKS, n] * period
    if slack_time > SLACK_WARN_S:
        evidence[T02A_SLACK_TENDON, n] = slack_time
    if slack_time > SLACK_TRIP_S:
        evidence[T02B_LASTING_SLACK, n] = slack_time
    tension = monitored_tension(x, c, n, x.run_int[s.ARE_CELLS_TARED] == 1)
    planned_speed = _planned_speed(x, c, n)
    if c.tendon_int[h.IS_SPOOL_PAIR, n] and commanded_tension < 0.0:
        commanded_tension = -commanded_tension
        speed = -speed
        planned_speed = -planned_speed
        tension = -tension
    was_recently_taut = (
        0.0 <= x.tendon_int[s.TICKS_SINCE_TAUT, n] * period < TAUT_BEFORE_SNAP_TIME_S
    )
    unplanned_speed = speed - max(planned_speed, 0.0)
    if (
        unplanned_speed > _snapped_speed_threshold(x, c, n, commanded_tension)
        and commanded_tension > SNAP_MIN_COMMAND_N
        and tension < SNAP_TENSION_FRACTION * commanded_tension
        and was_recently_taut
    ):
        evidence[T01_SNAPPED_TENDON, n] = unplanned_speed
