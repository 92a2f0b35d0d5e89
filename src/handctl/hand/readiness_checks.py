"""Checks that a hand must pass before a run, in addition to the checks of every hand file.

Tools and logs can use any hand file that is valid. For a run, a hand must fulfil three more
conditions. CAN controllers must support the bit rates, springs or antagonistic tendons must be able
to open the digits, and positive coordinates must flex the digits.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from handctl.hand.description import Hand
from handctl.hand.digit import coordinate_range
from handctl.hand.file.error_text import FileMistake
from handctl.hand.file.section_models import PRISMATIC_KEYS, REVOLUTE_KEYS, Bus, Digit
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
SMALLEST_RANGE_DEG = 1.0
"""Smallest range of a coordinate that counts as a motion [deg]."""


def reasons_not_ready(hand: Hand) -> Iterator[FileMistake]:
    """Yield the reasons why a valid hand must not run, each with the key path of the cause."""
    for bus in hand.bus:
        yield from _check_rates(bus)
    for digit in hand.digit:
        yield from _check_direction(digit)
        yield from _check_opening(hand, digit)


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
            yield FileMistake(
                f"column {i} opens the digit",
                location,
                "the opposite sign: a positive coordinate flexes",
            )


def displayed_range(digit: Digit) -> tuple[Vector, Vector]:
    """Return the smallest and the largest value (n_c,) of each coordinate of a digit [deg or mm].

    While one coordinate moves between its two values and the other coordinates are zero, all joints
    stay within their limits.
    """
    limits = np.array(digit.displayed_joint_limits)
    if digit.coupling is None:
        return limits[0], limits[1]
    low, high = coordinate_range(np.array(digit.coupling), limits)
    return low, high


def _check_opening(hand: Hand, digit: Digit) -> Iterator[FileMistake]:
    """Check that springs or antagonistic tendons can open a digit against the tension floor.

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


def moment_arm_fit_lines(hand: Hand) -> tuple[str, ...]:
    """Return lines that report the differences between polynomials and tables of moment arms.

    The text has one line for each tendon with a table of moment arms.
    """
    lines = []
    for tendon in hand.tendon:
        tables = {
            joint: arm
            for joint, arm in tendon.moment_arm_m.items()
            if len(moment_arm_table(arm)[0])
        }
        if tables:
            differences_text = ", ".join(
                f"{1e3 * moment_arm_table_residual(arm):.2g} mm at {joint}"
                for joint, arm in tables.items()
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
