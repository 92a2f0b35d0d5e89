"""Checks that compare several sections of a hand file.

The checks cover references between sections, lengths of lists, tendon routing, limits and CAN
identifiers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from handctl.hand.file.error_text import FileMistake
from handctl.hand.file.section_models import (
    PRISMATIC_KEYS,
    REVOLUTE_KEYS,
    Digit,
    Motor,
    Mount,
    StreamLimits,
    Tendon,
)
from handctl.hand.file.sensor_checks import amplifier_identifiers, check_sensor_node
from handctl.hand.link_geometry import link_inertia
from handctl.hand.moment_arms import (
    MOMENT_ARM_FIT_DEGREE,
    is_moment_arm_varying,
    moment_arm_polynomial,
    moment_arm_table_residual,
    moment_arms_at,
)

if TYPE_CHECKING:
    from handctl.hand.description import Hand

SMALLEST_RATIO = 0.05
"""Smallest accepted absolute excursion ratio of a tendon at a prismatic joint."""
SMALLEST_MOMENT_ARM_M = 1e-4
"""Smallest accepted absolute moment arm of a tendon at a joint [m]."""
LARGEST_MOMENT_ARM_M = 0.05
"""Largest accepted absolute moment arm of a tendon at a joint [m]."""
MOMENT_ARM_SAMPLE_COUNT = 181
"""Number of joint angles at which a moment arm that depends on the joint angle is checked."""
MAX_TABLE_RESIDUAL_FRACTION = 0.1
"""Largest difference between a table of moment arms and its polynomial, as a fraction of the largest moment arm."""
ROUTING_POSTURE_COUNT = 11
"""Number of postures at which tendon routing is checked, in a digit whose moment arms depend on joint angles."""
ROUNDING_DEG = 1e-6
"""Tolerance for angles that were converted from rad [deg]."""
KEYS_PER_LINK = (
    "link_com_m",
    "link_mass_kg",
    "link_inertia_kg_m2",
)
"""Keys of a digit with one value per link."""
MESH_POSE_KEYS = ("link_mesh_scale", "link_mesh_position_m", "link_mesh_rpy_deg")
"""Keys of a digit that scale and place the meshes of ``link_mesh``."""
PALM_POSE_KEYS = ("palm_mesh_scale", "palm_mesh_position_m", "palm_mesh_rpy_deg")
"""Keys of the section ``mount`` that scale and place the mesh of ``palm_mesh``."""
OPTIONAL_KEYS_PER_LINK = (
    "joint_type",
    "joint_axis",
    "joint_rpy_deg",
    "link_mesh",
    *MESH_POSE_KEYS,
)
"""Optional keys of a digit, with one value per link."""
RELATIVE_ROUNDING_TOLERANCE = 1e-3
"""Tolerance for rounding errors.

The tolerance applies to the length of a unit vector and to the triangle inequality of inertias.
"""
BREAKING_FORCE_KEY = "rated_breaking_force_N"
"""Key of a tendon's breaking force."""
TENSION_LIMIT_KEYS = (
    "tension_floor_N",
    "tension_max_N",
    "tension_trip_N",
    "drive_limit_N",
    BREAKING_FORCE_KEY,
)
"""Keys of a tendon's tension limits in ascending order."""
MIT_REPLY_OFFSET = 0x10
"""Identifier of an MIT drive's replies minus the identifier of its commands, if the option ``reply_id`` is absent.

Source: Damiao, MST_ID = ESC_ID + 0x10.
"""
MIT_REGISTER_ID = 0x7FF
"""Identifier that the register frames of all MIT drives share. Source: Damiao manual."""
CANOPEN_FRAME_IDS = (0x080, 0x180, 0x200, 0x580, 0x600, 0x700)
"""Identifiers of the CANopen frames emergency, TPDO1, RPDO1, SDO in both directions and heartbeat.

The identifier of a device's frame is a number of ``CANOPEN_FRAME_IDS`` plus the node number of the
device.

Source: CiA 301.
"""
EXTENDED_ID_FLAG = 1 << 31
"""Bit that marks a 29-bit CAN identifier. Source: Linux ``can.h``, CAN_EFF_FLAG."""
STANDARD_IDS = 0x800
"""Number of 11-bit CAN identifiers."""
IDS_SHARED_BY_MOTORS = (
    ("mit", MIT_REGISTER_ID, "the register frames of MIT drives"),
    ("odrive", 0x7E2, "the broadcast emergency stop of ODrives"),
    ("cia402", 0x000, "CANopen's NMT"),
    ("cia402", 0x77F, "this host's heartbeat to CiA 402 drives"),
)
"""Identifiers that all motors of a protocol on the same bus share.

Each entry contains a protocol, an identifier, and the name of the frame with the identifier.
"""
MIN_SINGULAR_VALUE_RATIO = 1e-6
"""Ratio of the smallest to the largest singular value above which a matrix counts as having full rank."""


MistakeIterator = Iterator[FileMistake]


def check_hand(hand: Hand) -> MistakeIterator:
    """Yield the mistakes that the separate validation of each section cannot find.

    Some checks need valid references and list lengths. The function skips these checks if a
    reference or a list length is wrong.

    Args:
        hand: hand of which every section has already been validated separately.
    """
    hand_mistakes = [*check_names(hand), *check_sections(hand.digit, hand.tendon)]
    hand_mistakes += check_mesh_keys(hand.mount, "palm_mesh", PALM_POSE_KEYS, "mount")
    yield from hand_mistakes
    if hand_mistakes:
        return
    hand_mistakes = [*_check_references(hand), *_check_mounts(hand)] or [*_check_tendon_order(hand)]
    yield from hand_mistakes
    if hand_mistakes:
        return
    yield from check_sensor_node(hand)
    for digit in hand.digit:
        yield from _check_routing(hand, digit)
        yield from _check_spool_pairs(hand, digit)
    for tendon in hand.tendon:
        yield from _check_drive(tendon, hand.motor_of_tendon(tendon.name))
        yield from _check_control(hand, tendon, hand.motor_of_tendon(tendon.name))
    yield from _check_stream(hand.stream)
    yield from _check_identifiers(hand)


def check_names(hand: Hand) -> MistakeIterator:
    """Yield a mistake for each name that two sections of the same kind share."""
    for key in ("bus", "digit", "tendon", "motor"):
        yield from _check_unique(
            [section.name for section in getattr(hand, key)], key + "[{}].name"
        )


def check_sections(digits: Iterable[Digit], tendons: Iterable[Tendon]) -> MistakeIterator:
    """Yield the mistakes that lie within one digit or within one tendon.

    The check of a digit or a tendon reads no other section of the hand file.
    """
    for digit in digits:
        yield from _check_digit(digit)
    for tendon in tendons:
        yield from _check_limits(tendon)
        yield from _check_pretension(tendon)


def _check_unique(names: Iterable[str], key_path: str) -> MistakeIterator:
    """Yield a mistake for each name that occurs more than once.

    The repeated name replaces the {} in the text ``key_path``.
    """
    seen_names: set[str] = set()
    for name in names:
        if name in seen_names:
            yield FileMistake(f'"{name}" twice', key_path.format(name), "every name once")
        seen_names.add(name)


def _check_digit(digit: Digit) -> MistakeIterator:
    """Check the list lengths, the joint limits and the links of a digit."""
    location = f"digit[{digit.name}]"
    links = len(digit.link_length_m)
    size_mistakes = [
        FileMistake(f"{len(values)} values", f"{location}.{key}", f"{links}, one per link_length_m")
        for key in (*KEYS_PER_LINK, *OPTIONAL_KEYS_PER_LINK)
        if (values := getattr(digit, key)) is not None and len(values) != links
    ]
    if digit.joint_type is None or len(digit.joint_type) == links:
        size_mistakes += _check_joint_values(digit, location)
    yield from size_mistakes
    yield from check_mesh_keys(digit, "link_mesh", MESH_POSE_KEYS, location)
    for i in range(links) if not size_mistakes else ():
        yield from _check_body(digit, i, location)
    for min_key, max_key in (REVOLUTE_KEYS[:2], PRISMATIC_KEYS[:2]) if not size_mistakes else ():
        pairs = zip(getattr(digit, min_key), getattr(digit, max_key), strict=True)
        for i, (low, high) in enumerate(pairs):
            if low >= high:
                yield FileMistake(
                    f"{high:g}", f"{location}.{max_key}[{i}]", f"more than {min_key}[{i}] = {low:g}"
                )
    for i, axis in enumerate(digit.joint_axis or ()):
        length = float(np.linalg.norm(axis))
        if abs(length - 1.0) > RELATIVE_ROUNDING_TOLERANCE:
            yield FileMistake(
                f"a vector of length {length:.3g}",
                f"{location}.joint_axis[{i}]",
                "a unit vector, of length 1",
            )
    if digit.link_length_m[-1] == 0.0:
        yield FileMistake(
            "0",
            f"{location}.link_length_m[{links - 1}]",
            "more than 0, as the tip is at the end of the last link",
        )
    if digit.coupling is not None:
        yield from _check_coupling(digit.coupling, f"{location}.coupling", links)
        yield from _check_coupled_types(digit, digit.coupling, f"{location}.coupling")


def _check_joint_values(digit: Digit, key_path: str) -> MistakeIterator:
    """Check the number of values in each key for revolute joints and in each key for prismatic joints.

    A key for revolute joints must have one value per revolute joint. A key for prismatic joints
    must have one value per prismatic joint.
    """
    prismatic_count = digit.is_prismatic.count(True)
    revolute_count = len(digit.is_prismatic) - prismatic_count
    keys = [
        *((key, revolute_count, "revolute") for key in (*REVOLUTE_KEYS, "joint_rated_torque_N_m")),
        *((key, prismatic_count, "prismatic") for key in (*PRISMATIC_KEYS, "joint_rated_force_N")),
    ]
    for key, count, kind in keys:
        values = getattr(digit, key)
        if values is None or len(values) == count:
            continue
        expected = f"{count}, one per {kind} joint"
        if not prismatic_count and kind == "revolute":
            expected = f"{count}, one per link_length_m"
        elif not prismatic_count:
            expected = 'joint_type with a joint "prismatic", or no such key'
        elif not count:
            expected = (
                f"no such key, as all joints are {'revolute' if revolute_count else 'prismatic'}"
            )
        elif not values:
            yield FileMistake("missing", f"{key_path}.{key}", f"{count}, one per {kind} joint")
            continue
        yield FileMistake(f"{len(values)} values", f"{key_path}.{key}", expected)


def _check_coupled_types(
    digit: Digit, coupling: tuple[tuple[float, ...], ...], key_path: str
) -> MistakeIterator:
    """Check that each coordinate of a coupled digit moves only revolute or only prismatic joints."""
    for i, column in enumerate(zip(*coupling, strict=False)):
        kinds = {
            kind for kind, ratio in zip(digit.is_prismatic, column, strict=False) if ratio != 0.0
        }
        if len(kinds) > 1:
            yield FileMistake(
                f"column {i} moves revolute and prismatic joints", key_path, "joints of one type"
            )


def check_mesh_keys(
    section: Digit | Mount, mesh: str, keys: Iterable[str], key_path: str
) -> MistakeIterator:
    """Check that a section with keys for mesh scale or mesh pose also names a mesh. A scale must not be 0."""
    for key in keys:
        if getattr(section, mesh) is None and getattr(section, key) is not None:
            yield FileMistake(
                f"given without {mesh}", f"{key_path}.{key}", f"{mesh} as well, or no such key"
            )
    mesh_scales = getattr(section, f"{mesh}_scale")
    for i, scale in enumerate(
        mesh_scales if isinstance(section, Digit) and mesh_scales else [mesh_scales]
    ):
        if isinstance(scale, tuple) and 0.0 in scale:
            scale_path = f"{key_path}.{mesh}_scale" + (
                f"[{i}]" if isinstance(section, Digit) else ""
            )
            yield FileMistake("a factor of 0", scale_path, "factors that are not 0")


def _check_body(digit: Digit, i: int, key_path: str) -> MistakeIterator:
    """Check that centre of mass and inertia of link i are possible for the size of the link."""
    com = digit.link_com_m[i]
    length = digit.link_length_m[i]
    # No point of a link can be farther from the centre of mass than the larger of the link's length
    # and width.
    max_distance = max(length, 2 * digit.link_radius_m)
    if isinstance(com, float):
        if com > length:
            yield FileMistake(
                f"{com:g}",
                f"{key_path}.link_com_m[{i}]",
                f"at most the link's length, {length:g} m",
            )
    elif np.linalg.norm(com) > max_distance:
        expected = f"at most {max_distance:g} m from the joint, the link's length or width"
        yield FileMistake(f"{np.linalg.norm(com):g} m", f"{key_path}.link_com_m[{i}]", expected)
    moments = np.linalg.eigvalsh(link_inertia(digit, i))
    max_moment = digit.link_mass_kg[i] * max_distance**2
    if moments[-1] > max_moment:
        expected = f"at most mass x length^2 = {max_moment:.3g} kg m2"
        yield FileMistake(f"{moments[-1]:g}", f"{key_path}.link_inertia_kg_m2[{i}]", expected)
    elif moments[0] <= 0.0:
        problem_text = f"a principal moment of {moments[0]:.3g} kg m2"
        yield FileMistake(
            problem_text, f"{key_path}.link_inertia_kg_m2[{i}]", "a positive definite inertia"
        )
    elif moments[-1] > (moments[0] + moments[1]) * (1.0 + RELATIVE_ROUNDING_TOLERANCE):
        problem_text = "principal moments " + ", ".join(f"{moment:.3g}" for moment in moments)
        yield FileMistake(
            problem_text,
            f"{key_path}.link_inertia_kg_m2[{i}]",
            "none larger than the sum of the other two",
        )


def _check_coupling(
    coupling: tuple[tuple[float, ...], ...], key_path: str, link_count: int
) -> MistakeIterator:
    """Check the shape of a coupling matrix."""
    if len(coupling) != link_count:
        yield FileMistake(f"{len(coupling)} rows", key_path, f"{link_count}, one per joint")
    row_lengths = {len(row) for row in coupling}
    if len(row_lengths) != 1 or not 1 <= min(row_lengths) <= link_count:
        yield FileMistake(
            f"rows of {sorted(row_lengths)} values",
            key_path,
            f"rows of equal length, 1 to {link_count}",
        )


def _check_references(hand: Hand) -> MistakeIterator:
    """Check that every referenced name exists, and that each motor drives one tendon."""
    node = hand.sensor_node
    yield from _check_name("sensor_node.bus", node.bus, hand.bus_names)
    for key, names, valid_names in (
        ("tendons", node.tendons, hand.tendon_names),
        ("joints", node.joints, hand.joints),
    ):
        yield from _check_unique(names, f"sensor_node.{key}")
        for i, name in enumerate(names):
            yield from _check_name(f"sensor_node.{key}[{i}]", name, valid_names)
    for motor in hand.motor:
        yield from _check_name(f"motor[{motor.name}].bus", motor.bus, hand.bus_names)
    for tendon in hand.tendon:
        for key in ("moment_arm_m", "excursion_ratio"):
            for joint in getattr(tendon, key):
                location = f"tendon[{tendon.name}].{key}.{joint}"
                reference_mistakes = [*_check_name(location, joint, hand.joints)]
                yield from reference_mistakes or _check_joint_type(hand, key, joint, location)
    yield from _check_motors(hand)


def _check_joint_type(hand: Hand, key: str, joint: str, key_path: str) -> MistakeIterator:
    """Check that a tendon has moment arms at revolute joints, and excursion ratios at prismatic joints."""
    is_prismatic = hand.is_prismatic[hand.joints.index(joint)]
    if is_prismatic and key == "moment_arm_m":
        yield FileMistake(
            f"{joint} is prismatic",
            key_path,
            f"excursion_ratio.{joint}, in metres of tendon per metre",
        )
    elif not is_prismatic and key == "excursion_ratio":
        yield FileMistake(f"{joint} is revolute", key_path, f"moment_arm_m.{joint}, in metres")


def _check_motors(hand: Hand) -> MistakeIterator:
    """Check that each tendon has its own motor, that all named motors exist, and that each motor has a tendon."""
    tendon_by_motor: dict[str, str] = {}
    motor_mistakes: list[FileMistake] = []
    for tendon in hand.tendon:
        location = f"tendon[{tendon.name}].motor"
        motor_mistakes += _check_name(location, tendon.motor, hand.motor_names)
        if tendon.motor in tendon_by_motor:
            problem_text = f'"{tendon.motor}" drives {tendon_by_motor[tendon.motor]} already'
            expected = (
                "a motor of its own, or one tendon with pretension_N for both tendons of its spool"
            )
            motor_mistakes.append(FileMistake(problem_text, location, expected))
        tendon_by_motor[tendon.motor] = tendon.name
    yield from motor_mistakes
    for motor in hand.motor:
        # If a tendon names a wrong motor, the right motor has no tendon. The check reports only the
        # wrong motor name, and not the motor without a tendon.
        if motor.name not in tendon_by_motor and not motor_mistakes:
            yield FileMistake(
                "drives no tendon", f"motor[{motor.name}].name", "to be the motor of one tendon"
            )


def _check_name(key_path: str, name: str, valid_names: tuple[str, ...]) -> MistakeIterator:
    """Yield a mistake if a name is not one of the valid names."""
    if name not in valid_names:
        yield FileMistake(
            f'"{name}" is not in this file', key_path, "one of " + ", ".join(valid_names)
        )


def _check_mounts(hand: Hand) -> MistakeIterator:
    """Check that each digit comes later in the hand file than the digit on which it is mounted.

    All digits that a digit carries, directly or through other digits, must follow the carrying
    digit without a gap.
    """
    line: list[str] = []
    for digit in hand.digit:
        location = f"digit[{digit.name}].mount_on"
        carrier = digit.mount_on
        if carrier is not None and carrier not in line:
            yield from _check_name(location, carrier, hand.digit_names)
            if carrier in hand.digit_names:
                problem_text = f"{digit.name} does not follow {carrier}"
                yield FileMistake(
                    problem_text,
                    location,
                    "each digit right after the one that carries it, or after others on it",
                )
        # The next digit may be mounted on this digit, or on one of the digits that carry this
        # digit.
        line = [*line[: line.index(carrier) + 1 if carrier in line else 0], digit.name]


def _check_tendon_order(hand: Hand) -> MistakeIterator:
    """Check that each tendon moves a single digit, and that the tendons are in the order of the digits.

    A tendon that moves a digit may cross the joints of this digit, and the joints of the digits
    that carry it. The tendon must not cross other joints.
    """
    last_digit_index = 0
    for tendon in hand.tendon:
        location = f"tendon[{tendon.name}].moment_arm_m"
        for joint in tendon.arms:
            yield from _check_moment_arm_range(hand, tendon, joint)
        name = hand.digit_of_tendon(tendon)
        if name is None:
            crossed_digits = [
                digit.name
                for digit in hand.digit
                if not tendon.arms.keys().isdisjoint(digit.joints)
            ]
            expected = "joints of one digit, and of digits that carry it (mount_on)"
            yield FileMistake(
                f"moves {' and '.join(crossed_digits) or 'no digit'}", location, expected
            )
            continue
        passed_joints = [
            joint for joint in tendon.arms if joint not in hand.digit_named(name).joints
        ]
        for joint in passed_joints:
            if is_moment_arm_varying(tendon.arms[joint]):
                expected = f"a number: {name} is carried by this joint"
                yield FileMistake(
                    "an arm that depends on the angle", f"{location}.{joint}", expected
                )
        digit = hand.digit_names.index(name)
        if digit < last_digit_index:
            problem_text = f"a tendon of {hand.digit[digit].name} after one of {hand.digit[last_digit_index].name}"
            yield FileMistake(
                problem_text, location, "tendons digit by digit, in the order of the digits"
            )
        last_digit_index = max(last_digit_index, digit)


def _check_moment_arm_range(hand: Hand, tendon: Tendon, joint: str) -> MistakeIterator:
    """Check the size and the sign of a moment arm over the range of its joint.

    A table of moment arms must cover the whole range of the joint and must be smooth.
    """
    arm = tendon.arms[joint]
    location = f"tendon[{tendon.name}].{tendon.moment_arm_key(joint)}.{joint}"
    if joint in tendon.excursion_ratio:
        if abs(arm) < SMALLEST_RATIO:
            expected = f"{SMALLEST_RATIO:g} to 5 m/m either way, or no such key"
            yield FileMistake(f"{arm:g}", location, expected)
        return
    if not isinstance(arm, dict):
        if abs(arm) < SMALLEST_MOMENT_ARM_M:
            yield FileMistake(f"{arm:g}", location, "0.0001 to 0.05 m either way, or no such key")
        return
    low, high = np.degrees(hand.joint_limits[:, hand.joints.index(joint)]).tolist()
    range_text = f"the joint's range, {low:g} to {high:g} deg"
    first_angle, *_, last_angle = arm.get("angle_deg", (low, high))
    if first_angle > low + ROUNDING_DEG or last_angle < high - ROUNDING_DEG:
        yield FileMistake(
            f"angle_deg from {first_angle:g} to {last_angle:g}",
            location,
            f"a table over {range_text}",
        )
        return
    angle = np.linspace(low, high, MOMENT_ARM_SAMPLE_COUNT)
    values = np.polynomial.polynomial.polyval(np.radians(angle), moment_arm_polynomial(arm))
    smallest_index = int(np.argmin(np.abs(values)))
    largest_arm = float(np.abs(values).max())
    if values.min() < 0.0 < values.max():
        sign_change_index = int(np.argmax(values * values[0] < 0.0))
        problem_text = f"the arm changes its sign at {angle[sign_change_index]:.0f} deg"
        yield FileMistake(
            problem_text,
            location,
            f"one sign over {range_text}: a tendon either closes or opens a joint",
        )
    elif abs(values[smallest_index]) < SMALLEST_MOMENT_ARM_M or largest_arm > LARGEST_MOMENT_ARM_M:
        worst_arm = (
            values[smallest_index]
            if abs(values[smallest_index]) < SMALLEST_MOMENT_ARM_M
            else values[np.argmax(np.abs(values))]
        )
        worst_angle = angle[np.argmin(np.abs(values - worst_arm))]
        yield FileMistake(
            f"an arm of {worst_arm:.3g} m at {worst_angle:.0f} deg",
            location,
            f"0.0001 to 0.05 m over {range_text}",
        )
    elif (residual := moment_arm_table_residual(arm)) > MAX_TABLE_RESIDUAL_FRACTION * largest_arm:
        degree_text = f"the polynomial of degree {MOMENT_ARM_FIT_DEGREE}"
        problem_text = f"{degree_text} differs by {1e3 * residual:.2g} mm from the table"
        yield FileMistake(
            problem_text,
            location,
            f"a smoother table, within {1e2 * MAX_TABLE_RESIDUAL_FRACTION:g} % of the arm, or polynomial_m",
        )


def _check_routing(hand: Hand, digit: Digit) -> MistakeIterator:
    """Check that the tendons of a digit can move every coordinate, and that each joint is crossed by a tendon.

    The tendons can move every coordinate if the product R B of moment arms and coupling matrix has
    full column rank.
    """
    tendons = hand.digit_tendons[digit.name]
    joints = hand.digit_joints[digit.name]
    arms = hand.moment_arms[tendons, joints]
    coupling = np.eye(len(digit.joints)) if digit.coupling is None else np.array(digit.coupling)
    columns = coupling.shape[1]
    rank = _moment_arm_rank(arms @ coupling)
    if hand.has_varying_arm[tendons].any():
        limits = hand.joint_limits[:, joints]
        postures = np.linspace(limits[0], limits[1], ROUTING_POSTURE_COUNT)
        rank = min(
            _moment_arm_rank(moment_arm @ coupling)
            for moment_arm in moment_arms_at(
                hand.arm_polynomials[tendons, joints], limits, postures
            )
        )
    if rank < columns:
        location = f"digit[{digit.name}].coupling"
        expected = f"a tendon for every coordinate, or a coupling that leaves {max(rank, 1)}"
        yield FileMistake(
            f"its tendons (moment_arm_m) can move only {rank} of {columns} coordinates",
            location,
            expected,
        )
    for joint, column in zip(digit.joints, arms.T, strict=True):
        if not column.any():
            yield FileMistake(
                f"no tendon crosses {joint}",
                f"digit[{digit.name}]",
                f"a tendon with {moment_arm_key_for_joint(hand, joint)}.{joint}",
            )


def moment_arm_key_for_joint(hand: Hand, joint: str) -> str:
    """Return the key that contains the moment arm of a tendon at a joint: ``moment_arm_m`` or ``excursion_ratio``.

    The key ``excursion_ratio`` is for prismatic joints, and the key ``moment_arm_m`` is for hinges.
    """
    is_prismatic = hand.is_prismatic[hand.joints.index(joint)]
    return "excursion_ratio" if is_prismatic else "moment_arm_m"


def _moment_arm_rank(arm_matrix: NDArray[np.float64]) -> int:
    """Return the rank of R B, the product of a digit's moment arms and coupling matrix."""
    values = np.linalg.svd(arm_matrix, compute_uv=False)
    return (
        int((values > MIN_SINGULAR_VALUE_RATIO * values.max(initial=0.0)).sum())
        if values.size
        else 0
    )


def _check_limits(tendon: Tendon) -> MistakeIterator:
    """Check that the tension limits of a tendon are in ascending order, from the floor to the breaking force."""
    values = {key: getattr(tendon, key) for key in TENSION_LIMIT_KEYS}
    breaking_force = tendon.rated_breaking_force_N
    is_too_high = False
    for lower_limit, key, upper_limit in zip(
        (None, *TENSION_LIMIT_KEYS), TENSION_LIMIT_KEYS[:-1], TENSION_LIMIT_KEYS[1:], strict=False
    ):
        value = values[key]
        upper_limit_value = values[upper_limit]
        # If the check has already reported the lower limit as too high, it does not also report the
        # present limit as too low.
        is_too_low = lower_limit is not None and value <= values[lower_limit] and not is_too_high
        bounds = (
            [] if lower_limit is None else [f"more than {lower_limit} = {values[lower_limit]:g} N"]
        )
        if upper_limit == BREAKING_FORCE_KEY or breaking_force < upper_limit_value:
            bounds.append(f"at most {BREAKING_FORCE_KEY} = {breaking_force:g} N")
            is_too_high = value > breaking_force
        else:
            bounds.append(f"less than {upper_limit} = {upper_limit_value:g} N")
            is_too_high = value >= upper_limit_value
        if is_too_high or is_too_low:
            breaking_text = (
                f", and the tendon breaks at {breaking_force:g} N" if value > breaking_force else ""
            )
            yield FileMistake(
                f"{value:g}{breaking_text}", f"tendon[{tendon.name}].{key}", " and ".join(bounds)
            )


def _check_pretension(tendon: Tendon) -> MistakeIterator:
    """Check the pretension of a spool pair, and check that the pair has no tension floor.

    The limits of a spool pair apply to its net tension. The pretension must be so small that
    neither tendon of the pair exceeds these limits.

    For a net tension u and a pretension p, the pulling tendon has the tension max(p + u / 2, u).
    """
    pretension = tendon.pretension_N
    if pretension is None:
        return
    max_pretension = 0.5 * tendon.tension_max_N
    if pretension > max_pretension:
        expected = f"at most tension_max_N / 2 = {max_pretension:g} N, so that no tendon of the pair exceeds its limits"
        yield FileMistake(f"{pretension:g}", f"tendon[{tendon.name}].pretension_N", expected)
    if tendon.tension_floor_N != 0.0:
        expected = (
            "0 in the section of this spool pair: the net tension of a pair has both signs, "
            "and the default is for single tendons"
        )
        yield FileMistake(
            f"{tendon.tension_floor_N:g}", f"tendon[{tendon.name}].tension_floor_N", expected
        )


def _check_spool_pairs(hand: Hand, digit: Digit) -> MistakeIterator:
    """Check that a digit with spool pairs has one pair per coordinate.

    A digit with spool pairs must have no single tendons, no springs and no load cells.
    """
    tendons = hand.tendon[hand.digit_tendons[digit.name]]
    pairs = [tendon for tendon in tendons if tendon.pretension_N is not None]
    if not pairs:
        return
    location = f"digit[{digit.name}]"
    coordinates = len(digit.joints) if digit.coupling is None else len(digit.coupling[0])
    single_tendons = [tendon.name for tendon in tendons if tendon.pretension_N is None]
    if single_tendons:
        problem_text = f"{pairs[0].name} is a spool pair, and {single_tendons[0]} is not"
        expected = f"pretension_N on all tendons of {digit.name}, or on none"
        yield FileMistake(problem_text, f"tendon[{single_tendons[0]}].pretension_N", expected)
    elif len(pairs) != coordinates:
        problem_text = f"{len(pairs)} spool pairs for {coordinates} coordinates"
        yield FileMistake(
            problem_text,
            f"{location}.tendon",
            "one spool pair per coordinate: a pair pulls both ways",
        )
    if digit.has_springs:
        problem_text = "springs beside spool pairs"
        key = 0 if any(digit.spring_stiffness_N_m_per_rad) else 1
        yield FileMistake(
            problem_text,
            f"{location}.{('spring_stiffness_N_m_per_rad', 'spring_stiffness_N_per_m')[key]}",
            "no springs: a spool pair returns the joint",
        )
    for i, name in enumerate(hand.sensor_node.tendons):
        if name in [tendon.name for tendon in pairs]:
            expected = "tendons with one load cell each: the net tension of a spool pair comes from its motor"
            yield FileMistake(f"{name} is a spool pair", f"sensor_node.tendons[{i}]", expected)


def _check_drive(tendon: Tendon, motor: Motor) -> MistakeIterator:
    """Check that a motor's ``torque_max_N_m`` equals the tendon's ``drive_limit_N`` within 1 %, at the spool.

    The function also checks that ``torque_max_N_m`` is not larger than the peak torque of the
    motor.
    """
    location = f"motor[{motor.name}].torque_max_N_m"
    limit = tendon.drive_limit_N * motor.spool_radius_m
    if abs(motor.torque_max_N_m - limit) > 0.01 * limit:
        expected = f"drive_limit_N x spool_radius_m = {limit:.4g} N m, within 1 %"
        yield FileMistake(f"{motor.torque_max_N_m:g}", location, expected)
    if motor.torque_max_N_m > motor.torque_peak_N_m:
        yield FileMistake(
            f"{motor.torque_max_N_m:g}",
            location,
            f"at most torque_peak_N_m = {motor.torque_peak_N_m:g} N m",
        )


def _check_control(hand: Hand, tendon: Tendon, motor: Motor) -> MistakeIterator:
    """Check the keys that configure the position loop in the drive of a motor.

    Only a motor with ``control = "position"`` is allowed to have keys for the position loop.
    """
    location = f"motor[{motor.name}]"
    if not motor.closes_position_loop:
        for key in ("kp_N_m_per_rad", "kd_N_m_s_per_rad"):
            value = getattr(motor, key)
            if value is not None:
                expected = 'no such key without control = "position"'
                yield FileMistake(f"{value:g}", f"{location}.{key}", expected)
        return
    for digit in hand.digit:
        tendons = hand.digit_tendons[digit.name]
        coordinates = len(digit.joints) if digit.coupling is None else len(digit.coupling[0])
        if tendon in hand.tendon[tendons] and tendons.stop - tendons.start > coordinates:
            expected = (
                '"torque": position loops of antagonistic tendons would pull against each other'
            )
            yield FileMistake('"position"', f"{location}.control", expected)
    max_stiffness = tendon.stiffness_N_per_m * motor.spool_radius_m**2
    if (motor.kp_N_m_per_rad or 0.0) > max_stiffness:
        expected = f"at most stiffness_N_per_m x spool_radius_m^2 = {max_stiffness:.3g} N m/rad"
        yield FileMistake(f"{motor.kp_N_m_per_rad:g}", f"{location}.kp_N_m_per_rad", expected)


def _check_stream(stream: StreamLimits) -> MistakeIterator:
    """Check that ``relax_after_ms`` is longer than ``hold_after_ms``.

    After the last streamed target, the hand first holds its position and later relaxes its tendons.
    """
    if stream.relax_after_ms <= stream.hold_after_ms:
        expected = f"more than hold_after_ms = {stream.hold_after_ms:g} ms"
        yield FileMistake(f"{stream.relax_after_ms:g}", "stream.relax_after_ms", expected)


def _check_identifiers(hand: Hand) -> MistakeIterator:
    """Check that no two frames on a bus have the same CAN identifier."""
    owner: dict[tuple[str, object], str] = {}
    duplicate_texts: set[str] = set()
    for motor in hand.motor:
        yield from _check_reply_id(motor)
    for bus, identifier, location in _frame_identifiers(hand):
        if (bus, identifier) in owner and location not in duplicate_texts:
            duplicate_texts.add(location)
            text = (
                f"0x{identifier & ~EXTENDED_ID_FLAG:X}"
                if isinstance(identifier, int)
                else str(identifier)
            )
            expected = f"an identifier that is not in use; {owner[bus, identifier]} has it"
            yield FileMistake(f'{text} on bus "{bus}" is taken', location, expected)
        owner.setdefault((bus, identifier), location)


def _frame_identifiers(hand: Hand) -> Iterator[tuple[str, object, str]]:
    """Yield (bus, identifier, key path) for each CAN frame of a hand.

    If this module does not know the identifiers of a motor's protocol, a text with protocol and
    node number replaces the identifier.
    """
    for protocol, identifier, use_text in IDS_SHARED_BY_MOTORS:
        for bus in {motor.bus for motor in hand.motor if motor.protocol == protocol}:
            yield bus, identifier, use_text
    node = hand.sensor_node
    if node.tendons or node.joints:
        yield node.bus, node.sync_id, "sensor_node.sync_id"
    for identifier, location in amplifier_identifiers(node):
        yield node.bus, identifier, location
    for identifier in () if node.is_cia404 else (*node.tension_ids, *node.joint_ids):
        yield node.bus, identifier, "sensor_node.base_id"
    for motor in hand.motor:
        for key, location in _motor_identifiers(motor):
            yield motor.bus, key, location


def _motor_identifiers(motor: Motor) -> Iterator[tuple[object, str]]:
    """Yield (identifier, key path) for each CAN frame of a motor."""
    location = f"motor[{motor.name}].node_id"
    if motor.protocol == "mit":
        yield motor.node_id, location
        yield _mit_reply_id(motor, location)
    elif motor.protocol == "odrive":
        # An ODrive uses the identifiers of all 32 commands with its node number.
        for message in range(32):
            yield motor.node_id << 5 | message, location
    elif motor.protocol == "cia402":
        for service_base_id in CANOPEN_FRAME_IDS:
            yield service_base_id + motor.node_id, location
    elif motor.protocol == "moteus":
        # The first identifier belongs to moteus requests. It contains the source number 0 and the
        # bit that asks for a reply. The second identifier belongs to moteus replies, and has 11
        # bits if it is small enough.
        yield EXTENDED_ID_FLAG | 0x8000 | motor.node_id, location
        number = motor.node_id << 8
        yield number if number < STANDARD_IDS else number | EXTENDED_ID_FLAG, location
    elif motor.protocol == "robstride":
        # The first identifier belongs to RobStride requests of type 0. The second identifier
        # belongs to the feedback of a running RobStride motor to the default host.
        yield EXTENDED_ID_FLAG | 0xFD00 | motor.node_id, location
        yield EXTENDED_ID_FLAG | 0x0280_00FD | motor.node_id << 8, location
    else:
        yield f"{motor.protocol} node {motor.node_id}", location


def _mit_reply_id(motor: Motor, key_path: str) -> tuple[object, str]:
    """Return the CAN identifier of the replies of an MIT drive, and the key path that sets the identifier."""
    reply = motor.options.get("reply_id")
    if reply is None:
        return motor.node_id + MIT_REPLY_OFFSET, key_path
    return reply, f"motor[{motor.name}].options.reply_id"


def _check_reply_id(motor: Motor) -> MistakeIterator:
    """Check the CAN identifier of the replies of an MIT drive."""
    reply = motor.options.get("reply_id")
    if motor.protocol != "mit" or reply is None:
        return
    if isinstance(reply, bool) or not isinstance(reply, int) or not 1 <= reply <= 0x7FF:
        yield FileMistake(
            f"{reply}", f"motor[{motor.name}].options.reply_id", "a whole number from 1 to 2047"
        )
