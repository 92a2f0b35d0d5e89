"""Compiled stages of a tick.

Between the compiled stages, ``controller.tick`` makes decisions in Python.

The following list contains the stages in the order of their execution, each with its input and its
result:

begin      number and time of the tick -> state block, with the flags of received data reset
receive    frames -> values of drives and sensors, see ``wire.cyclic_frames``
observe    values -> measurements
correct    measurements -> filter states of the last tick, corrected
predict    corrected states -> states at the present, by ``filterpy``
conclude   states -> tensions, blocked digits, joint angles
judge      measurements and estimate -> faults
refer      goals -> required joint torques and tensions
act        required tensions, goals, estimate -> motor torques
send       motor torques -> frames, see ``wire.cyclic_frames``
store      commands -> memory for the next tick, numbers for the log

In most ticks, no state machine must handle a frame. The kernel ``receive_and_correct`` then executes
the stages from begin to correct. While the hand is active, the kernel ``command_active_hand`` executes
the stages refer, act and send.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrowed_array, kernel, kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import ConstantTables, constant_tables
from handctl.core.control_law import computed_torque, digit_reference
from handctl.core.detectors import fault_detection, outstanding_requests, stuck_sensors
from handctl.core.detectors.bus_faults import EvidenceTable
from handctl.core.estimation import (
    blocked_digits,
    contact_force,
    kalman,
    measurements,
    posture,
    varying_moment_arms,
)
from handctl.core.state_block import StateTables, state_tables, write_canonical_nan
from handctl.core.tick_types import ACTIVE_MODE, ARMING_MODE, DONE_MODE, RELAX_MODE, SILENT_MODE
from handctl.core.wire import cyclic_frames
from handctl.core.wire.wire_tables import IntArray, WordBlock, wire_tables
from handctl.drives.frame_records import WordRows
from handctl.safety.safety_action import SafetyAction

HOLD_ACTION = int(SafetyAction.HOLD)
"""Value of ``safety.safety_action.SafetyAction.HOLD``."""


@kernel("block", "layout", "count", "count", "count", "count", "count")
def begin_tick(
    block: BlockArray,
    at: TableOffsets,
    k: int,
    t_ns: int,
    lateness_ns: int,
    missed_ticks: int,
    frames: int,
) -> None:
    """Reset the flags of received data, and store the number and the time of the tick.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        k: number of the tick.
        t_ns: time of the tick [ns].
        lateness_ns: delay of the start of the tick [ns].
        missed_ticks: ticks missed before the present tick.
        frames: number of received frames.
    """
    _begin_tick(state_tables(block, at), k, t_ns, lateness_ns, missed_ticks, frames)


@kernel_helper
def _begin_tick(
    x: StateTables, k: int, t_ns: int, lateness_ns: int, missed_ticks: int, frames: int
) -> None:
    """Reset the flags of received data, see ``begin_tick``."""
    x.run_int[s.K] = k
    x.run_int[s.TICK_TIME_NS] = t_ns
    x.run_int[s.TICK_DELAY_NS] = lateness_ns
    x.run_int[s.MISSED_TICKS] = missed_ticks
    x.run_int[s.RECEIVED_FRAME_COUNT] = frames
    for n in range(x.tendon.shape[1]):
        x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n] = x.tendon_int[s.HAS_NEW_CELL_READING, n] = 0
        x.tendon_int[s.LAST_DRIVE_PHASE, n] = x.tendon_int[s.DRIVE_PHASE, n]
    for j in range(x.joint.shape[1]):
        x.joint_int[s.HAS_NEW_JOINT_READING, j] = 0
    for g in range(x.group_int.shape[1]):
        x.group_int[s.GROUP_FRAME_COUNT_IN_TICK, g] = 0
    for node in range(x.node_int.shape[1]):
        x.node_int[s.HAS_MALFORMED_FRAME, node] = x.node_int[s.DUPLICATE_REPLIES, node] = 0
    x.run_int[s.STALE_FRAME_STATE] = x.run_int[s.UNKNOWN_FRAME_COUNT] = 0
    x.run_int[s.REFUSED_REQUESTS_IN_TICK] = x.run_int[s.CONSISTENCY_CHANGED] = 0


@kernel("block", "layout", "count", "real", "real", "real", "real", *("count",) * 11)
def store_drive_values(
    block: BlockArray,
    at: TableOffsets,
    n: int,
    position: float,
    velocity: float,
    torque: float,
    temperature: float,
    feedback_t_ns: int,
    feedback_count: int,
    recheck_step: int,
    recheck_due_ns: int,
    recheck_tries: int,
    phase: int,
    fault_code: int,
    fault_cause: int,
    steady_status: int,
    due_ns: int,
    is_malformed: int,
) -> None:
    """Store the values of a drive after a step of its state machine.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        n: index of the drive.
        position: motor position, at the spool [rad].
        velocity: motor velocity, at the spool [rad/s].
        torque: torque that the drive reports [N m].
        temperature: temperature of the hottest sensor of the drive [degC].
        feedback_t_ns: reception time of the latest feedback [ns].
        feedback_count: number of feedback frames since the start of the run.
        recheck_step: index of the setting of the drive that is read again next.
        recheck_due_ns: time at which the next setting is requested [ns].
        recheck_tries: number of requests for the next setting that the drive has not answered.
        phase: ``drives.contract.DrivePhase`` of the drive.
        fault_code: error code of the drive.
        fault_cause: ``drives.contract.DriveFaultCause`` of the error code, -1 without a fault.
        steady_status: status that the drive reports while its state machine has nothing to do.
        due_ns: time at which the state machine of the drive must run next [ns].
        is_malformed: 1 if a frame of the drive in the present tick had a wrong shape.
    """
    x = state_tables(block, at)
    x.tendon[s.POSITION, n] = position
    x.tendon[s.VELOCITY, n] = velocity
    x.tendon[s.REPORTED_TORQUE, n] = torque
    x.tendon[s.TEMPERATURE, n] = temperature
    x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n] += feedback_count - x.tendon_int[s.FEEDBACK_COUNT, n]
    x.tendon_int[s.FEEDBACK_COUNT, n] = feedback_count
    x.tendon_int[s.FEEDBACK_RECEIVED_NS, n] = feedback_t_ns
    x.tendon_int[s.RECHECK_STEP, n] = recheck_step
    x.tendon_int[s.RECHECK_DUE_NS, n] = recheck_due_ns
    x.tendon_int[s.RECHECK_TRIES, n] = recheck_tries
    x.tendon_int[s.DRIVE_PHASE, n] = phase
    x.tendon_int[s.FAULT_CODE, n] = fault_code
    x.tendon_int[s.FAULT_CAUSE, n] = fault_cause
    x.tendon_int[s.EXPECTED_DRIVE_STATUS, n] = steady_status
    x.tendon_int[s.DRIVE_DUE_NS, n] = due_ns
    if is_malformed:
        x.node_int[s.HAS_MALFORMED_FRAME, n] = 1


@kernel("block", "layout", "count")
def read_drive_values(
    block: BlockArray, at: TableOffsets, n: int
) -> tuple[float, float, float, float, int, int, int, int, int]:
    """Return the numbers of a drive before a step of its state machine.

    The result contains position, velocity, torque, temperature, reception time and number of the
    feedback frames, and step, due time and tries of the repeated read-back, see
    ``store_drive_values``.
    """
    x = state_tables(block, at)
    return (
        float(x.tendon[s.POSITION, n]),
        float(x.tendon[s.VELOCITY, n]),
        float(x.tendon[s.REPORTED_TORQUE, n]),
        float(x.tendon[s.TEMPERATURE, n]),
        int(x.tendon_int[s.FEEDBACK_RECEIVED_NS, n]),
        int(x.tendon_int[s.FEEDBACK_COUNT, n]),
        int(x.tendon_int[s.RECHECK_STEP, n]),
        int(x.tendon_int[s.RECHECK_DUE_NS, n]),
        int(x.tendon_int[s.RECHECK_TRIES, n]),
    )


@kernel("block", "layout", "constants", "layout")
def observe_tick(
    block: BlockArray, at: TableOffsets, constants: BlockArray, constant_offsets: TableOffsets
) -> None:
    """Convert the values that were received in the present tick into measurements."""
    _observe_tick(state_tables(block, at), constant_tables(constants, constant_offsets))


@kernel_helper
def _observe_tick(x: StateTables, c: ConstantTables) -> None:
    """Convert received values into measurements, see ``observe_tick``."""
    measurements.write_measurements(x, c)
    if ARMING_MODE <= x.run_int[s.HAND_MODE] <= RELAX_MODE:
        measurements.reject_outliers(x, c, x.run_int[s.MISSED_TICKS])
    else:
        measurements.reset_rejected_steps(x)
    measurements.convert_positions(x, c)
    if not x.run_int[s.FILTER_STARTED]:
        measurements.start_filter(x, c)


@kernel("block", "layout", "constants", "layout")
def correct_tension_estimate(
    block: BlockArray, at: TableOffsets, constants: BlockArray, constant_offsets: TableOffsets
) -> None:
    """Correct the tension filter by the measurements, and judge the regime of each tendon."""
    _correct_tension_estimate(state_tables(block, at), constant_tables(constants, constant_offsets))


@kernel_helper
def _correct_tension_estimate(x: StateTables, c: ConstantTables) -> None:
    """Correct the tension filter, see ``correct_tension_estimate``."""
    if c.run_int[h.HAND_HAS_VARYING_ARM]:
        varying_moment_arms.update_moment_arm_tables(x, c)
    if x.run_int[s.FILTER_STARTED]:
        kalman.correct_tension_filter(x, c, x.run_int[s.MISSED_TICKS])
    else:
        kalman.write_estimate_before_start(x)


@kernel(
    "block", "layout", "constants", "layout", "frame_tables", "layout",
    "words", "count", "count", "count", "count", "count",
)  # fmt: skip
def receive_and_correct(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    table_words: WordBlock,
    table_offsets: TableOffsets,
    frame_rows: WordRows,
    k: int,
    t_ns: int,
    lateness_ns: int,
    missed_ticks: int,
    min_receive_ns: int,
) -> int:
    """Execute the stages begin, receive, observe and correct.

    A single kernel (compiled function) is faster than four. If a state machine must handle a frame,
    the kernel stops at this frame, and the remaining stages are not executed.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        constants: constants of the hand.
        constant_offsets: ``BlockLayout.offsets`` of the constants.
        table_words: ``WireBlock.words`` of the hand.
        table_offsets: ``WireBlock.offsets`` of the hand.
        frame_rows: (n, WORDS_PER_RECORD) records of frames.
        k: number of the tick.
        t_ns: time of the tick [ns].
        lateness_ns: delay of the start of the tick [ns].
        missed_ticks: ticks missed before the present tick.
        min_receive_ns: see ``cyclic_frames.receive_frames``.

    Returns:
        The result of ``cyclic_frames.receive_frames``.
    """
    x = state_tables(block, at)
    c = constant_tables(constants, constant_offsets)
    _begin_tick(x, k, t_ns, lateness_ns, missed_ticks, len(frame_rows))
    w = wire_tables(table_words, table_offsets)
    stop = cyclic_frames.decode_frames(x, c, w, frame_rows, 0, min_receive_ns)
    if stop == len(frame_rows):
        _observe_tick(x, c)
        _correct_tension_estimate(x, c)
    return stop


@kernel("block", "layout", "constants", "layout")
def conclude_estimate(
    block: BlockArray, at: TableOffsets, constants: BlockArray, constant_offsets: TableOffsets
) -> bool:
    """Compute the estimate of the tick from the predicted states of the tension filter.

    Return True if a node has sent more replies than it has received requests from this host.
    """
    x = state_tables(block, at)
    c = constant_tables(constants, constant_offsets)
    if c.run_int[h.HAND_HAS_VARYING_ARM]:
        varying_moment_arms.update_moment_arm_tables(x, c)
    kalman.derive_estimate(x, c)
    if x.run_int[s.HAND_MODE] == ACTIVE_MODE or x.run_int[s.HAND_MODE] == RELAX_MODE:
        blocked_digits.update_blocked_digits(x, c)
    else:
        blocked_digits.reset_blocked_digits(x)
    for j in range(x.joint.shape[1]):
        x.joint[s.Q_SIGMA, j] = math.nan
    if x.run_int[s.FILTER_STARTED]:
        posture.estimate_joint_angles(x, c, x.run_int[s.K], x.run_int[s.TICK_TIME_NS])
    contact_force.update_tip_forces(x, c)
    contact_force.update_grip_travel(x, c)
    return outstanding_requests.close_answered_requests(x, c)


@kernel("block", "layout", "constants", "layout", "constants", "results")
def find_faults(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    initial: BlockArray,
    evidence: EvidenceTable,
) -> int:
    """Find and debounce the faults of a tick, see ``detectors.fault_detection``.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        constants: constants of the hand.
        constant_offsets: ``BlockLayout.offsets`` of the constants.
        initial: state block before the first tick.
        evidence: (faults, instances) result: evidence of each fault.

    Returns:
        The most severe action of all active faults.
    """
    x = state_tables(block, at)
    c = constant_tables(constants, constant_offsets)
    evidence = borrowed_array(evidence, 0, evidence.shape)
    return fault_detection.find_and_debounce_faults(x, c, state_tables(initial, at), evidence)


@kernel("block", "layout", "constants", "layout", "count")
def evaluate_goals(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    action: int,
) -> int:
    """Evaluate the goals of all digits.

    The result has one bit for each digit. The bit of a digit is 1 if the bounded least-squares
    problem of the digit must still be solved.
    """
    return _evaluate_goals(
        state_tables(block, at), constant_tables(constants, constant_offsets), action
    )


@kernel_helper
def _evaluate_goals(x: StateTables, c: ConstantTables, action: int) -> int:
    """Evaluate the goals of all digits, see ``evaluate_goals``."""
    computed_torque.update_hold_limits(
        x, c, action == HOLD_ACTION and x.run_int[s.HAND_MODE] == ACTIVE_MODE
    )
    digit_reference.follow_trajectories(x, c, x.run_int[s.SAFETY_HOLD_ACTIVE] == 1)
    digit_reference.write_required_torque(x, c, digit_reference.joint_trajectories(x, c))
    return digit_reference.write_required_tensions(x, c)


@kernel("block", "layout", "constants", "layout")
def joint_motion(
    block: BlockArray, at: TableOffsets, constants: BlockArray, constant_offsets: TableOffsets
) -> NDArray[np.float64]:
    """Return angles, rates and accelerations (3, J) of all joints on their trajectories."""
    return digit_reference.joint_trajectories(
        state_tables(block, at), constant_tables(constants, constant_offsets)
    )


@kernel("block", "layout", "constants", "layout")
def write_loads(
    block: BlockArray, at: TableOffsets, constants: BlockArray, constant_offsets: TableOffsets
) -> int:
    """Convert the required joint torques into tensions, see ``digit_reference.write_required_tensions``."""
    return digit_reference.write_required_tensions(
        state_tables(block, at), constant_tables(constants, constant_offsets)
    )


@kernel("block", "layout", "constants", "layout", "real", "count", "count")
def compute_motor_torques(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    relax_rate: float,
    open_loop: int,
    elapsed_periods: int,
) -> None:
    """Compute the motor torques of the tick, see ``computed_torque``.

    The motor torques are 0 unless the hand is active or relaxing.
    """
    _compute_motor_torques(
        state_tables(block, at),
        constant_tables(constants, constant_offsets),
        relax_rate,
        open_loop,
        elapsed_periods,
    )


@kernel_helper
def _compute_motor_torques(
    x: StateTables, c: ConstantTables, relax_rate: float, open_loop: int, elapsed_periods: int
) -> None:
    """Compute the motor torques of the tick, see ``compute_motor_torques``."""
    if x.run_int[s.HAND_MODE] == ACTIVE_MODE or x.run_int[s.HAND_MODE] == RELAX_MODE:
        computed_torque.write_motor_torques(
            x,
            c,
            digit_reference.joint_trajectories(x, c),
            relax_rate,
            open_loop == 1,
            elapsed_periods,
        )
    else:
        computed_torque.command_zero_torque(x, c)


@kernel(
    "block", "layout", "constants", "layout", "frame_tables", "layout",
    "words", "count", "count",
)  # fmt: skip
def command_active_hand(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    table_words: WordBlock,
    table_offsets: TableOffsets,
    frame_rows: WordRows,
    action: int,
    elapsed_periods: int,
) -> tuple[int, int, int]:
    """Execute the stages refer, act and send for an active hand.

    A single kernel (compiled function) is faster than separate calls of ``evaluate_goals``,
    ``compute_motor_torques`` and ``cyclic_frames.encode_commands``. If a bounded least-squares
    problem must be solved after the evaluation of the goals, the remaining stages are not executed.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        constants: constants of the hand.
        constant_offsets: ``BlockLayout.offsets`` of the constants.
        table_words: ``WireBlock.words`` of the hand.
        table_offsets: ``WireBlock.offsets`` of the hand.
        frame_rows: (frames, WORDS_PER_RECORD) result: records of the commands, from row 1 on.
        action: reaction of the safety monitor, as a value of ``safety.safety_action.SafetyAction``.
        elapsed_periods: number of control periods since the last tick.

    Returns:
        The result of ``evaluate_goals``, 0 if the motor torques were computed. The two other
        numbers are the results of ``cyclic_frames.encode_commands``.
    """
    x = state_tables(block, at)
    c = constant_tables(constants, constant_offsets)
    unsolved_digits = _evaluate_goals(x, c, action)
    if unsolved_digits != 0:
        return unsolved_digits, 0, 1
    _compute_motor_torques(x, c, 0.0, 0, elapsed_periods)
    torque = np.empty(x.tendon.shape[1])
    for n in range(len(torque)):
        torque[n] = x.tendon[s.COMMANDED_TORQUE, n] / c.tendon[h.TORQUE_GAIN, n]
    w = wire_tables(table_words, table_offsets)
    n, count = cyclic_frames.write_commands(x, w, frame_rows, torque, 0, 1)
    return 0, n, count


@kernel("block", "layout", "constants", "layout", "keys", "block")
def store_commands(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    telemetry_elements: IntArray,
    telemetry: BlockArray,
) -> None:
    """Store the commands and requests for the next tick, and copy the telemetry from the state block.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        constants: constants of the hand.
        constant_offsets: ``BlockLayout.offsets`` of the constants.
        telemetry_elements: (m,) index of each number of the telemetry in the state block.
        telemetry: (m,) result: telemetry of the tick.
    """
    x = state_tables(block, at)
    c = constant_tables(constants, constant_offsets)
    mode = x.run_int[s.HAND_MODE]
    for n in range(x.tendon.shape[1]):
        x.tendon[s.COMMANDED_FORCE, n] = x.tendon[s.COMMANDED_TENSION, n] = math.nan
        if mode == ACTIVE_MODE or mode == RELAX_MODE:
            x.tendon[s.COMMANDED_FORCE, n] = (
                x.tendon[s.COMMANDED_TORQUE, n] / c.tendon[h.SPOOL_RADIUS, n]
            )
        if mode == ACTIVE_MODE:
            x.tendon[s.COMMANDED_TENSION, n] = x.tendon[s.TENSION_GOAL, n]
    if mode == ACTIVE_MODE:
        stuck_sensors.filter_goals(x, c)
    else:
        for n in range(x.tendon.shape[1]):
            x.tendon[s.FILTERED_GOAL, n] = math.nan
    if mode != SILENT_MODE and mode != DONE_MODE:
        outstanding_requests.add_requests(x)
    posture.estimate_tip_forces(x, c)
    for d in range(x.digit.shape[1]):
        has_contact = x.digit_int[s.PLANNED_CONTACT, d] == 1 or x.digit_int[s.IS_BLOCKED, d] == 1
        x.digit[s.IS_IN_CONTACT, d] = 1.0 if has_contact else 0.0
    now_ns = x.run_int[s.TICK_TIME_NS]
    for n in range(x.tendon.shape[1]):
        last_frame_ns = x.tendon_int[s.FEEDBACK_RECEIVED_NS, n]
        x.tendon[s.MOTOR_AGE, n] = (
            (now_ns - last_frame_ns) / 1e9 if last_frame_ns >= 0 else math.nan
        )
        x.tendon[s.LOGGED_DRIVE_PHASE, n] = x.tendon_int[s.DRIVE_PHASE, n]
        has_reading = not math.isnan(x.tendon[s.MEASURED_TRAVEL, n])
        x.tendon[s.MOTOR_VELOCITY, n] = x.tendon[s.VELOCITY, n] if has_reading else math.nan
        x.tendon[s.MOTOR_TORQUE, n] = x.tendon[s.REPORTED_TORQUE, n] if has_reading else math.nan
    write_canonical_nan(block, at)
    for i in range(len(telemetry)):
        telemetry[i] = block[telemetry_elements[i]]
