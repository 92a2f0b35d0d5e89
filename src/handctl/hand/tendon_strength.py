"""Comparison of the force of a runaway drive with the strength of its tendon.

A runaway drive is a drive that makes its largest torque without a command. The tendon tension
reaches its peak 5 to 15 ms after the motor current rises. No host can react within 15 ms. Only the
current limit inside the drive protects the tendon. If a constant force F accelerates a rotor from
rest against an elastic tendon, the tension overshoots to 2 F.
"""

from collections.abc import Iterable

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.file.error_text import lines_by_text
from handctl.hand.moment_arms import moment_arms_at

MIN_STRENGTH_RATIO = 1.5
"""Required ratio of a tendon's ``rated_breaking_force_N`` to the peak tension during a runaway of its drive."""
CHECKED_POSTURE_COUNT = 11
"""Number of postures of a digit in which the largest absolute moment arms are searched."""
RUNAWAY_OVERSHOOT = 2.0
"""Ratio of the peak tension of a tendon to the constant force that accelerates the rotor.

The rotor starts at rest, and the elastic tendon is slack at the start and has no damping.
"""


def runaway_tension(force: float) -> float:
    """Return the peak tension [N] when a drive at rest runs away and pulls the tendon with a constant ``force`` [N]."""
    return RUNAWAY_OVERSHOOT * force


def largest_safe_force(breaking_force: float) -> float:
    """Return the largest drive force [N] that is safe for a tendon with the given breaking force [N].

    At the largest safe force, the ratio of breaking force to peak tension is
    ``MIN_STRENGTH_RATIO``.
    """
    return breaking_force / (RUNAWAY_OVERSHOOT * MIN_STRENGTH_RATIO)


def strength_warnings(hand: Hand) -> tuple[str, ...]:
    """Return a line of text for each tendon or joint whose strength margin is too small or unknown.

    If several tendons or joints have the same text, the text appears in a single line.
    """
    warnings_by_tendon: list[tuple[str, str]] = []
    for tendon in hand.tendon:
        motor = hand.motor_of_tendon(tendon.name)
        breaking_force = tendon.rated_breaking_force_N
        peak = motor.torque_peak_N_m / motor.spool_radius_m
        for key, force in (("drive_limit_N", tendon.drive_limit_N), ("torque_peak_N_m", peak)):
            if breaking_force < MIN_STRENGTH_RATIO * runaway_tension(force):
                text = _runaway_text(key, force, breaking_force, motor.spool_radius_m)
                warnings_by_tendon.append((tendon.name, text))
    for key, is_prismatic in (("joint_rated_torque_N_m", False), ("joint_rated_force_N", True)):
        text = f"{key} is missing: the strength of the joints in a runaway is unknown"
        warnings_by_tendon += [
            (digit.name, text)
            for digit in hand.digit
            if is_prismatic in digit.is_prismatic and getattr(digit, key) is None
        ]
    for digit in hand.digit:
        for joint, torque, rated_load in _joint_loads(hand, digit.name):
            if rated_load < MIN_STRENGTH_RATIO * torque:
                unit = "N" if hand.is_prismatic[hand.joints.index(joint)] else "N m"
                load = f"{torque:.3g} {unit}, and {rated_load:g} {unit} is its rating"
                text = f"a runaway at torque_peak_N_m loads it with {load}"
                warnings_by_tendon.append((joint, text))
    return lines_by_text(warnings_by_tendon)


def _runaway_text(key: str, force: float, breaking_force: float, spool_radius: float) -> str:
    """Return a text about a runaway drive with a given force, and about the torque limit that the drive needs."""
    peak = runaway_tension(force)
    safe_force = largest_safe_force(breaking_force)
    factor = breaking_force / peak
    return (
        f"{key} ({force:g} N at the tendon) makes {peak:g} N in a runaway. The strength of {breaking_force:g} N is "
        f"{factor:.2f} times this tension; expected a factor of {MIN_STRENGTH_RATIO:g}: "
        f"limit the drive to {safe_force:.0f} N = {safe_force * spool_radius:.3g} N m"
    )


def _joint_loads(hand: Hand, digit: str) -> Iterable[tuple[str, float, float]]:
    """Yield three values for each joint of a digit: name, torque during a runaway, and rated torque [N m or N].

    For a digit without rated torques, the function yields nothing.
    """
    digit_section = hand.digit_named(digit)
    rated_loads = digit_section.rated_loads
    if rated_loads is None:
        return
    tendons = hand.digit_tendons[digit]
    joints = hand.digit_joints[digit]
    motors = [hand.motor_of_tendon(tendon.name) for tendon in hand.tendon[tendons]]
    peak_loads = np.array(
        [runaway_tension(motor.torque_peak_N_m / motor.spool_radius_m) for motor in motors]
    )
    limits = hand.joint_limits[:, joints]
    arms = hand.moment_arms[tendons, joints]
    if hand.has_varying_arm[tendons].any():
        postures = np.linspace(limits[0], limits[1], CHECKED_POSTURE_COUNT)
        arms = np.abs(moment_arms_at(hand.arm_polynomials[tendons, joints], limits, postures)).max(
            axis=0
        )
    torques = np.abs(arms).T @ peak_loads
    yield from zip(digit_section.joints, torques.tolist(), rated_loads, strict=True)
