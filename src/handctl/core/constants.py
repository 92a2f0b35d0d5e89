"""Constants of a hand for compiled code, as a block beside the block of the state.

``HandConstants`` fills the block from a ``HandModel``, from drives and from sensors.
``constant_tables`` gives compiled code the tables by name. New gains make a new block.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrow, inner
from handctl.core.schema import Block, Places, Schema
from handctl.hand import rigid_body
from handctl.hand.file.quantities import COEFFICIENTS

AXES = ("tendon", "joint", "digit", "coordinate", "kind", "element", "place", "run")
TABLES = (
    "tendon", "joint", "run", "joint*tendon", "tendon*joint", "joint*joint", "joint*coordinate",
    "tendon*coordinate", "place*joint", "tendon*kind*element",
    "tendon_int", "joint_int", "digit_int", "run_int",
)  # fmt: skip

HAND = Schema(*TABLES)
_real = HAND.real
_whole = HAND.whole

# Tendons and motors, at the spool.
MOTOR_MASS = _real("motor_mass", "tendon", "kg", "reflected rotor inertia")
MOTOR_DAMPING = _real("motor_damping", "tendon", "N s/m", "of the motor")
COULOMB = _real("coulomb", "tendon", "N", "motor friction")
STIFFNESS = _real("stiffness", "tendon", "N/m", "of the tendon")
LOAD_STIFFNESS = _real("load_stiffness", "tendon", "N/m", "return springs along the tendon")
LOAD_DAMPING = _real("load_damping", "tendon", "N s/m", "joint damping along the tendon")
SPOOL = _real("spool", "tendon", "m", "radius")
TARE = _real("tare", "tendon", "N", "load-cell tare")
ZERO = _real("zero", "tendon", "rad", "motor zero")
CAPSTAN = _real("capstan", "tendon", "", "friction coefficient of the pulleys")
WRAP = _real("wrap", "tendon", "rad", "wrap angle before the first joint pulley")
FLOOR = _real("floor", "tendon", "N", "smallest tension")
CEILING = _real("ceiling", "tendon", "N", "largest tension")
TORQUE_GAIN = _real("torque_gain", "tendon", "", "torque at the spool over what the drive is told")
DIGIT = _whole("digit", "tendon", "", "index of the tendon's digit")
SIDE = _real("side", "tendon", "", "1 for a tendon that closes its digit, -1 for one that opens it")
OPEN_EXCURSION = _real("open_excursion", "tendon", "m", "excursion at the lower joint limits")
EXCURSION_LOW = _real("excursion_low", "tendon", "m", "smallest excursion within the joint limits")
EXCURSION_HIGH = _real("excursion_high", "tendon", "m", "largest excursion within the joint limits")
BLIND = _real("blind", "tendon", "N", "margin of an estimated tension without load cell, 0 with load cell")
RELAXED = _real("relaxed", "tendon", "N", "tension of a relaxed hand")
BALANCE = _real("balance", "tendon", "N", "tensions of a digit without torque, 0 without surplus tendons")
PRETENSION = _real("pretension", "tendon", "N", "of both tendons of a spool pair at rest, 0 for a single tendon")
PAIR = _whole("pair", "tendon", "", "two antagonistic tendons on one spool: tensions are net, of both signs")
SPRUNG = _whole("sprung", "tendon", "", "springs return the digit to its lower joint limits")
REDUNDANT = _whole("redundant", "tendon", "", "the digit has more tendons than coordinates")
ABSOLUTE = _whole("absolute", "tendon", "", "a newly taut tendon keeps its length, its excursion follows")

# Control law.
LIMIT = _real("limit", "tendon", "N", "largest motor force")
UNWIND = _real("unwind", "tendon", "N", "smallest motor force")
MASS = _real("mass", "tendon", "kg", "mass that the feedback accelerates")
INERTIA = _real("inertia", "tendon", "kg", "mass that the trajectory's acceleration moves")
ERROR_GAIN = _real("error_gain", "tendon", "1/s2", "motion loop: acceleration per excursion error")
SPEED_GAIN = _real("speed_gain", "tendon", "1/s", "motion loop: acceleration per speed error")
TENSION_GAIN = _real("tension_gain", "tendon", "", "tension loop: force per newton of error")
TENSION_SPEED_GAIN = _real("tension_speed_gain", "tendon", "N s/m", "tension loop: force per speed")
HALF = _real("half", "tendon", "m/(N s)", "speed that a force makes in half a period")
STOPPING = _real("stopping", "tendon", "m/s", "scale of speeds that motor friction stops within a period")
SERVO = _whole("servo", "tendon", "", "the drive closes the position loop of a motion")
SERVO_STIFFNESS = _real("servo_stiffness", "tendon", "N m/rad", "kp of this loop")
SERVO_DAMPING = _real("servo_damping", "tendon", "N m s/rad", "kd of this loop")
SERVO_KP_STEP = _real("servo_kp_step", "tendon", "N m/rad", "one count of kp", initial=1.0)
SERVO_KD_STEP = _real("servo_kd_step", "tendon", "N m s/rad", "one count of kd", initial=1.0)
SERVO_ROUNDING = _real("servo_rounding", "tendon", "N", "force of this loop by one count of its inputs")
EXACT = _whole("exact", "tendon", "", "a joint torque asks one tension and no other")
REJECTION = _real("rejection", "run", "", "fraction of the disturbance that is cancelled")
FRICTION_FRACTION = _real("friction_fraction", "run", "", "fraction of pulley friction that is made up for")
TENSION_FEEDBACK = _real("tension_feedback", "run", "", "inner tension loop of a moving digit")
INTEGRAL_GAIN = _real("integral_gain", "run", "", "tension loop: integral gain times the period")
PERIOD = _real("period", "run", "s", "control period")
STREAM_SPEED = _real("stream_speed", "run", "rad/s", "largest rate of a streamed motion")
STREAM_ACCELERATION = _real("stream_acceleration", "run", "rad/s2", "largest acceleration of a streamed motion")
STREAM_HOLD_NS = _whole("stream_hold_ns", "run", "ns", "age of a target after which the hand holds")
STREAM_RELAX_NS = _whole("stream_relax_ns", "run", "ns", "age of a target after which the hand relaxes")
TRIM_DECAY = _real("trim_kept", "run", "", "fraction of a trim that is left after a tick")

# Joints and links.
SPRING = _real("spring", "joint", "N m/rad", "return spring")
PRELOAD = _real("preload", "joint", "rad", "of the spring")
JOINT_DAMPING = _real("joint_damping", "joint", "N m s/rad", "viscous")
LINK = _real("link", "joint", "", "frames and bodies of the links, see hand.rigid_body", rows=rigid_body.ROWS)
PARENT = _whole("parent", "joint", "", "joint before; -1 for the palm")
LOW = _real("low", "joint", "rad", "smallest angle")
HIGH = _real("high", "joint", "rad", "largest angle")
RANGE_SIGMA = _real("range_sigma", "joint", "rad", "standard deviation of an angle anywhere in the range")
ENCODER_VARIANCE = _real("encoder_variance", "joint", "rad2", "of a joint encoder's reading")
LOOSE = _whole("loose", "joint", "", "the joint has an encoder and its digit a null space")
GRAVITY = _real("gravity", "run", "m/s2", "gravity in the palm frame", rows=3)
JOINTS_FIRST = _whole("joints_first", "digit", "", "first joint")
JOINTS_END = _whole("joints_end", "digit", "", "joint after the last")
TENDONS_FIRST = _whole("tendons_first", "digit", "", "first tendon")
TENDONS_END = _whole("tendons_end", "digit", "", "tendon after the last")
COORDINATES_FIRST = _whole("coordinates_first", "digit", "", "first coordinate")
COORDINATES_END = _whole("coordinates_end", "digit", "", "coordinate after the last")

# Structure.
EXCURSION_TO_JOINTS = _real("excursion_to_joints", "joint*tendon", "rad/m", "joint angles of an excursion")
POSTURE_TORQUE = _real("posture_torque", "joint*tendon", "m", "joint torque of tensions in the digits' coordinates")
MOVES = _real("moves", "joint*tendon", "", "1 where a joint angle follows from a tendon's excursion")
MOMENT_ARMS = _real("moment_arms", "tendon*joint", "m", "moment arms R")
CARRIER_ARMS = _real("carrier_arms", "tendon*joint", "m", "moment arms about joints that carry the tendon's digit")
HAND_PASSED = _whole("hand_passed", "run", "", "a tendon of the hand has such a moment arm")
TORQUE_TO_TENSION = _real("torque_to_tension", "tendon*joint", "1/m", "smallest tensions that make a torque")
PULLEY_WEIGHT = _real("pulley_weight", "tendon*joint", "", "fraction of each pulley in a tendon's moment arms")
COUPLING = _real("coupling", "joint*coordinate", "", "joint angles of coordinates")
REDUCED_ARMS = _real("reduced_arms", "tendon*coordinate", "m", "moment arms about coordinates")

# Moment arms by joint angle. The tables of ``structure`` that depend on R are then those at the present angles.
VARYING = _whole("varying", "tendon", "", "a moment arm of the tendon depends on the joint angle")
DIGIT_VARYING = _whole("digit_varying", "digit", "", "a tendon of the digit has such a moment arm")
HAND_VARYING = _whole("hand_varying", "run", "", "a tendon of the hand has such a moment arm")
ARM_POLYNOMIAL = _real("arm_polynomial", "tendon*joint", "m", "coefficients of the arm by the angle in rad",
                       rows=COEFFICIENTS)  # fmt: skip
ANGLE_OFFSET = _real("angle_offset", "joint", "rad", "free joint angle at zero excursion, of the linear relations")
EXPLAINED_OFFSET = _real("explained_offset", "tendon", "m", "excursion beyond R q, of the linear relations")
MEAN_BALANCE = _real("mean_balance", "tendon", "N", "balance with mean moment arms")

# Posture in the null space.
COMPLIANCE = _real("compliance", "joint*joint", "rad/(N m)", "joint angles per torque at constant excursion")
SPREAD = _real("spread", "joint*joint", "", "joint torques in the digits' coordinates and back")
SAME_DIGIT = _real("same_digit", "joint*joint", "", "1 where two joints are of one digit")
PLACE_WEIGHT = _real("place_weight", "place*joint", "", "probability of each place")
EXCURSION_VARIANCE = _real("excursion_variance", "tendon", "m2", "of an excursion, that of the stretch aside")
TURN_FRACTION = _real("turn_fraction", "run", "", "fraction of a new turn in the smoothed one")
PRESSED_DECAY = _real("pressed_kept", "run", "", "fraction of a contact that is left after a tick")
NULL_SPACE = _whole("null_space", "run", "", "a digit has a null space")
JOINTS_FUSED = _whole("joints_fused", "run", "", "a joint of such a digit has an encoder")
POSTURE_TICKS = _whole("posture_ticks", "run", "", "ticks from one estimate in the null space to the next")

# Tension filter: blocks of a tendon in one kind (a regime, or 3 and a regime in doubt), element by element.
DESIGN = _real("design", "tendon*kind*element", "", "blocks of the filter, see the elements below")
F_AT = 0
B_AT = 49
K_AT = 63
Q_AT = 84
R_AT = 133
P_AT = 135
H_AT = 184
TENSION_AT = 205
INFORMATION_AT = 212
VARIANCE_AT = 215
CELL_SIGMA_AT = 216
DRIFT_AT = 217
KNOWN_AT = 218
ELEMENTS = 219
"""Number of elements of a filter design. The constants above are the first elements of the parts.

F (7, 7), B (7, 2), K (7, 3), Q (7, 7), R (2), P (7, 7), H (3, 7), tension row (7), inverse
covariance of the innovations (encoder squared, twice the product, load cell squared), and single
numbers.
"""
KINDS = 6

# Contact and grip: fractions of what is new that averages take in a tick.
TIP_FORCE_FRACTION = _real("felt_fraction", "run", "", "of the force felt")
TIP_FORCE_MEAN_FRACTION = _real("usual_fraction", "run", "", "of its mean")
DRIFT_FRACTION = _real("drift_fraction", "run", "", "of its long mean")
FAST_FRACTION = _real("fast_fraction", "run", "", "of a grip's quick average")
SLOW_FRACTION = _real("slow_fraction", "run", "", "of its slow average")

# Touch and monitor.
TOUCH_DECAY = _real("touch_kept", "run", "", "fraction of the smoothed unexplained tension that is kept in a tick")
STEP_LIMIT = _real("step_limit", "tendon", "rad", "largest step of a motor position in a period")
JOINT_STEP_LIMIT = _real("joint_step_limit", "joint", "rad", "largest step of a joint angle in a period")
RESIDUAL_FRACTION = _real("residual_fraction", "tendon", "", "fraction of what is new in each low-passed residual",
                          rows=8)  # fmt: skip
ARMS_SUM = _real("arms_sum", "tendon", "m", "sum of a tendon's moment arms")
MOTOR_PERIOD = _real("motor_period", "tendon", "s", "how often the motor tells its position")
JOINT_PERIOD = _real("joint_period", "run", "s", "how often joints are read")
TENSION_TRIP = _real("tension_trip", "tendon", "N", "tension of one sample that means relax")
DRIVE_LIMIT = _real("drive_limit", "tendon", "N", "tension that the drive's own torque limit can make")
TORQUE_STEP = _real("torque_step", "tendon", "N", "one count of the drive's torque, 0 for a floating-point number")
NOISE_LIMIT = _real("noise_limit", "run", "rad2", "mean squared jerk of a motor's position that means noise")
TEMPERATURE_SOFT = _real("temperature_soft", "run", "degC", "from here on a tendon's limit falls")
TEMPERATURE_HARD = _real("temperature_hard", "run", "degC", "here it has fallen to the floor")
TENSION_RAIL = _real("tension_rail", "run", "N", "reading at which a load cell may be saturated")
TENSION_LOW = _real("tension_low", "run", "N", "reading, after any tare, that no tendon can make")
CELL_LOW = _real("cell_low", "run", "N", "reading before the tare at the lower end of a load cell's range")
CELL_HIGH = _real("cell_high", "run", "N", "the same at the upper end")
CYCLIC_NS = _whole("cyclic_ns", "tendon", "ns", "how often feedback comes by itself; 0 if every tick asks for it")
ANSWERS_ONCE = _whole("answers_once", "tendon", "", "every command has exactly one answer")
CELL_GROUP = _whole("cell_group", "tendon", "", "frame group of the load cell; -1 without one")
JOINT_GROUP = _whole("joint_group", "joint", "", "frame group of the joint encoder; -1 without one")
PERIOD_NS = _whole("period_ns", "run", "ns", "control period")
MUTE_NS = _whole("mute_ns", "run", "ns", "silence after which joint encoders count as silent")
SILENT_TICKS = _whole("silent_ticks", "run", "", "replies in a row that may be missing before a node counts as silent")
ONE_SILENT_TICKS = _whole("one_silent_ticks", "run", "", "the same for a motor while another one answers")
STALLED_TICKS = _whole("stalled_ticks", "run", "", "ticks in a row that may be missed before the host stood still")
FRAMES_LIMIT = _whole("frames_limit", "run", "", "frames in one tick that are more than all nodes can have sent")
TENSION_GROUPS = _whole("tension_groups", "run", "", "frame groups that carry tensions")


class ConstantTables(NamedTuple):
    """Tables of a block of ``HAND``, each (rows, lengths of the axes). The design is (N, kind, element)."""

    tendon: NDArray[np.float64]
    joint: NDArray[np.float64]
    run: NDArray[np.float64]
    joint_tendon: NDArray[np.float64]
    tendon_joint: NDArray[np.float64]
    joint_joint: NDArray[np.float64]
    joint_coordinate: NDArray[np.float64]
    tendon_coordinate: NDArray[np.float64]
    place_joint: NDArray[np.float64]
    design: NDArray[np.float64]
    tendon_int: NDArray[np.int64]
    joint_int: NDArray[np.int64]
    digit_int: NDArray[np.int64]
    run_int: NDArray[np.int64]


@inner
def constant_tables(block: Block, at: Places) -> ConstantTables:
    """Return the tables of a hand's constants.

    Args:
        block: the constants.
        at: ``Layout.places``.
    """
    n = at[0]
    j = at[1]
    d = at[2]
    c = at[3]
    kinds = at[4]
    elements = at[5]
    places = at[6]
    whole = block.view(np.int64)
    return ConstantTables(
        borrow(block, at[8], ((at[9] - at[8]) // n, n)),
        borrow(block, at[9], ((at[10] - at[9]) // j, j)),
        borrow(block, at[10], (at[11] - at[10],)),
        borrow(block, at[11], ((at[12] - at[11]) // (j * n), j, n)),
        borrow(block, at[12], ((at[13] - at[12]) // (n * j), n, j)),
        borrow(block, at[13], ((at[14] - at[13]) // (j * j), j, j)),
        borrow(block, at[14], ((at[15] - at[14]) // (j * c), j, c)),
        borrow(block, at[15], ((at[16] - at[15]) // (n * c), n, c)),
        borrow(block, at[16], ((at[17] - at[16]) // (places * j), places, j)),
        borrow(block, at[17], (n, kinds, elements)),
        borrow(whole, at[18], ((at[19] - at[18]) // n, n)),
        borrow(whole, at[19], ((at[20] - at[19]) // j, j)),
        borrow(whole, at[20], ((at[21] - at[20]) // d, d)),
        borrow(whole, at[21], (at[22] - at[21],)),
    )
