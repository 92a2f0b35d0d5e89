"""What a digit does so that its parameters show: within its limits, in about twenty seconds."""

import math

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.programs.excite import ExciteStep

LOW_DEG, HIGH_DEG = 6.0, 32.0
"""Range of free sweeps: clear of the open stop, and short of where the packaged hands' fingers meet thumb or palm."""
SWING_DEG, SWING_LOW_HZ, SWING_HIGH_HZ = 9.0, 0.7, 6.0
PRESS_SHARE = (0.08, 0.15, 0.5)
"""Tension to which a press ends, and between which a digit is pressed, as shares of the most allowed. A motor 30 %
weaker than its file lacks a third of what it is asked for; pressed harder, it is taken for a wrong load cell (T04b)."""
LEAST_N, LIFT_SHARE = 1.1, 0.6
"""A digit on its open stop is stretched between the first, above what counts as slack, and the second, a share of the
tension that lifts it off against springs as in the hand file."""
LEAST_STRETCH_N = 0.5
"""Range of that stretch, at least: less is lost in the load cell's noise."""
STRETCH_S, STRETCHES = 0.9, 4
"""The motor's own friction is more than this tension, and gains may be weak: on quicker ramps the rope's tension
makes a third of its way."""
SWEEP_S = (0.8, 0.3, 0.55, 0.8)


def excitation(hand: Hand, digits: tuple[str, ...]) -> tuple[ExciteStep, ...]:
    """Steps of the named digits, one digit after the other.

    Raises:
        ConfigError: there is no such digit, or its springs are too weak to stretch its tendon on the open stop.
    """
    for name in digits:
        if name not in hand.digit_names:
            raise ConfigError(repr(name), "--digits", "some of " + ", ".join(hand.digit_names))
        if LIFT_SHARE * (tension := lift_off(hand, name)) < LEAST_N + LEAST_STRETCH_N:
            least = (LEAST_N + LEAST_STRETCH_N) / LIFT_SHARE
            what = f"{tension:.2f} N lifts it off its open stop, too little to stretch its tendon there"
            raise ConfigError(
                what, f"digit {name}", f"springs with a preload of {least:.2f} N or more, or other --digits"
            )
    return tuple(step for name in digits for step in _steps(hand, name))


def _steps(hand: Hand, digit: str) -> list[ExciteStep]:
    """Tare, stop, free sweeps slow and fast, a swing of rising frequency, presses against whatever stops it."""
    tendons = hand.tendon[hand.digit_tendons[digit]]
    most = min(tendon.tension_max_N for tendon in tendons)
    floor = max(tendon.tension_floor_N for tendon in tendons)
    low, high = (math.radians(angle) for angle in _range(hand, digit))
    middle, swing = 0.5 * (low + high), math.radians(SWING_DEG)
    lift = LIFT_SHARE * lift_off(hand, digit)
    let_go, soft, hard = (share * most for share in PRESS_SHARE)

    def step(
        name: str, kind: str, duration_s: float, target: float = 0.0, rate: float = 100.0, held: bool = False
    ) -> ExciteStep:
        return ExciteStep.model_validate(
            {"digit": digit, "name": name, "kind": kind, "duration_s": duration_s}
            | {"target": target, "rate": rate, "held": held}
        )

    swing_step = step("swing", "chirp", 2.4, middle)
    swing_step = swing_step.model_copy(update={"amplitude": swing, "low_Hz": SWING_LOW_HZ, "high_Hz": SWING_HIGH_HZ})
    sweeps = [step("sweep", "move", duration, goal) for duration in SWEEP_S for goal in (high, low)]
    presses = [step("press", "tension", 0.22, goal, 250.0, held=True) for _ in range(3) for goal in (hard, soft)]
    stretch = [
        step("stretch", "tension", STRETCH_S, goal, (lift - LEAST_N) / STRETCH_S)
        for _ in range(STRETCHES)
        for goal in (lift, LEAST_N)
    ]
    return [
        step("tare", "limp", 0.5),
        step("taut", "taut", 0.4, floor, 40.0),
        *stretch,
        step("approach", "move", 0.4, low),
        *sweeps,
        step("approach", "move", 0.3, middle),
        swing_step,
        step("approach", "move", 0.3, high),
        step("close", "tension", 0.5, soft, 80.0, held=True),
        *presses,
        step("open", "tension", 0.7, let_go, 60.0, held=True),
        step("open", "move", 0.5, low),
        step("rest", "limp", 0.1),
    ]


def _range(hand: Hand, digit: str) -> tuple[float, float]:
    """Free range of the digit's joints [deg]."""
    known = hand.digit_named(digit)
    least, most = max(known.joint_min_deg), min(known.joint_max_deg)
    return least + LOW_DEG, min(least + HIGH_DEG, most - LOW_DEG)


def lift_off(hand: Hand, digit: str) -> float:
    """Tension that lifts a joint of the digit off its open stop, without friction and weight [N]."""
    known, joints = hand.digit_named(digit), hand.digit_joints[digit]
    arms = abs(hand.moment_arms[hand.digit_tendons[digit], joints]).sum(axis=0)
    preload = zip(known.spring_stiffness_N_m_per_rad, known.spring_preload_rad, arms.tolist(), strict=True)
    return min(float(stiffness * angle / arm) for stiffness, angle, arm in preload if arm > 0.0)
