"""Checks that a hand must pass before a run, in addition to the checks of every hand file.

Tools and logs can use any hand file that is valid. For a run, a hand must fulfil more conditions:

- CAN controllers must support the bit rates.
- Springs or antagonistic tendons must be able to open the digits, and tendons must be able to close
  the digits.
- Positive coordinates must flex the digits.
- The position values of the drives must cover the travel of the spools.
- Each digit must have a place of its own at the palm.

``doubtful_values`` returns warnings about values that are possible, but probably not intended.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from handctl.hand.description import Hand
from handctl.hand.digit import coordinate_range
from handctl.hand.file.error_text import FileMistake, lines_by_text
from handctl.hand.file.section_models import PRISMATIC_KEYS, REVOLUTE_KEYS, Bus, Digit, Tendon
from handctl.hand.link_geometry import link_inertia
from handctl.hand.link_tree import LinkTree
from handctl.hand.moment_arms import moment_arm_table, moment_arm_table_residual, moment_arms_at

Vector = NDArray[np.float64]
MAX_ARBITRATION_BITRATE = 1_000_000
"""Largest bit rate of classical CAN and of the arbitration phase of CAN FD [bit/s].

Source: ISO 11898-2.
"""
MAX_TORQUE_RESIDUAL = 1e-6
"""Largest torque that counts as 0, as a fraction of the torque that 1 N makes at the largest moment arm."""
CHECKED_POSTURE_COUNT = 11
"""Number of postures at which a digit is checked, if its moment arms depend on joint angles."""
SPRING_STIFFNESS = REVOLUTE_KEYS.index("spring_stiffness_N_m_per_rad")
SPRING_PRELOAD = REVOLUTE_KEYS.index("spring_preload_rad")
"""Index of each key of return springs in ``REVOLUTE_KEYS``."""
MIN_MOUNT_DISTANCE_M = 1e-3
"""Smallest distance between the mount positions of two digits [m]."""
STANDARD_GRAVITY_M_S2 = 9.81
"""Gravity on earth [m/s2]."""
GRAVITY_TOLERANCE_M_S2 = 0.1
"""Difference from the gravity on earth above which a warning is printed [m/s2]."""
LONGEST_WATCHDOG_MS = 200
"""Watchdog time above which a warning is printed [ms].

Until its watchdog expires, a drive pulls with its last torque although the computer has stopped.
"""
SMALLEST_USUAL_RANGE_DEG = 5.0
"""Range of a hinge below which a warning is printed [deg]."""
LARGEST_ANGLE_IN_RADIANS = 3.2
"""Joint angle up to which a closed stop in degrees is probably a value in radians."""
SMALLEST_USUAL_GYRATION_RATIO = 0.05
"""Radius of gyration below which a warning is printed, divided by the length or the diameter of the link."""
USUAL_PEAK_CURRENTS_A = (0.1, 500.0)
"""Usual current of a motor at its peak torque [A]."""
SMALLEST_USUAL_TRANSMISSION = 0.5
"""Fraction of the tension behind the guide before the first joint below which a warning is printed."""
LARGEST_AXIS_COMPONENT_ALONG_LINK = 0.99
"""Component of a joint axis along its link above which a warning is printed."""
SMALLEST_RANGE_DEG = 1.0
"""Smallest range of a coordinate that counts as a motion [deg]."""


def reasons_not_ready(hand: Hand) -> Iterator[FileMistake]:
    """Yield the reasons why a valid hand must not run, each with the key path of the cause."""
    for bus in hand.bus:
        yield from _check_rates(bus)
    for digit in hand.digit:
        direction_mistakes = list(_check_direction(digit))
        yield from direction_mistakes
        yield from _check_opening(hand, digit)
        # A coupling of the wrong sign also makes closing tendons open the digit.
        yield from () if direction_mistakes else _check_closing(hand, digit)
    for tendon in hand.tendon:
        yield from _check_position_range(hand, tendon)
    yield from _check_mount_positions(hand)


def _check_rates(bus: Bus) -> Iterator[FileMistake]:
    """Check that the bit rates of a bus are possible for CAN controllers."""
    location = f"bus[{bus.name}]"
    if bus.bitrate > MAX_ARBITRATION_BITRATE:
        expected = (
            f"at most {MAX_ARBITRATION_BITRATE}; the faster data phase of CAN FD is data_bitrate"
        )
        yield FileMistake(f"{bus.bitrate}", f"{location}.bitrate", expected)
    elif bus.data_bitrate is not None and bus.data_bitrate < bus.bitrate:
        yield FileMistake(
            f"{bus.data_bitrate}", f"{location}.data_bitrate", f"at least bitrate = {bus.bitrate}"
        )


def _check_direction(digit: Digit) -> Iterator[FileMistake]:
    """Check that coupled joints can move within their limits.

    The function also checks that positive coordinates flex the digit.
    """
    if digit.coupling is None:
        return
    location = f"digit[{digit.name}].coupling"
    for i, (low, high) in enumerate(zip(*displayed_range(digit), strict=True)):
        # A range of less than 1 mm of a prismatic joint does not count as a motion either.
        if high - low < SMALLEST_RANGE_DEG:
            expected = "signs and sizes that leave the joints a common range within their limits"
            yield FileMistake(f"column {i} moves no joint within its limits", location, expected)
        elif low + high < 0.0:
            expected = "the opposite sign: a positive coordinate flexes"
            if 0.0 < max(digit.joint_max_deg, default=0.0) <= LARGEST_ANGLE_IN_RADIANS:
                expected += ", or joint_max_deg in degrees"
            yield FileMistake(f"column {i} opens the digit", location, expected)


def displayed_range(digit: Digit) -> tuple[Vector, Vector]:
    """Return the smallest and the largest value of each coordinate of a digit, (n_c,) [deg or mm] each.

    All joints stay within their limits while one coordinate moves between its two values and the
    other coordinates are zero.
    """
    limits = np.array(digit.displayed_joint_limits)
    if digit.coupling is None:
        return limits[0], limits[1]
    low, high = coordinate_range(np.array(digit.coupling), limits)
    return low, high


def _check_opening(hand: Hand, digit: Digit) -> Iterator[FileMistake]:
    """Check that springs or antagonistic tendons can open a digit against the tension floor of the closing tendons.

    The function checks every coordinate of the digit.
    """
    tendons = hand.digit_tendons[digit.name]
    if hand.is_pair[tendons].any():
        return  # a spool pair can pull in both directions
    coupling = np.eye(len(digit.joints)) if digit.coupling is None else np.array(digit.coupling)
    postures = [hand.moment_arms[tendons, hand.digit_joints[digit.name]] @ coupling]
    if hand.has_varying_arm[tendons].any():
        limits = hand.joint_limits[:, hand.digit_joints[digit.name]]
        polynomials = hand.arm_polynomials[tendons, hand.digit_joints[digit.name]]
        postures = list(
            moment_arms_at(
                polynomials, limits, np.linspace(limits[0], limits[1], CHECKED_POSTURE_COUNT)
            )
            @ coupling
        )
    arms = postures[0]  # moment arms of the digit in its open posture
    floor = np.array([tendon.tension_floor_N for tendon in hand.tendon[tendons]])
    stiffness = np.array(digit.joint_values("spring_stiffness_N_m_per_rad"))
    opened_angles = np.add(digit.joint_limits[0], digit.joint_values("spring_preload_rad"))
    springs = coupling.T @ (stiffness * opened_angles)
    closing_torque = arms.T @ floor
    if all(map(can_tensions_balance, postures)):
        return
    if (arms.min(axis=0) < 0.0).any() and not stiffness.any():
        expected = "tensions above 0 that make no torque together: one more tendon than coordinates, or other arms"
        yield FileMistake(
            "its tendons cannot hold each other", f"digit[{digit.name}].tendon", expected
        )
        return
    is_too_weak = (springs <= closing_torque) & (arms.min(axis=0) >= 0.0)
    if not is_too_weak.any():
        return
    # Each digit causes at most one mistake, about the joint whose closing torque exceeds the spring
    # torque most.
    worst_joint = int(np.argmax(np.where(is_too_weak, closing_torque - springs, -np.inf)))
    joint = f"j{worst_joint + 1}" if digit.coupling is None else "the joints"
    is_prismatic = bool((coupling[np.array(digit.is_prismatic), worst_joint] != 0.0).any())
    keys = [(key, PRISMATIC_KEYS[i]) for i, key in enumerate(REVOLUTE_KEYS)]
    key = keys[SPRING_PRELOAD if stiffness.any() else SPRING_STIFFNESS][is_prismatic]
    unit = ("N m", "N")[is_prismatic]
    problem_text = f"the springs open {joint} with {springs[worst_joint]:.3g} {unit} at {keys[0][is_prismatic]}"
    expected = (
        f"more than the {closing_torque[worst_joint]:.3g} {unit} with which tension_floor_N closes"
    )
    yield FileMistake(problem_text, f"digit[{digit.name}].{key}", expected)


def _check_closing(hand: Hand, digit: Digit) -> Iterator[FileMistake]:
    """Check that a tendon can close each coordinate of a digit with springs. The springs only open the digit."""
    if not digit.has_springs:
        return
    coupling = np.eye(len(digit.joints)) if digit.coupling is None else np.array(digit.coupling)
    arms = hand.moment_arms[hand.digit_tendons[digit.name], hand.digit_joints[digit.name]]
    for i, largest_arm in enumerate((arms @ coupling).max(axis=0).tolist()):
        if largest_arm < 0.0:
            joint = f"j{i + 1}" if digit.coupling is None else "the joints"
            yield FileMistake(
                f"no tendon closes {joint}, which the springs open",
                f"digit[{digit.name}].tendon",
                "a tendon with positive moment arms: a positive angle flexes the digit",
            )


def _check_position_range(hand: Hand, tendon: Tendon) -> Iterator[FileMistake]:
    """Check that the position values of a drive cover the spool travel between the joint limits.

    The travel includes the stretch of the tendon at ``drive_limit_N``.
    """
    index = hand.tendon_names.index(tendon.name)
    motor = hand.motor_of_tendon(tendon.name)
    excursions = hand.moment_arms[index] * hand.joint_limits
    stretch = tendon.drive_limit_N / tendon.stiffness_N_per_m
    farthest_m = max(excursions.max(axis=0).sum() + stretch, -excursions.min(axis=0).sum())
    farthest_rad = farthest_m / motor.spool_radius_m + abs(motor.zero_rad)
    if farthest_rad > motor.position_range_rad:
        yield FileMistake(
            f"{motor.position_range_rad:g}",
            f"motor[{motor.name}].position_range_rad",
            f"at least {farthest_rad:.3g} rad, the spool angle of {tendon.name} at the joint limits",
        )


def _check_mount_positions(hand: Hand) -> Iterator[FileMistake]:
    """Check that no two digits on the same carrier begin at the same position."""
    for i, digit in enumerate(hand.digit):
        for other_digit in hand.digit[:i]:
            is_same_carrier = digit.mount_on == other_digit.mount_on
            if is_same_carrier and _mount_distance(digit, other_digit) < MIN_MOUNT_DISTANCE_M:
                yield FileMistake(
                    f"the position of {other_digit.name}",
                    f"digit[{digit.name}].mount_position_m",
                    f"another position, at least {1e3 * MIN_MOUNT_DISTANCE_M:g} mm away",
                )


def _mount_distance(digit: Digit, other_digit: Digit) -> float:
    """Return the distance [m] between the mount positions of two digits on the same carrier."""
    return float(np.linalg.norm(np.subtract(digit.mount_position_m, other_digit.mount_position_m)))


def doubtful_values(hand: Hand) -> tuple[str, ...]:
    """Return one line for each value that is possible, but is probably a mistake."""
    lines = []
    gravity = float(np.linalg.norm(hand.mount.gravity_m_s2))
    if abs(gravity - STANDARD_GRAVITY_M_S2) > GRAVITY_TOLERANCE_M_S2:
        lines.append(
            f"mount.gravity_m_s2: a gravity of {gravity:.3g} m/s2; "
            f"on earth {STANDARD_GRAVITY_M_S2:g} m/s2 in the direction of gravity"
        )
    lines += _far_mount_lines(hand)
    lines += _sagging_digit_lines(hand)
    lines += lines_by_text(
        (
            tendon.name,
            f"friction_coefficient and wrap_angle_rad: only {100 * transmitted:.0f} % of the tension passes the "
            "guide before the first joint",
        )
        for tendon in hand.tendon
        if (transmitted := np.exp(-tendon.friction_coefficient * tendon.wrap_angle_rad))
        < SMALLEST_USUAL_TRANSMISSION
    )
    doubtful_joints: list[tuple[str, str]] = []
    lines += lines_by_text(
        (
            motor.name,
            f"watchdog_ms: the drive keeps its torque for {motor.watchdog_ms} ms after the last command; "
            f"at most {LONGEST_WATCHDOG_MS} ms is usual",
        )
        for motor in hand.motor
        if motor.watchdog_ms > LONGEST_WATCHDOG_MS
    )
    lines += lines_by_text(_doubtful_torque_constants(hand))
    for digit in hand.digit:
        lines += _doubtful_inertia_lines(digit)
        hinges = [
            joint
            for joint, is_prismatic in zip(digit.joints, digit.is_prismatic, strict=True)
            if not is_prismatic
        ]
        ranges = np.subtract(digit.joint_max_deg, digit.joint_min_deg).tolist()
        doubtful_joints += [
            (
                joint,
                f"joint_max_deg: the joint can turn by only {width:.3g} deg; angles in hand files are in degrees",
            )
            for joint, width in zip(hinges, ranges, strict=True)
            if width < SMALLEST_USUAL_RANGE_DEG
        ]
        largest_angle = max(digit.joint_max_deg, default=0.0)
        # A small range has its own line above.
        is_in_radians = (
            0.0 < largest_angle <= LARGEST_ANGLE_IN_RADIANS
            and min(ranges) >= SMALLEST_USUAL_RANGE_DEG
        )
        doubtful_joints += [
            (
                joint,
                f"joint_max_deg: no joint of the digit closes beyond {largest_angle:.3g} deg; "
                "angles in hand files are in degrees",
            )
            for joint in hinges
            if is_in_radians
        ]
        doubtful_joints += [
            (
                joint,
                "joint_axis: the joint turns its link about the link's own x axis; "
                "flexion is about z, and abduction about y",
            )
            for joint, axis in zip(digit.joints, digit.joint_axis or (), strict=False)
            if joint in hinges
            and digit.name not in hand.carrier_digits
            and abs(axis[0]) > LARGEST_AXIS_COMPONENT_ALONG_LINK
        ]
    lines += lines_by_text(doubtful_joints)
    return tuple(lines)


def _doubtful_torque_constants(hand: Hand) -> Iterator[tuple[str, str]]:
    """Yield the name of each motor with an unusual peak current, and a text about its torque constant."""
    smallest, largest = USUAL_PEAK_CURRENTS_A
    for motor in hand.motor:
        peak_current = motor.torque_peak_N_m / motor.torque_constant_N_m_per_A
        if not smallest <= peak_current <= largest:
            yield (
                motor.name,
                f"torque_constant_N_m_per_A: torque_peak_N_m needs {peak_current:.3g} A; "
                f"{smallest:g} to {largest:g} A is usual",
            )


def _doubtful_inertia_lines(digit: Digit) -> Iterator[str]:
    """Yield a line for each link whose inertia is too small for its mass and its size."""
    for i, (mass, length) in enumerate(zip(digit.link_mass_kg, digit.link_length_m, strict=True)):
        gyration_radius = math.sqrt(float(np.linalg.eigvalsh(link_inertia(digit, i))[-1]) / mass)
        link_size = max(length, 2.0 * digit.link_radius_m)
        if gyration_radius / link_size < SMALLEST_USUAL_GYRATION_RATIO:
            yield (
                f"digit[{digit.name}].link_inertia_kg_m2[{i}]: a radius of gyration of {1e3 * gyration_radius:.3g} mm "
                f"for a link of {1e3 * link_size:.3g} mm; a rod has {1e3 * link_size / math.sqrt(12.0):.3g} mm"
            )


def _sagging_digit_lines(hand: Hand) -> Iterator[str]:
    """Yield a line for each joint whose spring is too weak to hold the joint open.

    The spring works against the weight of the links and the tension floors of the tendons. The
    coupling of joints by springs is elastic, so each joint needs a spring that can hold this joint
    alone.
    """
    tree = LinkTree.from_hand(hand)
    open_angles = hand.joint_limits[0]
    floor = np.array([tendon.tension_floor_N for tendon in hand.tendon])
    opening_torques = tree.spring_stiffness * (open_angles + tree.spring_preload)
    # The static torque balances springs and weight. Without the springs, weight and floor remain.
    closing_torques = hand.moment_arms.T @ floor + opening_torques - tree.static_torque(open_angles)
    torques = zip(hand.joints, opening_torques.tolist(), closing_torques.tolist(), strict=True)
    for joint, opening_torque, closing_torque in torques:
        if 0.0 < opening_torque < closing_torque:
            yield (
                f"{joint}: with this gravity, weight and tension_floor_N close the joint with "
                f"{closing_torque:.3g} N m, and its spring opens it with {opening_torque:.3g} N m"
            )


def _far_mount_lines(hand: Hand) -> Iterator[str]:
    """Yield a line for each digit on the palm that is far from all other digits on the palm."""
    digits = [digit for digit in hand.digit if digit.mount_on is None]
    reach = 2.0 * max(sum(digit.link_length_m) for digit in hand.digit)
    for digit in digits:
        distances = [
            _mount_distance(digit, other_digit)
            for other_digit in digits
            if other_digit is not digit
        ]
        if distances and min(distances) > reach:
            yield (
                f"digit[{digit.name}].mount_position_m: {min(distances):.3g} m from the nearest digit, "
                "more than two digit lengths"
            )


def moment_arm_fit_lines(hand: Hand) -> tuple[str, ...]:
    """Return lines about the differences between tables of moment arms and the polynomials that replace them.

    The text has one line for each tendon with a table of moment arms.
    """
    lines = []
    for tendon in hand.tendon:
        table_by_joint = {
            joint: arm
            for joint, arm in tendon.moment_arm_m.items()
            if len(moment_arm_table(arm)[0])
        }
        if table_by_joint:
            differences_text = ", ".join(
                f"{1e3 * moment_arm_table_residual(arm):.2g} mm at {joint}"
                for joint, arm in table_by_joint.items()
            )
            lines.append(
                f"{tendon.name}: the polynomial of its table of moment arms differs by at most {differences_text}"
            )
    return tuple(lines)


def can_tensions_balance(moment_arms: Vector) -> bool:
    """Return True if a set of positive tensions makes no torque at any coordinate.

    Args:
        moment_arms: matrix R B (n_t, n_c) of moment arms in the coordinates of a digit [m].
    """
    largest = np.abs(moment_arms).max()
    if (
        (moment_arms.min(axis=0) >= 0.0) & (moment_arms.max(axis=0) > MAX_TORQUE_RESIDUAL * largest)
    ).any():
        return (
            # If all moment arms at a coordinate are positive, positive tensions always make a
            # torque at the coordinate.
            False
        )
    from scipy.optimize import nnls  # the import takes as long as all other checks

    # If the non-negative least-squares problem has no residual, the sum of the torques of the
    # tensions 1 + w with w >= 0 is zero.
    _, residual = nnls(moment_arms.T, -moment_arms.sum(axis=0))
    return bool(residual <= MAX_TORQUE_RESIDUAL * largest)
