"""Text of a new hand file from a few answers, with a comment at each number that is only an assumption."""

from dataclasses import dataclass

from handctl.errors import ConfigError
from handctl.hand.file.quantities import NAME_PATTERN

DENSITY_KG_M3 = 1050.0
"""Density of printed links."""
FLOOR_N = 2.0
"""Tension floor of a new hand [N]."""
PRELOAD_RAD = 0.6
"""Preload of the springs of a new hand [rad]."""
OPENING = 3.0
"""Torque of the springs of an open digit per torque of the tension floor."""
TRIP = 1.2
"""Trip limit per largest tension."""
DRIVE = 1.4
"""Limit within the drive per largest tension."""
SPACING_M = 0.022
"""Distance of neighbouring digits along the hinges [m]."""
FINGERS = ("index", "middle", "ring", "little")
"""Names of the digits of one side. Further digits are numbered."""
LARGEST_COUNT = 8
"""Largest number of digits on a side."""


@dataclass(frozen=True)
class Answers:
    """Answers about a hand.

    Attributes:
        name: name of the hand.
        fingers: number of equal digits on one side.
        opposed: number of equal digits that close against them.
        links_mm: length of each link of a digit, from the palm outwards [mm].
        width_mm: width of the links [mm].
        palm_mm: distance between the two sides [mm].
        tendons: ``one`` per digit, or one ``each`` joint.
        pulley_mm: moment arm at the joints [mm].
        spool_mm: radius of the spools [mm].
        tension_N: largest commanded tension [N].
        strength_N: rated breaking force of the tendons [N].
        protocol: protocol of the drives.
    """

    name: str = "mine"
    fingers: int = 2
    opposed: int = 1
    links_mm: tuple[float, ...] = (40.0, 30.0)
    width_mm: float = 12.0
    palm_mm: float = 52.0
    tendons: str = "one"
    pulley_mm: float = 5.0
    spool_mm: float = 8.0
    tension_N: float = 80.0
    strength_N: float = 600.0
    protocol: str = "mit"


def check_answers(answers: Answers) -> None:
    """Refuse answers that make no hand file. All further limits are those of a hand file.

    Raises:
        ConfigError: a name or a number of digits is wrong.
    """
    if not NAME_PATTERN.fullmatch(answers.name):
        raise ConfigError(repr(answers.name), "--name", "letters, digits and _, first a letter")
    for option, count in (("--fingers", answers.fingers), ("--opposed", answers.opposed)):
        if not 0 <= count <= LARGEST_COUNT:
            raise ConfigError(f"{count}", option, f"0 to {LARGEST_COUNT}")
    if answers.fingers + answers.opposed == 0:
        raise ConfigError("no digit", "--fingers", "a digit at least")
    if not answers.links_mm:
        raise ConfigError("no link", "--links", "the length of each link in millimetres")


def new_hand_text(answers: Answers) -> str:
    """Return the text of a hand file of schema 2."""
    names = _names(answers)
    parts = [_head(answers), _digit_values(answers), _tendon_values(answers), _motor_values(answers)]
    node = 0
    for side, digits in enumerate(names):
        for place, name in enumerate(digits):
            y = (0.5 - side) * answers.palm_mm * 1e-3
            z = SPACING_M * ((len(digits) - 1) / 2 - place)
            motors = _motor_names(answers)
            ids = ", ".join(f"{motor}.node_id = {node + i + 1}" for i, motor in enumerate(motors))
            node += len(motors)
            roll = 180.0 * (1 - side)
            comment = "closes towards -y" if side == 0 else "closes towards +y, against the others"
            parts.append(
                f'[[digit]]\nname = "{name}"\nmount_position_m = [0.0, {_text(y)}, {_text(z)}]\n'
                f"mount_rpy_deg = [{roll}, 0.0, 0.0]   # {comment}\nmotor = {{ {ids} }}"
            )
    return "\n\n".join(parts) + "\n"


def _names(answers: Answers) -> tuple[list[str], list[str]]:
    """Return the names of the digits of both sides."""
    fingers = [FINGERS[i] if i < len(FINGERS) else f"finger_{i + 1}" for i in range(answers.fingers)]
    opposed = ["thumb" if i == 0 else f"thumb_{i + 1}" for i in range(answers.opposed)]
    return fingers, opposed


def _motor_names(answers: Answers) -> list[str]:
    """Return the short names of the motors of a digit."""
    return ["motor"] if answers.tendons == "one" else [f"m{i + 1}" for i in range(len(answers.links_mm))]


def _head(answers: Answers) -> str:
    """Return the tables before the digits."""
    tendons = "one tendon per digit" if answers.tendons == "one" else "one tendon per joint"
    return f"""# Written by handctl config init. SI units, named in each key. Measure or look up what is marked ASSUMED.
# handctl config check --hand FILE finds mistakes, handctl demo --lockstep --hand FILE is the first grasp.
schema = 2
name = "{answers.name}"
description = "{answers.fingers + answers.opposed} digits of {len(answers.links_mm)} joints, {tendons}"

[mount]
gravity_m_s2 = [0.0, 0.0, -9.81]   # palm frame: x out of the palm, y from thumb to fingers, z along the hinges

[[bus]]
name = "main"
bitrate = 1_000_000

[sensor_node]
bus = "main"
sync_id = 0x080
base_id = 0x1A0
tendons = "all"                    # a load cell at every tendon
joints = []                        # no joint encoders; "all" for one at every joint
joint_decimation = 1
tension_noise_N = {_text(answers.tension_N * 0.005)}              # ASSUMED standard deviation of a sample
tension_bias_drift_N = {_text(answers.tension_N * 0.01)}         # ASSUMED, per 100 s
joint_noise_rad = 0.001"""


def _digit_values(answers: Answers) -> str:
    """Return the values that all digits have in common."""
    lengths = [1e-3 * length for length in answers.links_mm]
    width = 1e-3 * answers.width_mm
    masses = [DENSITY_KG_M3 * length * width**2 for length in lengths]
    inertias = [mass * (length**2 + width**2) / 12 for mass, length in zip(masses, lengths, strict=True)]
    count = len(lengths)
    # The floor of all tendons that cross a joint closes it, and its spring opens it.
    crossing = [1] * count if answers.tendons == "one" else [count - i for i in range(count)]
    stiffness = [OPENING * tendons * 1e-3 * answers.pulley_mm * FLOOR_N / PRELOAD_RAD for tendons in crossing]
    lines = [
        "[default.digit]                    # one number holds for every link",
        f"link_length_m = {_list(lengths)}",
        f"link_com_m = {_list([length / 2 for length in lengths])}          # ASSUMED: the middle",
        f"link_mass_kg = {_list(masses)}        # ASSUMED: a bar of {DENSITY_KG_M3:g} kg/m3",
        f"link_inertia_kg_m2 = {_list(inertias)}   # ASSUMED: m (L^2 + h^2) / 12",
        f"link_radius_m = {_text(width / 2)}",
        "joint_min_deg = 0.0",
        "joint_max_deg = 95.0",
        "joint_damping_N_m_s_per_rad = 5e-4 # ASSUMED",
        "joint_armature_kg_m2 = 1e-6        # ASSUMED: pulley and pin",
        f"spring_stiffness_N_m_per_rad = {_list(stiffness)}   # ASSUMED: opens against the tension floor",
        f"spring_preload_rad = {PRELOAD_RAD}           # ASSUMED",
    ]
    if answers.tendons == "one" and count > 1:
        lines.append(f"coupling = {_list([[1.0]] * count)}   # springs equal on equal pulleys: all joints turn alike")
    for i, motor in enumerate(_motor_names(answers)):
        crossed = count if answers.tendons == "one" else i + 1
        arms = ", ".join(f"j{j + 1} = {_text(1e-3 * answers.pulley_mm)}" for j in range(crossed))
        short = "tendon" if answers.tendons == "one" else f"t{i + 1}"
        lines.append(f'tendon.{short} = {{ motor = "{motor}", moment_arm_m = {{ {arms} }} }}')
    return "\n".join(lines)


def _tendon_values(answers: Answers) -> str:
    """Return the values that all tendons have in common."""
    return f"""[default.tendon]
stiffness_N_per_m = 1.0e5          # ASSUMED: handctl identify measures it
damping_N_s_per_m = 30.0           # ASSUMED
knee_N = {_text(answers.strength_N / 3)}                     # ASSUMED: linear up to here
stiffness_beyond_ratio = 0.5       # ASSUMED
knee_width_m = 0.3e-3              # ASSUMED
friction_coefficient = 0.08        # ASSUMED: 0.05 lined, 0.15 dry
wrap_angle_rad = 1.5708            # ASSUMED: before the first joint pulley
rated_breaking_force_N = {_text(answers.strength_N)}
tension_floor_N = {FLOOR_N}
tension_max_N = {_text(answers.tension_N)}
tension_trip_N = {_text(TRIP * answers.tension_N)}              # above this one valid sample relaxes the hand
drive_limit_N = {_text(DRIVE * answers.tension_N)}              # torque_max_N_m / spool_radius_m"""


def _motor_values(answers: Answers) -> str:
    """Return the values that all motors have in common."""
    torque = DRIVE * answers.tension_N * 1e-3 * answers.spool_mm
    options = {
        "mit": "",
        "odrive": "\n# options: the endpoints of your firmware, from its flat_endpoints.json; config check names them",
        "cia402": "\noptions = { rated_torque_N_m = 0.4, counts_per_turn = 65536 }   # ASSUMED: of your drive",
    }
    return f"""[default.motor]                    # quantities at the spool, after the gear
protocol = "{answers.protocol}"
bus = "main"
spool_radius_m = {_text(1e-3 * answers.spool_mm)}
inertia_kg_m2 = 1.3e-4             # ASSUMED: rotor and gear
viscous_N_m_s_per_rad = 1e-3       # ASSUMED
coulomb_N_m = 0.015                # ASSUMED
torque_constant_N_m_per_A = 0.26   # ASSUMED
torque_max_N_m = {_text(torque)}              # the limit that is set in the drive
torque_peak_N_m = {_text(1.1 * torque)}             # ASSUMED: what the motor can make
position_range_rad = 12.5          # as in the drive's registers
velocity_range_rad_s = 50.0        # as in the drive's registers
direction = 1                      # 1 if positive torque winds; handctl commission checks it
zero_rad = 0.0
watchdog_ms = 50{options[answers.protocol]}"""


def _text(value: float) -> str:
    """Return a number with four digits."""
    return repr(float(f"{value:.4g}"))


def _list(values: list[float] | list[list[float]]) -> str:
    """Return a list, or one number if all are equal."""
    texts = [_list(value) if isinstance(value, list) else _text(value) for value in values]
    return "[" + ", ".join(texts) + "]"
