"""Motions from which the parameters of a digit can be identified, if tendons both close and open the digit.

A digit that tendons both close and open has either spool pairs, or n + 1 tendons for n joints and
no springs.

First, the digit sweeps about a middle posture. In the sweeps, the joints first move together. Then
the joints move against each other. In all sweeps, the motors wind up some of the tendons, and pay
out the other tendons. After the sweeps, the digit oscillates. At the end, the tendons are stretched
while the digit is pressed against its lower stops.
"""

import math

import numpy as np

from handctl.core.control_law.tendon_redundancy import redundancy_of_hand
from handctl.hand.description import Hand
from handctl.hand.digit import Array, DigitModel
from handctl.hand.link_tree import LinkTree
from handctl.programs.clear_range import highest_clear_coordinates
from handctl.programs.excitation import TARE_DURATION_S, TARE_STEP_NAME, ExciteStep

LOWEST_SWEEP_ANGLE_DEG = 0.0
"""Smallest joint angle of the sweeps [deg]. At smaller joint angles, a thumb can touch the palm."""
HIGHEST_SWEEP_ANGLE_DEG = 32.0
"""Largest joint angle of the sweeps [deg].

At larger joint angles, the fingers of the packaged hands touch the thumb or the palm.
"""
STOP_MARGIN_DEG = 6.0
"""Smallest distance of the sweeps from the joint limits [deg]."""
SIDEWAYS_SWEEP_RANGE_DEG = (-2.0, 12.0)
"""Ends of sweeps that move a digit sideways [deg].

The range of the sideways sweep is small, because neighbouring digits are close.
"""
SWEEP_DURATIONS_S = (0.8, 0.45, 0.45)
"""Durations of the motions from one end of a sweep to the other [s]."""
SWING_AMPLITUDE_DEG = 9.0
"""Largest amplitude of the sinusoidal swing of the joints [deg]."""
SWING_DURATION_S = 3.0
"""Duration of the swing [s]."""
SWING_MIN_FREQUENCY_HZ = 0.7
"""Lowest frequency of the swing [Hz]."""
SWING_MAX_FREQUENCY_HZ = 6.0
"""Highest frequency of the swing [Hz]."""
SWING_TORQUE_FRACTION = 0.25
"""Largest motor torque during the swing, as a fraction of the motor's torque limit."""
STRETCH_TENSION_FRACTION = 0.3
"""Largest tension while a tendon is stretched, as a fraction of ``tension_max_N``.

The tendons that hold the digit open have the largest tension for several seconds. At higher
tensions, the monitor would mistake a motor that makes 30 % less torque than commanded for a wrong
load cell (T04b) or an oscillation (N14b).
"""
SPOOL_PAIR_MIN_TENSION_FRACTION = 0.07
"""Smallest net tension while a spool pair is stretched, as a fraction of ``tension_max_N``."""
CLOSING_TENSION_FRACTION = 0.12
"""Net tension with which spool pairs move their digit to its lower stops, as a fraction of ``tension_max_N``."""
CLOSING_DURATION_S = 2.5
"""Time in which spool pairs move their digit to its lower stops [s].

The control law damps the motion to the lower stops.
"""
OPENING_DURATION_S = 1.5
"""Time in which the digit moves back from its lower stops [s]."""
MAX_TORQUE_RATIO = 0.7
"""Largest joint torque of a stretched closing tendon, as a fraction of the opening torque of the other tendons."""
TAUT_TENSION_RATIO = 1.3
"""Ratio of the tensions that take up the slack to the smallest tensions that balance each other."""
COUNTER_MOTION_FRACTION = 0.5
"""Amplitude of a coordinate that moves against the other coordinates, as a fraction of its full amplitude.

If two joints moved against each other with full amplitude, a tendon that crosses both joints would
not move.
"""
TENSION_RATE_N_PER_S = 250.0
"""Rate at which the tension changes while a tendon is stretched [N/s].

At a rate of 250 N/s, the spool turns fast enough that the direction of the spool's friction is
known.
"""
STRETCH_WAIT_S = 0.06
"""Waiting time after a stretch [s]."""
STRETCH_COUNT = 5
"""Number of times that the tension of each stretched tendon rises and falls, except in spool pairs."""
SPOOL_PAIR_STRETCH_COUNT = 10
"""Number of times that the net tension of the stretched spool pairs of a digit rises and falls.

All pairs are stretched at once.
"""
SPOOL_PAIR_MAX_TENSION_FRACTION = 0.65
"""Largest net tension while a spool pair is stretched, as a fraction of ``tension_max_N``.

If the net tension exceeds twice the pretension, one of the two tendons is slack. The largest net
tension must be well above twice the pretension.
"""


def antagonist_steps(hand: Hand, name: str) -> list[ExciteStep]:
    """Return the steps that excite a digit which tendons both close and open.

    Args:
        hand: description of the hand.
        name: name of the digit.
    """
    digit = DigitModel.from_hand(hand, name)
    low, high = sweep_range(digit)
    high = highest_clear_coordinates(hand, name, low, high)
    middle_angles = 0.5 * (low + high)
    half_range = 0.5 * (high - low)

    def excite_step(
        step_name: str,
        kind: str,
        duration_s: float,
        targets: Array | None = None,
        **other_fields: object,
    ) -> ExciteStep:
        target_values = () if targets is None else tuple(targets.tolist())
        step_fields = {
            "digit": name,
            "name": step_name,
            "kind": kind,
            "duration_s": duration_s,
        } | other_fields
        return ExciteStep.model_validate(step_fields | {"targets": target_values})

    sweep_steps = []
    for signs in _sign_patterns(len(middle_angles)):
        sweep_steps.append(excite_step("approach", "move", 0.4, middle_angles - signs * half_range))
        for duration in SWEEP_DURATIONS_S:
            sweep_steps += [
                excite_step("sweep", "move", duration, middle_angles + side * signs * half_range)
                for side in (1.0, -1.0)
            ]
    amplitudes = tuple(_swing_amplitudes(hand, digit, middle_angles, half_range).tolist())
    swing_step = excite_step(
        "swing",
        "chirp",
        SWING_DURATION_S,
        middle_angles,
        amplitudes=amplitudes,
        low_Hz=SWING_MIN_FREQUENCY_HZ,
        high_Hz=SWING_MAX_FREQUENCY_HZ,
    )
    rest_tension, stretch_ranges = _stretched_tensions(hand, digit)
    pairs = bool(hand.is_pair[digit.tendons].any())
    _, largest = _tension_limits(hand, digit)
    closing_tensions = (
        -CLOSING_TENSION_FRACTION / STRETCH_TENSION_FRACTION * largest
        if pairs
        else stretch_ranges[0][0]
    )
    stretch_steps = []
    for lower, upper in stretch_ranges:
        duration = float(np.abs(upper - lower).max()) / TENSION_RATE_N_PER_S + STRETCH_WAIT_S
        stretch_steps.append(excite_step("close", "tension", 0.5, lower, rate=80.0, held=True))
        for _ in range(SPOOL_PAIR_STRETCH_COUNT if pairs else STRETCH_COUNT):
            for goal in (upper, lower):
                stretch_steps.append(
                    excite_step(
                        "stretch",
                        "tension",
                        duration,
                        goal,
                        rate=TENSION_RATE_N_PER_S,
                        held=True,
                    )
                )
    # Spool pairs have no load cells to tare.
    tare_steps = [] if pairs else [excite_step(TARE_STEP_NAME, "limp", TARE_DURATION_S)]
    return [
        *tare_steps,
        excite_step(
            "taut",
            "tension" if pairs else "taut",
            0.4,
            rest_tension if pairs else _balanced_tensions(hand, digit),
            rate=40.0,
        ),
        *sweep_steps,
        excite_step("approach", "move", 0.4, middle_angles),
        swing_step,
        excite_step("approach", "move", 0.6, low),
        excite_step(
            "close",
            "tension",
            CLOSING_DURATION_S if pairs else 0.8,
            closing_tensions,
            rate=20.0 if pairs else 60.0,
            held=True,
        ),
        *stretch_steps,
        excite_step(
            "open",
            "tension",
            0.4,
            rest_tension if pairs else stretch_ranges[0][0],
            rate=100.0,
            held=True,
        ),
        excite_step("open", "move", OPENING_DURATION_S, low),
        excite_step("rest", "limp", 0.1),
    ]


def sweep_range(digit: DigitModel) -> tuple[Array, Array]:
    """Return the smallest and the largest coordinates (n_c,) in the sweeps of a digit [rad]."""
    lowest_angles, highest_angles = digit.coordinate_limits
    margin = math.radians(STOP_MARGIN_DEG)
    low = np.maximum(lowest_angles + margin, math.radians(LOWEST_SWEEP_ANGLE_DEG))
    high = np.minimum(highest_angles - margin, math.radians(HIGHEST_SWEEP_ANGLE_DEG))
    near_angle, far_angle = np.radians(SIDEWAYS_SWEEP_RANGE_DEG)
    sideways = (
        digit.sideways_coordinates
        & (lowest_angles + margin < near_angle)
        & (highest_angles - margin > far_angle)
    )
    return np.where(sideways, near_angle, low), np.where(sideways, far_angle, high)


def _sign_patterns(coordinate_count: int) -> list[Array]:
    """Return sign patterns for the motion of a digit's coordinates.

    Each pattern has one factor for each coordinate (coordinate_count,).

    In the first pattern, all coordinates move together. In each other pattern, one coordinate moves
    against all other coordinates.
    """
    sign_patterns = [np.ones(coordinate_count)]
    if coordinate_count > 1:
        # With two coordinates, a single pattern with opposite motion is sufficient, because each
        # coordinate moves against the other.
        sign_patterns += [
            np.where(np.arange(coordinate_count) == i, -COUNTER_MOTION_FRACTION, 1.0)
            for i in range(coordinate_count if coordinate_count > 2 else 1)
        ]
    return sign_patterns


def _swing_amplitudes(
    hand: Hand, digit: DigitModel, middle_angles: Array, half_ranges: Array
) -> Array:
    """Return the amplitudes (n_c,) of an oscillation that the motors can produce [rad]."""
    tree = LinkTree.from_hand(hand)
    q = np.clip(np.zeros(len(hand.joints)), hand.joint_limits[0], hand.joint_limits[1])
    q[digit.joints] = digit.coupling @ middle_angles
    mass_matrix = tree.mass_matrix(q)[digit.joints, digit.joints]
    arms = digit.reduced_moment_arms
    inertia = np.abs(digit.coupling.T @ mass_matrix @ digit.coupling).sum(axis=1)
    force = np.abs(digit.torque_to_tension @ digit.joints_to_coordinates.T @ inertia)
    force = force + digit.motor_mass * np.abs(arms).sum(axis=1)
    motors = [hand.motor_of_tendon(tendon) for tendon in digit.tendon_names]
    available_force = SWING_TORQUE_FRACTION * np.array(
        [motor.torque_max_N_m / motor.spool_radius_m for motor in motors]
    )
    max_amplitude = float(
        (available_force / (force * (2.0 * math.pi * SWING_MAX_FREQUENCY_HZ) ** 2)).min()
    )
    return np.minimum(
        np.minimum(math.radians(SWING_AMPLITUDE_DEG), 0.7 * half_ranges), max_amplitude
    )


def _tension_limits(hand: Hand, digit: DigitModel) -> tuple[Array, Array]:
    """Return two limits of each tendon's tension [N]: the tension floor, and the largest tension in a stretch.

    The tension floor is the smallest tension that is ever commanded. Each limit has the shape
    (n_t,).
    """
    tendons = hand.tendon[digit.tendons]
    floor = np.array([tendon.tension_floor_N for tendon in tendons])
    return floor, STRETCH_TENSION_FRACTION * np.array([tendon.tension_max_N for tendon in tendons])


def _balanced_tensions(hand: Hand, digit: DigitModel) -> Array:
    """Return tensions (n_t,) whose joint torques cancel each other [N].

    All returned tensions are above the tension floors.
    """
    floor = np.array([tendon.tension_floor_N for tendon in hand.tendon])
    ceiling = np.array([tendon.tension_max_N for tendon in hand.tendon])
    return (
        TAUT_TENSION_RATIO
        * redundancy_of_hand((digit,), floor, ceiling, hand.is_pair).balance_tension
    )


def _stretched_tensions(hand: Hand, digit: DigitModel) -> tuple[Array, list[tuple[Array, Array]]]:
    """Return the tensions that hold a digit at rest, and the lower and the upper tensions of each stretch [N].

    The tendons are stretched while the digit is pressed against its lower stops.

    All spool pairs of a digit are stretched at the same time. In a digit without spool pairs, all
    tendons that open the digit are stretched at the same time. Then each tendon that closes the
    digit is stretched alone. The torque of the closing tendon stays small enough for the opening
    tendons to hold the digit open.
    """
    floor, largest = _tension_limits(hand, digit)
    if hand.is_pair[digit.tendons].any():
        full_stretch_tension = largest / STRETCH_TENSION_FRACTION
        return np.zeros(len(full_stretch_tension)), [
            (
                -SPOOL_PAIR_MIN_TENSION_FRACTION * full_stretch_tension,
                -SPOOL_PAIR_MAX_TENSION_FRACTION * full_stretch_tension,
            )
        ]
    arms = digit.reduced_moment_arms
    is_opening_tendon = arms.sum(axis=1) < 0.0
    hold = np.where(is_opening_tendon, largest, floor)
    half_tension = np.where(is_opening_tendon, 0.5 * largest, floor)
    stretch_ranges = [(half_tension, hold)]
    for i in np.flatnonzero(~is_opening_tendon).tolist():
        hold_without_tendon = np.where(np.arange(len(hold)) == i, 0.0, hold)
        opening_torque = -(arms.T @ hold_without_tendon)
        closing_arms = np.maximum(arms[i], 0.0)
        max_closing_tension = float(
            (
                MAX_TORQUE_RATIO
                * opening_torque[closing_arms > 0.0]
                / closing_arms[closing_arms > 0.0]
            ).min()
        )
        upper = hold.copy()
        upper[i] = max(min(max_closing_tension, float(largest[i])), float(floor[i]))
        stretch_ranges.append((hold, upper))
    return hold, stretch_ranges
