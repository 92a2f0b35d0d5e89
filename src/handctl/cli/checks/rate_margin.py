"""Warnings about a motion loop whose gain margin is too small at the control rate or with the gains of a run.

A hand with too small a gain margin can oscillate, even if its buses can carry all frames.
"""

import math

from handctl.controller.bus_load import split_motors_over_buses
from handctl.core.gains.gains import Gains, packaged_gains
from handctl.hand.description import Hand
from handctl.hand.hand_loading import packaged_hands

MIN_UNCHECKED_RATE_HZ = 250.0
"""Control rate at and above which the motion loops of a hand are not checked [Hz].

All packaged hands and the hands of ``config init`` run at this rate.
"""
MIN_UNCHECKED_RATE_WITHOUT_CELLS_HZ = 500.0
"""Value of MIN_UNCHECKED_RATE_HZ for a hand whose tendons have neither load cells nor springs [Hz].

Tendons without springs hold each other, and the filter without load cells has a larger phase lag.
In simulation at 250 Hz, the tensions of tendons without springs and load cells oscillated, and the
safety monitor took freely closing digits for torn tendons (fault T01).
"""


def rate_warnings(hand: Hand, gains: Gains, rate_hz: float) -> list[str]:
    """Return a warning if the gain margin of a tendon's motion loop is too small at a control rate.

    If the load of a bus is high, the control rate must be low. At a low control rate, the tensions
    of fingers with light links can oscillate. If the tensions oscillate, the run ends with an
    oscillation fault (N14b) or an over-tension fault (T03).

    Args:
        hand: description of the hand.
        gains: gains of a run.
        rate_hz: control rate of the run [Hz].
    """
    min_unchecked_rate = _min_unchecked_rate(hand)
    if rate_hz >= min_unchecked_rate:
        return []
    # The compiled core computes the control loops, and is imported only here. The other checks of a
    # hand do not need the compiled core.
    from handctl.tune.loops.default_gains import smallest_gain_margin
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB

    name, margin_db = smallest_gain_margin(hand, gains, rate_hz)
    if margin_db >= MIN_GAIN_MARGIN_DB:
        return []
    buses = split_motors_over_buses(hand, min_unchecked_rate)
    remedy = (
        f"{len(buses)} buses allow {min_unchecked_rate:g} Hz (bus plan --rate {min_unchecked_rate:g})"
        if buses and len(buses) > len(hand.bus)
        else f"a higher bitrate, or other motors on each bus, for {min_unchecked_rate:g} Hz"
    )
    faults = "N14b or T03" if min_unchecked_rate == MIN_UNCHECKED_RATE_HZ else "T01"
    return [
        f"{name}: at {rate_hz:g} Hz, which the buses allow, its motion loop with motion.force_N = "
        f"{gains.force_weights_of_tendon(name)[0]:g} N has a gain margin of {_margin_text(margin_db)} "
        f"instead of {MIN_GAIN_MARGIN_DB:g} dB, and a run may oscillate and end with {faults}; {remedy}"
    ]


def force_warnings(hand: Hand, gains: Gains, rate_hz: float) -> list[str]:
    """Return a warning if the gain margin of a tendon's motion loop is too small with the chosen gains.

    With the default gains of a hand, the gain margin is sufficient where this is possible, see
    ``default_gains``. Gains from a file or from the command line can be too large.

    Args:
        hand: description of the hand.
        gains: gains of a run.
        rate_hz: control rate of a run [Hz].
    """
    is_packaged = hand.name in packaged_hands() and gains == packaged_gains(hand.name)
    # At a lower control rate, ``rate_warnings`` checks the motion loops of all tendons.
    if rate_hz < _min_unchecked_rate(hand) or is_packaged:
        return []
    from handctl.tune.loops.default_gains import largest_force_with_margin, smallest_gain_margin
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB

    name, margin_db = smallest_gain_margin(hand, gains, rate_hz)
    if margin_db >= MIN_GAIN_MARGIN_DB:
        return []
    force = gains.force_weights_of_tendon(name)[0]
    is_tendon_force = force != gains.motion.force_N
    key = f"tendon.{name}.motion_force_N" if is_tendon_force else "motion.force_N"
    largest_force = None if is_tendon_force else largest_force_with_margin(hand, gains, rate_hz)
    expected = "gains from tune design" if largest_force is None else f"at most {largest_force:g} N"
    return [
        f"{key}: {force:g} N leave the motion loop of {name} a gain margin of {_margin_text(margin_db)} "
        f"instead of {MIN_GAIN_MARGIN_DB:g} dB at {rate_hz:g} Hz; expected {expected}"
    ]


def _margin_text(margin_db: float) -> str:
    """Return a gain margin as text. The margin is rounded down, so that 5.97 dB is not shown as 6 dB."""
    return f"{math.floor(10.0 * margin_db) / 10.0:.1f} dB"


def _has_tendon_without_cell(hand: Hand, digit: str) -> bool:
    """Return True if a digit has a tendon without a load cell. Spool pairs do not count."""
    has_no_cell = ~hand.has_cell & ~hand.is_pair
    return bool(has_no_cell[hand.digit_tendons[digit]].any())


def _min_unchecked_rate(hand: Hand) -> float:
    """Return the lowest control rate at which the motion loops of a hand need no check [Hz]."""
    for digit in hand.digit:
        tendons = hand.digit_tendons[digit.name]
        coordinates = len(digit.joints) if digit.coupling is None else len(digit.coupling[0])
        # A digit with more tendons than coordinates has antagonists instead of springs.
        if tendons.stop - tendons.start > coordinates and _has_tendon_without_cell(
            hand, digit.name
        ):
            return MIN_UNCHECKED_RATE_WITHOUT_CELLS_HZ
    return MIN_UNCHECKED_RATE_HZ
