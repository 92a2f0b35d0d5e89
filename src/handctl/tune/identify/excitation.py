"""Excitation of a digit, from which its parameters are identified.

The motion of the digit stays within the joint limits. The excitation takes about twenty seconds per
digit.
"""

import math

import numpy as np

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.programs.clear_range import highest_clear_coordinates
from handctl.programs.excitation import TARE_DURATION_S, TARE_STEP_NAME, ExciteStep
from handctl.tune.identify.excitation_antagonists import antagonist_steps

SWEEP_MARGIN_DEG = 6.0
"""Smallest distance of free sweeps from both ends of the joints' ranges [deg]."""
SWEEP_TOP_DEG = 32.0
"""Upper end of free sweeps, as a joint angle from the open stop [deg].

At larger joint angles, the fingers of the hand jamia touch the thumb or the palm. If a digit touches
another digit at a smaller angle, its sweeps end before the contact.
"""
MIN_SWEEP_DEG = 5.0
"""Smallest range of the free sweeps from which the parameters can be identified [deg]."""
SWING_AMPLITUDE_DEG = 9.0
"""Largest amplitude of the sinusoidal swing of the joints [deg]."""
SWING_RANGE_FRACTION = 0.35
"""Largest amplitude of the swing, as a fraction of the range of the sweeps."""
SWING_MIN_FREQUENCY_HZ = 0.7
"""Lowest frequency of the swing [Hz]."""
SWING_MAX_FREQUENCY_HZ = 6.0
"""Highest frequency of the swing [Hz]."""
PRESS_TENSION_FRACTIONS = (0.08, 0.15, 0.5)
"""Three tensions of the presses, as fractions of the largest tension of the tendon.

The first tension is the tension after the presses against an obstacle. The other two tensions are
the lower and the upper tension of a press.

A motor that is 30 % weaker than in the hand file reaches only two thirds of the commanded tension.
With a motor that is 30 % too weak, the monitor would report a wrong load cell (T04b) at higher
tensions.
"""
MIN_TENSION_N = 1.1
"""Lower tension when a tendon is stretched while its digit rests on the open stop [N]."""
STRETCH_UPPER_FRACTION = 0.6
"""Upper tension of a stretch, as a fraction of the tension at which the digit leaves its open stop.

The tension at which the digit leaves its stop is calculated with the springs of the hand file.
"""
MIN_STRETCH_RANGE_N = 0.5
"""Smallest difference between the upper and the lower tension of a stretch [N].

The noise of the load cell would hide a smaller difference of the tensions.
"""
STRETCH_DURATION_S = 0.9
"""Duration of one rise or one fall of the tension in a stretch [s].

The friction of the motor is larger than the tension, and the gains can be low. On faster ramps of
the commanded tension, the tension would change by only a third of the commanded range.
"""
STRETCH_COUNT = 4
"""Number of times that the tension of a stretched tendon rises and falls."""
SWEEP_DURATIONS_S = (0.8, 0.3, 0.55, 0.8)
"""Durations of the free sweeps [s]."""


def excitation_steps(hand: Hand, digits: tuple[str, ...]) -> tuple[ExciteStep, ...]:
    """Return the steps that excite the named digits, one after the other.

    Raises:
        ConfigError: a digit does not exist or has no load cells, or its springs are too weak to
            hold it at the open stop while the tendon is stretched.
    """
    check_identifiable(hand, digits)
    for name in digits:
        if not hand.digit_named(name).has_springs:
            continue
        if (
            STRETCH_UPPER_FRACTION * (tension := lift_off_tension(hand, name))
            < MIN_TENSION_N + MIN_STRETCH_RANGE_N
        ):
            min_preload = (MIN_TENSION_N + MIN_STRETCH_RANGE_N) / STRETCH_UPPER_FRACTION
            problem = f"the digit leaves its open stop at {tension:.2f} N, too low a tension to stretch the tendon"
            raise ConfigError(
                problem,
                f"digit {name}",
                f"springs with a preload of {min_preload:.2f} N or more, or other --digits",
            )
    return tuple(
        step
        for name in digits
        for step in (
            _digit_steps(hand, name)
            if hand.digit_named(name).has_springs
            else antagonist_steps(hand, name)
        )
    )


def identifiable_digits(hand: Hand) -> tuple[str, ...]:
    """Return the names of the digits whose parameters can be identified."""
    return tuple(name for name in hand.digit_names if not unidentifiable_reason(hand, name))


def unidentifiable_reason(hand: Hand, digit: str) -> str:
    """Return the reason why the parameters of a digit cannot be identified.

    If the parameters can be identified, the text is empty. All tendons of the digit must have load
    cells. Spool pairs need none.
    """
    if any(hand.digit_named(digit).is_prismatic):
        return "a prismatic joint, which is not identified yet"
    tendons = hand.digit_tendons[digit]
    has_known_force = hand.has_cell[tendons] | hand.is_pair[tendons]
    names_without_cell = [
        tendon.name
        for tendon, is_known in zip(hand.tendon[tendons], has_known_force, strict=True)
        if not is_known
    ]
    return f"no load cell on {', '.join(names_without_cell)}" if names_without_cell else ""


def check_identifiable(hand: Hand, digits: tuple[str, ...]) -> None:
    """Check that the named digits exist, and that their parameters can be identified.

    Raises:
        ConfigError: a digit does not exist, lacks a load cell, or has a prismatic joint.
    """
    for name in digits:
        if name not in hand.digit_names:
            raise ConfigError(repr(name), "--digits", "some of " + ", ".join(hand.digit_names))
        reason = unidentifiable_reason(hand, name)
        if not reason:
            continue
        possible_digits = identifiable_digits(hand)
        expected = (
            f"only digits that can be identified: --digits {' '.join(possible_digits)}"
            if possible_digits
            else "load cells on all tendons of a digit, or spool pairs, and only hinges"
        )
        raise ConfigError(reason, f"digit {name}", expected)


def _digit_steps(hand: Hand, digit: str) -> list[ExciteStep]:
    """Return the excitation steps of a digit.

    The steps are a tare, stretches, slow and fast sweeps, a swing, and presses against an obstacle.
    """
    tendons = hand.tendon[hand.digit_tendons[digit]]
    max_tension = min(tendon.tension_max_N for tendon in tendons)
    floor = max(tendon.tension_floor_N for tendon in tendons)
    low, high = _sweep_range(hand, digit)
    middle_angle = 0.5 * (low + high)
    swing_amplitude = min(math.radians(SWING_AMPLITUDE_DEG), SWING_RANGE_FRACTION * (high - low))
    upper_stretch_tension = STRETCH_UPPER_FRACTION * lift_off_tension(hand, digit)
    released_tension, medium_tension, high_tension = (
        fraction * max_tension for fraction in PRESS_TENSION_FRACTIONS
    )

    def excite_step(
        name: str,
        kind: str,
        duration_s: float,
        target: float = 0.0,
        rate: float = 100.0,
        is_held: bool = False,
    ) -> ExciteStep:
        return ExciteStep.model_validate(
            {"digit": digit, "name": name, "kind": kind, "duration_s": duration_s}
            | {"target": target, "rate": rate, "held": is_held}
        )

    swing_step = excite_step("swing", "chirp", 2.4, middle_angle)
    swing_step = swing_step.model_copy(
        update={
            "amplitude": swing_amplitude,
            "low_Hz": SWING_MIN_FREQUENCY_HZ,
            "high_Hz": SWING_MAX_FREQUENCY_HZ,
        }
    )
    sweep_steps = [
        excite_step("sweep", "move", duration, goal)
        for duration in SWEEP_DURATIONS_S
        for goal in (high, low)
    ]
    press_steps = [
        excite_step("press", "tension", 0.22, goal, 250.0, is_held=True)
        for _ in range(3)
        for goal in (high_tension, medium_tension)
    ]
    stretch = [
        excite_step(
            "stretch",
            "tension",
            STRETCH_DURATION_S,
            goal,
            (upper_stretch_tension - MIN_TENSION_N) / STRETCH_DURATION_S,
        )
        for _ in range(STRETCH_COUNT)
        for goal in (upper_stretch_tension, MIN_TENSION_N)
    ]
    return [
        excite_step(TARE_STEP_NAME, "limp", TARE_DURATION_S),
        excite_step("taut", "taut", 0.4, floor, 40.0),
        *stretch,
        excite_step("approach", "move", 0.4, low),
        *sweep_steps,
        excite_step("approach", "move", 0.3, middle_angle),
        swing_step,
        excite_step("approach", "move", 0.3, high),
        excite_step("close", "tension", 0.5, medium_tension, 80.0, is_held=True),
        *press_steps,
        excite_step("open", "tension", 0.7, released_tension, 60.0, is_held=True),
        excite_step("open", "move", 0.5, low),
        excite_step("rest", "limp", 0.1),
    ]


def _sweep_range(hand: Hand, digit: str) -> tuple[float, float]:
    """Return the smallest and the largest coordinate in the free sweeps of a digit [rad].

    Raises:
        ConfigError: the digit touches another digit when it is almost open.
    """
    digit_file = hand.digit_named(digit)
    lower = max(digit_file.joint_min_deg)
    upper = min(digit_file.joint_max_deg)
    low = math.radians(lower + SWEEP_MARGIN_DEG)
    high = math.radians(min(lower + SWEEP_TOP_DEG, upper - SWEEP_MARGIN_DEG))
    coordinate_count = DigitModel.from_hand(hand, digit).coupling.shape[1]
    high = float(
        highest_clear_coordinates(
            hand, digit, np.full(coordinate_count, low), np.full(coordinate_count, high)
        )[0]
    )
    if high - low < math.radians(MIN_SWEEP_DEG):
        problem = f"touches another digit at {math.degrees(high):.0f} deg"
        raise ConfigError(
            problem,
            f"digit {digit}",
            f"at least {MIN_SWEEP_DEG:g} deg of free motion, or other --digits",
        )
    return low, high


def lift_off_tension(hand: Hand, digit: str) -> float:
    """Return the tension at which the first joint of a digit leaves its open stop [N].

    The calculation of the tension neglects the friction and the weight.
    """
    digit_file = hand.digit_named(digit)
    model = DigitModel.from_hand(hand, digit)
    moment_arms = abs(model.moment_arms_at(model.joint_min)).sum(axis=0)
    preload = zip(
        digit_file.spring_stiffness_N_m_per_rad,
        digit_file.spring_preload_rad,
        moment_arms.tolist(),
        strict=True,
    )
    # When a joint leaves its open stop, the torque of its spring equals the tension times the
    # moment arm (virtual work).
    return min(float(stiffness * angle / arm) for stiffness, angle, arm in preload if arm > 0.0)
