"""Rows N01 to N17 of the fault catalogue: faults of drives and sensors.

Before arming, in the mode INVENTORY, the controller checks that no node is missing (N03) and that
no drive has wrong settings (N12).
"""

from handctl.safety.faults.bus import MALFORMED_WINDOW_TICKS, SILENCE_TIME_REASON
from handctl.safety.faults.fault import (
    CHECKED_BEFORE_ARMING,
    CHECKED_BY_FAULT_TABLE,
    CLEARED_BY_ITSELF,
    CLEARED_BY_OPERATOR,
    FAULT_PLACE_JOINT,
    FAULT_PLACE_MOTOR,
    FAULT_PLACE_NODE,
    FAULT_PLACE_TENDON,
    INDIRECTLY_VISIBLE,
    INVISIBLE_FAULT,
    VISIBLE_FAULT,
    declare_catalogue_row,
    declare_fault,
)
from handctl.safety.safety_action import RelaxMethod, SafetyAction
from handctl.safety.safety_limits import MAX_SILENCE_S, MIN_SILENT_TICKS

STUCK_SENSOR_TIME_S = 0.1
STUCK_SENSOR_GOAL_CHANGE_M = 0.5e-3
STUCK_SENSOR_TENSION_CHANGE_N = 8.0
STUCK_SENSOR_JOINT_CHANGE_DEG = 10.0
"""Thresholds for a stuck sensor: duration of a constant reading, and changes of related signals meanwhile.

A motor's encoder is stuck if its reading is constant while the goal moves by 0.5 mm, or while the
tension changes by 8 N (80 um of tendon stretch). In a digit with several tendons and load cells,
only the goal counts, because the other tendons also change the tension. A joint encoder is stuck if
its reading is constant while the joint angle computed from the spools changes by 10 degrees.
"""
SLIP_WARN_DEG = 3.0
SLIP_TRIP_DEG = 6.0
"""Differences between joint encoder and spool that are faults [deg].

The reaction is WARN above the first difference of the angles, and RELAX above the second
difference.
"""
POSITION_NOISE_FACTOR = 9.0
"""Mean squared jerk of a noisy position, as a multiple of the value expected from torque and encoder rounding."""
HIGH_TEMPERATURE_TICKS = 20
"""Number of consecutive ticks with a high temperature after which there is a fault."""
TORQUE_DIFFERENCE_LIMIT_N = 15.0
TORQUE_DIFFERENCE_LIMIT_FRACTION = 0.1
"""Difference between commanded and reported torque above which there is a fault.

The two thresholds are a tension [N], and a fraction of the tension at the drive's torque limit. The
smaller threshold applies. A hand with small tensions has small commands, so a fault of its drives
would be found later with a constant threshold.
"""
CONTRADICTORY_REPORT_N = 6.0
CONTRADICTORY_REPORT_FRACTION = 0.25
CONTRADICTORY_REPORT_MEAN_N = 4.0
"""Thresholds for a report that contradicts its command: force [N], fraction of the command, filtered difference [N].

A drive that obeys its commands reports one of the last three commands, within 0.1 N in simulation.
A drive whose current follows a step with a time constant of 4 ms still differs by 15 % of the step
after three ticks of 2.5 ms.
"""
OSCILLATION_RMS_N = 8.0
OSCILLATION_DURATION_S = 0.25
MIN_OSCILLATION_HZ = 8.0
"""Thresholds for an oscillation of the tension: RMS [N], duration [s], lowest frequency [Hz].

The RMS threshold corresponds to an amplitude of 11 N. After a command step of 75 N at 5000 N/s, the
RMS of the tension exceeds the threshold for only 0.15 s.
"""
HALF_RATE_LOSS_COUNT = 7
"""Number of missing replies in ``MALFORMED_WINDOW_TICKS`` ticks from which a node counts as slow.

A slow node replies at half the control rate. Two replies in a row are missing when the time between
the start of a tick and the reply drifts past a control period.
"""
TENSION_AFTER_CUT_TIME_S = 0.1
TENSION_AFTER_CUT_FRACTION = 0.5
TENSION_AFTER_CUT_N = 10.0
REPORTED_FORCE_AFTER_CUT_N = 1.0
"""Thresholds for a tendon that is still taut after a cut: time [s], fraction of the tension at the cut, tension [N].

The last threshold is for the motor force that the drive reports. The resolution of the reported
force is added to this threshold. A drive without torque reports less than 0.1 N in simulation, and
the reading of a load cell drifts by newtons.

``TENSION_AFTER_CUT_TIME_S`` after a cut of the torque, tendons of the packaged hands have at most a
third of their tension if the motor is off, and at least 0.74 of their tension if the motor still
pulls.
"""
RELEASED_SPOOL_TRAVEL_M = 3e-3
"""Length of tendon that a spool pays out after a cut, above which the spool counts as released [m].

A spring that opens a digit keeps its tendon taut while the tendon accelerates the rotor. On jamia11,
a released tendon had 10 N for 150 ms, and its spool had paid out 6 mm after 100 ms. A motor that
still pulls holds its spool or winds the tendon.
"""
MIN_REPORTED_TORQUE_FRACTION = 0.4
TORQUE_CORRELATION_TIME_S = 0.25
"""Smallest ratio of the reported to the commanded torque changes, and time constant of the comparison [s]."""

# Texts of the fault catalogue for faults that the messages of a drive protocol do not report.
_HEARTBEAT_TEXT = f"{VISIBLE_FAULT}: by the heartbeat, every 100 ms"
_EXCESS_REPLIES_TEXT = f"{INVISIBLE_FAULT}: excess replies look like cyclic messages, which come in addition to replies"
_JOINT_ENCODERS_TEXT = (
    f"{INDIRECTLY_VISIBLE}: only with joint encoders, else the motor's encoder has no reference"
)
_SINGLE_LOSSES_TEXT = (
    f"{INDIRECTLY_VISIBLE}: by single losses (B01), because cyclic messages come in between"
)
_SETTINGS_RECHECK_REASON = "While enabled, limit and watchdog are read in turn, one every 500 ms"
_SILENCE_CONDITION_TEXT = f"for {MAX_SILENCE_S * 1e3:g} ms, at least {MIN_SILENT_TICKS} in a row"
_MODES_TEST_FILE = "tests/controller/test_controller_modes.py"

declare_catalogue_row("N01", "reset in motion", odrive=_HEARTBEAT_TEXT, ticks=4, odrive_extra_ms=100, required_ticks=2,
    why="4 ticks if the drive is silent while it restarts (CiA 402), else 2 ticks")  # fmt: skip
N01_DRIVE_DROPPED_OUT = declare_fault(
    "N01", "a drive dropped out", "A drive reports that it is disabled, or has restarted",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    cause="The drive has restarted, usually because its supply voltage dropped.",
    remedy="Check supply voltage and wiring of the motor under load, then start a new run.",
)  # fmt: skip

declare_catalogue_row("N02", "silent node", ticks=1, ms=30, required_ticks=4,
    why=SILENCE_TIME_REASON + ". Joint encoders are read in every fourth tick: four readings take 85 ms at 200 Hz",
)  # fmt: skip
N02_SILENT_LOAD_CELLS = declare_fault(
    "N02", "the load cells are silent", f"The sensor node sends no tension frame {_SILENCE_CONDITION_TEXT}",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    caused_by_lateness=True, needs_load_cell=True,
    cause="The sensor node has lost power or its cable, or has crashed.",
    remedy="Check supply and cable of the sensor node, then start a new run.",
)  # fmt: skip
N02B_SILENT_JOINT_ENCODERS = declare_fault(
    "N02b", "the joint encoders are silent", f"The sensor node sends no joint frame {_SILENCE_CONDITION_TEXT}",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_JOINT,
    caused_by_lateness=True,
    cause="The sensor node, or its joint encoders, have lost power or cable.",
    remedy="Check supply and cable of the sensor node and of the joint encoders, then start a new run.",
)  # fmt: skip

declare_catalogue_row("N03", "missing at start", CHECKED_BEFORE_ARMING, tested_by=_MODES_TEST_FILE)

declare_catalogue_row("N04", "encoder stuck", ticks=2, ms=500, required_ticks=22,
    why="a constant reading is a fault only after the goal moved by 0.5 mm or the tension by 8 N, and after 100 ms",
)  # fmt: skip
N04_STUCK_ENCODER = declare_fault(
    "N04", "an encoder is stuck",
    f"A reading is constant for {STUCK_SENSOR_TIME_S * 1e3:g} ms, although the goal, the tension or the spool moves",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR, FAULT_PLACE_JOINT, relax_method=RelaxMethod.OPEN_LOOP,
    cause="The encoder or its magnet has failed, the drive repeats old values, or a tendon without load cell has torn.",
    remedy="Turn motor and joint by hand in handctl bus watch. "
    "Replace an encoder that does not follow. Else check the tendon.",
)  # fmt: skip

declare_catalogue_row("N05", "encoder jump", ticks=3, required_ticks=3)
N05A_ENCODER_JUMP = declare_fault(
    "N05a", "an encoder jumped",
    "A position changes more than a rotor can move, and the controller rejects the reading",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_MOTOR, FAULT_PLACE_JOINT,
    cause="Noise on the encoder's cable, or a loose magnet, disturbed a reading.",
    remedy="Ignore single cases. If it repeats, check cable and magnet of the encoder.",
)  # fmt: skip
N05B_REPEATED_ENCODER_JUMPS = declare_fault(
    "N05b", "an encoder jumps", "Two readings in a row change more than a rotor can move",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR, FAULT_PLACE_JOINT, relax_method=RelaxMethod.OPEN_LOOP,
    cause="The encoder or its magnet is loose, or the drive has lost its reference.",
    remedy="Check magnet and cable of the encoder with handctl bus watch, then commission again (handctl commission).",
)  # fmt: skip

declare_catalogue_row("N06", "encoder drift or slip", CHECKED_BY_FAULT_TABLE, _JOINT_ENCODERS_TEXT,
    _JOINT_ENCODERS_TEXT, _JOINT_ENCODERS_TEXT, ticks=4, ms=900, required_ticks=200,
    why="sooner than the required 1000 ms")  # fmt: skip
N06A_JOINT_SPOOL_MISMATCH = declare_fault(
    "N06a", "joint and spool disagree",
    f"The filtered difference of joint encoder and spool is above {SLIP_WARN_DEG:g} degrees",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_TENDON,
    needs_joint_encoders=True,
    cause="A tendon stretches or slips on its spool, or an encoder drifts.",
    remedy="Check the tendon's clamp and the encoder's magnet. Commission the hand again (handctl commission).",
)  # fmt: skip
N06B_SLIPPING_ENCODER_OR_TENDON = declare_fault(
    "N06b", "an encoder or a tendon slips",
    f"The filtered difference of joint encoder and spool is above {SLIP_TRIP_DEG:g} degrees",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, relax_method=RelaxMethod.OPEN_LOOP,
    needs_joint_encoders=True,
    cause="The tendon slips on its spool, has left a pulley, or an encoder has come loose.",
    remedy="Check clamp and path of the tendon and the encoder's magnet, then commission again (handctl commission).",
)  # fmt: skip

declare_catalogue_row("N07", "encoder noise", ticks=4, ms=60, required_ticks=52)
N07_NOISY_ENCODER = declare_fault(
    "N07", "a noisy encoder",
    f"Over 100 ms, the noise of the position has {POSITION_NOISE_FACTOR:g} times the expected variance",
    SafetyAction.HOLD, CLEARED_BY_ITSELF, FAULT_PLACE_MOTOR,
    cause="The encoder's cable picks up noise, or its magnet is too far away.",
    remedy="Check shield and cable of the encoder, and the distance of its magnet.",
)  # fmt: skip

declare_catalogue_row("N08", "the drive's watchdog fired", odrive=_HEARTBEAT_TEXT, ticks=2, odrive_extra_ms=100,
    required_ticks=2,
    robstride=f"{INDIRECTLY_VISIBLE}: by N01, because the drive reports only that it is disabled")  # fmt: skip
N08_WATCHDOG_FIRED = declare_fault(
    "N08", "a drive's watchdog fired", "The drive reports that its watchdog fired", SafetyAction.RELAX,
    CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    caused_by_lateness=True,
    cause="The drive received no command in time: this host was too slow, or commands were lost.",
    remedy="Run handctl doctor (priority, cores), close other programs, or lower the rate.",
)  # fmt: skip

declare_catalogue_row("N09", "over-temperature", odrive=f"{VISIBLE_FAULT}: requested five times a second",
    cia402=f"{INDIRECTLY_VISIBLE}: by the drive's own limit (N11), because the PDO has no temperature",
    ticks=22, odrive_extra_ms=200, required_ticks=22)  # fmt: skip
N09A_WARM_DRIVE = declare_fault(
    "N09a", "a drive is warm",
    "The temperature is above the soft limit, and the controller lowers the limit of the tension",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_MOTOR, debounce_ticks=HIGH_TEMPERATURE_TICKS,
    cause="The hand holds a high tension for a long time, or the drive has too little cooling.",
    remedy="Let the hand rest, hold with less tension, or improve the cooling.",
)  # fmt: skip
N09B_OVERHEATED_DRIVE = declare_fault(
    "N09b", "a drive is too hot", "The temperature is above the hard limit",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR, debounce_ticks=HIGH_TEMPERATURE_TICKS,
    cause="The hand holds a high tension for a long time, or the drive has too little cooling.",
    remedy="Let the drive cool down. Hold with less tension, or improve the cooling.",
)  # fmt: skip

declare_catalogue_row(
    "N10",
    "under- or over-voltage",
    odrive=_HEARTBEAT_TEXT,
    ticks=2,
    odrive_extra_ms=100,
    required_ticks=2,
)
N10_SUPPLY_VOLTAGE = declare_fault(
    "N10", "wrong supply voltage", "The drive reports that the voltage is too low or too high",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    cause="The supply is too weak, or braking motors raise the voltage.",
    remedy="Measure the supply under load. Use a stronger supply, or a brake resistor.",
)  # fmt: skip

declare_catalogue_row(
    "N11", "node fault code", odrive=_HEARTBEAT_TEXT, ticks=2, odrive_extra_ms=100, required_ticks=2
)
N11_DRIVE_ERROR = declare_fault(
    "N11", "a drive reports an error",
    "The feedback of the drive contains an error code", SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    cause="The drive has detected an error of its own, for example over-current or a failed encoder.",
    remedy="Look the code up in the drive's manual, remove its cause, and start the next run with --clear.",
)  # fmt: skip
N11B_UNKNOWN_DRIVE_ERROR = declare_fault(
    "N11b", "a drive reports an unknown error", "The feedback contains an error code that handctl does not know",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR,
    cause="The drive has another firmware than handctl knows.",
    remedy="Look the code up in the drive's manual, and check the firmware version in the hand file.",
)  # fmt: skip

declare_catalogue_row("N12", "wrong firmware or settings", CHECKED_BY_FAULT_TABLE,
    f"{INDIRECTLY_VISIBLE}: by registers, without serial number. {_SETTINGS_RECHECK_REASON}",
    f"{INDIRECTLY_VISIBLE}: by protocol version and endpoints, without serial number. {_SETTINGS_RECHECK_REASON}",
    f"{INDIRECTLY_VISIBLE}: by objects, without serial number. {_SETTINGS_RECHECK_REASON}", ticks=4, ms=1000,
    moteus=f"{INDIRECTLY_VISIBLE}: by settings. {_SETTINGS_RECHECK_REASON}",
    robstride=f"{INDIRECTLY_VISIBLE}: by parameters. {_SETTINGS_RECHECK_REASON}")  # fmt: skip
N12_CHANGED_SETTINGS = declare_fault(
    "N12", "a drive is not as configured",
    "A setting that was read back is wrong, or another host has enabled the drive",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR, relax_method=RelaxMethod.OPEN_LOOP,
    cause="The drive was replaced, has lost its settings, or another program writes to it.",
    remedy="Close other programs, compare the drive with the hand file, and restart the drive.",
)  # fmt: skip

declare_catalogue_row("N13", "two nodes with one id", odrive=_EXCESS_REPLIES_TEXT, ticks=4, required_ticks=2,
    why="2 ticks if the second reply has different bytes, else two replies in three ticks in a row")  # fmt: skip
N13_SHARED_IDENTIFIER = declare_fault(
    "N13", "two nodes with one identifier", "A node sends two replies to one request, in three ticks in a row",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_NODE, debounce_ticks=3, relax_method=RelaxMethod.OPEN_LOOP,
    cause="Two nodes on the bus have the same identifier.",
    remedy="Connect the nodes one at a time, run handctl scan, and give each its own identifier.",
)  # fmt: skip

declare_catalogue_row("N14", "command not obeyed",
    odrive=f"{INDIRECTLY_VISIBLE}: by tension (T04) unless torque_feedback is set",
    ticks=22, ms=600, required_ticks=22,
    why="22 ticks if reported and commanded torque differ. Ripple that no drive reports is found by N14b",
    )  # fmt: skip
N14_DISOBEYED_COMMAND = declare_fault(
    "N14", "a command is not obeyed",
    f"The filtered difference of commanded and reported torque is above {TORQUE_DIFFERENCE_LIMIT_N:g} N at the "
    "tendon, or above "
    f"{TORQUE_DIFFERENCE_LIMIT_FRACTION * 100.0:g} % of the drive's limit. Or it is above "
    f"{CONTRADICTORY_REPORT_MEAN_N:g} N "
    f"without a load cell, and the report is far from the last three commands",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR, relax_method=RelaxMethod.OPEN_LOOP,
    cause="The drive limits its torque, is in another mode, or its torque constant is wrong.",
    remedy="Check torque limit and torque constant of the drive, and run handctl conformance on it.",
)  # fmt: skip
N14B_OSCILLATING_TENSION = declare_fault(
    "N14b", "the tension oscillates",
    f"For {OSCILLATION_DURATION_S * 1e3:g} ms, the tension oscillates about the command with {OSCILLATION_RMS_N:g} "
    f"N RMS, above {MIN_OSCILLATION_HZ:g} Hz",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, relax_method=RelaxMethod.OPEN_LOOP,
    needs_load_cell=True,
    cause="The torque of the motor has a ripple, or the gains are too high for this hand.",
    remedy="Lower the gains (handctl gains, handctl tune), and calibrate the drive against cogging.",
)  # fmt: skip

declare_catalogue_row("N15", "slow node", odrive=_SINGLE_LOSSES_TEXT, ticks=22, required_ticks=22)
N15_SLOW_NODE = declare_fault(
    "N15", "a slow node",
    f"{HALF_RATE_LOSS_COUNT} of {MALFORMED_WINDOW_TICKS} replies of a node are missing, and rarely two in a row",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_NODE,
    cause="The node replies to every second request only, because its control rate is lower than that of the hand.",
    remedy="Raise the node's rate, or lower the control rate of the hand.",
)  # fmt: skip

declare_catalogue_row("N16", "node refuses to release", ticks=2, ms=100, required_ticks=21,
    why="in the required time of 21 ticks of 5 ms the springs open the finger")  # fmt: skip
N16_PULL_AFTER_CUT = declare_fault(
    "N16", "a drive does not release",
    f"The tension or the reported torque does not fall within {TENSION_AFTER_CUT_TIME_S * 1e3:g} ms after the torque "
    "was cut",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    shows_torque_after_cut=True,
    cause="The drive does not obey the cut, or something else pulls the tendon.",
    remedy="Remove the motor power now. Then check the drive before the hand is powered again.",
)  # fmt: skip

declare_catalogue_row("N17", "drives exchanged, or obeying late",
    odrive=f"{INDIRECTLY_VISIBLE}: N05, N06 or T04 in motion or with unequal tensions, because no torque is reported",
    ticks=2, ms=4000)  # fmt: skip
N17_EXCHANGED_TORQUE_REPORTS = declare_fault(
    "N17", "torque reports of another motor",
    f"Over {TORQUE_CORRELATION_TIME_S * 1e3:g} ms, less than {MIN_REPORTED_TORQUE_FRACTION:g} of the small changes "
    "of the command are reported",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_MOTOR, relax_method=RelaxMethod.OPEN_LOOP,
    cause="Cables or identifiers of two motors are exchanged, or the drive obeys late.",
    remedy="Check the identifiers of all motors with handctl scan, and commission again (handctl commission).",
)  # fmt: skip
