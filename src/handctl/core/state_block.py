"""Declaration of every quantity of the state block, with its table, unit and meaning.

Each tick passes the state block to the next tick.

Each tick copies the block of the last tick and writes into the copy. The state block contains the
measurements, estimates and commands of a tick, and the values that the next tick needs. The log,
the viewer and the next tick read the same numbers, because all of them read the state block.
``state_tables`` returns the tables of the block by name, for compiled code. The module
``block_schema`` explains how code addresses a row of a table.

Each table of the state block has one or more of the following axes. The capital letter or number
after the name of an axis is the length of the axis:

- tendon, N. A motor has the same index as its tendon.
- joint, J.
- digit, D.
- coordinate, C: the reduced coordinates of all digits.
- node, N + 1: the motors first, and then all load cells as one node.
- group, G: the frames in which the sensor node sends its readings.
- instance: the places in which a fault can occur: motors, tendons, joints or nodes. The length of
the axis ``instance`` is the largest number of motors, tendons, joints or nodes.
- run, 1: numbers that exist once for the whole hand.
- servo: N if any drive of the hand closes a position loop by itself, and 0 otherwise.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrowed_array, kernel_helper
from handctl.core.block_schema import BlockArray, BlockSchema, TableOffsets

NAN = math.nan
STATE_AXES = ("tendon", "joint", "digit", "coordinate", "node", "group", "instance", "run", "servo")
"""Names of the axes of the state block.

``BlockLayout.offsets`` begins with the lengths of the axes, in the order of their names.
"""
STATE_TABLES = (
    "tendon", "joint", "digit", "coordinate", "run", "servo",
    "tendon_int", "joint_int", "digit_int", "node_int", "group_int", "instance_int", "run_int",
)  # fmt: skip

STATE_SCHEMA = BlockSchema(*STATE_TABLES, optional_axis="servo")
_real_field = STATE_SCHEMA.declare_real_field
_integer_field = STATE_SCHEMA.declare_integer_field

# Tension filter. The seven states of each tendon are declared first, so that they form one
# contiguous vector (7 N) for filterpy.
SPOOL_TRAVEL = _real_field("travel", "tendon", "m",
    "length of tendon wound on the spool, predicted to the present")  # fmt: skip
SPOOL_SPEED = _real_field("speed", "tendon", "m/s", "rate of the travel")
EXCURSION = _real_field("excursion", "tendon", "m", "tendon excursion at the joints")
EXCURSION_RATE = _real_field("excursion_rate", "tendon", "m/s", "rate of the excursion")
MOTOR_DISTURBANCE = _real_field("disturbance", "tendon", "N",
    "force on the motor that the model does not explain")  # fmt: skip
CELL_ERROR = _real_field("cell_error", "tendon", "N",
    "load-cell error, as estimated when the tendon was last slack")  # fmt: skip
STRETCH_OFFSET = _real_field("stretch_offset", "tendon", "m",
    "travel less excursion at which the stretch begins")  # fmt: skip
FILTER_INPUT_FORCE = _real_field("force", "tendon", "N",
    "commanded motor force less motor friction: first input of the filter")  # fmt: skip
PLANNED_TENSION_RATE = _real_field("rate", "tendon", "N/s",
    "planned rate of the tension: second input of the filter")  # fmt: skip
COVARIANCE = _real_field("covariance", "tendon", "",
    "covariance of the seven states, row by row, while it is propagated", rows=49)  # fmt: skip
CELL_INNOVATION_SIGMAS = _real_field("surprise", "tendon", "",
    "last load-cell innovation in standard deviations; 0 without a reading")  # fmt: skip
NIS_MEAN = _real_field("nis_mean", "tendon", "",
    "normalised innovation squared, averaged over 1 s", initial=2.0)  # fmt: skip
RECENT_NIS_MEAN = _real_field("nis_lately", "tendon", "", initial=2.0,
    meaning="normalised innovation squared of the model without added noise, averaged over 0.25 s")  # fmt: skip
ADDED_NOISE_TIME_S = _real_field(
    "wary", "tendon", "s", "time for which the filter still adds process noise"
)
REGIME = _integer_field(
    "regime", "tendon", "", "regime of the tendon: 0 free, 1 held, 2 slack", initial=2
)
FILTER_KIND = _integer_field("kind", "tendon", "", initial=2,
    meaning="index of the filter design: the regime, plus 3 with added process noise")  # fmt: skip
LAST_FILTER_KIND = _integer_field("kind_before", "tendon", "",
    "index of the filter design for the measurements of this tick", initial=2)  # fmt: skip
DIGIT_ON_OPEN_STOP = _integer_field("stopped", "tendon", "",
    "1 if springs hold the digit on its open stop", initial=1)  # fmt: skip
REGIME_EVIDENCE = _integer_field("turning", "tendon", "",
    "evidence that the tendon becomes slack or taut, see slack_detection")  # fmt: skip
TENDON_LENGTH_KNOWN = _integer_field("length_known", "tendon", "",
    "1 after a take-up, which shows the length of the tendon")  # fmt: skip
MODEL_INCONSISTENT = _integer_field(
    "doubtful", "tendon", "", "1 if the mean NIS is too large for a correct model"
)
COVARIANCE_PROPAGATED = _integer_field("carried", "run", "",
    "1 while the covariance is propagated, because measurements were missing")  # fmt: skip
FILTER_STARTED = _integer_field("started", "run", "",
    "1 after the first reading of every encoder and load cell")  # fmt: skip

# Measurements of the present tick. A missing measurement is NaN.
MEASURED_TRAVEL = _real_field("measured_travel", "tendon", "m",
    "length of tendon wound on the spool, by the motor encoder", initial=NAN)  # fmt: skip
MEASURED_POSITION = _real_field("measured_position", "tendon", "rad",
    "motor position by its encoder, at the spool, less the motor zero", initial=NAN)  # fmt: skip
MEASURED_TENSION = _real_field("measured_tension", "tendon", "N",
    "load-cell reading less the tare", initial=NAN)  # fmt: skip
MEASURED_EXCURSION = _real_field("measured_excursion", "tendon", "m",
    "tendon excursion by the joint encoders", initial=NAN)  # fmt: skip
MEASURED_JOINT = _real_field("measured_joint", "joint", "rad",
    "joint angle by the joint encoder", initial=NAN)  # fmt: skip
MEASURED_FORCE = _real_field("measured_force", "tendon", "N",
    "motor force at the spool, from the torque that the drive reports", initial=NAN)  # fmt: skip
IS_CELL_SATURATED = _integer_field(
    "saturated", "tendon", "", "1 if the load cell is at an end of its range"
)
JOINT_ANGLE = _real_field("joint_angle", "joint", "rad",
    "latest reading of the joint encoder", initial=NAN)  # fmt: skip
HAS_ANY_JOINT_READING = _integer_field(
    "joints_read", "run", "", "1 if a joint encoder was read in this tick"
)
REJECTED_MOTOR_STEP = _real_field("jump", "tendon", "rad",
    "step of a motor position that this tick rejected; 0 if none")  # fmt: skip
REJECTED_JOINT_STEP = _real_field("joint_jump", "joint", "rad",
    "step of a joint angle that this tick rejected; 0 if none")  # fmt: skip
TARE_MEASURED_BY_PROGRAM = _real_field("program_tare", "tendon", "N",
    "load-cell tare that the program measured in this run")  # fmt: skip

# Estimates of the present tick.
TENSION = _real_field("tension", "tendon", "N", "tension at the load cell; 0 in slack")
TENSION_SIGMA = _real_field(
    "sigma", "tendon", "N", "standard deviation of the tension", initial=NAN
)
EXTERNAL_TENSION = _real_field("external", "tendon", "N",
    "load force that the model does not explain, positive against closing: contact")  # fmt: skip
INNOVATION = _real_field("innovation", "tendon", "N",
    "load-cell reading less its prediction; NaN if missing", initial=NAN)  # fmt: skip
NIS = _real_field("nis", "tendon", "", "normalised innovation squared; NaN if missing", initial=NAN)
Q = _real_field("q", "joint", "rad", "joint angle")
DQ = _real_field("dq", "joint", "rad/s", "joint rate")
Q_SIGMA = _real_field(
    "q_sigma", "joint", "rad", "standard deviation of the joint angle", initial=NAN
)
UNEXPLAINED_TENSION = _real_field("touch", "digit", "N",
    "unexplained tension, the mean over the tendons of a digit, low-passed")  # fmt: skip
IS_BLOCKED = _integer_field("blocked", "digit", "",
    "1 if the digit touches something that no program planned to touch")  # fmt: skip
CONTACT_TENSION = _real_field("pressed", "digit", "N",
    "tension of a contact, which rises at once and fades slowly")  # fmt: skip
CONTACT_TURN = _real_field("turn", "joint", "rad", "angle by which a contact turns the joint")
CONTACT_TURN_SIGMA = _real_field("turn_sigma", "joint", "rad",
    "standard deviation of the turn by contact")  # fmt: skip
TIP_FORCE = _real_field("tip_force", "digit", "N",
    "tip-equivalent contact force, normal to the last link")  # fmt: skip
TIP_FORCE_SIGMA = _real_field(
    "tip_force_sigma", "digit", "N", "standard deviation of the tip force"
)
IS_IN_CONTACT = _real_field("contact", "digit", "", "1 if the digit is in contact, else 0")
PLANNED_CONTACT = _integer_field("planned_contact", "digit", "",
    "1 if the program knows that the digit touches an object")  # fmt: skip

# Contact of closing digits, and motion of the tendons while the hand holds an object, see
# estimation.contact_force.
CLOSING_UNTIL_CONTACT = _integer_field(
    "closing", "digit", "", "1 while the program closes the digit until contact"
)
SMOOTHED_TIP_FORCE = _real_field("felt", "digit", "N",
    "force at the tip of a closing digit, low-passed over 5 ms; 0 for other digits")  # fmt: skip
TIP_FORCE_MEAN = _real_field("usual", "digit", "N", initial=NAN,
    meaning="mean force at the tip of a closing digit over 0.15 s; NaN for other digits")  # fmt: skip
TIP_FORCE_DRIFT = _real_field("drift", "digit", "N", initial=NAN,
    meaning="mean force at the tip over all closing so far, caused by errors of the load cells")  # fmt: skip
CONTACT_FORCE = _real_field("grown", "digit", "N",
    "smoothed force at the tip less a negative mean and a positive drift")  # fmt: skip
PROGRAM_HOLDS_OBJECT = _integer_field("gripping", "run", "", "1 while the program holds an object")
SLIP_DETECTION_START = _real_field(
    "grip_ready", "run", "s", "program time from which slip is judged"
)
FAST_GRIP_TRAVEL = _real_field("grip_fast", "tendon", "m",
    "length wound on the spool less stretch, averaged over 0.02 s")  # fmt: skip
SLOW_GRIP_TRAVEL = _real_field("grip_slow", "tendon", "m",
    "length wound on the spool less stretch, averaged over 0.2 s")  # fmt: skip

# Goals of the digits, for the control law.
GOAL_KIND = _integer_field(
    "goal_kind", "tendon", "", "type of control: 0 limp, 1 motion, 2 tension"
)
TRAJECTORY_KIND = _integer_field("way_kind", "digit", "",
    "type of trajectory: 0 none, 1 minimum jerk, 2 sampled by the program, 3 streamed")  # fmt: skip
TRAJECTORY_START = _real_field("way_start", "coordinate", "rad",
    "position at the start of a minimum-jerk move")  # fmt: skip
TRAJECTORY_END = _real_field(
    "way_end", "coordinate", "rad", "position at the end of a minimum-jerk move"
)
TRAJECTORY_START_SPEED = _real_field("trajectory_start_speed", "coordinate", "rad/s",
                               "rate at the start of a minimum-jerk move")  # fmt: skip
TRAJECTORY_START_ACCELERATION = _real_field("trajectory_start_acceleration", "coordinate", "rad/s2",
    "acceleration at the start of a minimum-jerk move")  # fmt: skip
TRAJECTORY_START_TIME = _real_field("way_since", "digit", "s",
    "program time at which the minimum-jerk move starts")  # fmt: skip
TRAJECTORY_DURATION = _real_field("way_duration", "digit", "s",
    "duration of the minimum-jerk move", initial=1.0)  # fmt: skip
TRAJECTORY_BLEND_TIME = _real_field("trajectory_blend", "digit", "s",
    "time in which an earlier motion fades during the minimum-jerk move", initial=1.0)  # fmt: skip
TRAJECTORY = _real_field("way", "coordinate", "rad, /s, /s2",
    "position, rate and acceleration on the trajectory", rows=3)  # fmt: skip
TENSION_TARGET = _real_field("target", "tendon", "N",
    "tension that the setpoint of the tension loop approaches")  # fmt: skip
TENSION_SETPOINT_STEP = _real_field("target_step", "tendon", "N",
    "largest change of the tension setpoint in a tick")  # fmt: skip
FORCE_LIMIT = _real_field("force_limit", "tendon", "N", "largest motor force that the goal allows")
STIFFNESS_FRACTION = _real_field("stiffness_fraction", "tendon", "",
    "fraction of the motion loop's stiffness that is used", initial=1.0)  # fmt: skip
DAMPING_FRACTION = _real_field("damping_fraction", "tendon", "",
    "fraction of the motion loop's damping that is used", initial=1.0)  # fmt: skip

# Stream of targets from a client, see ``control_law.streamed_motion``. The times of the stream are
# read from the clock of the run.
STREAM_SEGMENT = _real_field("stream_segment", "coordinate", "rad .. rad/s5",
    "coefficients of the polynomial from the reference to the target", rows=6)  # fmt: skip
STREAM_TARGET = _real_field("stream_target", "coordinate", "rad",
    "latest target, clipped to the range of the joints")  # fmt: skip
STREAM_TARGET_RATE = _real_field("stream_target_rate", "coordinate", "rad/s",
    "rate between the latest two targets")  # fmt: skip
STREAM_RANGE = _real_field("stream_range", "coordinate", "rad",
    "smallest and largest target within the range of the joints", rows=2)  # fmt: skip
STREAM_SEGMENT_START = _real_field(
    "stream_since", "run", "s", "time at which the present segment starts"
)
STREAM_DURATION = _real_field("stream_duration", "run", "s",
    "duration of the present segment", initial=1.0)  # fmt: skip
STREAM_SENT_NS = _integer_field("stream_sent_ns", "run", "ns",
    "time at which the latest accepted target was sent")  # fmt: skip
STREAM_STATE = _integer_field("streaming", "run", "",
    "1 if a stream is open, 2 after its first accepted target, else 0")  # fmt: skip
OPEN_STREAM, RUNNING_STREAM = 1, 2
"""Values of the field ``STREAM_STATE``."""
STREAM_SEQUENCE = _integer_field("stream_sequence", "run", "",
    "sequence number of the latest accepted target; -1 before the first", initial=-1)  # fmt: skip
ACCEPTED_TARGET_COUNT = _integer_field(
    "stream_accepted", "run", "", "number of accepted targets of the stream"
)
CLIPPED_TARGET_COUNT = _integer_field("stream_clipped", "run", "",
    "number of accepted targets that were clipped to the range")  # fmt: skip
LATE_TARGET_COUNT = _integer_field("stream_late", "run", "",
    "number of ignored targets: repeated, overtaken or too old")  # fmt: skip
REFUSED_TARGET_COUNT = _integer_field("stream_refused", "run", "",
    "number of refused targets: not numbers, or of a wrong shape")  # fmt: skip
LIMITED_COORDINATE_COUNT = _integer_field("stream_limited", "run", "",
    "number of coordinates that speed or acceleration limits hold back in this tick")  # fmt: skip

# Control law.
TENSION_SETPOINT = _real_field("setpoint", "tendon", "N", "present setpoint of the tension loop")
REQUIRED_TENSION = _real_field("load", "tendon", "N",
    "tension at the joints that the trajectory requires")  # fmt: skip
REQUIRED_JOINT_TORQUE = _real_field("joint_required", "joint", "N m",
    "joint torque that the trajectory requires")  # fmt: skip
TENSION_INTEGRAL = _real_field(
    "integral", "tendon", "N", "integral of the tension error, as a force"
)
PLANNED_TENSION = _real_field("planned", "tendon", "N",
    "planned tension of a moving tendon a period from now; 0 for other tendons")  # fmt: skip
TRIM_FORCE = _real_field("trim", "tendon", "N",
    "fading motor force that avoids a jump of the torque after a change of gains")  # fmt: skip
HOLD_TENSION_LIMIT = _real_field("limit_held", "tendon", "N",
    "largest tension while safety holds the hand", initial=NAN)  # fmt: skip
FRICTION_STATE = _real_field("friction_state", "tendon", "",
    "development of friction: 1 winding, -1 paying out; NaN if unknown", initial=NAN)  # fmt: skip
FRICTION_SLIDER = _real_field("friction_slider", "tendon", "m", initial=NAN,
    meaning="travel at which the friction element of a moving tendon has no tension; NaN if unknown")  # fmt: skip
TRIM_ACTIVE = _integer_field("trimmed", "run", "", "1 while a trim is not yet zero")
SAFETY_HOLD_ACTIVE = _integer_field("holding", "run", "", "1 while safety holds the hand")

# Motor commands of the present tick.
COMMANDED_TORQUE = _real_field("torque", "tendon", "N m", "commanded motor torque, at the spool")
TENSION_GOAL = _real_field("tension_goal", "tendon", "N",
    "commanded tension; NaN without a tension command", initial=NAN)  # fmt: skip
JOINT_TORQUE = _real_field("joint_torque", "joint", "N m", "commanded joint torque")
Q_GOAL = _real_field("q_goal", "joint", "rad",
    "commanded joint angle; NaN for a digit in the tension loop", initial=NAN)  # fmt: skip
DQ_GOAL = _real_field("dq_goal", "joint", "rad/s",
    "commanded joint rate; NaN for a digit in the tension loop", initial=NAN)  # fmt: skip

# Command of the present tick to each drive that closes the position loop by itself, see
# ``control_law.servo_commands``.
SERVO_POSITION = _real_field("servo_position", "servo", "rad",
    "position that the drive approaches, at the spool")  # fmt: skip
SERVO_VELOCITY = _real_field("servo_velocity", "servo", "rad/s",
    "velocity that the drive approaches, at the spool")  # fmt: skip
SERVO_KP = _real_field("servo_kp", "servo", "N m/rad",
    "stiffness of the drive's position loop; 0 for a torque command")  # fmt: skip
SERVO_KD = _real_field("servo_kd", "servo", "N m s/rad",
    "damping of the drive's position loop; 0 for a torque command")  # fmt: skip
SERVO_TORQUE = _real_field("servo_torque", "servo", "N m",
    "torque that the drive adds to that of its position loop")  # fmt: skip
SERVO_TORQUE_LIMIT = _real_field("servo_limit", "servo", "N m",
    "torque limit in the command; 0 for a drive whose commands contain none")  # fmt: skip
LAST_SERVO_COMMAND = _real_field("servo_before", "servo", "",
    "position as the drive has it now, velocity, kp, kd, torque and limit of the last command", rows=6)  # fmt: skip
POSITION_COMMAND_FRACTION = _real_field(
    "servo_share", "servo", "", "fraction of recent ticks with kp > 0"
)
EXPECTED_SERVO_FORCE = _real_field("servo_report", "servo", "N",
    "motor force that the drive should report in this tick", initial=NAN)  # fmt: skip

# Values of the drives, from their cyclic frames. The state of each drive's set-up is in
# ``ControllerState.drives``.
POSITION = _real_field("position", "tendon", "rad",
    "motor position, at the spool; NaN before any feedback", initial=NAN)  # fmt: skip
VELOCITY = _real_field("velocity", "tendon", "rad/s",
    "motor velocity, at the spool; NaN before any feedback", initial=NAN)  # fmt: skip
REPORTED_TORQUE = _real_field("reported", "tendon", "N m",
    "motor torque that the drive reports", initial=NAN)  # fmt: skip
TEMPERATURE = _real_field("temperature", "tendon", "degC",
    "temperature of the drive's hottest sensor", initial=NAN)  # fmt: skip
FEEDBACK_RECEIVED_NS = _integer_field("feedback_ns", "tendon", "ns",
    "reception time of the latest feedback; -1 before the first", initial=-1)  # fmt: skip
FEEDBACK_COUNT = _integer_field(
    "feedbacks", "tendon", "", "number of feedback frames since the start"
)
FEEDBACK_COUNT_IN_TICK = _integer_field(
    "answered", "tendon", "", "number of feedback frames in this tick"
)
DRIVE_STATUS = _integer_field("status", "tendon", "", "status field of the latest feedback")
EXPECTED_DRIVE_STATUS = _integer_field("status_expected", "tendon", "", initial=-1,
    meaning="status that needs no action of the drive's state machine; -1 for none")  # fmt: skip
DRIVE_DUE_NS = _integer_field(
    "due_ns", "tendon", "ns", "time at which the drive's state machine must run next"
)
DRIVE_PHASE = _integer_field("phase", "tendon", "", "phase of the drive, drives.contract.Phase")
LAST_DRIVE_PHASE = _integer_field(
    "phase_before", "tendon", "", "phase of the drive before this tick"
)
EXCESS_REPLY_COUNT = _integer_field("surplus", "tendon", "",
    "number of open requests plus 1 if more replies came than requests, else 0")  # fmt: skip
FAULT_CODE = _integer_field("fault_code", "tendon", "", "error code of a drive in fault")
FAULT_CAUSE = _integer_field("fault_cause", "tendon", "",
    "cause of the drive's fault, drives.causes.Cause; -1 without fault", initial=-1)  # fmt: skip
HAS_MALFORMED_FRAME = _integer_field("misread_now", "node", "",
    "1 if a frame of the node had a wrong shape in this tick")  # fmt: skip
DUPLICATE_REPLIES = _integer_field("twice", "node", "",
    "excess replies of this tick: 0 none, 1 with equal bytes, 2 with other bytes")  # fmt: skip

# Numbers that only the log uses.
MOTOR_AGE = _real_field("motor_age", "tendon", "s", "age of the latest feedback", initial=NAN)
LOGGED_DRIVE_PHASE = _real_field("drive_phase", "tendon", "",
    "phase of the drive, drives.contract.Phase, as a real number")  # fmt: skip
MOTOR_VELOCITY = _real_field("motor_velocity", "tendon", "rad/s",
    "motor velocity of this tick; NaN without feedback", initial=NAN)  # fmt: skip
MOTOR_TORQUE = _real_field("motor_torque", "tendon", "N m",
    "motor torque of this tick; NaN without feedback", initial=NAN)  # fmt: skip

# Sensor node.
CELL_READING = _real_field("cell", "tendon", "N", "latest load-cell reading, before the tare")
HAS_NEW_CELL_READING = _integer_field(
    "cell_fresh", "tendon", "", "1 if the load cell was read in this tick"
)
HAS_NEW_JOINT_READING = _integer_field(
    "joint_fresh", "joint", "", "1 if the joint encoder was read in this tick"
)
GROUP_RECEIVED_NS = _integer_field("group_ns", "group", "ns",
    "reception time of the latest frame of the group; -1 before the first", initial=-1)  # fmt: skip
GROUP_FRAME_COUNT = _integer_field("group_frames", "group", "",
    "number of accepted frames of the group since the start")  # fmt: skip
GROUP_FRAME_COUNT_IN_TICK = _integer_field("group_answered", "group", "",
    "number of accepted frames of the group in this tick")  # fmt: skip
SYNC_COUNTER = _integer_field("sync_asked", "run", "",
    "low four bits of the counter of the last SYNC; -1 before the first", initial=-1)  # fmt: skip
SYNC_COUNT = _integer_field("syncs", "run", "", "number of SYNCs sent since the start")
STALE_FRAME_COUNT = _integer_field("stale", "run", "",
    "number of sensor frames since the start that answered an older SYNC")  # fmt: skip
TENSION_FRAME_COUNT = _integer_field("tension_frames", "run", "",
    "number of accepted load-cell frames since the start")  # fmt: skip
STALE_FRAME_STATE = _integer_field("stale_now", "run", "",
    "1 if a sensor frame of this tick answered an older SYNC, 2 if after a fresh frame, else 0")  # fmt: skip

# Memory of the fault detectors. ``reset_monitor`` resets the fields from here to _MONITOR_END_ROWS.
_MONITOR_FIRST_ROWS = {table: STATE_SCHEMA.rows(table) for table in STATE_TABLES}
ACCEPTED_POSITION = _real_field("accepted", "tendon", "rad",
    "latest motor position that the outlier test accepted", initial=NAN)  # fmt: skip
ACCEPTED_POSITION_AGE = _real_field("accepted_gap", "tendon", "",
    "number of ticks before the last tick at which that position may have been measured")  # fmt: skip
REJECTED_POSITION_COUNT = _real_field("dropped", "tendon", "",
    "number of motor positions in a row that the outlier test rejected")  # fmt: skip
ACCEPTED_JOINT_ANGLE = _real_field("joint_accepted", "joint", "rad",
    "latest joint angle that the outlier test accepted", initial=NAN)  # fmt: skip
ACCEPTED_ANGLE_AGE = _real_field("joint_gap", "joint", "",
    "number of ticks before the last tick at which that angle may have been measured")  # fmt: skip
REJECTED_ANGLE_COUNT = _real_field("joint_dropped", "joint", "",
    "number of joint angles in a row that the outlier test rejected")  # fmt: skip
RESIDUAL = _real_field(
    "residual", "tendon", "", "low-passed residuals, see detectors.residuals", rows=9
)
LAST_SPEED = _real_field(
    "last_speed", "tendon", "m/s", "tendon speed of the last tick", initial=NAN
)
LAST_POSITION = _real_field("last_position", "tendon", "rad",
    "motor position of the last tick", initial=NAN)  # fmt: skip
LAST_POSITION_STEP = _real_field("last_turned", "tendon", "rad",
    "change of the motor position in the last tick", initial=NAN)  # fmt: skip
RESIDUALS_STARTED = _integer_field(
    "filtered", "run", "", "1 after the first update of the residuals"
)
STUCK_TEST_POSITION = _real_field("motor_value", "tendon", "m", initial=NAN,
    meaning="last reading of the motor encoder along the tendon, for the stuck test")  # fmt: skip
REFERENCE_AT_LAST_MOTOR_CHANGE = _real_field("motor_anchor", "tendon", "m, N", rows=2, initial=NAN,
    meaning="goal and tension when the reading of the motor encoder last changed")  # fmt: skip
MOTOR_UNCHANGED_COUNT = _integer_field("motor_stuck", "tendon", "",
    "number of readings since the motor encoder's reading last changed")  # fmt: skip
STUCK_TEST_TENSION = _real_field("cell_value", "tendon", "N",
    "last load-cell reading, for the stuck test", initial=NAN)  # fmt: skip
FORCE_RANGE_SINCE_CELL_CHANGE = _real_field("cell_anchor", "tendon", "N", rows=2, initial=NAN,
    meaning="smallest and largest motor force since the load-cell reading last changed")  # fmt: skip
CELL_UNCHANGED_COUNT = _integer_field("cell_stuck", "tendon", "",
    "number of readings since the load-cell reading last changed")  # fmt: skip
STUCK_TEST_ANGLE = _real_field("joint_value", "joint", "rad",
    "last reading of the joint encoder, for the stuck test", initial=NAN)  # fmt: skip
ANGLE_AT_LAST_JOINT_CHANGE = _real_field("joint_anchor", "joint", "rad",
    "joint angle by the spools when the joint reading last changed", initial=NAN)  # fmt: skip
JOINT_UNCHANGED_COUNT = _integer_field("joint_stuck", "joint", "",
    "number of readings since the joint encoder's reading last changed")  # fmt: skip
TAUT_TIME_S = _real_field("taut_s", "tendon", "s", "time for which the tendon has been taut")
IS_TAUT = _integer_field("bears", "tendon", "",
    "1 if taut by the filtered tension, so that spool and joints move together")  # fmt: skip
SLIP_REFERENCE = _real_field("slip_from", "tendon", "m", initial=NAN,
    meaning="travel less stretch and joint excursion, measured when the tendon became taut")  # fmt: skip
TENDON_SLIP = _real_field("slip", "tendon", "deg", initial=NAN,
    meaning="spool against joint encoders since the tendon became taut, as mean joint angle")  # fmt: skip
DERAILED_READING_COUNT = _real_field("derailed", "tendon", "",
    "number of readings in a row with more slip than any stretch explains")  # fmt: skip
COMMANDED_FORCE = _real_field("asked", "tendon", "N",
    "motor force that the last tick commanded; NaN without a command", initial=NAN)  # fmt: skip
COMMANDED_TENSION = _real_field("wanted", "tendon", "N",
    "tension that the last tick commanded; NaN without a command", initial=NAN)  # fmt: skip
FILTERED_GOAL = _real_field("followed", "tendon", "m",
    "goal of the excursion in the last tick, filtered to the speed of a motor; NaN without a goal",
    initial=NAN)  # fmt: skip
TICKS_SINCE_TAUT = _integer_field("taut_ago", "tendon", "", initial=-1,
    meaning="ticks since the tendon was last taut; -1 if never since a tension was commanded")  # fmt: skip
SLACK_TICKS = _integer_field("slack_ticks", "tendon", "",
    "number of ticks in a row for which the tendon has been slack")  # fmt: skip
TICKS_SINCE_CUT = _integer_field("cut_ticks", "run", "",
    "ticks since the torque was cut; -1 if it was not cut", initial=-1)  # fmt: skip
TENSION_AT_CUT = _real_field("cut_from", "tendon", "N",
    "tension when the torque was cut; NaN before a load cell was read", initial=NAN)  # fmt: skip
POSITION_AT_CUT = _real_field("cut_position", "tendon", "rad",
    "motor position when the torque was cut", initial=NAN)  # fmt: skip
TENSION_AFTER_CUT = _real_field("cut_bears", "tendon", "N", initial=NAN,
    meaning="latest tension at least 80 ms after the cut; NaN if none was measured")  # fmt: skip
PAST_CELL_READINGS = _real_field("past", "tendon", "N",
    "load-cell readings of the last 64 ticks, the latest first", rows=64, initial=NAN)  # fmt: skip
PRESENT_CELL_READING = _real_field("reading", "tendon", "N",
    "load-cell reading of this tick, compared with the past readings", initial=NAN)  # fmt: skip
LONGEST_READING_REPETITION = _integer_field("longest", "tendon", "",
    "longest run of repeated readings, over all ages")  # fmt: skip
REPEATED_READINGS_BY_AGE = _integer_field("same", "tendon", "", rows=64,
    meaning="for each age in ticks, readings in a row that equal the reading of that age")  # fmt: skip
SLOW_TENSION_DEVIATION = _real_field(
    "swing_slow", "tendon", "N", "slow part of measured less commanded tension"
)
MEAN_SQUARE_TENSION_SWING = _real_field("swing_square", "tendon", "N2",
    "mean square of measured less commanded tension, without its slow part")  # fmt: skip
SWING_DURATION = _real_field(
    "swing_s", "tendon", "s", "time for which the tension has oscillated strongly"
)
RECENT_MOTOR_FORCES = _real_field("report_forces", "tendon", "N", rows=4, initial=NAN,
    meaning="last three commanded forces and last reported force of the motor")  # fmt: skip
FORCE_INCREMENT_PRODUCTS = _real_field("report_moments", "tendon", "N2",
    "low-passed products of the increments of commanded and reported forces", rows=5)  # fmt: skip
REPLIES_ON_TIME = _real_field("report_on_time", "tendon", "",
    "number of ticks in a row in which the motor replied in time")  # fmt: skip
_MONITOR_END_ROWS = {table: STATE_SCHEMA.rows(table) for table in STATE_TABLES}

# Memory of the fault detectors that ``reset_monitor`` does not reset.
LOST_REPLY_BITS = _integer_field("lost", "node", "",
    "ticks without a reply, one bit each: the last 50, and the 50 before", rows=2)  # fmt: skip
MALFORMED_FRAME_TICKS = _integer_field("misshapen", "node", "",
    "ticks with a frame of a wrong shape, one bit each: the last 20")  # fmt: skip
UNKNOWN_FRAME_RATE = _real_field("unknown", "run", "1/s",
    "frames with unknown identifiers per second, averaged over about a second")  # fmt: skip
OPEN_REQUEST_BITS = _integer_field("open_requests", "tendon", "",
    "ticks whose request the motor has not answered, one bit each: the last 50, and the 50 before", rows=2)  # fmt: skip
RECHECK_STEP = _integer_field("recheck_step", "tendon", "",
    "index of the setting that is read again next from the enabled drive")  # fmt: skip
RECHECK_DUE_NS = _integer_field(
    "recheck_due_ns", "tendon", "ns", "time at which this setting is requested"
)
RECHECK_TRIES = _integer_field("recheck_tries", "tendon", "",
    "number of requests for this setting without an answer")  # fmt: skip
FAULT_TICKS = _integer_field("fault_ticks", "instance", "",
    "number of ticks in a row in which each fault is present", rows=64)  # fmt: skip

# Facts of the present tick that the fault detectors judge.
TICK_TIME_NS = _integer_field("t_ns", "run", "ns", "time of the tick")
TICK_DELAY_NS = _integer_field("late_ns", "run", "ns", "delay of the start of the tick")
MISSED_TICKS = _integer_field("missed", "run", "", "number of ticks skipped before this tick")
RECEIVED_FRAME_COUNT = _integer_field("frames", "run", "", "number of frames received in this tick")
UNKNOWN_FRAME_COUNT = _integer_field("strange", "run", "",
    "number of frames with unknown identifiers in this tick")  # fmt: skip
REFUSED_REQUESTS = _integer_field(
    "refused", "run", "", "number of malformed requests in the last second"
)
REFUSED_REQUESTS_IN_TICK = _integer_field(
    "refused_now", "run", "", "number of requests refused in this tick"
)
CONSISTENCY_CHANGED = _integer_field(
    "changed", "run", "", "1 if MODEL_INCONSISTENT or IS_BLOCKED changed in this tick"
)
ARE_CELLS_TARED = _integer_field(
    "tared", "run", "", "1 if the load cells' zero is known", initial=1
)
NEW_FAULT_COUNT = _integer_field(
    "found_now", "run", "", "number of faults that became active in this tick"
)

# State of the whole run.
K = _integer_field("k", "run", "", "number of the last tick; -1 before the first", initial=-1)
HAND_MODE = _integer_field("mode", "run", "", "mode of the hand, core.tick_types.HandMode")
MODE_START_TIME = _real_field("mode_since", "run", "s", "time at which the mode began")
GOAL_TIME = _real_field("goal_time", "run", "s",
    "time of the program, which stands still while safety holds the hand")  # fmt: skip
ARMING_REQUESTED = _integer_field("armed", "run", "", "1 if arming is requested")
CLEARING_DRIVE_ERRORS = _integer_field("clearing", "run", "",
    "1 while latched errors of the drives are cleared before arming")  # fmt: skip


class StateTables(NamedTuple):
    """Tables of a state block.

    The tables ``run`` and ``run_int`` have the shape (rows,). All other tables have the shape
    (rows, length of the axis).
    """

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


@kernel_helper
def state_tables(block: BlockArray, at: TableOffsets) -> StateTables:
    """Return the tables of a state block.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the layout of the block.
    """
    integer_view = block.view(np.int64)
    return StateTables(
        borrowed_array(block, at[9], ((at[10] - at[9]) // at[0], at[0])),
        borrowed_array(block, at[10], ((at[11] - at[10]) // at[1], at[1])),
        borrowed_array(block, at[11], ((at[12] - at[11]) // at[2], at[2])),
        borrowed_array(block, at[12], ((at[13] - at[12]) // at[3], at[3])),
        borrowed_array(block, at[13], (at[14] - at[13],)),
        borrowed_array(block, at[14], ((at[15] - at[14]) // max(at[8], 1), at[8])),
        borrowed_array(integer_view, at[15], ((at[16] - at[15]) // at[0], at[0])),
        borrowed_array(integer_view, at[16], ((at[17] - at[16]) // at[1], at[1])),
        borrowed_array(integer_view, at[17], ((at[18] - at[17]) // at[2], at[2])),
        borrowed_array(integer_view, at[18], ((at[19] - at[18]) // at[4], at[4])),
        borrowed_array(integer_view, at[19], ((at[20] - at[19]) // at[5], at[5])),
        borrowed_array(integer_view, at[20], ((at[21] - at[20]) // at[6], at[6])),
        borrowed_array(integer_view, at[21], (at[22] - at[21],)),
    )


@kernel_helper
def write_canonical_nan(block: BlockArray, at: TableOffsets) -> None:
    """Replace every NaN in the tables of real numbers by the NaN of ``math.nan``.

    An invalid operation can return a NaN with another sign bit, and the sign depends on the order
    of the operands. The compiler is allowed to exchange the operands. Without the replacement of
    NaN, the hash of a state with NaN could differ between compiled and interpreted code.

    Args:
        block: state block, modified in place.
        at: ``BlockLayout.offsets`` of the layout of the block.
    """
    # The tables of real numbers are at the start of the block. The loop begins at 0 and always
    # writes, so that the compiler can handle several numbers at once. A loop that does not always
    # write takes ten times as long.
    for i in range(at[15]):
        value = block[i]
        block[i] = math.nan if math.isnan(value) else value


RESET_TENDON_ROWS = _MONITOR_FIRST_ROWS["tendon"], _MONITOR_END_ROWS["tendon"]
RESET_TENDON_INTEGER_ROWS = _MONITOR_FIRST_ROWS["tendon_int"], _MONITOR_END_ROWS["tendon_int"]
RESET_JOINT_ROWS = _MONITOR_FIRST_ROWS["joint"], _MONITOR_END_ROWS["joint"]
RESET_JOINT_INTEGER_ROWS = _MONITOR_FIRST_ROWS["joint_int"], _MONITOR_END_ROWS["joint_int"]
RESET_RUN_INTEGER_ROWS = _MONITOR_FIRST_ROWS["run_int"], _MONITOR_END_ROWS["run_int"]
"""For each table, the first row that ``reset_monitor`` resets, and the row after the last reset row."""


@kernel_helper
def reset_monitor(x: StateTables, initial: StateTables) -> None:
    """Reset the stored values of the fault detectors that run while the motors are allowed to make torque."""
    for n in range(x.tendon.shape[1]):
        for row in range(RESET_TENDON_ROWS[0], RESET_TENDON_ROWS[1]):
            x.tendon[row, n] = initial.tendon[row, n]
        for row in range(RESET_TENDON_INTEGER_ROWS[0], RESET_TENDON_INTEGER_ROWS[1]):
            x.tendon_int[row, n] = initial.tendon_int[row, n]
    for j in range(x.joint.shape[1]):
        for row in range(RESET_JOINT_ROWS[0], RESET_JOINT_ROWS[1]):
            x.joint[row, j] = initial.joint[row, j]
        for row in range(RESET_JOINT_INTEGER_ROWS[0], RESET_JOINT_INTEGER_ROWS[1]):
            x.joint_int[row, j] = initial.joint_int[row, j]
    for row in range(RESET_RUN_INTEGER_ROWS[0], RESET_RUN_INTEGER_ROWS[1]):
        x.run_int[row] = initial.run_int[row]
