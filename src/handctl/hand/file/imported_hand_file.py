"""Text of a new hand file for the digits of a robot description.

The file contains ``"TODO"`` for each value that the robot description does not contain.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from handctl.hand.digit import Array
from handctl.hand.file.error_text import first_sentence
from handctl.hand.file.key_descriptions import key_description
from handctl.hand.file.new_hand_file import (
    DRIVE_LIMIT_RATIO,
    MOTORS_PER_BUS,
    SENSOR_IDS,
    TENSION_FLOOR_N,
    TENSION_TRIP_RATIO,
)
from handctl.hand.file.quantity_types import UNMEASURED_PLACEHOLDER
from handctl.hand.file.section_models import (
    PRISMATIC,
    PRISMATIC_KEYS,
    REVOLUTE_KEYS,
    Y_AXIS,
    Z_AXIS,
    Digit,
    Motor,
    Mount,
    Section,
    SensorNode,
    Tendon,
)
from handctl.hand.file.toml_text import quoted_string
from handctl.hand.formats.model_tree import ModelDigit, ModelMesh
from handctl.hand.link_geometry import rpy_of_rotation

SMALLEST_MOMENT_ARM_M = 1e-4
"""Smallest absolute moment arm of a tendon [m]."""
LARGEST_MOMENT_ARM_M = 0.05
"""Largest absolute moment arm of a tendon [m].

A coefficient of a fixed tendon in MJCF is used as a moment arm only if it is between
SMALLEST_MOMENT_ARM_M and LARGEST_MOMENT_ARM_M.
"""
ROUNDING_TOLERANCE = 1e-9
"""Tolerance for rounding errors in an axis, a position or a rotation."""
WRITTEN_DECIMALS = 12
"""Number of decimals of a length, a mass or an inertia in the new hand file, in SI units."""
KEYS_CHOSEN_BY_USER = {
    "protocol",
    "tendons",
    "joints",
    "tension_floor_N",
    "tension_max_N",
    "tension_trip_N",
    "drive_limit_N",
    "torque_max_N_m",
    "position_range_rad",
    "velocity_range_rad_s",
}
"""Keys whose values the user chooses. The user must measure the missing values of all other keys."""
MISSING_MOMENT_ARMS_COMMENT = (
    f"{UNMEASURED_PLACEHOLDER} measure: the moment arm at each "
    "joint that it passes, as in "
    f"{{ j1 = 0.010, j2 = 0.008 }}"
)
"""Comment after a tendon without moment arms in the new hand file."""
PLACEHOLDER_TENDONS_COMMENT = (
    "# The tendons below only stand for those of the "
    "hand: one for each {}. Add, remove and rename them.\n"
)
"""Comment at the top of the new hand file if the robot description has no tendons."""


@dataclass(frozen=True)
class ImportAnswers:
    """Answers of the user about values that a robot description does not contain.

    If an answer of the user is missing, the new hand file contains ``"TODO"``.

    Attributes:
        name: name of the hand.
        tendons: ``one`` for one tendon per digit, ``each`` for one tendon per joint. Without an
            answer, the hand file has one tendon per joint.
        pulley_mm: moment arm of the tendons at the joints [mm].
        spool_mm: radius of the spools [mm].
        tension_N: largest commanded tension [N].
        strength_N: rated breaking force of the tendons [N].
        protocol: protocol of the drives.
        motor_type: type of the motors, or None for the default type of the protocol.
        first_node: node number of the first drive on each bus. The other drives on the bus get the
            following node numbers.
        cells: ``all`` if all tendons have a load cell, ``none`` if no tendon has one.
        encoders: ``all`` if all joints have an encoder, ``none`` if no joint has one.
        springs: ``all`` if springs open the digits, ``none`` if antagonistic tendons open them.
    """

    name: str | None = None
    tendons: str | None = None
    pulley_mm: float | None = None
    spool_mm: float | None = None
    tension_N: float | None = None
    strength_N: float | None = None
    protocol: str | None = None
    motor_type: str | None = None
    first_node: int | None = None
    cells: str | None = None
    encoders: str | None = None
    springs: str | None = None


@dataclass(frozen=True, eq=False)
class ImportedHand:
    """Hand that was read from a robot description (URDF or MJCF).

    Attributes:
        source: name of the file with the robot description.
        name: name of the hand.
        gravity: (3,) gravitational acceleration in the palm frame [m/s2], or None if the robot
            description does not contain it.
        palm: (3, 3) rotation from the palm frame to the root frame of the robot description.
        digits: digits of the hand, where each digit comes after the digit that carries it.
        tendons: a table for each tendon, with ``name``, ``arms``, ``motor``, ``tension_max`` and
            ``pulls_both_ways``.
        palm_mesh: mesh of the palm in the palm frame, or None for a palm without a mesh.
    """

    source: str
    name: str
    gravity: Sequence[float] | None
    palm: Array
    digits: tuple[ModelDigit, ...]
    tendons: Sequence[Mapping[str, Any]]
    palm_mesh: ModelMesh | None = None


@dataclass(frozen=True)
class _SectionLine:
    """Line of a section of the new hand file: a key, the text of the value, and a comment."""

    key: str
    value: str
    comment: str = ""

    def __str__(self) -> str:
        return f"{self.key} = {self.value}" + (f"   # {self.comment}" if self.comment else "")


def usable_tendons(imported_hand: ImportedHand) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the tendons that a hand file can contain, and a note about each tendon that it cannot contain.

    The table of each tendon has ``digit``, ``name``, ``motor``, ``tension_max``, ``is_spool_pair``,
    ``sliding`` and ``arms``. ``arms`` is a mapping from the short name of a joint, such as ``j1``,
    to the moment arm of the tendon at this joint.
    """
    joint_indices = {
        joint: (digit.name, f"j{i + 1}")
        for digit in imported_hand.digits
        for i, joint in enumerate(digit.joints)
    }
    prismatic_joints = {
        (digit.name, joint) for digit in imported_hand.digits for joint in _sliding_joints(digit)
    }
    usable_tendons_found: list[dict[str, Any]] = []
    notes = []
    for tendon in imported_hand.tendons:
        name = tendon["name"]
        arms = {joint_indices[joint]: arm for joint, arm in tendon["arms"].items() if arm}
        digits = {digit for digit, _ in arms}
        if len(digits) != 1:
            notes.append(f"tendon {name} is not read: it moves joints of {len(digits)} digits")
        elif not all(
            SMALLEST_MOMENT_ARM_M <= abs(arm) <= LARGEST_MOMENT_ARM_M
            for digit_and_joint, arm in arms.items()
            if digit_and_joint not in prismatic_joints
        ):
            expected = f"{SMALLEST_MOMENT_ARM_M:g} to {LARGEST_MOMENT_ARM_M:g} m"
            notes.append(
                f"tendon {name} is not read: its coefficients are no moment arms of {expected}"
            )
        else:
            (digit,) = digits
            own_values: dict[str, Any] = {
                "digit": digit,
                "name": _short_name(name, digit),
                "motor": _short_name(tendon["motor"] or name, digit),
            }
            own_values |= {
                "arms": {joint: arm for (_, joint), arm in arms.items()},
                "sliding": {
                    joint
                    for digit_and_joint in prismatic_joints & arms.keys()
                    for joint in digit_and_joint[1:]
                },
                "tension_max": tendon["tension_max"],
                "is_spool_pair": tendon["pulls_both_ways"],
            }
            usable_tendons_found.append(own_values)
    # If the tendons together do not move every joint, the tendons only model a mechanism, and other
    # actuators move the hand.
    moved_joints = {
        (tendon["digit"], joint) for tendon in usable_tendons_found for joint in tendon["arms"]
    }
    if usable_tendons_found and moved_joints != set(joint_indices.values()):
        notes.append("the tendons of the file are not read: they do not move every joint")
        return [], notes
    return usable_tendons_found, notes


def imported_hand_text(
    imported_hand: ImportedHand,
    import_answers: ImportAnswers,
    drive_options_text: str,
    can_fd: bool,
) -> str:
    """Return the text of a hand file (schema 2) for a robot description.

    Args:
        imported_hand: hand of a robot description.
        import_answers: the user's answers about values that the robot description does not contain.
        drive_options_text: line with the options of the drives, or an empty text for drives without options.
        can_fd: True if the protocol of the drives needs a bus with CAN FD.
    """
    tendons, _ = usable_tendons(imported_hand)
    has_placeholder_tendons = not tendons
    tendons = tendons or [
        line
        for digit in imported_hand.digits
        for line in _placeholder_tendons(digit, import_answers)
    ]
    buses = _bus_by_digit(imported_hand, tendons)
    file_sections = [
        _text_before_digits(
            imported_hand, import_answers, max(buses.values(), default=0) + 1, can_fd
        )
    ]
    if has_placeholder_tendons:
        file_sections[0] = (
            PLACEHOLDER_TENDONS_COMMENT.format(
                "digit" if import_answers.tendons == "one" else "joint"
            )
            + file_sections[0]
        )
    common_lines = _common_lines(imported_hand, import_answers)
    file_sections += [_section_text("default.digit", common_lines)] if common_lines else []
    max_tensions = {tendon["tension_max"] for tendon in tendons}
    if import_answers.tension_N is None and len(max_tensions) == 1:
        import_answers = replace(import_answers, tension_N=max_tensions.pop())
    file_sections.append(_section_text("default.tendon", _tendon_lines(import_answers)))
    file_sections.append(
        _section_text("default.motor", _motor_lines(import_answers)) + drive_options_text
    )
    nodes: dict[int, int | None] = dict.fromkeys(buses.values(), import_answers.first_node)
    for digit in imported_hand.digits:
        digit_tendons = [tendon for tendon in tendons if tendon["digit"] == digit.name]
        lines = [
            *_digit_lines(digit, import_answers),
            *_drive_lines(digit_tendons, buses[digit.name], nodes),
        ]
        coupling = digit.coupling
        if len(digit_tendons) < coupling.shape[1]:
            lines.append(_todo_line(Digit, "coupling"))
        elif coupling.shape[1] < len(digit.joints):
            lines.append(_SectionLine("coupling", _number_rows_text(coupling)))
        file_sections.append(
            f"# joints in {imported_hand.source}: {', '.join(digit.joints)}\n"
            + _section_text("[digit]", lines)
        )
    return "\n\n".join(file_sections) + "\n"


def _placeholder_tendons(
    digit: ModelDigit, import_answers: ImportAnswers
) -> Iterable[dict[str, Any]]:
    """Yield placeholder tendons for a digit. The tendons have moment arms if the user has given a pulley radius."""
    joints = [f"j{i + 1}" for i in range(len(digit.joints))]
    prismatic_joints = _sliding_joints(digit)
    arm = None if import_answers.pulley_mm is None else 1e-3 * import_answers.pulley_mm
    crossed_joints = (
        [joints]
        if import_answers.tendons == "one"
        else [joints[: np.flatnonzero(column)[-1] + 1] for column in digit.coupling.T]
    )
    for i, names in enumerate(crossed_joints):
        yield {
            "digit": digit.name,
            "name": f"t{i + 1}",
            "motor": f"m{i + 1}",
            "arms": None
            if arm is None and not set(names) <= prismatic_joints
            else {name: 1.0 if name in prismatic_joints else arm for name in names},
            "sliding": prismatic_joints & set(names),
            "tension_max": None,
            "is_spool_pair": False,
        }


def _sliding_joints(digit: ModelDigit) -> set[str]:
    """Return the short names of the prismatic joints of a digit."""
    return {f"j{i + 1}" for i, link in enumerate(digit.links) if link.is_prismatic}


def _bus_by_digit(
    imported_hand: ImportedHand, tendons: Sequence[Mapping[str, Any]]
) -> dict[str, int]:
    """Return the index of the bus for each digit. All motors of a digit are on the same bus."""
    buses = {}
    bus = motors_on_bus = 0
    for digit in imported_hand.digits:
        count = sum(tendon["digit"] == digit.name for tendon in tendons)
        if motors_on_bus and motors_on_bus + count > MOTORS_PER_BUS:
            bus, motors_on_bus = bus + 1, 0
        motors_on_bus += count
        buses[digit.name] = bus
    return buses


def _bus_name(bus: int) -> str:
    return "main" if bus == 0 else f"bus_{bus + 1}"


def _text_before_digits(
    imported_hand: ImportedHand, import_answers: ImportAnswers, buses: int, can_fd: bool
) -> str:
    """Return the text of the hand file before the first digit."""
    joints = sum(len(digit.joints) for digit in imported_hand.digits)
    palm_rotation_text = (
        ""
        if np.array_equal(imported_hand.palm, np.eye(3))
        else (
            f"# The palm frame is the root frame of {imported_hand.source} turned by roll, pitch, yaw of "
            f"{_number_list_text(np.round(np.degrees(rpy_of_rotation(imported_hand.palm)), 6))} degrees.\n"
        )
    )
    gravity = imported_hand.gravity
    mount = (
        _todo_line(Mount, "gravity_m_s2")
        if gravity is None
        else _SectionLine("gravity_m_s2", _number_list_text(gravity))
    )
    rate = "bitrate = 1_000_000" + ("\ndata_bitrate = 5_000_000" if can_fd else "")
    palm_mesh = "".join(f"{line}\n" for line in _palm_mesh_lines(imported_hand.palm_mesh))
    lines = "\n\n".join(f'[[bus]]\nname = "{_bus_name(bus)}"\n{rate}' for bus in range(buses))
    return (
        f"# From {imported_hand.source} by handctl config init. Each value {UNMEASURED_PLACEHOLDER!r} must be "
        "measured or\n"
        f"# chosen before the hand can run: handctl config check --hand FILE lists them.\n{palm_rotation_text}"
        f'schema = 2\nname = "{import_answers.name or imported_hand.name}"\n'
        f'description = "{len(imported_hand.digits)} digits, {joints} joints, from {imported_hand.source}"\n\n'
        f"[mount]\n{mount}\n{palm_mesh}\n{lines}{_sensor_node(import_answers)}"
    )


def _sensor_node(import_answers: ImportAnswers) -> str:
    """Return the text of the section ``sensor_node``.

    The text of the section is empty if the hand has no sensors.
    """
    if import_answers.cells == import_answers.encoders == "none":
        return ""
    sync, base = SENSOR_IDS.get(import_answers.protocol or "", SENSOR_IDS["mit"])
    lines = [
        _SectionLine("bus", '"main"'),
        _SectionLine("sync_id", sync),
        _SectionLine("base_id", base),
    ]
    for key, answer in (("tendons", import_answers.cells), ("joints", import_answers.encoders)):
        list_text = {"all": '"all"', "none": "[]"}.get(answer or "")
        lines.append(
            _todo_line(SensorNode, key) if list_text is None else _SectionLine(key, list_text)
        )
    lines.append(_SectionLine("joint_decimation", "1"))
    for key, answer in (
        ("tension_noise_N", import_answers.cells),
        ("tension_bias_drift_N", import_answers.cells),
        ("joint_noise_rad", import_answers.encoders),
    ):
        value_without_sensor = "0.001" if key == "joint_noise_rad" else "0.0"
        lines.append(
            _SectionLine(key, value_without_sensor, "no such sensor")
            if answer == "none"
            else _todo_line(SensorNode, key)
        )
    return "\n\n" + _section_text("sensor_node", lines)


def _common_lines(imported_hand: ImportedHand, import_answers: ImportAnswers) -> list[_SectionLine]:
    """Return lines for the digit values that are missing in the robot description.

    Each missing value has a single line in the new hand file, which applies to all digits.
    """
    all_links = [link for digit in imported_hand.digits for link in digit.links]
    is_known_by_key = {"link_radius_m": any(link.radius for link in all_links)}
    for is_prismatic in (False, True):
        links = [link for link in all_links if link.is_prismatic == is_prismatic]
        has_springs = any(link.stiffness for link in links) or import_answers.springs == "none"
        values = {
            "joint_damping_N_m_s_per_rad": any(link.damping for link in links),
            "joint_armature_kg_m2": any(link.armature for link in links),
            "spring_stiffness_N_m_per_rad": has_springs,
            "spring_preload_rad": has_springs,
        }
        is_known_by_key |= {
            _key_for_joint_type(key, is_prismatic): not links or value
            for key, value in values.items()
        }
    return [_todo_line(Digit, key) for key, is_known in is_known_by_key.items() if not is_known]


def _digit_lines(digit: ModelDigit, import_answers: ImportAnswers) -> list[_SectionLine]:
    """Return lines for the values that the robot description gives for a digit."""
    links = digit.links
    lines = [_SectionLine("name", f'"{digit.name}"')]
    if digit.carrier is not None:
        lines.append(_SectionLine("mount_on", f'"{digit.carrier}"'))
    lines += [
        _SectionLine("mount_position_m", _number_list_text(digit.position)),
        _SectionLine("mount_rpy_deg", _rpy_deg_text(digit.rotation)),
        _SectionLine("link_length_m", _number_list_text(digit.lengths)),
    ]
    are_prismatic = [link.is_prismatic for link in links]
    if any(are_prismatic):
        kinds = ", ".join(f'"{PRISMATIC if slide else "revolute"}"' for slide in are_prismatic)
        lines.append(_SectionLine("joint_type", f"[{kinds}]"))
    default_axes = [Y_AXIS if slide else Z_AXIS for slide in are_prismatic]
    if np.abs(digit.axes - default_axes).max() > ROUNDING_TOLERANCE:
        lines.append(_SectionLine("joint_axis", _number_rows_text(digit.axes)))
    if len(digit.turns) and np.abs(digit.turns - np.eye(3)).max() > ROUNDING_TOLERANCE:
        joint_rotations_text = ", ".join(
            ["[0.0, 0.0, 0.0]", *(_rpy_deg_text(turn) for turn in digit.turns)]
        )
        lines.append(_SectionLine("joint_rpy_deg", f"[{joint_rotations_text}]"))
    lines += [
        _SectionLine("link_com_m", _number_rows_text(digit.centres_of_mass)),
        _SectionLine("link_mass_kg", _number_list_text([link.mass for link in links])),
        _SectionLine(
            "link_inertia_kg_m2",
            _number_rows_text([_inertia_moments(inertia) for inertia in digit.inertias]),
        ),
    ]
    radii = [link.radius for link in links if link.radius]
    if radii:
        lines.append(_SectionLine("link_radius_m", _number_text(float(np.median(radii)))))
    for slide in sorted(set(are_prismatic)):
        links_of_type = [link for link in links if link.is_prismatic == slide]
        for side, key in enumerate(("joint_min_deg", "joint_max_deg")):
            limits = [link.range[side] for link in links_of_type if link.range is not None]
            name = _key_for_joint_type(key, slide)
            lines.append(
                _SectionLine(name, _number_list_text(limits if slide else np.degrees(limits)))
                if len(limits) == len(links_of_type)
                else _todo_line(Digit, name)
            )
    return [*lines, *_joint_lines(digit, import_answers), *_mesh_lines(digit.meshes)]


def _palm_mesh_lines(mesh: ModelMesh | None) -> Iterable[_SectionLine]:
    """Yield lines for the mesh of the palm. A key that has its default value gets no line."""
    if mesh is None:
        return
    yield _SectionLine("palm_mesh", quoted_string(mesh.file))
    if (mesh.scale != 1.0).any():
        yield _SectionLine("palm_mesh_scale", _scale_text(mesh.scale))
    if np.abs(mesh.position).max() > ROUNDING_TOLERANCE:
        yield _SectionLine("palm_mesh_position_m", _number_list_text(mesh.position))
    if np.abs(mesh.rotation - np.eye(3)).max() > ROUNDING_TOLERANCE:
        yield _SectionLine("palm_mesh_rpy_deg", _rpy_deg_text(mesh.rotation))


def _mesh_lines(link_meshes: Sequence[ModelMesh | None]) -> Iterable[_SectionLine]:
    """Yield lines for the meshes of a digit. A key that has its default value gets no line."""
    if not any(link_meshes):
        return
    no_mesh = ModelMesh("", np.ones(3), np.zeros(3), np.eye(3))
    mesh_names = [mesh or no_mesh for mesh in link_meshes]
    yield _SectionLine(
        "link_mesh", f"[{', '.join(quoted_string(mesh.file) for mesh in mesh_names)}]"
    )
    if any((mesh.scale != 1.0).any() for mesh in mesh_names):
        yield _SectionLine(
            "link_mesh_scale", f"[{', '.join(_scale_text(mesh.scale) for mesh in mesh_names)}]"
        )
    if any(np.abs(mesh.position).max() > ROUNDING_TOLERANCE for mesh in mesh_names):
        yield _SectionLine(
            "link_mesh_position_m", _number_rows_text(mesh.position for mesh in mesh_names)
        )
    if any(np.abs(mesh.rotation - np.eye(3)).max() > ROUNDING_TOLERANCE for mesh in mesh_names):
        yield _SectionLine(
            "link_mesh_rpy_deg",
            f"[{', '.join(_rpy_deg_text(mesh.rotation) for mesh in mesh_names)}]",
        )


def _scale_text(scale: Array) -> str:
    """Return the scale of a mesh as text.

    The text is a single number if the scale is the same along all axes.
    """
    return (
        _number_text(float(scale[0]))
        if scale[0] > 0.0 and not np.ptp(scale)
        else _number_list_text(scale)
    )


def _joint_lines(digit: ModelDigit, import_answers: ImportAnswers) -> Iterable[_SectionLine]:
    """Yield lines for the damping, the armature and the springs of a digit.

    In a robot description, a damping, an armature or a stiffness of 0 means that the value is not
    known.
    """
    for is_prismatic in (False, True):
        links = [link for link in digit.links if link.is_prismatic == is_prismatic]
        values = {
            "joint_damping_N_m_s_per_rad": [link.damping for link in links],
            "joint_armature_kg_m2": [link.armature for link in links],
        }
        if import_answers.springs != "none" and any(link.stiffness for link in links):
            values["spring_stiffness_N_m_per_rad"] = [link.stiffness for link in links]
            values["spring_preload_rad"] = [-link.rest if link.stiffness else 0.0 for link in links]
        for key, joint_values in values.items():
            if any(joint_values):
                yield _SectionLine(
                    _key_for_joint_type(key, is_prismatic), _number_list_text(joint_values)
                )


def _key_for_joint_type(key: str, is_prismatic: bool) -> str:
    """Return a key for revolute joints, or the corresponding key for prismatic joints."""
    return PRISMATIC_KEYS[REVOLUTE_KEYS.index(key)] if is_prismatic else key


def _drive_lines(
    tendons: Sequence[Mapping[str, Any]], bus: int, last_node_of_bus: dict[int, int | None]
) -> Iterable[_SectionLine]:
    """Yield lines for the tendons and motors of a digit.

    The node numbers on each bus are consecutive.
    """
    for tendon in tendons:
        arms = tendon["arms"]
        inline_entries = [f'motor = "{tendon["motor"]}"']
        prismatic_joints = tendon["sliding"]
        if arms is None:
            inline_entries.append(f'moment_arm_m = "{UNMEASURED_PLACEHOLDER}"')
        ratios = dict.fromkeys(sorted(prismatic_joints), 1.0)
        if arms is not None:
            ratios = {joint: arm for joint, arm in arms.items() if joint in prismatic_joints}
            revolute_arms = {
                joint: arm for joint, arm in arms.items() if joint not in prismatic_joints
            }
            if revolute_arms:
                inline_entries.append(f"moment_arm_m = {{ {_inline_table_text(revolute_arms)} }}")
        if ratios:
            inline_entries.append(f"excursion_ratio = {{ {_inline_table_text(ratios)} }}")
        comment = MISSING_MOMENT_ARMS_COMMENT if arms is None else ""
        if tendon["is_spool_pair"]:
            inline_entries.append(f'pretension_N = "{UNMEASURED_PLACEHOLDER}"')
            comment = f"{UNMEASURED_PLACEHOLDER} measure: {_key_meaning(Tendon, 'pretension_N')}"
        yield _SectionLine(
            f"tendon.{tendon['name']}", f"{{ {', '.join(inline_entries)} }}", comment
        )
    for motor in dict.fromkeys(tendon["motor"] for tendon in tendons):
        node = last_node_of_bus[bus]
        inline_entries = [f'bus = "{_bus_name(bus)}"'] if bus else []
        inline_entries.append(
            f'node_id = "{UNMEASURED_PLACEHOLDER}"' if node is None else f"node_id = {node}"
        )
        comment = (
            f"{UNMEASURED_PLACEHOLDER} set: {_key_meaning(Motor, 'node_id')}"
            if node is None
            else ""
        )
        yield _SectionLine(f"motor.{motor}", f"{{ {', '.join(inline_entries)} }}", comment)
        if node is not None:
            last_node_of_bus[bus] = node + 1


def _tendon_lines(import_answers: ImportAnswers) -> Iterable[_SectionLine]:
    """Yield the lines of the section ``[default.tendon]``, with the values that all tendons have in common."""
    tension = import_answers.tension_N
    value_by_key: dict[str, float | None] = {
        "stiffness_N_per_m": None,
        "damping_N_s_per_m": None,
        "knee_N": None,
        "stiffness_beyond_ratio": None,
        "knee_width_m": None,
        "friction_coefficient": None,
        "wrap_angle_rad": None,
        "rated_breaking_force_N": import_answers.strength_N,
        "tension_floor_N": None if tension is None else TENSION_FLOOR_N,
        "tension_max_N": tension,
        "tension_trip_N": None if tension is None else TENSION_TRIP_RATIO * tension,
        "drive_limit_N": None if tension is None else DRIVE_LIMIT_RATIO * tension,
    }
    for key, value in value_by_key.items():
        yield _todo_line(Tendon, key) if value is None else _SectionLine(key, _number_text(value))


def _motor_lines(import_answers: ImportAnswers) -> Iterable[_SectionLine]:
    """Yield lines for the values that all motors have in common."""
    torque = None
    if import_answers.tension_N is not None and import_answers.spool_mm is not None:
        torque = DRIVE_LIMIT_RATIO * import_answers.tension_N * 1e-3 * import_answers.spool_mm
    text_by_key: dict[str, str | None] = {
        "protocol": None if import_answers.protocol is None else f'"{import_answers.protocol}"',
        "bus": '"main"',
        "spool_radius_m": None
        if import_answers.spool_mm is None
        else _number_text(1e-3 * import_answers.spool_mm),
        "inertia_kg_m2": None,
        "viscous_N_m_s_per_rad": None,
        "coulomb_N_m": None,
        "torque_constant_N_m_per_A": None,
        "torque_max_N_m": None if torque is None else _number_text(torque),
        "torque_peak_N_m": None,
        "position_range_rad": None,
        "velocity_range_rad_s": None,
        "direction": "1",
        "zero_rad": "0.0",
        "watchdog_ms": "50",
    }
    measured_keys = {"direction": "commission finds it", "zero_rad": "commission measures it"}
    for key, value in text_by_key.items():
        yield (
            _todo_line(Motor, key)
            if value is None
            else _SectionLine(key, value, measured_keys.get(key, ""))
        )


def _todo_line(section: type[Section], key: str) -> _SectionLine:
    """Return the line for a key without a known value. In this line, the key has the value ``"TODO"``."""
    todo_verb = "set" if key in KEYS_CHOSEN_BY_USER else "measure"
    return _SectionLine(
        key,
        f'"{UNMEASURED_PLACEHOLDER}"',
        f"{UNMEASURED_PLACEHOLDER} {todo_verb}: {_key_meaning(section, key)}",
    )


def _key_meaning(section: type[Section], key: str) -> str:
    """Return the first sentence of the description of a key."""
    return first_sentence(key_description(section, key))


def _section_text(name: str, section_lines: Iterable[_SectionLine]) -> str:
    """Return the text of a section of the hand file: header and lines."""
    return "\n".join([f"[{name}]", *map(str, section_lines)])


def _short_name(name: str, digit: str) -> str:
    """Return the short name of a tendon or motor, which does not contain the name of the digit."""
    short_name = name.removeprefix(f"{digit}_")
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in short_name)


def _inertia_moments(inertia: Array) -> Array:
    """Return the three moments of an inertia (3, 3) [kg m2].

    If the products of inertia are not zero, the returned values also contain the products, after
    the moments.
    """
    products_of_inertia = np.array([inertia[0, 1], inertia[0, 2], inertia[1, 2]])
    diagonal_moments = np.diag(inertia)
    return (
        diagonal_moments
        if np.abs(products_of_inertia).max() < 1e-9 * diagonal_moments.max()
        else np.concatenate((diagonal_moments, products_of_inertia))
    )


def _rpy_deg_text(rotation: Array) -> str:
    """Return a text with roll, pitch and yaw [deg] of a rotation (3, 3)."""
    return _number_list_text(np.degrees(rpy_of_rotation(rotation)))


def _number_text(value: float) -> str:
    """Return the text of a number with ten significant digits."""
    number = float(f"{value:.10g}")
    return repr(0.0 if abs(number) < 10.0**-WRITTEN_DECIMALS else number)


def _number_list_text(values: Iterable[float]) -> str:
    """Return the text of a list of numbers."""
    return "[" + ", ".join(_number_text(float(value)) for value in values) + "]"


def _number_rows_text(number_rows: Iterable[Iterable[float]]) -> str:
    """Return the text of a list of lists of numbers."""
    return "[" + ", ".join(_number_list_text(row) for row in number_rows) + "]"


def _inline_table_text(table_values: Mapping[str, float]) -> str:
    """Return the text of an inline table of numbers, without the braces."""
    return ", ".join(f"{key} = {_number_text(value)}" for key, value in table_values.items())


IMPORT_ANSWER_NAMES = tuple(field.name for field in fields(ImportAnswers))
"""Names of all answers that the user can give about a robot description."""
