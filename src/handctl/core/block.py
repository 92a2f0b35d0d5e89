"""State block of a tick: every quantity with table, unit and meaning.

A tick copies the block of the last tick and writes into the copy. Results of the tick
(measurements, estimates, the command) are in the same block, so log, viewer and next tick read the
same data. ``state_tables`` gives compiled code the tables by name. See ``schema`` for the addressing of
rows.

Axes: tendon N (motors have the index of their tendon), joint J, digit D, coordinate C (reduced
coordinates of all digits), node N + 1 (motors, then the load cells), group G (frames of the sensor
node), instance (of a fault), run, of length 1, and servo: N if a drive of the hand closes a position
loop, else 0.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrow, inner
from handctl.core.schema import Block, Places, Schema

NAN = math.nan
AXES = ("tendon", "joint", "digit", "coordinate", "node", "group", "instance", "run", "servo")
"""Axes, in the order of the lengths at the start of a layout."""
TABLES = (
    "tendon", "joint", "digit", "coordinate", "run", "servo",
    "tendon_int", "joint_int", "digit_int", "node_int", "group_int", "instance_int", "run_int",
)  # fmt: skip

STATE = Schema(*TABLES, optional="servo")
_real = STATE.real
_whole = STATE.whole

# Tension filter. The seven states come first, so that they are one contiguous vector (7 N) for filterpy.
TRAVEL = _real("travel", "tendon", "m", "tendon wound at the spool, predicted to the present")
SPEED = _real("speed", "tendon", "m/s", "its rate")
EXCURSION = _real("excursion", "tendon", "m", "tendon excursion at the joints")
EXCURSION_RATE = _real("excursion_rate", "tendon", "m/s", "its rate")
DISTURBANCE = _real("disturbance", "tendon", "N", "force on the motor that the model lacks")
CELL_ERROR = _real("cell_error", "tendon", "N", "load-cell error, as last seen in slack")
STRETCH_OFFSET = _real("stretch_offset", "tendon", "m", "stretch offset")
FORCE = _real("force", "tendon", "N", "motor force commanded, friction taken off: the filter's first input")
RATE = _real("rate", "tendon", "N/s", "planned rate of the tension: the filter's second input")
COVARIANCE = _real("covariance", "tendon", "", "covariance of the seven states, row by row, while carried", rows=49)
SURPRISE = _real("surprise", "tendon", "", "last load-cell innovation by its standard deviation; 0 if there was none")
NIS_MEAN = _real("nis_mean", "tendon", "", "normalised innovation squared, averaged over 1 s", initial=2.0)
NIS_FAST = _real("nis_lately", "tendon", "", "the same by the undoubted model, averaged over 0.25 s", initial=2.0)
WARY = _real("wary", "tendon", "s", "time for which the filter still doubts its model")
REGIME = _whole("regime", "tendon", "", "0 free, 1 held, 2 slack", initial=2)
KIND = _whole("kind", "tendon", "", "regime, plus 3 while the filter doubts its model", initial=2)
KIND_BEFORE = _whole("kind_before", "tendon", "", "kind of the measurements that this tick judged", initial=2)
STOPPED = _whole("stopped", "tendon", "", "springs hold the digit on its open stop", initial=1)
TURNING = _whole("turning", "tendon", "", "evidence for leaving or entering slack, see take_up")
LENGTH_KNOWN = _whole("length_known", "tendon", "", "the tendon's length is known from a take-up")
DOUBTFUL = _whole("doubtful", "tendon", "", "the model does not fit")
CARRIED = _whole("carried", "run", "", "the covariance is carried along, because measurements were missing")
STARTED = _whole("started", "run", "", "encoder and load cell of every tendon were read once")

# Measurements of this tick, NaN where nothing came.
MEASURED_TRAVEL = _real("measured_travel", "tendon", "m", "encoder, at the spool", initial=NAN)
MEASURED_POSITION = _real("measured_position", "tendon", "rad", "encoder, at the spool", initial=NAN)
MEASURED_TENSION = _real("measured_tension", "tendon", "N", "load cell, tared", initial=NAN)
MEASURED_EXCURSION = _real("measured_excursion", "tendon", "m", "excursion by joint encoders", initial=NAN)
MEASURED_JOINT = _real("measured_joint", "joint", "rad", "joint encoder", initial=NAN)
MEASURED_FORCE = _real("measured_force", "tendon", "N", "force that the motor reports, at the spool", initial=NAN)
SATURATED = _whole("saturated", "tendon", "", "the load cell is at an end of its range")
JOINT_ANGLE = _real("joint_angle", "joint", "rad", "latest reading of the joint encoder", initial=NAN)
JOINTS_READ = _whole("joints_read", "run", "", "a joint encoder was read in this tick")
JUMP = _real("jump", "tendon", "rad", "step of a position that was dropped in this tick; 0 if none was")
JOINT_JUMP = _real("joint_jump", "joint", "rad", "the same of a joint encoder")
PROGRAM_TARE = _real("program_tare", "tendon", "N", "load-cell tare found in this run")

# Estimates of this tick.
TENSION = _real("tension", "tendon", "N", "tension at the load cell; 0 in slack")
SIGMA = _real("sigma", "tendon", "N", "its standard deviation", initial=NAN)
EXTERNAL = _real("external", "tendon", "N", "load force that the model lacks, positive against closing: contact")
INNOVATION = _real("innovation", "tendon", "N", "load cell less prediction; NaN if missing", initial=NAN)
NIS = _real("nis", "tendon", "", "normalised innovation squared; NaN if missing", initial=NAN)
Q = _real("q", "joint", "rad", "joint angle")
DQ = _real("dq", "joint", "rad/s", "joint rate")
Q_SIGMA = _real("q_sigma", "joint", "rad", "standard deviation of the joint angle", initial=NAN)
TOUCH = _real("touch", "digit", "N", "unexplained tension, the mean of a digit's tendons, smoothed")
BLOCKED = _whole("blocked", "digit", "", "the digit has met something that no program planned")
PRESSED = _real("pressed", "digit", "N", "tension of contact: rises at once, fades slowly")
TURN = _real("turn", "joint", "rad", "angle by which contact turns a joint")
TURN_SIGMA = _real("turn_sigma", "joint", "rad", "its standard deviation")
TIP_FORCE = _real("tip_force", "digit", "N", "tip-equivalent contact force, normal to the last link")
TIP_FORCE_SIGMA = _real("tip_force_sigma", "digit", "N", "its standard deviation")
CONTACT = _real("contact", "digit", "", "1 in contact, 0 not")
PLANNED_CONTACT = _whole("planned_contact", "digit", "", "the program knows that the digit touches")

# Contact of closing digits, and motion of a grip; see estimation.contact.
CLOSING = _whole("closing", "digit", "", "the program closes the digit until it touches")
SMOOTHED_TIP_FORCE = _real("felt", "digit", "N", "force at the tip of a closing digit, smoothed; 0 for the others")
TIP_FORCE_MEAN = _real("usual", "digit", "N", "its mean over a longer time; NaN before", initial=NAN)
DRIFT = _real("drift", "digit", "N", "its mean over all closing so far, which is the load cells' error", initial=NAN)
CONTACT_FORCE = _real("grown", "digit", "N", "what counts of the force felt")
GRIPPING = _whole("gripping", "run", "", "the program holds an object")
GRIP_READY = _real("grip_ready", "run", "s", "time of the program from which on slip is judged")
GRIP_FAST = _real("grip_fast", "tendon", "m", "tendon wound less stretch, quickly averaged")
GRIP_SLOW = _real("grip_slow", "tendon", "m", "the same, slowly averaged")

# Goals of the digits: what the control law follows.
GOAL_KIND = _whole("goal_kind", "tendon", "", "0 limp, 1 motion, 2 tension")
TRAJECTORY_KIND = _whole("way_kind", "digit", "", "0 none, 1 minimum jerk, 2 sampled by the program, 3 streamed")
TRAJECTORY_START = _real("way_start", "coordinate", "rad", "where a minimum-jerk move begins")
TRAJECTORY_END = _real("way_end", "coordinate", "rad", "where it ends")
TRAJECTORY_START_SPEED = _real("trajectory_start_speed", "coordinate", "rad/s", "rate at its beginning")
TRAJECTORY_START_ACCELERATION = _real("trajectory_start_acceleration", "coordinate", "rad/s2",
                                      "acceleration at its beginning")  # fmt: skip
TRAJECTORY_SINCE = _real("way_since", "digit", "s", "when it began, in time of the program")
TRAJECTORY_DURATION = _real("way_duration", "digit", "s", "how long it takes", initial=1.0)
TRAJECTORY_BLEND = _real("trajectory_blend", "digit", "s", "how long an earlier motion continues in it", initial=1.0)
TRAJECTORY = _real("way", "coordinate", "rad, /s, /s2", "position, rate and acceleration on the trajectory", rows=3)
TARGET = _real("target", "tendon", "N", "tension to approach")
TARGET_STEP = _real("target_step", "tendon", "N", "largest change of the setpoint in a tick")
FORCE_LIMIT = _real("force_limit", "tendon", "N", "largest motor force that the goal may use")
STIFFNESS_FRACTION = _real("stiffness_fraction", "tendon", "", "fraction of the motion loop's stiffness", initial=1.0)
DAMPING_FRACTION = _real("damping_fraction", "tendon", "", "fraction of its damping", initial=1.0)

# Stream of targets from a client, see ``law.stream``. Times are the run's.
STREAM_SEGMENT = _real("stream_segment", "coordinate", "rad .. rad/s5", "polynomial from the start to the target",
                       rows=6)  # fmt: skip
STREAM_TARGET = _real("stream_target", "coordinate", "rad", "latest target within the joints' range")
STREAM_TARGET_RATE = _real("stream_target_rate", "coordinate", "rad/s", "rate between the latest two targets")
STREAM_RANGE = _real("stream_range", "coordinate", "rad", "lowest and highest target", rows=2)
STREAM_SINCE = _real("stream_since", "run", "s", "start of the present segment")
STREAM_DURATION = _real("stream_duration", "run", "s", "time from its start to its target", initial=1.0)
STREAM_SENT_NS = _whole("stream_sent_ns", "run", "ns", "when the latest accepted target was sent")
STREAMING = _whole("streaming", "run", "", "1 a stream is open, 2 a target of it was accepted")
STREAM_SEQUENCE = _whole("stream_sequence", "run", "", "number of the latest accepted target; -1 before", initial=-1)
STREAM_ACCEPTED = _whole("stream_accepted", "run", "", "accepted targets of the stream")
STREAM_CLIPPED = _whole("stream_clipped", "run", "", "accepted targets that were clipped to the range")
STREAM_LATE = _whole("stream_late", "run", "", "ignored targets: repeated, overtaken or too old")
STREAM_REFUSED = _whole("stream_refused", "run", "", "refused targets: not numbers, or of a wrong shape")
STREAM_LIMITED = _whole("stream_limited", "run", "", "coordinates that the limits hold back in this tick")

# Control law.
SETPOINT = _real("setpoint", "tendon", "N", "present setpoint of the tension loop")
LOAD = _real("load", "tendon", "N", "tension at the joints that the trajectory asks for")
JOINT_REQUIRED = _real("joint_required", "joint", "N m", "joint torque that the trajectory asks for")
INTEGRAL = _real("integral", "tendon", "N", "its integral part")
PLANNED = _real("planned", "tendon", "N", "tension of a moving digit a period from now; 0 where nothing moves")
TRIM = _real("trim", "tendon", "N", "motor force that makes up for a change of gains, fading")
HOLD_LIMIT = _real("limit_held", "tendon", "N", "largest tension while safety holds", initial=NAN)
FRICTION_STATE = _real("friction_state", "tendon", "", "developed friction: 1 winding, -1 paying out; NaN unknown",
                       initial=NAN)  # fmt: skip
TRIMMED = _whole("trimmed", "run", "", "a trim is left")
HOLDING = _whole("holding", "run", "", "safety holds the hand")

# Command of this tick.
TORQUE = _real("torque", "tendon", "N m", "commanded motor torque, at the spool")
TENSION_GOAL = _real("tension_goal", "tendon", "N", "commanded tension; NaN where nothing is", initial=NAN)
JOINT_TORQUE = _real("joint_torque", "joint", "N m", "commanded joint torque")
Q_GOAL = _real("q_goal", "joint", "rad", "commanded joint angle; NaN for a digit in the tension loop", initial=NAN)
DQ_GOAL = _real("dq_goal", "joint", "rad/s", "its rate", initial=NAN)

# Command of this tick to a drive that closes the position loop by itself, see ``law.servo``.
SERVO_POSITION = _real("servo_position", "servo", "rad", "position to approach, at the spool")
SERVO_VELOCITY = _real("servo_velocity", "servo", "rad/s", "its rate")
SERVO_KP = _real("servo_kp", "servo", "N m/rad", "stiffness; 0 if the command is a torque only")
SERVO_KD = _real("servo_kd", "servo", "N m s/rad", "damping; 0 if the command is a torque only")
SERVO_TORQUE = _real("servo_torque", "servo", "N m", "torque that the drive adds")
SERVO_BEFORE = _real("servo_before", "servo", "", "the five numbers of the tick before", rows=5)
SERVO_SHARE = _real("servo_share", "servo", "", "fraction of recent ticks with kp > 0")
SERVO_REPORT = _real("servo_report", "servo", "N", "motor force to be reported now", initial=NAN)

# Drives: the values of their cyclic frames. Their set-up is in ``State.drives``.
POSITION = _real("position", "tendon", "rad", "motor position, at the spool; NaN before any feedback", initial=NAN)
VELOCITY = _real("velocity", "tendon", "rad/s", "motor velocity", initial=NAN)
REPORTED = _real("reported", "tendon", "N m", "motor torque that the drive reports", initial=NAN)
TEMPERATURE = _real("temperature", "tendon", "degC", "hottest sensor of the drive", initial=NAN)
FEEDBACK_NS = _whole("feedback_ns", "tendon", "ns", "reception of the latest feedback; -1 before", initial=-1)
FEEDBACKS = _whole("feedbacks", "tendon", "", "feedback frames so far")
ANSWERED = _whole("answered", "tendon", "", "feedback frames of this tick")
STATUS = _whole("status", "tendon", "", "status field of the latest feedback")
STATUS_EXPECTED = _whole("status_expected", "tendon", "", "status at which the state machine has nothing to do",
                         initial=-1)  # fmt: skip
DUE_NS = _whole("due_ns", "tendon", "ns", "when the drive's state machine must run next")
PHASE = _whole("phase", "tendon", "", "drives.contract.Phase")
PHASE_BEFORE = _whole("phase_before", "tendon", "", "the same before this tick")
EXCESS_REPLIES = _whole("surplus", "tendon", "", "one more than the open questions if more answers came; 0 if not")
FAULT_CODE = _whole("fault_code", "tendon", "", "error code of a drive in fault")
FAULT_CAUSE = _whole("fault_cause", "tendon", "", "drives.causes.Cause of it; -1 without fault", initial=-1)
MISREAD_NOW = _whole("misread_now", "node", "", "a frame of the node in this tick had a wrong shape")
DUPLICATES = _whole("twice", "node", "", "excess replies of this tick: 1 with equal bytes, 2 with other bytes")

# Numbers for the log alone.
MOTOR_AGE = _real("motor_age", "tendon", "s", "age of the latest feedback", initial=NAN)
DRIVE_PHASE = _real("drive_phase", "tendon", "", "drives.contract.Phase")
MOTOR_VELOCITY = _real("motor_velocity", "tendon", "rad/s", "motor velocity of this tick; NaN if none", initial=NAN)
MOTOR_TORQUE = _real("motor_torque", "tendon", "N m", "motor torque of this tick; NaN if none came", initial=NAN)

# Sensor node.
CELL = _real("cell", "tendon", "N", "latest load-cell reading, as it came")
CELL_FRESH = _whole("cell_fresh", "tendon", "", "the load cell was read in this tick")
JOINT_FRESH = _whole("joint_fresh", "joint", "", "the joint encoder was read in this tick")
GROUP_NS = _whole("group_ns", "group", "ns", "reception of the latest frame; -1 before", initial=-1)
GROUP_FRAMES = _whole("group_frames", "group", "", "frames accepted so far")
GROUP_ANSWERED = _whole("group_answered", "group", "", "frames accepted in this tick")
SYNC_COUNTER = _whole("sync_asked", "run", "", "low four bits of the last SYNC; -1 before", initial=-1)
SYNCS = _whole("syncs", "run", "", "SYNCs so far")
STALE = _whole("stale", "run", "", "frames of load cells or joints that answer an older SYNC")
TENSION_FRAMES = _whole("tension_frames", "run", "", "frames of load cells accepted so far")
STALE_NOW = _whole("stale_now", "run", "", "in this tick: 1 such a frame, 2 one that came after the fresh one")

# Monitor. From here to MONITOR_END everything begins anew when the hand is armed.
_MONITOR_FIRST = {table: STATE.rows(table) for table in TABLES}
ACCEPTED = _real("accepted", "tendon", "rad", "last motor position that was accepted", initial=NAN)
ACCEPTED_GAP = _real("accepted_gap", "tendon", "", "ticks by which it may be older than the last one")
DROPPED = _real("dropped", "tendon", "", "positions dropped in a row")
JOINT_ACCEPTED = _real("joint_accepted", "joint", "rad", "last joint angle that was accepted", initial=NAN)
JOINT_GAP = _real("joint_gap", "joint", "", "ticks by which it may be older than the last one")
JOINT_DROPPED = _real("joint_dropped", "joint", "", "joint angles dropped in a row")
RESIDUAL = _real("residual", "tendon", "", "low-passed residuals, see detectors.residuals", rows=8)
LAST_SPEED = _real("last_speed", "tendon", "m/s", "tendon speed of the last tick", initial=NAN)
LAST_POSITION = _real("last_position", "tendon", "rad", "motor position of the last tick", initial=NAN)
LAST_TURNED = _real("last_turned", "tendon", "rad", "motion of the motor in the last tick", initial=NAN)
FILTERED = _whole("filtered", "run", "", "the residuals have begun")
MOTOR_VALUE = _real("motor_value", "tendon", "m", "last reading of the encoder, for the stuck test", initial=NAN)
MOTOR_ANCHOR = _real("motor_anchor", "tendon", "m, N", "goal and tension when it last changed", rows=2, initial=NAN)
MOTOR_STUCK = _whole("motor_stuck", "tendon", "", "ticks for which it is the same")
CELL_VALUE = _real("cell_value", "tendon", "N", "last load-cell reading, for the stuck test", initial=NAN)
CELL_ANCHOR = _real("cell_anchor", "tendon", "N", "motor force when it last changed", initial=NAN)
CELL_STUCK = _whole("cell_stuck", "tendon", "", "ticks for which it is the same")
JOINT_VALUE = _real("joint_value", "joint", "rad", "last joint reading, for the stuck test", initial=NAN)
JOINT_ANCHOR = _real("joint_anchor", "joint", "rad", "angle by the spools when it last changed", initial=NAN)
JOINT_STUCK = _whole("joint_stuck", "joint", "", "ticks for which it is the same")
TAUT_S = _real("taut_s", "tendon", "s", "time for which the tendon has been taut")
IS_TAUT = _whole("bears", "tendon", "", "taut by its filtered tension, so that spool and joints move together")
SLIP_FROM = _real("slip_from", "tendon", "m", "joint against spool when the tendon became taut", initial=NAN)
SLIP = _real("slip", "tendon", "deg", "joint encoders against spool, as a mean joint angle", initial=NAN)
DERAILED = _real("derailed", "tendon", "", "readings in a row in which the two are further apart than any stretch")
COMMANDED_FORCE = _real("asked", "tendon", "N", "motor force that the last tick commanded; NaN if none", initial=NAN)
COMMANDED_TENSION = _real("wanted", "tendon", "N", "tension that the last tick commanded; NaN if none", initial=NAN)
FOLLOWED = _real("followed", "tendon", "m", "goal of the last tick, as a motor can follow it; NaN if none", initial=NAN)
TAUT_AGO = _whole("taut_ago", "tendon", "", "ticks since the tendon was taut; -1 if it was not since tension is wanted",
                  initial=-1)  # fmt: skip
SLACK_TICKS = _whole("slack_ticks", "tendon", "", "ticks for which it has been slack")
CUT_TICKS = _whole("cut_ticks", "run", "", "ticks since the torque was cut; -1 if it is not", initial=-1)
TENSION_AT_CUT = _real("cut_from", "tendon", "N", "tension back then; NaN if no load cell has told it yet", initial=NAN)
TENSION_AFTER_CUT = _real("cut_bears", "tendon", "N", "last reading well after the cut, NaN if none", initial=NAN)
PAST = _real("past", "tendon", "N", "load-cell readings of the last 64 ticks, the latest first", rows=64, initial=NAN)
READING = _real("reading", "tendon", "N", "load-cell reading that is compared with them", initial=NAN)
LONGEST = _whole("longest", "tendon", "", "longest run of equal readings")
SAME = _whole("same", "tendon", "", "readings in a row that were as so many ticks before", rows=64)
SWING_SLOW = _real("swing_slow", "tendon", "N", "slow part of the tension's deviation from its command")
SWING_SQUARE = _real("swing_square", "tendon", "N2", "mean square of the rest")
SWING_S = _real("swing_s", "tendon", "s", "time for which it has been large")
REPORT_FORCES = _real("report_forces", "tendon", "N", "last three commands and last report", rows=4, initial=NAN)
REPORT_MOMENTS = _real("report_moments", "tendon", "N2", "low-passed products of their increments", rows=5)
REPORT_ON_TIME = _real("report_on_time", "tendon", "", "ticks in a row in which the motor answered in time")
_MONITOR_END = {table: STATE.rows(table) for table in TABLES}

# Monitor, beyond arming.
LOST = _whole("lost", "node", "", "ticks without an answer, a bit each, of the last 50 and of the 50 before", rows=2)
MALFORMED = _whole("misshapen", "node", "", "ticks with a frame of a wrong shape, a bit each, of the last 20")
UNKNOWN = _real("unknown", "run", "1/s", "frames of unknown identifiers in about a second")
OUTSTANDING = _whole("open_questions", "tendon", "", "number of questions that the motor has not answered")
REQUEST_TICKS = _whole("question", "tendon", "", "ticks in which they were asked, the oldest first", rows=8)
FAULT_TICKS = _whole("fault_ticks", "instance", "", "consecutive ticks in which each fault is present", rows=64)

# Facts of this tick that detectors judge.
T_NS = _whole("t_ns", "run", "ns", "time of the tick")
LATE_NS = _whole("late_ns", "run", "ns", "how late the tick began")
MISSED = _whole("missed", "run", "", "ticks that were skipped before it")
FRAMES = _whole("frames", "run", "", "frames received")
UNKNOWN_FRAMES = _whole("strange", "run", "", "frames of unknown identifiers")
REFUSED = _whole("refused", "run", "", "malformed requests in the last second")
REFUSED_NOW = _whole("refused_now", "run", "", "requests refused in this tick")
CHANGED = _whole("changed", "run", "", "a doubt of the filter or a blocked digit has changed in this tick")
TARED = _whole("tared", "run", "", "the load cells' zero is known", initial=1)
FOUND_NOW = _whole("found_now", "run", "", "faults that began to count in this tick")

# The run.
K = _whole("k", "run", "", "number of the last tick; -1 before the first", initial=-1)
MODE = _whole("mode", "run", "", "core.types.Mode")
MODE_SINCE = _real("mode_since", "run", "s", "when the mode began")
GOAL_TIME = _real("goal_time", "run", "s", "time that the program was given; stands still while safety holds")
ARMED = _whole("armed", "run", "", "arming is requested")
CLEARING = _whole("clearing", "run", "", "what the drives have latched is being cleared, before they are armed")


class Tables(NamedTuple):
    """Tables of a block of ``STATE``, each (rows, length of the axis), ``run`` and ``run_int`` (rows,)."""

    tendon: NDArray[np.float64]
    joint: NDArray[np.float64]
    digit: NDArray[np.float64]
    coordinate: NDArray[np.float64]
    run: NDArray[np.float64]
    servo: NDArray[np.float64]
    tendon_int: NDArray[np.int64]
    joint_int: NDArray[np.int64]
    digit_int: NDArray[np.int64]
    node_int: NDArray[np.int64]
    group_int: NDArray[np.int64]
    instance_int: NDArray[np.int64]
    run_int: NDArray[np.int64]


@inner
def state_tables(block: Block, at: Places) -> Tables:
    """Return the tables of a block.

    Args:
        block: the state.
        at: ``Layout.places``.
    """
    whole = block.view(np.int64)
    return Tables(
        borrow(block, at[9], ((at[10] - at[9]) // at[0], at[0])),
        borrow(block, at[10], ((at[11] - at[10]) // at[1], at[1])),
        borrow(block, at[11], ((at[12] - at[11]) // at[2], at[2])),
        borrow(block, at[12], ((at[13] - at[12]) // at[3], at[3])),
        borrow(block, at[13], (at[14] - at[13],)),
        borrow(block, at[14], ((at[15] - at[14]) // max(at[8], 1), at[8])),
        borrow(whole, at[15], ((at[16] - at[15]) // at[0], at[0])),
        borrow(whole, at[16], ((at[17] - at[16]) // at[1], at[1])),
        borrow(whole, at[17], ((at[18] - at[17]) // at[2], at[2])),
        borrow(whole, at[18], ((at[19] - at[18]) // at[4], at[4])),
        borrow(whole, at[19], ((at[20] - at[19]) // at[5], at[5])),
        borrow(whole, at[20], ((at[21] - at[20]) // at[6], at[6])),
        borrow(whole, at[21], (at[22] - at[21],)),
    )


TENDON_FIRST = _MONITOR_FIRST["tendon"]
TENDON_END = _MONITOR_END["tendon"]
TENDON_INT_FIRST = _MONITOR_FIRST["tendon_int"]
TENDON_INT_END = _MONITOR_END["tendon_int"]
JOINT_FIRST = _MONITOR_FIRST["joint"]
JOINT_END = _MONITOR_END["joint"]
JOINT_INT_FIRST = _MONITOR_FIRST["joint_int"]
JOINT_INT_END = _MONITOR_END["joint_int"]
RUN_INT_FIRST, RUN_INT_END = _MONITOR_FIRST["run_int"], _MONITOR_END["run_int"]
"""Rows reset when the hand is armed."""


@inner
def reset_monitor(x: Tables, initial: Tables) -> None:
    """Reset what the fault detectors remember of a hand under torque."""
    for n in range(x.tendon.shape[1]):
        for row in range(TENDON_FIRST, TENDON_END):
            x.tendon[row, n] = initial.tendon[row, n]
        for row in range(TENDON_INT_FIRST, TENDON_INT_END):
            x.tendon_int[row, n] = initial.tendon_int[row, n]
    for j in range(x.joint.shape[1]):
        for row in range(JOINT_FIRST, JOINT_END):
            x.joint[row, j] = initial.joint[row, j]
        for row in range(JOINT_INT_FIRST, JOINT_INT_END):
            x.joint_int[row, j] = initial.joint_int[row, j]
    for row in range(RUN_INT_FIRST, RUN_INT_END):
        x.run_int[row] = initial.run_int[row]
