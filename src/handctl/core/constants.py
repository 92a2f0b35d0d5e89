"""Constants of a hand for compiled code.

The constants of a hand are in a block of their own, separate from the state block.

``HandConstants`` fills the block of constants from a ``HandModel``, from drives and from sensors.
``constant_tables`` returns the tables of constants by name, for compiled code. A change of gains
needs a new block of constants.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrowed_array, kernel_helper
from handctl.core.block_schema import BlockArray, BlockSchema, TableOffsets
from handctl.hand import rigid_body
from handctl.hand.file.quantity_types import POLYNOMIAL_COEFFICIENTS

CONSTANT_AXES = ("tendon", "joint", "digit", "coordinate", "kind", "element", "place", "run")
CONSTANT_TABLES = (
    "tendon", "joint", "run", "joint*tendon", "tendon*joint", "joint*joint", "joint*coordinate",
    "tendon*coordinate", "place*joint", "tendon*kind*element",
    "tendon_int", "joint_int", "digit_int", "run_int",
)  # fmt: skip

CONSTANT_SCHEMA = BlockSchema(*CONSTANT_TABLES)
_real_field = CONSTANT_SCHEMA.declare_real_field
_integer_field = CONSTANT_SCHEMA.declare_integer_field

# Tendons and motors. Quantities of motors are converted to forces and lengths at the spool.
MOTOR_MASS = _real_field("motor_mass", "tendon", "kg", "reflected rotor inertia")
MOTOR_DAMPING = _real_field("motor_damping", "tendon", "N s/m", "viscous friction of the motor")
MOTOR_COULOMB_FRICTION = _real_field("coulomb", "tendon", "N", "Coulomb friction of the motor")
TENDON_STIFFNESS = _real_field("stiffness", "tendon", "N/m", "stiffness of the tendon")
LOAD_STIFFNESS = _real_field("load_stiffness", "tendon", "N/m",
    "stiffness of the return springs along the tendon")  # fmt: skip
LOAD_DAMPING = _real_field(
    "load_damping", "tendon", "N s/m", "damping of the joints along the tendon"
)
SPOOL_RADIUS = _real_field("spool", "tendon", "m", "radius of the spool")
CELL_TARE = _real_field("tare", "tendon", "N", "tare of the load cell")
MOTOR_ZERO = _real_field("zero", "tendon", "rad", "motor position at which the travel is zero")
CAPSTAN_COEFFICIENT = _real_field("capstan", "tendon", "", "friction coefficient of the pulleys")
WRAP_ANGLE = _real_field("wrap", "tendon", "rad", "wrap angle before the first joint pulley")
TENSION_FLOOR = _real_field("floor", "tendon", "N", "smallest tension of the control law")
TENSION_CEILING = _real_field("ceiling", "tendon", "N", "largest tension of the control law")
TORQUE_GAIN = _real_field("torque_gain", "tendon", "",
    "torque at the spool divided by the torque that the drive is commanded")  # fmt: skip
DIGIT_OF_TENDON = _integer_field("digit", "tendon", "", "index of the tendon's digit")
CLOSING_SIGN = _real_field("side", "tendon", "",
    "1 for a tendon that closes its digit, -1 for one that opens it")  # fmt: skip
OPEN_EXCURSION = _real_field("open_excursion", "tendon", "m", "excursion at the lower joint limits")
MIN_EXCURSION = _real_field(
    "excursion_low", "tendon", "m", "smallest excursion within the joint limits"
)
MAX_EXCURSION = _real_field(
    "excursion_high", "tendon", "m", "largest excursion within the joint limits"
)
MARGIN_WITHOUT_CELL = _real_field("blind", "tendon", "N",
    "margin of limits for a tension estimated without load cell; 0 with load cell")  # fmt: skip
RELAXED_TENSION = _real_field("relaxed", "tendon", "N", "tension of a relaxed hand")
BALANCE_TENSION = _real_field("balance", "tendon", "N",
    "tension in the digit's null space, without torque; 0 without surplus tendons")  # fmt: skip
PRETENSION = _real_field("pretension", "tendon", "N",
    "pretension of both tendons of a spool pair; 0 for a single tendon")  # fmt: skip
IS_SPOOL_PAIR = _integer_field("pair", "tendon", "",
    "1 for two antagonistic tendons on one spool, whose net tension has both signs")  # fmt: skip
HAS_RETURN_SPRINGS = _integer_field("sprung", "tendon", "",
    "1 if springs return the digit to its lower joint limits")  # fmt: skip
IS_REDUNDANT_DIGIT = _integer_field(
    "redundant", "tendon", "", "1 if the digit has more tendons than coordinates"
)
HAS_CONSTANT_LENGTH = _integer_field("absolute", "tendon", "",
    "1 if the tendon keeps its length when it becomes taut, so that its excursion follows")  # fmt: skip

# Control law.
MAX_MOTOR_FORCE = _real_field("limit", "tendon", "N", "largest motor force")
MIN_MOTOR_FORCE = _real_field("unwind", "tendon", "N", "smallest motor force")
FEEDBACK_MASS = _real_field("mass", "tendon", "kg", "mass that the feedback accelerates")
FEEDFORWARD_MASS = _real_field("inertia", "tendon", "kg",
    "mass for which the trajectory's acceleration is fed forward")  # fmt: skip
EXCURSION_GAIN = _real_field(
    "error_gain", "tendon", "1/s2", "motion loop: acceleration per excursion error"
)
SPEED_GAIN = _real_field("speed_gain", "tendon", "1/s", "motion loop: acceleration per speed error")
TENSION_GAIN = _real_field("tension_gain", "tendon", "", "tension loop: force per newton of error")
TENSION_SPEED_GAIN = _real_field(
    "tension_speed_gain", "tendon", "N s/m", "tension loop: force per speed"
)
HALF_PERIOD_SPEED = _real_field("half", "tendon", "m/(N s)",
    "speed that a force of 1 N gives the rotor in half a period")  # fmt: skip
FRICTION_STOP_SPEED = _real_field("stopping", "tendon", "m/s",
    "scale of speeds that motor friction stops within a period")  # fmt: skip
DRIVE_CLOSES_LOOP = _integer_field("servo", "tendon", "",
    "1 if the drive closes the position loop of a motion")  # fmt: skip
DRIVE_MOVES_TARGET = _integer_field("servo_moves", "tendon", "",
    "1 if the drive moves the commanded position with the commanded velocity")  # fmt: skip
SERVO_STIFFNESS = _real_field(
    "servo_stiffness", "tendon", "N m/rad", "kp of the drive's position loop"
)
SERVO_DAMPING = _real_field(
    "servo_damping", "tendon", "N m s/rad", "kd of the drive's position loop"
)
SERVO_KP_STEP = _real_field("servo_kp_step", "tendon", "N m/rad",
    "resolution of kp in the command", initial=1.0)  # fmt: skip
SERVO_KD_STEP = _real_field("servo_kd_step", "tendon", "N m s/rad",
    "resolution of kd in the command", initial=1.0)  # fmt: skip
SERVO_KP_MAX = _real_field("servo_kp_max", "tendon", "N m/rad",
    "largest kp in the command", initial=math.inf)  # fmt: skip
SERVO_KD_MAX = _real_field("servo_kd_max", "tendon", "N m s/rad",
    "largest kd in the command", initial=math.inf)  # fmt: skip
SERVO_ROUNDING_FORCE = _real_field("servo_rounding", "tendon", "N",
    "force of the drive's position loop for one count of position and speed")  # fmt: skip
HAS_UNIQUE_TENSIONS = _integer_field("exact", "tendon", "",
    "1 if a joint torque determines the tensions of the digit")  # fmt: skip
DISTURBANCE_REJECTION = _real_field("rejection", "run", "",
    "fraction of the estimated motor disturbance that is cancelled")  # fmt: skip
FRICTION_FRACTION = _real_field("friction_fraction", "run", "",
    "fraction of pulley and motor friction that is compensated")  # fmt: skip
TENSION_FEEDBACK = _real_field("tension_feedback", "run", "",
    "gain of the inner tension loop of a moving digit")  # fmt: skip
INTEGRAL_GAIN = _real_field("integral_gain", "run", "",
    "integral gain of the tension loop, times the period")  # fmt: skip
CONTROL_PERIOD = _real_field("period", "run", "s", "control period")
STREAM_SPEED = _real_field("stream_speed", "run", "rad/s", "largest rate of a streamed motion")
STREAM_ACCELERATION = _real_field("stream_acceleration", "run", "rad/s2",
    "largest acceleration of a streamed motion")  # fmt: skip
STREAM_HOLD_DELAY_NS = _integer_field(
    "stream_hold_ns", "run", "ns", "age of a target after which the hand holds"
)
STREAM_RELAX_DELAY_NS = _integer_field("stream_relax_ns", "run", "ns",
    "age of a target after which the hand relaxes")  # fmt: skip
TRIM_DECAY = _real_field("trim_kept", "run", "", "fraction of a trim that remains after a tick")

# Joints and links.
SPRING_STIFFNESS = _real_field("spring", "joint", "N m/rad", "stiffness of the return spring")
SPRING_PRELOAD = _real_field("preload", "joint", "rad", "preload of the return spring")
JOINT_DAMPING = _real_field("joint_damping", "joint", "N m s/rad", "viscous damping of the joint")
LINK_TABLE = _real_field("link", "joint", "",
    "frames and bodies of the links, see hand.rigid_body", rows=rigid_body.LINK_TABLE_ROW_COUNT)  # fmt: skip
PARENT_JOINT = _integer_field("parent", "joint", "",
    "index of the joint before, towards the palm; -1 for the first")  # fmt: skip
JOINT_SCALE = _real_field("joint_scale", "joint", "rad/rad or m/rad",
    "motion that counts like 1 rad in thresholds: 1, less for a prismatic joint", initial=1.0)  # fmt: skip
MIN_JOINT_ANGLE = _real_field("low", "joint", "rad", "smallest joint angle")
MAX_JOINT_ANGLE = _real_field("high", "joint", "rad", "largest joint angle")
ANGLE_RANGE_SIGMA = _real_field("range_sigma", "joint", "rad",
    "standard deviation of an angle of which only the range is known")  # fmt: skip
ENCODER_VARIANCE = _real_field("encoder_variance", "joint", "rad2",
    "variance of a joint encoder's reading")  # fmt: skip
IS_ENCODER_FUSED = _integer_field("loose", "joint", "",
    "1 if the joint has an encoder and its digit has a null space")  # fmt: skip
GRAVITY = _real_field("gravity", "run", "m/s2", "gravity in the palm frame", rows=3)
FIRST_JOINT = _integer_field("joints_first", "digit", "", "index of the digit's first joint")
END_JOINT = _integer_field("joints_end", "digit", "", "index of the joint after the digit's last")
FIRST_TENDON = _integer_field("tendons_first", "digit", "", "index of the digit's first tendon")
END_TENDON = _integer_field(
    "tendons_end", "digit", "", "index of the tendon after the digit's last"
)
FIRST_COORDINATE = _integer_field("coordinates_first", "digit", "",
    "index of the digit's first coordinate")  # fmt: skip
END_COORDINATE = _integer_field("coordinates_end", "digit", "",
    "index of the coordinate after the digit's last")  # fmt: skip

# Structure of the hand: relations between joints, tendons and coordinates of the digits.
EXCURSION_TO_JOINTS = _real_field("excursion_to_joints", "joint*tendon", "rad/m",
    "joint angles per excursion")  # fmt: skip
POSTURE_TORQUE = _real_field("posture_torque", "joint*tendon", "m",
    "joint torque per tension, projected onto the coordinates of the digits")  # fmt: skip
MOVES_JOINT = _real_field("moves", "joint*tendon", "",
    "1 if the joint angle depends on the tendon's excursion")  # fmt: skip
MOMENT_ARMS = _real_field("moment_arms", "tendon*joint", "m", "moment arms R")
CARRIER_ARMS = _real_field("carrier_arms", "tendon*joint", "m",
    "moment arms about joints that carry the tendon's digit")  # fmt: skip
HAS_CARRIER_ARMS = _integer_field("hand_passed", "run", "",
    "1 if a tendon of the hand has a moment arm about a carrying joint")  # fmt: skip
TORQUE_TO_TENSION = _real_field("torque_to_tension", "tendon*joint", "1/m",
    "smallest tensions per joint torque")  # fmt: skip
PULLEY_WEIGHTS = _real_field("pulley_weight", "tendon*joint", "",
    "moment arm at a pulley, as a fraction of the sum over all pulleys of the tendon")  # fmt: skip
JOINT_COUPLING = _real_field("coupling", "joint*coordinate", "", "joint angles per coordinate")
REDUCED_ARMS = _real_field(
    "reduced_arms", "tendon*coordinate", "m", "moment arms about the coordinates"
)

# Moment arms that depend on the joint angle. In a digit with varying moment arms, each table that
# is computed from the moment arms R contains the values for the present joint angles.
HAS_VARYING_ARM = _integer_field("varying", "tendon", "",
    "1 if a moment arm of the tendon depends on the joint angle")  # fmt: skip
DIGIT_HAS_VARYING_ARM = _integer_field("digit_varying", "digit", "",
    "1 if a moment arm of the digit depends on the joint angle")  # fmt: skip
HAND_HAS_VARYING_ARM = _integer_field("hand_varying", "run", "",
    "1 if a moment arm of the hand depends on the joint angle")  # fmt: skip
ARM_POLYNOMIAL = _real_field("arm_polynomial", "tendon*joint", "m", rows=POLYNOMIAL_COEFFICIENTS,
    meaning="coefficients of the moment arm as a polynomial of the joint angle in rad")  # fmt: skip
ANGLE_OFFSET = _real_field("angle_offset", "joint", "rad",
    "joint angle at zero excursion, by the linear relation at the present angles")  # fmt: skip
EXCURSION_MODEL_OFFSET = _real_field("explained_offset", "tendon", "m",
    "excursion less R R^+ s, by the linear relation at the present angles")  # fmt: skip
MEAN_BALANCE_TENSION = _real_field(
    "mean_balance", "tendon", "N", "balance tension with the mean moment arms"
)

# Null space of the moment arms: all changes of a digit's posture that do not change any tendon
# excursion.
COMPLIANCE = _real_field("compliance", "joint*joint", "rad/(N m)",
    "joint angles per joint torque at constant excursion")  # fmt: skip
COORDINATE_PROJECTION = _real_field("spread", "joint*joint", "",
    "projection of joint torques onto the coordinates, B B^T")  # fmt: skip
ARE_IN_SAME_DIGIT = _real_field(
    "same_digit", "joint*joint", "", "1 if two joints belong to one digit"
)
CONTACT_PLACE_PROBABILITY = _real_field(
    "place_weight", "place*joint", "", "probability of each place of contact"
)
EXCURSION_VARIANCE = _real_field("excursion_variance", "tendon", "m2",
                           "variance of an excursion, without the part of the stretch")  # fmt: skip
TURN_SMOOTHING_FRACTION = _real_field("turn_fraction", "run", "",
    "fraction of the difference by which the smoothed turn approaches a new one")  # fmt: skip
CONTACT_DECAY = _real_field("pressed_kept", "run", "",
    "fraction of the contact tension that remains after a tick")  # fmt: skip
HAS_NULL_SPACE = _integer_field(
    "null_space", "run", "", "1 if a digit of the hand has a null space"
)
HAS_FUSED_ENCODERS = _integer_field("joints_fused", "run", "",
    "1 if a joint of a digit with a null space has an encoder")  # fmt: skip
POSTURE_UPDATE_TICKS = _integer_field("posture_ticks", "run", "",
    "ticks from one estimate in the null space to the next")  # fmt: skip

# Tension filter: the elements of each filter design. There are six filter designs for each tendon.
# The index of a filter design is the value of the tendon's ``TendonRegime``. A filter design with
# added process noise has an index that is larger by 3.
FILTER_DESIGNS = _real_field(
    "design", "tendon*kind*element", "", "blocks of the filter, see the elements below"
)
TRANSITION_MATRIX_OFFSET = 0
INPUT_MATRIX_OFFSET = 49
KALMAN_GAIN_OFFSET = 63
PROCESS_NOISE_OFFSET = 84
MEASUREMENT_NOISE_OFFSET = 133
COVARIANCE_OFFSET = 135
MEASUREMENT_MATRIX_OFFSET = 184
TENSION_ROW_OFFSET = 205
INFORMATION_OFFSET = 212
TENSION_VARIANCE_OFFSET = 215
CELL_SIGMA_OFFSET = 216
CELL_ERROR_VARIANCE_OFFSET = 217
CELL_ERROR_OBSERVABLE_OFFSET = 218
FILTER_DESIGN_SIZE = 219
"""Number of elements of a filter design.

Each constant with the suffix ``_OFFSET`` is the index of the first element of a matrix, vector or
number in the filter design.

A filter design contains F (7, 7), B (7, 2), K (7, 3), Q (7, 7), R (2), P (7, 7), H (3, 7), the
tension row (7), the inverse covariance of the innovations (encoder squared, twice the product, load
cell squared), and four single numbers. ``filter_types.FilterBlock`` explains the matrices, vectors
and numbers of a filter design.
"""
FILTER_DESIGN_COUNT = 6

# Filters for the detection of contact and slip. In each tick, the output of a low-pass filter moves
# towards the input by a fraction of their distance. Each constant below is this fraction for one
# low-pass filter.
TIP_FORCE_UPDATE_FRACTION = _real_field("felt_fraction", "run", "",
    "update fraction of the smoothed force at the tip")  # fmt: skip
MEAN_FORCE_UPDATE_FRACTION = _real_field("usual_fraction", "run", "",
    "update fraction of the mean force at the tip")  # fmt: skip
DRIFT_UPDATE_FRACTION = _real_field("drift_fraction", "run", "",
    "update fraction of the drift of the force at the tip")  # fmt: skip
FAST_GRIP_UPDATE_FRACTION = _real_field("fast_fraction", "run", "",
    "update fraction of the fast average of a grip")  # fmt: skip
SLOW_GRIP_UPDATE_FRACTION = _real_field("slow_fraction", "run", "",
    "update fraction of the slow average of a grip")  # fmt: skip

# Detection of contact, and the limits of the fault detectors.
TOUCH_DECAY = _real_field("touch_kept", "run", "",
    "fraction of the smoothed unexplained tension that remains after a tick")  # fmt: skip
MOTOR_STEP_LIMIT = _real_field(
    "step_limit", "tendon", "rad", "largest step of a motor position in a period"
)
JOINT_STEP_LIMIT = _real_field("joint_step_limit", "joint", "rad",
    "largest step of a joint angle in a period")  # fmt: skip
RESIDUAL_UPDATE_FRACTION = _real_field("residual_fraction", "tendon", "",
    "update fraction of each low-passed residual", rows=9)  # fmt: skip
MOMENT_ARM_SUM = _real_field("arms_sum", "tendon", "m",
    "sum of the absolute moment arms of a tendon, times the scale of each joint")  # fmt: skip
MOTOR_PERIOD = _real_field("motor_period", "tendon", "s",
    "time between two reported positions of the motor")  # fmt: skip
JOINT_PERIOD = _real_field(
    "joint_period", "run", "s", "time between two readings of the joint encoders"
)
TENSION_TRIP = _real_field("tension_trip", "tendon", "N",
    "tension of a single sample above which the hand relaxes")  # fmt: skip
DRIVE_TENSION_LIMIT = _real_field(
    "drive_limit", "tendon", "N", "tension at the drive's own torque limit"
)
TORQUE_STEP = _real_field("torque_step", "tendon", "N",
    "force of one count of the drive's torque; 0 for a floating-point torque")  # fmt: skip
POSITION_NOISE_LIMIT = _real_field("noise_limit", "run", "rad2",
    "mean squared jerk of a motor's position above which the position counts as noisy")  # fmt: skip
DERATING_START_TEMPERATURE = _real_field("temperature_soft", "run", "degC",
    "drive temperature from which the tension limit falls")  # fmt: skip
DERATING_END_TEMPERATURE = _real_field("temperature_hard", "run", "degC",
    "drive temperature at which the tension limit has fallen to the floor")  # fmt: skip
CELL_SATURATION = _real_field("tension_rail", "run", "N",
    "tared reading from which a load cell counts as saturated")  # fmt: skip
MIN_CELL_READING = _real_field("tension_low", "run", "N",
    "reading, after any tare, below which no tension can be")  # fmt: skip
MIN_CELL_RANGE = _real_field("cell_low", "run", "N",
    "reading before the tare at the lower end of a load cell's range")  # fmt: skip
MAX_CELL_RANGE = _real_field("cell_high", "run", "N",
    "reading before the tare at the upper end of a load cell's range")  # fmt: skip
CYCLIC_FEEDBACK_PERIOD_NS = _integer_field("cyclic_ns", "tendon", "ns",
    "period of feedback that the drive sends by itself; 0 if every tick requests feedback")  # fmt: skip
HAS_SINGLE_ANSWER = _integer_field(
    "answers_once", "tendon", "", "1 if every command has exactly one answer"
)
CELL_GROUP = _integer_field(
    "cell_group", "tendon", "", "frame group of the load cell; -1 without one"
)
JOINT_GROUP = _integer_field(
    "joint_group", "joint", "", "frame group of the joint encoder; -1 without one"
)
CONTROL_PERIOD_NS = _integer_field("period_ns", "run", "ns", "control period")
JOINT_SILENCE_NS = _integer_field("mute_ns", "run", "ns",
    "time without a reading after which joint encoders count as silent")  # fmt: skip
SILENT_TICKS = _integer_field("silent_ticks", "run", "",
    "missing replies in a row after which a node counts as silent")  # fmt: skip
SILENT_TICKS_OF_SINGLE_MOTOR = _integer_field("one_silent_ticks", "run", "",
    "missing replies in a row after which a motor counts as silent while another answers")  # fmt: skip
STALLED_TICKS = _integer_field("stalled_ticks", "run", "",
    "missed ticks in a row after which the host counts as stalled")  # fmt: skip
MAX_FRAMES_PER_TICK = _integer_field("frames_limit", "run", "",
    "number of frames in a tick above which the bus counts as flooded")  # fmt: skip
TENSION_GROUP_COUNT = _integer_field(
    "tension_groups", "run", "", "frame groups that carry tensions"
)


class ConstantTables(NamedTuple):
    """Tables of constants of a hand, for compiled kernels.

    The shape of each table except ``design`` is (rows, length of the first axis, length of the
    second axis if there is one). The table ``design`` has the shape (tendon, kind of filter design,
    element of the design).
    """

    tendon: NDArray[np.float64]
    joint: NDArray[np.float64]
    run: NDArray[np.float64]
    joint_tendon_table: NDArray[np.float64]
    tendon_joint_table: NDArray[np.float64]
    joint_joint_table: NDArray[np.float64]
    joint_coordinate_table: NDArray[np.float64]
    tendon_coordinate_table: NDArray[np.float64]
    place_joint_table: NDArray[np.float64]
    design: NDArray[np.float64]
    tendon_int: NDArray[np.int64]
    joint_int: NDArray[np.int64]
    digit_int: NDArray[np.int64]
    run_int: NDArray[np.int64]


@kernel_helper
def constant_tables(block: BlockArray, at: TableOffsets) -> ConstantTables:
    """Return the tables of a hand's constants.

    Args:
        block: block of constants.
        at: positions of the tables, from ``BlockLayout.offsets`` of the block's layout.
    """
    n = at[0]
    j = at[1]
    d = at[2]
    c = at[3]
    kinds = at[4]
    elements = at[5]
    places = at[6]
    integer_view = block.view(np.int64)
    return ConstantTables(
        borrowed_array(block, at[8], ((at[9] - at[8]) // n, n)),
        borrowed_array(block, at[9], ((at[10] - at[9]) // j, j)),
        borrowed_array(block, at[10], (at[11] - at[10],)),
        borrowed_array(block, at[11], ((at[12] - at[11]) // (j * n), j, n)),
        borrowed_array(block, at[12], ((at[13] - at[12]) // (n * j), n, j)),
        borrowed_array(block, at[13], ((at[14] - at[13]) // (j * j), j, j)),
        borrowed_array(block, at[14], ((at[15] - at[14]) // (j * c), j, c)),
        borrowed_array(block, at[15], ((at[16] - at[15]) // (n * c), n, c)),
        borrowed_array(block, at[16], ((at[17] - at[16]) // (places * j), places, j)),
        borrowed_array(block, at[17], (n, kinds, elements)),
        borrowed_array(integer_view, at[18], ((at[19] - at[18]) // n, n)),
        borrowed_array(integer_view, at[19], ((at[20] - at[19]) // j, j)),
        borrowed_array(integer_view, at[20], ((at[21] - at[20]) // d, d)),
        borrowed_array(integer_view, at[21], (at[22] - at[21],)),
    )
