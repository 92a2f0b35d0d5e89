"""Default task and default object for a hand without a task file.

The phases of the task are: open, close until contact, hold, release, open.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from handctl.core.estimation.tip_force import reduced_tip_lever
from handctl.document import validate_content
from handctl.hand.description import Hand
from handctl.hand.digit import Array, DigitModel
from handctl.hand.file.error_text import shortened_list
from handctl.hand.file.new_hand_file import CLEARANCE_MM, OBJECT_DIAMETER_RATIO, SMALLEST_OBJECT_MM
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import parse_toml
from handctl.hand.kinematics import link_rotations
from handctl.hand.link_tree import LinkTree
from handctl.hand.readiness_checks import displayed_range
from handctl.programs.task import Task

CLOSED_FRACTION = 0.85
"""Angle of a closed coordinate divided by its largest angle.

With a closed angle below the largest angle, a digit that touches no object stops before its joints
reach their limits.
"""
CLOSING_SPEED_DEG_S = 50.0
PRISMATIC_CLOSING_SPEED = 20.0
"""Closing speed of digits [deg/s], and closing speed of a hand with prismatic joints [deg/s or mm/s]."""
LARGEST_CLOSED_DEG = 120.0
"""Largest angle of a closed coordinate [deg]."""
HOLD_TENSION_FRACTION = 0.3
"""Hold tension divided by ``tension_max_N``, if equally many digits close from both sides of the object."""
MAX_HOLD_TENSION_FRACTION = 0.7
"""Largest hold tension divided by ``tension_max_N``."""
MIN_FORCE_BALANCE_FACTOR = 0.1
"""Smallest allowed factor on the tension of a digit to balance the forces on an object.

If the balance requires a smaller factor, the default task does not balance the forces.
"""
PRESSING_FORCE_N = 1.0
"""Smallest force at the tip of a half-closed digit in the hold phase, after subtraction of the spring force [N]."""
CONTACT_TENSION_FRACTION = 0.16
"""Tension of a digit in contact divided by ``tension_max_N``, until all digits are in contact."""
RELEASE_TENSION_MARGIN_N = 6.0
"""Difference between the tension of the release phase and the highest ``tension_floor_N`` of the hand [N]."""
OPENING_DURATION_S = 1.2
"""Duration of the last phase, in which the hand opens [s].

In 1.2 s, a joint opens by 90 deg with a speed of at most 140 deg/s.
"""
EXTENSOR_TENSION_FACTOR = 1.5
"""Tension of an extensor in the hold phase, divided by ``tension_floor_N``."""
CYLINDER_SCENE = "cylinder"
"""Scene with an object of 35 mm in front of the palm, for digits that flex in parallel planes."""
SPHERE_SCENE = "sphere"
"""Scene with a sphere, for digits that do not flex in parallel planes."""
MAX_AXIAL_COMPONENT = 0.1
"""Largest axial component of a direction of flexion that still counts as normal to the cylinder."""
PALM_GAP_M = 0.002
"""Gap between the palm and the object of the scene [m].

Source: ``firmware_sim/scenes/cylinder.toml``.
"""
MIN_DISTANCE_AWAY_M = 0.01
"""Distance in the direction of flexion above which another digit is in front of or behind a digit [m]."""
OBJECT_HALF_LENGTH_M = 0.0465
"""Half length of the scene's object along the hinges [m].

Source: ``firmware_sim/scenes/cylinder.toml``.
"""
SAMPLES_PER_LINK = 9
"""Number of points along a link for which the distance to the object is computed."""


def default_task(hand: Hand) -> tuple[Task, str]:
    """Return the default task of a hand in two forms: as an object, and as the text of a task file.

    Args:
        hand: hand that shall execute the task.
    """
    largest = min(tendon.tension_max_N for tendon in hand.tendon)
    floor = max(tendon.tension_floor_N for tendon in hand.tendon)
    open_angles = {
        name: np.zeros_like(_closed_angles_deg(hand, name)).tolist() for name in hand.digit_names
    }
    # A digit that carries other digits, such as a wrist, keeps its angle in the default task.
    closing_digit_names = [name for name in hand.digit_names if name not in hand.carrier_digits]
    content: dict[str, Any] = {
        "schema": 1,
        "name": "close, hold, open",
        "description": f"Default task of {hand.name}",
        "phase": [
            {"kind": "move", "name": "home", "angle_deg": open_angles, "duration_s": 0.4},
            {
                "kind": "close",
                "name": "close",
                "angle_deg": {
                    name: _closed_angles_deg(hand, name).tolist() for name in closing_digit_names
                },
                "speed_deg_s": PRISMATIC_CLOSING_SPEED
                if hand.is_prismatic.any()
                else CLOSING_SPEED_DEG_S,
                "contact_tension_N": round(max(CONTACT_TENSION_FRACTION * largest, floor + 1.0), 1),
            },
            {
                "kind": "hold",
                "name": "hold",
                "tension_N": {
                    name: _hold_tensions(hand, name, share)
                    for name, share in _tension_factors(hand).items()
                },
                "rate_N_per_s": 40.0,
                "duration_s": 5.0,
            },
            {
                "kind": "release",
                "name": "release",
                "tension_N": min(floor + RELEASE_TENSION_MARGIN_N, largest),
                "rate_N_per_s": 60.0,
            },
            {
                "kind": "move",
                "name": "open",
                "angle_deg": open_angles,
                "duration_s": OPENING_DURATION_S,
            },
        ],
    }
    text = (
        f"# Made for {hand.name} by handctl: open, close until contact, hold, release, open.\n"
        + toml_text(content)
    )
    return validate_content(parse_toml(text, "default task"), Task, "default task"), text


def _closed_angles_deg(hand: Hand, name: str) -> np.ndarray:
    """Return the coordinates (n_c,) of a closed digit, in deg, or in mm for prismatic joints."""
    _, high = displayed_range(hand.digit_named(name))
    is_sideways = DigitModel.from_hand(hand, name).sideways_coordinates
    closed_angles = np.where(
        is_sideways, 0.0, np.minimum(CLOSED_FRACTION * high, LARGEST_CLOSED_DEG)
    )
    return np.asarray(np.round(closed_angles, 1))


def _tension_factors(hand: Hand) -> dict[str, float]:
    """Return, for each digit, the factor by which the digit's tension in a hold is multiplied.

    The mean of the tension factors is 1. With the returned factors, the forces of the digits on an
    object balance each other. With equal factors, for example, two fingers would push a thumb open.
    """
    balance = _force_balance_factors(hand)
    if balance is not None:
        return balance
    # If no tension factors balance the forces on the object, the palm or friction must balance the
    # forces. The opposed digits together then press with the same force as the other digits
    # together.
    is_opposed_by_name = _are_digits_opposed(hand)
    count = len(is_opposed_by_name)
    opposed_digit_count = sum(is_opposed_by_name.values())
    if opposed_digit_count == 0:
        return dict.fromkeys(is_opposed_by_name, 1.0)
    return {
        name: count / 2 / (opposed_digit_count if is_opposed else count - opposed_digit_count)
        for name, is_opposed in is_opposed_by_name.items()
    }


def _force_balance_factors(hand: Hand) -> dict[str, float] | None:
    """Return factors for the tensions of the digits, with which the digit forces on an object cancel each other.

    The factors have the mean 1, and are as near to 1 as possible. Return None if a factor is below
    ``MIN_FORCE_BALANCE_FACTOR``.
    """
    flexion_directions = _flexion_directions(hand)
    rows = np.array(list(flexion_directions.values()))
    factors = 1.0 - rows @ np.linalg.pinv(rows.T @ rows) @ rows.sum(axis=0)
    if factors.min() < MIN_FORCE_BALANCE_FACTOR:
        return None
    return dict(zip(flexion_directions, (factors / factors.mean()).tolist(), strict=True))


def _flexion_directions(hand: Hand) -> dict[str, Array]:
    """Return the direction (3,) in which the tip of each closing digit moves, in the palm frame.

    The direction is the y axis of the last link when all joint angles are 0.
    """
    tree = LinkTree.from_hand(hand)
    turned_link_rotations = link_rotations(tree.poses(np.zeros(len(hand.joints))))
    return {
        digit.name: turned_link_rotations[digit.joints][-1, :, 1]
        for digit in tree.digits
        if digit.name not in hand.carrier_digits
    }


def _are_digits_opposed(hand: Hand) -> dict[str, bool]:
    """Return, for each closing digit, True if the digit closes in the direction opposite to the first closing digit."""
    flexion_directions = _flexion_directions(hand)
    first_direction = next(iter(flexion_directions.values()))
    return {
        name: bool(direction @ first_direction < 0.0)
        for name, direction in flexion_directions.items()
    }


def _hold_tensions(hand: Hand, name: str, tension_fraction: float) -> float | list[float]:
    """Return the tension [N] of each tendon of a digit during a hold.

    The tension of a tendon that extends the digit is just large enough to keep the tendon taut.

    For a digit with spool pairs, the result is a single number: the largest net tension that a pair
    has while the digit presses.
    """
    if hand.is_pair[hand.digit_tendons[name]].any():
        largest = min(tendon.tension_max_N for tendon in hand.tendon[hand.digit_tendons[name]])
        return round(
            min(HOLD_TENSION_FRACTION * tension_fraction, MAX_HOLD_TENSION_FRACTION) * largest, 1
        )
    pressing_tension = _pressing_tension(hand, name)
    arms = DigitModel.from_hand(hand, name).reduced_moment_arms
    rows = zip(hand.tendon[hand.digit_tendons[name]], arms.sum(axis=1), strict=True)
    return [
        round(
            min(
                tension_fraction
                * max(HOLD_TENSION_FRACTION * tendon.tension_max_N, pressing_tension),
                MAX_HOLD_TENSION_FRACTION * tendon.tension_max_N,
            )
            if arm > 0.0
            else EXTENSOR_TENSION_FACTOR * tendon.tension_floor_N,
            1,
        )
        for tendon, arm in rows
    ]


def _pressing_tension(hand: Hand, name: str) -> float:
    """Return the tension [N] with which the closing tendons make a half-closed digit press with PRESSING_FORCE_N."""
    digit = DigitModel.from_hand(hand, name)
    half_closed_angles = digit.coordinate_units.to_si_units(_closed_angles_deg(hand, name)) / 2
    q = digit.coupling @ half_closed_angles
    springs = digit.coupling.T @ (
        np.array(digit.spring_stiffness) * (q + np.array(digit.spring_preload))
    )
    torque = springs + PRESSING_FORCE_N * reduced_tip_lever(digit, q)
    arms = digit.with_moment_arms_at(q).reduced_moment_arms
    closing_moment_arms = arms[arms.sum(axis=1) > 0.0].sum(axis=0)
    # A coordinate whose angle stays the same, or that no tendon closes, requires no tension.
    is_flexed = (half_closed_angles > 0.0) & (closing_moment_arms > 0.0)
    return float((torque[is_flexed] / closing_moment_arms[is_flexed]).max(initial=0.0))


def grasp_warnings(hand: Hand) -> tuple[str, ...]:
    """Return one line for each reason why a hand cannot lift the object of the default task.

    A hand cannot lift the object if no digit closes against another digit, or if a digit is too
    weak.
    """
    warnings = []
    is_opposed = _are_digits_opposed(hand)
    if len(set(is_opposed.values())) == 1:
        warnings.append(
            f"{shortened_list(list(is_opposed))}: no digit closes against another: the default task lifts no object; "
            "add a digit that is turned by 180 degrees about x in mount_rpy_deg"
        )
    else:
        warnings += [
            f"{name}: flexes away from the other digits; "
            "turn it by 180 degrees about x in mount_rpy_deg, in degrees"
            for name in _digits_flexing_away(hand)
        ]
    for name in is_opposed:
        tendons = hand.tendon[hand.digit_tendons[name]]
        max_hold_tension = MAX_HOLD_TENSION_FRACTION * min(
            tendon.tension_max_N for tendon in tendons
        )
        if (tension := _pressing_tension(hand, name)) > max_hold_tension:
            warnings.append(
                f"{name}: pressing with {PRESSING_FORCE_N:g} N at its tip takes {tension:.0f} N of tension, "
                f"and a hold allows {max_hold_tension:.0f} N; raise tension_max_N or moment_arm_m, or lower the springs"
            )
    return tuple(warnings)


def _digits_flexing_away(hand: Hand) -> list[str]:
    """Return the closing digits that flex away from the mount positions of all other closing digits."""
    flexion_directions = _flexion_directions(hand)
    points = LinkTree.from_hand(hand).points(np.zeros(len(hand.joints)))
    first_point = dict(
        zip(hand.digit_names, (digit_points[0] for digit_points in points), strict=True)
    )
    mount_positions = {name: first_point[name] for name in flexion_directions}
    names = []
    for name, direction in flexion_directions.items():
        distances = [
            (position - mount_positions[name]) @ direction
            for other_name, position in mount_positions.items()
            if other_name != name
        ]
        # Digits side by side, such as fingers, have almost no distance in the direction of flexion.
        is_away = max(distances, default=0.0) < MIN_DISTANCE_AWAY_M
        if is_away and min(distances, default=0.0) < -MIN_DISTANCE_AWAY_M:
            names.append(name)
    return names


def default_scene(hand: Hand) -> str:
    """Return the scene for the default task of a hand.

    The scene contains a cylinder or a ball between the open digits. The diameter of the object is
    proportional to the length of the digits. If the object were thinner, the tips of opposed digits
    would touch each other. If the digits of a hand cannot press against each other, as in an
    anthropomorphic hand, the object has a diameter of 35 mm.
    """
    flexion_directions = _flexion_directions(hand)
    are_digits_parallel = all(
        abs(direction[2]) < MAX_AXIAL_COMPONENT for direction in flexion_directions.values()
    )
    if not are_digits_parallel and _force_balance_factors(hand) is None:
        return CYLINDER_SCENE
    shape = CYLINDER_SCENE if are_digits_parallel else SPHERE_SCENE
    longest_digit_mm = 1e3 * max(
        sum(hand.digit_named(name).link_length_m) for name in flexion_directions
    )
    free_space_mm = 1e3 * _largest_object_diameter(hand, is_ball=shape == SPHERE_SCENE)
    diameter = max(
        SMALLEST_OBJECT_MM,
        min(OBJECT_DIAMETER_RATIO * longest_digit_mm, free_space_mm - CLEARANCE_MM),
    )
    if diameter > free_space_mm:
        diameter = free_space_mm - CLEARANCE_MM
    return (
        CYLINDER_SCENE
        if (shape, round(diameter)) == (CYLINDER_SCENE, SMALLEST_OBJECT_MM)
        else f"{shape}:{max(diameter, 1.0):.0f}"
    )


def _largest_object_diameter(hand: Hand, is_ball: bool) -> float:
    """Return the diameter [m] of the largest cylinder or ball that fits between the open digits."""
    tree = LinkTree.from_hand(hand)
    q = np.concatenate([np.maximum(digit.joint_min, 0.0) for digit in tree.digits])
    largest = 1.0
    fractions = np.linspace(0.0, 1.0, SAMPLES_PER_LINK)[:, None]
    for digit, points in zip(tree.digits, tree.points(q), strict=True):
        for start, end in pairwise(points):
            x, y, z = (start + fractions * (end - start)).T
            # A circle with diameter D that touches the line x = gap has its centre at x = gap +
            # D/2. A point at the distance D/2 + r from the centre satisfies (x - gap)^2 + y^2 - r^2
            # = D (x - gap + r). For a ball, y^2 + z^2 replaces y^2.
            reach_m = x - PALM_GAP_M + digit.radius
            passes_object = (reach_m > 0.0) & (is_ball | (np.abs(z) < OBJECT_HALF_LENGTH_M))
            free_space = (x - PALM_GAP_M) ** 2 + y**2 + is_ball * z**2 - digit.radius**2
            largest = min(
                largest,
                float((free_space[passes_object] / reach_m[passes_object]).min(initial=largest)),
            )
    return max(largest, 0.0)
