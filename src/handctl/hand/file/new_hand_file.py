"""Text of a new hand file from a few answers of the user.

In the new hand file, a comment marks each number that is only an assumption.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from handctl.errors import ConfigError
from handctl.hand.file.quantity_types import NAME_PATTERN

DENSITY_KG_M3 = 1050.0
"""Density of 3D-printed links [kg/m3]."""
TENSION_FLOOR_N = 2.0
"""Tension floor of a new hand [N]."""
PRELOAD_RAD = 0.6
"""Preload of the return springs of a new hand [rad]."""
OPENING_TORQUE_RATIO = 3.0
"""Torque of a return spring in the open digit, divided by the torque of the tension floor at the same joint."""
TENSION_TRIP_RATIO = 1.2
"""Tension limit ``tension_trip_N`` divided by the largest commanded tension."""
DRIVE_LIMIT_RATIO = 1.4
"""Tension at the torque limit inside the drive, divided by the largest commanded tension."""
OBJECT_DIAMETER_RATIO = 0.75
"""Smallest diameter of a graspable object divided by the length of the digits.

On an object with a smaller diameter, the tips of opposed digits would touch each other.
"""
SMALLEST_OBJECT_MM = 35.0
"""Smallest diameter of an object for which the palm gets space [mm]."""
MIN_OBJECT_SPACE_OF_STRAIGHT_DIGITS_MM = 26.0
"""Smallest free distance at which two facing digits with one link each can grasp an object [mm]."""
CLEARANCE_MM = 5.0
"""Free space between the open digits and an object [mm]."""
DIGIT_LENGTH_RATIO = 14.0
"""Length of a digit divided by the moment arm at its joints.

With a constant ratio of length to moment arm, digits of any length press equally hard.
"""
DIGIT_SIDE_CLEARANCE_MM = 2.0
"""Free space beside a digit, on each of its sides [mm]."""
MAX_DIGIT_ROW_WIDTH_MM = 80.0
"""Largest width of a row of digits, if the gaps are wide enough for the opposed digits [mm]."""
MOTORS_PER_BUS = 8
"""Largest number of motors on a bus. A classical bus of 1 Mbit/s can serve 8 motors at a control rate of 250 Hz."""
MOTORS_PER_FAST_BUS = 4
"""Largest number of motors on a bus of a hand with neither springs nor load cells.

A bus can serve 4 motors at a control rate of 500 Hz. At 250 Hz, the motion loops of a hand with
neither springs nor load cells have a gain margin of 5 dB, and its tensions oscillate.
"""
SENSOR_IDS = {"mit": ("0x080", "0x1A0"), "odrive": ("0x700", "0x720")}
"""CAN identifiers of SYNC and of the first sensor frame, by drive protocol.

The ODrive with node number n has the identifiers 32 n to 32 n + 31.
"""
FINGER_NAMES = ("index", "middle", "ring", "little")
"""Names of the first fingers. Further fingers have a number in their name."""
ENCODER_DECIMATION = 4
"""Number of ticks from one frame of the joint encoders to the next.

With an encoder frame in every tick, a hand of twelve motors and nine encoders could not run at 200
Hz on two buses.
"""
EXTENSOR = "e"
"""Short name of the tendon that opens a digit without springs. The motor of the tendon has the same name."""
MAX_DIGITS_PER_SIDE = 8
"""Largest number of digits on one side of the hand."""


@dataclass(frozen=True)
class NewHandAnswers:
    """Answers of the user about a new hand.

    Attributes:
        name: name of the hand.
        fingers: number of fingers, which are equal digits on the same side of the palm.
        opposed: number of equal digits on the other side of the palm, which close against the
            fingers.
        links_mm: length of each link of a digit, from the palm to the tip [mm].
        width_mm: width of the links [mm].
        palm_mm: distance between the two rows of digits [mm]. If ``palm_mm`` is None, the distance
            is computed from the length of the digits.
        tendons: ``one`` for one tendon per digit, ``each`` for one tendon per joint.
        pulley_mm: moment arm of the tendons at the joints [mm]. If ``pulley_mm`` is None, the
            moment arm is computed from the length of the digits.
        spool_mm: radius of the spools [mm].
        tension_N: largest commanded tension [N].
        strength_N: rated breaking force of the tendons [N].
        protocol: protocol of the drives.
        motor_type: type of the motors, or None for the default type of the protocol.
        cells: ``all`` if each tendon has a load cell, or ``none``.
        encoders: ``all`` if each joint has an encoder, or ``none``.
        springs: ``all`` if springs open the digits. ``none`` if a further tendon opens each digit,
            see ``check_springs``.
    """

    name: str = "mine"
    fingers: int = 2
    opposed: int = 1
    links_mm: tuple[float, ...] = (40.0, 30.0)
    width_mm: float = 12.0
    palm_mm: float | None = None
    tendons: str = "one"
    pulley_mm: float | None = None
    spool_mm: float = 8.0
    tension_N: float = 80.0
    strength_N: float = 600.0
    protocol: str = "mit"
    motor_type: str | None = None
    cells: str = "all"
    encoders: str = "none"
    springs: str = "all"

    @property
    def digit_length_mm(self) -> float:
        """Return the length of a digit [mm]."""
        return sum(self.links_mm)

    @property
    def palm(self) -> float:
        """Return the distance between the two rows of digits on the palm [mm].

        The default distance leaves space for a thick object.
        """
        return self.palm_width_for_thick_object if self.palm_mm is None else self.palm_mm

    @property
    def palm_width_for_thick_object(self) -> float:
        """Return the distance between the two rows of digits [mm] that leaves space for a thick object."""
        return (
            max(SMALLEST_OBJECT_MM, OBJECT_DIAMETER_RATIO * self.digit_length_mm)
            + self.width_mm
            + CLEARANCE_MM
        )

    @property
    def joint_moment_arm_mm(self) -> float:
        """Return the moment arm [mm] of the tendons at the joints.

        By default, the moment arm is in proportion to the length of the digits.
        """
        return (
            self.digit_length_mm / DIGIT_LENGTH_RATIO if self.pulley_mm is None else self.pulley_mm
        )


def check_new_hand_answers(hand_answers: NewHandAnswers) -> None:
    """Check the user's answers about a new hand before the hand file is written.

    Mistakes that this function does not find are found later, by the checks of the finished hand
    file.

    Raises:
        ConfigError: the name, a number of digits, the distance between the sides of the palm, or
            the lengths of the links are wrong.
    """
    check_name(hand_answers.name)
    for option, count in (("--fingers", hand_answers.fingers), ("--opposed", hand_answers.opposed)):
        if not 0 <= count <= MAX_DIGITS_PER_SIDE:
            raise ConfigError(f"{count}", option, f"0 to {MAX_DIGITS_PER_SIDE}")
    if hand_answers.fingers + hand_answers.opposed == 0:
        raise ConfigError("no digit", "--fingers", "a digit at least")
    min_palm_width = hand_answers.width_mm + 2 * CLEARANCE_MM
    if hand_answers.opposed and hand_answers.fingers and hand_answers.palm < min_palm_width:
        raise ConfigError(
            f"{hand_answers.palm:g}",
            "--palm",
            f"at least {min_palm_width:g} mm, for an object between the digits",
        )
    if not hand_answers.links_mm:
        raise ConfigError("no link", "--links", "the length of each link in millimetres")
    check_springs(hand_answers.tendons, hand_answers.springs)


def check_springs(tendons: str | None, spring_torques_text: str | None) -> None:
    """Check that springs or a tendon can open each digit.

    If a digit has a single tendon, the tendon only closes the digit, and springs must open the
    digit.

    Args:
        tendons: answer ``one`` or ``each`` about the tendons of a digit, or None.
        spring_torques_text: answer ``all`` or ``none`` about the springs, or None.

    Raises:
        ConfigError: the digits have one tendon and no springs.
    """
    if tendons == "one" and spring_torques_text == "none":
        raise ConfigError(
            "none, and one tendon cannot open a digit", "--springs", "all, or --tendons each"
        )


def check_name(name: str) -> None:
    """Check that the name of a hand is valid in a hand file.

    Raises:
        ConfigError: the name of the hand is not valid.
    """
    if not NAME_PATTERN.fullmatch(name):
        raise ConfigError(repr(name), "--name", "letters, digits and _, first a letter")


def opposition_warnings(hand_answers: NewHandAnswers) -> tuple[str, ...]:
    """Return a warning that proposes opposed digits if all digits are on one side."""
    digits = hand_answers.fingers + hand_answers.opposed
    if hand_answers.fingers and hand_answers.opposed:
        return ()
    option = "--fingers" if hand_answers.opposed else "--opposed"
    return (
        f"{option} 0: all digits are on one side; the same number on two sides is "
        f"--fingers {digits - 1} --opposed 1"
        if digits > 1
        else f"{option} 0: a single digit; two digits that close against each other are "
        "--fingers 1 --opposed 1",
    )


def palm_warnings(hand_answers: NewHandAnswers) -> tuple[str, ...]:
    """Return one line for each warning that the palm is too narrow for digits that face each other."""
    # Digits with a single straight link touch even thin objects before their tips meet.
    sufficient_palm_width = (
        hand_answers.palm_width_for_thick_object
        if len(hand_answers.links_mm) > 1
        else hand_answers.width_mm + MIN_OBJECT_SPACE_OF_STRAIGHT_DIGITS_MM
    )
    if hand_answers.fingers != hand_answers.opposed or hand_answers.palm >= sufficient_palm_width:
        return ()
    return (
        f"--palm {hand_answers.palm:g}: tips of {hand_answers.digit_length_mm:g} mm digits may meet around an object "
        f"that fits, and not press on it; expected {sufficient_palm_width:.0f} mm, shorter links, or a finger more "
        "on one side",
    )


def new_hand_text(
    hand_answers: NewHandAnswers, drive_options: Mapping[str, Any], can_fd: bool
) -> str:
    """Return the text of a hand file (schema 2) for a new hand.

    Args:
        hand_answers: the user's hand_answers, already checked.
        drive_options: options of a drive of the protocol.
        can_fd: True if the protocol of the drives needs a bus with CAN FD.
    """
    file_sections = [_tables_before_digits(hand_answers, can_fd), _digit_values(hand_answers)]
    file_sections += [_tendon_values(hand_answers), _motor_values(hand_answers, drive_options)]
    motors = _motor_names(hand_answers)
    buses = _bus_names(hand_answers)
    digits_per_bus = _digits_per_bus(hand_answers)
    digits = zip(_digit_names(hand_answers), _mount_positions(hand_answers), strict=True)
    for number, ((name, side), z) in enumerate(digits):
        y = (0.5 - side) * hand_answers.palm * 1e-3
        bus = buses[number // digits_per_bus]
        # On each bus, the node numbers begin at 1.
        first_node_id = number % digits_per_bus * len(motors) + 1
        bus_entry_format = "" if bus == buses[0] else ', {}.bus = "' + bus + '"'
        ids = ", ".join(
            f"{motor}.node_id = {first_node_id + i}{bus_entry_format.format(motor)}"
            for i, motor in enumerate(motors)
        )
        roll = 180.0 * (1 - side)
        comment = "closes towards -y" if side == 0 else "closes towards +y, against the others"
        file_sections.append(
            f'[[digit]]\nname = "{name}"\nmount_position_m = [0.0, {_number_text(y)}, {_number_text(z)}]\n'
            f"mount_rpy_deg = [{roll}, 0.0, 0.0]   # {comment}\nmotor = {{ {ids} }}"
        )
    return "\n\n".join(file_sections) + "\n"


def _digit_names(hand_answers: NewHandAnswers) -> list[tuple[str, int]]:
    """Return name and side of each digit. Side 0 of the palm has the fingers, and side 1 has the opposed digits."""
    fingers = [
        FINGER_NAMES[i] if i < len(FINGER_NAMES) else f"finger_{i + 1}"
        for i in range(hand_answers.fingers)
    ]
    opposed = ["thumb" if i == 0 else f"thumb_{i + 1}" for i in range(hand_answers.opposed)]
    return [*((name, 0) for name in fingers), *((name, 1) for name in opposed)]


def _mount_positions(hand_answers: NewHandAnswers) -> list[float]:
    """Return the position of each digit in the direction of the hinge axes [m]. The fingers come first.

    If the two sides of the palm have different numbers of digits, each digit faces a gap between
    two digits of the other side. If the tips of two digits faced each other, the tips would meet
    before the digits press on an object.
    """
    counts = (hand_answers.fingers, hand_answers.opposed)
    spacing_of_passing_digits = hand_answers.width_mm * 2 + DIGIT_SIDE_CLEARANCE_MM
    digit_spacing = max(
        hand_answers.width_mm + DIGIT_SIDE_CLEARANCE_MM,
        min(spacing_of_passing_digits, MAX_DIGIT_ROW_WIDTH_MM / max(1, max(counts) - 1)),
    )
    # If the numbers of digits differ, but both are even or both are odd, one row of digits is moved
    # by half of the distance between its digits. If the row were not moved, digits of both rows
    # would face each other.
    row_offset_mm = digit_spacing / 2 if counts[0] != counts[1] and sum(counts) % 2 == 0 else 0.0
    places = []
    for count in counts:
        offset = row_offset_mm if count == min(counts) else 0.0
        places += [1e-3 * (digit_spacing * ((count - 1) / 2 - i) + offset) for i in range(count)]
    return places


def _bus_names(hand_answers: NewHandAnswers) -> list[str]:
    """Return the names of the buses."""
    count = math.ceil((hand_answers.fingers + hand_answers.opposed) / _digits_per_bus(hand_answers))
    return ["main", *(f"bus_{i + 1}" for i in range(1, count))]


def _digits_per_bus(hand_answers: NewHandAnswers) -> int:
    """Return the largest number of digits per bus.

    All motors of a digit are on the same bus.
    """
    digits = hand_answers.fingers + hand_answers.opposed
    needs_fast_bus = hand_answers.springs == hand_answers.cells == "none"
    motors_per_bus = MOTORS_PER_FAST_BUS if needs_fast_bus else MOTORS_PER_BUS
    buses = math.ceil(digits / max(1, motors_per_bus // len(_motor_names(hand_answers))))
    return math.ceil(digits / buses)


def _motor_names(hand_answers: NewHandAnswers) -> list[str]:
    """Return the short names of the motors of a digit."""
    if hand_answers.tendons == "one":
        return ["motor"]
    closing = [f"m{i + 1}" for i in range(len(hand_answers.links_mm))]
    return closing if hand_answers.springs == "all" else [*closing, EXTENSOR]


def _tables_before_digits(hand_answers: NewHandAnswers, can_fd: bool) -> str:
    """Return the text of the hand file before the first digit."""
    tendons = "one tendon per digit" if hand_answers.tendons == "one" else "one tendon per joint"
    if hand_answers.springs == "none":
        tendons += " and one that opens the digit"
    bitrate = "bitrate = 1_000_000"
    if can_fd:
        bitrate += "\ndata_bitrate = 5_000_000         # ASSUMED: as set in the drives"
    buses = "\n\n".join(f'[[bus]]\nname = "{name}"\n{bitrate}' for name in _bus_names(hand_answers))
    return f"""# Written by handctl config init. SI units, named in each key. Measure or look up what is marked ASSUMED.
# handctl config check --hand FILE finds mistakes, handctl demo --lockstep --hand FILE is the first
# grasp.
schema = 2
name = "{hand_answers.name}"
description = "{hand_answers.fingers + hand_answers.opposed} digits of {len(hand_answers.links_mm)} joints, {tendons}"

[mount]
gravity_m_s2 = [0.0, 0.0, -9.81]   # palm frame: x out of the palm, y from thumb to fingers, z along the hinges

{buses}{_sensor_table(hand_answers)}"""


def _sensor_table(hand_answers: NewHandAnswers) -> str:
    """Return the text of the section ``sensor_node``, or an empty text for a hand without sensors."""
    if hand_answers.cells == hand_answers.encoders == "none":
        return ""
    sync, base = SENSOR_IDS.get(hand_answers.protocol, SENSOR_IDS["mit"])
    cells = (
        '"all"                    # a load cell at every tendon'
        if hand_answers.cells == "all"
        else '[]                       # no load cells; "all" for one at every tendon'
    )
    encoders = (
        '"all"                     # an encoder at every joint'
        if hand_answers.encoders == "all"
        else '[]                        # no joint encoders; "all" for one at every joint'
    )
    return f"""

[sensor_node]
bus = "main"
sync_id = {sync:s}
base_id = {base:s}
tendons = {cells}
joints = {encoders}
joint_decimation = {ENCODER_DECIMATION if hand_answers.encoders == "all" else 1}
tension_noise_N = {_number_text(hand_answers.tension_N * 0.005)}              # ASSUMED standard deviation of a sample
tension_bias_drift_N = {_number_text(hand_answers.tension_N * 0.01)}         # ASSUMED, per 100 s
joint_noise_rad = 0.001            # standard deviation of an encoder sample"""


def _digit_values(hand_answers: NewHandAnswers) -> str:
    """Return the text with the values that all digits have in common."""
    lengths = [1e-3 * length for length in hand_answers.links_mm]
    width = 1e-3 * hand_answers.width_mm
    masses = [DENSITY_KG_M3 * length * width**2 for length in lengths]
    inertias = [
        mass * (length**2 + width**2) / 12 for mass, length in zip(masses, lengths, strict=True)
    ]
    count = len(lengths)
    lines = [
        "[default.digit]                    # one number holds for every link",
        f"link_length_m = {_list_text(lengths)}",
        f"link_com_m = {_list_text([length / 2 for length in lengths])}          # ASSUMED: the middle",
        f"link_mass_kg = {_list_text(masses)}        # ASSUMED: a bar of {DENSITY_KG_M3:g} kg/m3",
        f"link_inertia_kg_m2 = {_list_text(inertias)}   # ASSUMED: m (L^2 + h^2) / 12",
        f"link_radius_m = {_number_text(width / 2)}",
        "joint_min_deg = 0.0",
        "joint_max_deg = 95.0",
        "joint_damping_N_m_s_per_rad = 5e-4 # ASSUMED",
        "joint_armature_kg_m2 = 1e-6        # ASSUMED: pulley and pin",
        *_spring_lines(hand_answers),
    ]
    if hand_answers.tendons == "one" and count > 1:
        coupling = _list_text([[1.0]] * count)
        lines.append(
            f"coupling = {coupling}   # springs equal on equal pulleys: all joints turn alike"
        )
    for i, motor in enumerate(_motor_names(hand_answers)):
        short_name = "tendon" if hand_answers.tendons == "one" else f"t{i + 1}"
        if motor == EXTENSOR:
            short_name = EXTENSOR
        arms = ", ".join(
            f"j{j + 1} = {_number_text(arm)}" for j, arm in enumerate(_moment_arms(hand_answers, i))
        )
        lines.append(f'tendon.{short_name} = {{ motor = "{motor}", moment_arm_m = {{ {arms} }} }}')
    return "\n".join(lines)


def _spring_lines(hand_answers: NewHandAnswers) -> list[str]:
    """Return the lines about the return springs of a digit, or no lines for a digit without springs."""
    if hand_answers.springs == "none":
        return []
    # All tendons that cross a joint close the joint. If all tensions are at the tension floor, the
    # spring of a joint must open the joint against all tendons that cross it.
    stiffness = [
        OPENING_TORQUE_RATIO
        * tendons
        * 1e-3
        * hand_answers.joint_moment_arm_mm
        * TENSION_FLOOR_N
        / PRELOAD_RAD
        for tendons in _closing_tendons(hand_answers)
    ]
    return [
        f"spring_stiffness_N_m_per_rad = {_list_text(stiffness)}   # ASSUMED: opens against the tension floor",
        f"spring_preload_rad = {PRELOAD_RAD}           # ASSUMED",
    ]


def _closing_tendons(hand_answers: NewHandAnswers) -> list[int]:
    """Return the number of tendons that close each joint of a digit."""
    count = len(hand_answers.links_mm)
    return [1] * count if hand_answers.tendons == "one" else [count - i for i in range(count)]


def _moment_arms(hand_answers: NewHandAnswers, tendon: int) -> list[float]:
    """Return the moment arm [m] of a digit's tendon at each joint that the tendon crosses.

    If a digit has n joints and n + 1 tendons, one tendon opens the digit, and n tendons close it.
    The closing tendon with index i crosses the joints 0 to i. If the n closing tendons have equal
    tensions, the opening tendon needs n times the tension of one closing tendon to balance all of
    them. The moment arm of the opening tendon at a joint is in proportion to the number of tendons
    that close the joint.

    Args:
        hand_answers: the user's hand_answers.
        tendon: index of the tendon among the tendons of the digit.
    """
    arm = 1e-3 * hand_answers.joint_moment_arm_mm
    count = len(hand_answers.links_mm)
    if hand_answers.tendons == "one":
        return [arm] * count
    if tendon < count:
        return [arm] * (tendon + 1)
    return [-arm * crossing / count for crossing in _closing_tendons(hand_answers)]


def _tendon_values(hand_answers: NewHandAnswers) -> str:
    """Return the text with the values that all tendons have in common."""
    trip_tension_text = _number_text(TENSION_TRIP_RATIO * hand_answers.tension_N)
    drive_limit_text = _number_text(DRIVE_LIMIT_RATIO * hand_answers.tension_N)
    return f"""[default.tendon]
stiffness_N_per_m = 1.0e5          # ASSUMED: handctl identify measures it
damping_N_s_per_m = 30.0           # ASSUMED
knee_N = {_number_text(hand_answers.strength_N / 3)}                     # ASSUMED: linear up to here
stiffness_beyond_ratio = 0.5       # ASSUMED
knee_width_m = 0.3e-3              # ASSUMED
friction_coefficient = 0.08        # ASSUMED: 0.05 lined, 0.15 dry
wrap_angle_rad = 1.5708            # ASSUMED: before the first joint pulley
rated_breaking_force_N = {_number_text(hand_answers.strength_N)}
tension_floor_N = {TENSION_FLOOR_N}
tension_max_N = {_number_text(hand_answers.tension_N)}
tension_trip_N = {trip_tension_text}              # above this one valid sample relaxes the hand
drive_limit_N = {drive_limit_text}              # torque_max_N_m / spool_radius_m"""


def _motor_values(hand_answers: NewHandAnswers, drive_options: Mapping[str, Any]) -> str:
    """Return the text with the values that all motors have in common."""
    torque = DRIVE_LIMIT_RATIO * hand_answers.tension_N * 1e-3 * hand_answers.spool_mm
    return f"""[default.motor]                    # quantities at the spool, after the gear
protocol = "{hand_answers.protocol}"
bus = "main"
spool_radius_m = {_number_text(1e-3 * hand_answers.spool_mm)}
inertia_kg_m2 = 1.3e-4             # ASSUMED: rotor and gear
viscous_N_m_s_per_rad = 1e-3       # ASSUMED
coulomb_N_m = 0.015                # ASSUMED
torque_constant_N_m_per_A = 0.26   # ASSUMED
torque_max_N_m = {_number_text(torque)}              # the limit that is set in the drive
torque_peak_N_m = {_number_text(1.1 * torque)}             # ASSUMED: what the motor can make
position_range_rad = 12.5          # as in the drive's registers
velocity_range_rad_s = 50.0        # as in the drive's registers
direction = 1                      # 1 if positive torque winds; handctl commission checks it
zero_rad = 0.0
watchdog_ms = 50{options_line(hand_answers.protocol, drive_options, hand_answers.cells == "all")}"""


def options_line(protocol: str, drive_options: Mapping[str, Any], has_cells: bool) -> str:
    """Return the TOML text with the options of the drives, which begins with a line break.

    The returned text is empty if the protocol has no options.

    Args:
        protocol: protocol of the drives.
        drive_options: options of the drives.
        has_cells: True if load cells measure the tension of all tendons.
    """
    if protocol == "odrive":
        line = "\n# options: the endpoints of your firmware, from its flat_endpoints.json; config check names them"
        return (
            line
            if has_cells
            else f"\noptions = {{ torque_feedback = true }}   # no load cells{line}"
        )
    if not drive_options:
        return ""
    values = ", ".join(f"{key} = {json.dumps(value)}" for key, value in drive_options.items())
    return f"\noptions = {{ {values} }}   # ASSUMED: of your drive"


def _number_text(value: float) -> str:
    """Return the text of a number with four significant digits."""
    return repr(float(f"{value:.4g}"))


def _list_text(values: list[float] | list[list[float]]) -> str:
    """Return the TOML text of a list. If all entries are equal, return the text of one number."""
    texts = [
        _list_text(value) if isinstance(value, list) else _number_text(value) for value in values
    ]
    return "[" + ", ".join(texts) + "]"
