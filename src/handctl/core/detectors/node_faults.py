"""Detectors of faults of drives and sensors, rows N01 to N17 of the fault catalogue, see ``safety.faults.node``."""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.detectors import residuals, stuck_sensors, torque_correlation
from handctl.core.detectors.bus_faults import EvidenceTable
from handctl.core.detectors.frame_losses import cell_ticks_overdue, misses_every_second_reply
from handctl.core.detectors.tendon_slip import DEG_PER_RAD
from handctl.core.state_block import StateTables
from handctl.drives.contract import DriveFaultCause, DrivePhase
from handctl.safety.faults.node import (
    N01_DRIVE_DROPPED_OUT,
    N02_SILENT_LOAD_CELLS,
    N02B_SILENT_JOINT_ENCODERS,
    N04_STUCK_ENCODER,
    N05A_ENCODER_JUMP,
    N05B_REPEATED_ENCODER_JUMPS,
    N06A_JOINT_SPOOL_MISMATCH,
    N06B_SLIPPING_ENCODER_OR_TENDON,
    N07_NOISY_ENCODER,
    N08_WATCHDOG_FIRED,
    N09A_WARM_DRIVE,
    N09B_OVERHEATED_DRIVE,
    N10_SUPPLY_VOLTAGE,
    N11_DRIVE_ERROR,
    N11B_UNKNOWN_DRIVE_ERROR,
    N12_CHANGED_SETTINGS,
    N13_SHARED_IDENTIFIER,
    N14_DISOBEYED_COMMAND,
    N14B_OSCILLATING_TENSION,
    N15_SLOW_NODE,
    N16_PULL_AFTER_CUT,
    N17_EXCHANGED_TORQUE_REPORTS,
    OSCILLATION_DURATION_S,
    RELEASED_SPOOL_TRAVEL_M,
    REPORTED_FORCE_AFTER_CUT_N,
    SLIP_TRIP_DEG,
    SLIP_WARN_DEG,
    STUCK_SENSOR_GOAL_CHANGE_M,
    STUCK_SENSOR_JOINT_CHANGE_DEG,
    STUCK_SENSOR_TENSION_CHANGE_N,
    STUCK_SENSOR_TIME_S,
    TENSION_AFTER_CUT_FRACTION,
    TENSION_AFTER_CUT_N,
    TENSION_AFTER_CUT_TIME_S,
    TORQUE_DIFFERENCE_LIMIT_FRACTION,
    TORQUE_DIFFERENCE_LIMIT_N,
)

_FAULT_ROW_BY_CAUSE = {
    DriveFaultCause.OTHER: N11_DRIVE_ERROR,
    DriveFaultCause.DROPPED_OUT: N01_DRIVE_DROPPED_OUT,
    DriveFaultCause.WATCHDOG: N08_WATCHDOG_FIRED,
    DriveFaultCause.VOLTAGE: N10_SUPPLY_VOLTAGE,
    DriveFaultCause.OVERHEATED: N11_DRIVE_ERROR,
    DriveFaultCause.SETTING_MISMATCH: N12_CHANGED_SETTINGS,
    DriveFaultCause.COMMUNICATION_LOST: N11_DRIVE_ERROR,
    DriveFaultCause.UNKNOWN: N11B_UNKNOWN_DRIVE_ERROR,
}
FAULT_ROW_BY_CAUSE_INDEX = tuple(_FAULT_ROW_BY_CAUSE[cause] for cause in sorted(DriveFaultCause))
"""Row of the evidence table for each value of ``drives.contract.DriveFaultCause``."""
FAULT_PHASE = int(DrivePhase.FAULT)
"""Value of ``drives.contract.DrivePhase.FAULT``."""


@kernel_helper
def detect_node_faults(
    x: StateTables, c: ConstantTables, is_armed: bool, evidence: EvidenceTable
) -> None:
    """Run the detectors that also work without motor torque, and write their results into the evidence table."""
    for n in range(x.tendon.shape[1]):
        if x.tendon[s.TEMPERATURE, n] > c.run[h.DERATING_START_TEMPERATURE]:
            evidence[N09A_WARM_DRIVE, n] = x.tendon[s.TEMPERATURE, n]
        if x.tendon[s.TEMPERATURE, n] > c.run[h.DERATING_END_TEMPERATURE]:
            evidence[N09B_OVERHEATED_DRIVE, n] = x.tendon[s.TEMPERATURE, n]
    _detect_rejected_positions(x, evidence)
    if not is_armed:
        return
    _detect_drive_errors(x, evidence)
    _detect_silent_sensors(x, c, evidence)
    for node in range(x.node_int.shape[1]):
        if misses_every_second_reply(x, node):
            evidence[N15_SLOW_NODE, node] = 0.5
        if x.node_int[s.DUPLICATE_REPLIES, node]:
            evidence[N13_SHARED_IDENTIFIER, node] = x.node_int[s.DUPLICATE_REPLIES, node] - 1.0


@kernel_helper
def _detect_drive_errors(x: StateTables, evidence: EvidenceTable) -> None:
    """Find the errors that drives report.

    Each cause of an error has its own row in the evidence table.
    """
    for n in range(x.tendon.shape[1]):
        if x.tendon_int[s.DRIVE_PHASE, n] == FAULT_PHASE:
            evidence[FAULT_ROW_BY_CAUSE_INDEX[x.tendon_int[s.FAULT_CAUSE, n]], n] = x.tendon_int[
                s.FAULT_CODE, n
            ]


@kernel_helper
def _detect_silent_sensors(x: StateTables, c: ConstantTables, evidence: EvidenceTable) -> None:
    """Find load cells and joint encoders whose last reading is too old."""
    now_ns = x.run_int[s.TICK_TIME_NS]
    for n in range(x.tendon.shape[1]):
        ticks_overdue = cell_ticks_overdue(x, c, n, now_ns)
        if ticks_overdue >= c.run_int[h.SILENT_TICKS]:
            evidence[N02_SILENT_LOAD_CELLS, n] = ticks_overdue
    last_group = -1
    for j in range(x.joint.shape[1]):
        group = c.joint_int[h.JOINT_GROUP, j]
        if group > last_group:  # a frame with several joints is tested once, for its first joint
            last_group = group
            last_frame_ns = x.group_int[s.GROUP_RECEIVED_NS, group]
            if last_frame_ns < now_ns - c.run_int[h.JOINT_SILENCE_NS]:
                evidence[N02B_SILENT_JOINT_ENCODERS, j] = (now_ns - last_frame_ns) * 1e-9


@kernel_helper
def _detect_rejected_positions(x: StateTables, evidence: EvidenceTable) -> None:
    """Find motors and joints whose measured positions were rejected.

    In the evidence table, the row for joints follows the row for motors.
    """
    for n in range(x.tendon.shape[1]):
        if x.tendon[s.REJECTED_MOTOR_STEP, n] > 0.0:
            evidence[N05A_ENCODER_JUMP, n] = x.tendon[s.REJECTED_MOTOR_STEP, n]
            if x.tendon[s.REJECTED_POSITION_COUNT, n] > 1.0:
                evidence[N05B_REPEATED_ENCODER_JUMPS, n] = x.tendon[s.REJECTED_MOTOR_STEP, n]
    for j in range(x.joint.shape[1]):
        if x.joint[s.REJECTED_JOINT_STEP, j] > 0.0:
            # A fault that can occur in motors and in joints has two rows of the evidence table: the
            # first row for motors, and the second row for joints.
            evidence[N05A_ENCODER_JUMP + 1, j] = x.joint[s.REJECTED_JOINT_STEP, j]
            if x.joint[s.REJECTED_ANGLE_COUNT, j] > 1.0:
                evidence[N05B_REPEATED_ENCODER_JUMPS + 1, j] = x.joint[s.REJECTED_JOINT_STEP, j]


@kernel_helper
def detect_node_faults_under_torque(
    x: StateTables, c: ConstantTables, evidence: EvidenceTable
) -> None:
    """Run the detectors that work only with motor torque, and write their results into the evidence table."""
    for n in range(x.tendon.shape[1]):
        slip = abs(x.tendon[s.RESIDUAL + residuals.SLIP, n])
        if slip > SLIP_WARN_DEG:
            evidence[N06A_JOINT_SPOOL_MISMATCH, n] = slip
        if slip > SLIP_TRIP_DEG:
            evidence[N06B_SLIPPING_ENCODER_OR_TENDON, n] = slip
        jerk = abs(x.tendon[s.RESIDUAL + residuals.JERK, n])
        if jerk > c.run[h.POSITION_NOISE_LIMIT]:
            evidence[N07_NOISY_ENCODER, n] = jerk
        command_difference = abs(x.tendon[s.RESIDUAL + residuals.COMMAND_DIFFERENCE, n])
        max_difference = min(
            TORQUE_DIFFERENCE_LIMIT_N,
            TORQUE_DIFFERENCE_LIMIT_FRACTION * c.tendon[h.DRIVE_TENSION_LIMIT, n],
        )
        if (
            command_difference > max_difference
            or torque_correlation.does_report_contradict_commands(x, c, n)
        ):
            evidence[N14_DISOBEYED_COMMAND, n] = command_difference
        if x.tendon[s.SWING_DURATION, n] > OSCILLATION_DURATION_S:
            evidence[N14B_OSCILLATING_TENSION, n] = math.sqrt(
                x.tendon[s.MEAN_SQUARE_TENSION_SWING, n]
            )
        if torque_correlation.is_torque_command_ignored(x, c, n):
            evidence[N17_EXCHANGED_TORQUE_REPORTS, n] = (
                torque_correlation.fraction_of_command_reported(x, n)
            )
    _detect_stuck_encoders(x, c, evidence)


@kernel_helper
def _detect_stuck_encoders(x: StateTables, c: ConstantTables, evidence: EvidenceTable) -> None:
    """Find encoders with a constant reading although their motor or joint moves.

    In the evidence table, the row for joints follows the row for motors.
    """
    for n in range(x.tendon.shape[1]):
        if (
            x.tendon_int[s.MOTOR_UNCHANGED_COUNT, n] * c.tendon[h.MOTOR_PERIOD, n]
            > STUCK_SENSOR_TIME_S
        ):
            goal = stuck_sensors.change_since_reading(
                x.tendon[s.FILTERED_GOAL, n], x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE, n]
            )
            tension = stuck_sensors.change_since_reading(
                stuck_sensors.reference_tension(x, c, n),
                x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE + 1, n],
            )
            if (
                goal > STUCK_SENSOR_GOAL_CHANGE_M and _overcomes_friction(c, n, goal)
            ) or tension > STUCK_SENSOR_TENSION_CHANGE_N:
                evidence[N04_STUCK_ENCODER, n] = max(goal * 1e3, tension)
    for j in range(x.joint.shape[1]):
        if x.joint_int[s.JOINT_UNCHANGED_COUNT, j] * c.run[h.JOINT_PERIOD] > STUCK_SENSOR_TIME_S:
            turned_angle = (
                stuck_sensors.change_since_reading(
                    stuck_sensors.joint_angle_by_spools(x, c, j),
                    x.joint[s.ANGLE_AT_LAST_JOINT_CHANGE, j],
                )
                / c.joint[h.JOINT_SCALE, j]
                * DEG_PER_RAD
            )
            if turned_angle > STUCK_SENSOR_JOINT_CHANGE_DEG:
                evidence[N04_STUCK_ENCODER + 1, j] = turned_angle


@kernel_helper
def _overcomes_friction(c: ConstantTables, n: int, goal_change: float) -> bool:
    """Return True if a change of the goal [m] moves the motor against its friction.

    Friction c can hold a motor at rest until the feedback force has changed by 2 c. With a soft
    position loop, the goal must move a long way to change the feedback force by 2 c. Position loops
    in drives are stiff.
    """
    if c.tendon_int[h.DRIVE_CLOSES_LOOP, n]:
        return True
    loop_stiffness = c.tendon[h.FEEDBACK_MASS, n] * c.tendon[h.EXCURSION_GAIN, n]
    return bool(goal_change * loop_stiffness > 2.0 * c.tendon[h.MOTOR_COULOMB_FRICTION, n])


@kernel_helper
def detect_tension_after_cut(x: StateTables, c: ConstantTables, evidence: EvidenceTable) -> None:
    """Find tendons that are still under tension after the motor torque was cut.

    The tension is visible in the load-cell reading or in the torque that the drive reports. A
    tendon can still be taut after its spool has paid it out, but then the motor no longer pulls.
    """
    if x.run_int[s.TICKS_SINCE_CUT] * c.run[h.CONTROL_PERIOD] < TENSION_AFTER_CUT_TIME_S:
        return
    for n in range(x.tendon.shape[1]):
        tension = x.tendon[s.TENSION_AFTER_CUT, n]
        if (
            tension > TENSION_AFTER_CUT_N
            and not _has_spool_paid_out(x, c, n)
            and tension > TENSION_AFTER_CUT_FRACTION * x.tendon[s.TENSION_AT_CUT, n]
        ):
            evidence[N16_PULL_AFTER_CUT, n] = tension
        elif _reports_torque_after_cut(x, c, n):
            evidence[N16_PULL_AFTER_CUT, n] = abs(x.tendon[s.MEASURED_FORCE, n])


@kernel_helper
def _has_spool_paid_out(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if a motor's encoder shows that the spool has paid out its tendon since the cut of the torque."""
    turned_angle = x.tendon[s.POSITION, n] - x.tendon[s.POSITION_AT_CUT, n]
    # The comparison with NaN is False, so a spool with an unknown position does not count as a
    # spool that has paid out its tendon.
    return bool(c.tendon[h.SPOOL_RADIUS, n] * turned_angle < -RELEASED_SPOOL_TRAVEL_M)


@kernel_helper
def _reports_torque_after_cut(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if the motor torque was cut, but the drive still reports a torque similar to the earlier torque."""
    # After a cut of the motor torque, a drive that reports its torque in a separate frame sends no
    # torque frames, so its last torque report is old.
    if not c.tendon_int[h.HAS_SINGLE_ANSWER, n]:
        return False
    # The last torque report before the cut of the torque is in RECENT_MOTOR_FORCES, which is
    # updated only while the motors are allowed to make torque.
    last_force = abs(x.tendon[s.RECENT_MOTOR_FORCES + 3, n])
    reported_force = abs(x.tendon[s.MEASURED_FORCE, n])
    # A drive that reports its torque in large steps can report one step although it makes no
    # torque.
    threshold = REPORTED_FORCE_AFTER_CUT_N + c.tendon[h.TORQUE_STEP, n]
    return reported_force > threshold and reported_force > TENSION_AFTER_CUT_FRACTION * last_force
