"""Warnings about a control rate or gains at which a hand can oscillate although the buses can carry all frames."""

import math

from handctl.controller.bus_load import split_motors_over_buses
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.hand.description import Hand

MIN_UNCHECKED_RATE_HZ = 250.0
"""Control rate at and above which the motion loops of a hand are not checked [Hz].

All packaged hands and the hands of ``config init`` run at this rate.
"""
MIN_UNCHECKED_RATE_WITHOUT_CELLS_HZ = 500.0
"""The rate MIN_UNCHECKED_RATE_HZ for a hand with tendons that have neither load cells nor springs to act against [Hz].

Tendons without springs hold each other, and the filter without load cells has a larger phase lag.
In simulation at 250 Hz, the tensions of tendons without springs and load cells oscillated, and the
safety monitor took freely closing digits for torn tendons (fault T01).
"""
FORCE_REDUCTION_FACTOR = 0.95
"""Factor between two values of ``motion.force_N`` that are tried until the gain margin is large enough."""
MIN_TRIED_FORCE_FRACTION = 0.05
"""Smallest fraction of ``motion.force_N`` that is tried."""


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
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB

    name, margin_db = _smallest_gain_margin(hand, gains, rate_hz)
    if margin_db >= MIN_GAIN_MARGIN_DB:
        return []
    buses = split_motors_over_buses(hand, min_unchecked_rate)
    remedy = (
        f"{len(buses)} buses allow {min_unchecked_rate:g} Hz (bus plan --rate {min_unchecked_rate:g})"
        if buses
        else "a faster bus"
    )
    faults = "N14b or T03" if min_unchecked_rate == MIN_UNCHECKED_RATE_HZ else "T01"
    return [
        f"{name}: at {rate_hz:g} Hz, which the buses allow, its motion loop has a gain margin of "
        f"{margin_db:.1f} dB instead of {MIN_GAIN_MARGIN_DB:g} dB, and a run may oscillate and "
        f"end with {faults}; {remedy}"
    ]


def force_warnings(hand: Hand, gains: Gains, rate_hz: float) -> list[str]:
    """Return a warning if the gain margin of a tendon with a spring and without a load cell is too small.

    The filter of a tendon without a load cell has a larger phase lag than the filter of a tendon
    with a load cell. With the default gains, the gain margin of the motion loop of a tendon without
    a load cell can be only 3 dB, even at 500 Hz.

    Args:
        hand: description of the hand.
        gains: gains of a run.
        rate_hz: control rate of a run [Hz].
    """
    # At a lower control rate, ``rate_warnings`` checks the motion loops of all tendons.
    if rate_hz < _min_unchecked_rate(hand) or not _has_springs_without_cells(hand):
        return []
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB

    name, margin_db = _smallest_gain_margin(hand, gains, rate_hz)
    if margin_db >= MIN_GAIN_MARGIN_DB:
        return []
    force = gains.force_weights_of_tendon(name)[0]
    is_tendon_force = force != gains.motion.force_N
    key = f"tendon.{name}.motion_force_N" if is_tendon_force else "motion.force_N"
    largest_force = None if is_tendon_force else _largest_force_with_margin(hand, gains, rate_hz)
    expected = "gains from tune design" if largest_force is None else f"at most {largest_force:g} N"
    return [
        f"{key}: {force:g} N leave the motion loop of {name}, which has no load cell, a gain margin of "
        f"{margin_db:.1f} dB instead of {MIN_GAIN_MARGIN_DB:g} dB at {rate_hz:g} Hz; expected {expected}"
    ]


def _largest_force_with_margin(hand: Hand, gains: Gains, rate_hz: float) -> float | None:
    """Try smaller values of ``motion.force_N``, and return the first value with a sufficient gain margin [N].

    If no tried value has a sufficient margin, return None. The tried values of the force are
    rounded down to two digits.
    """
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB

    force = gains.motion.force_N
    while force > MIN_TRIED_FORCE_FRACTION * gains.motion.force_N:
        unit = 10.0 ** (math.floor(math.log10(force)) - 1)
        rounded_force = float(f"{math.floor(force / unit) * unit:.2g}")
        motion = gains.motion.model_copy(update={"force_N": rounded_force})
        tried_gains = gains.model_copy(update={"motion": motion})
        if _smallest_gain_margin(hand, tried_gains, rate_hz)[1] >= MIN_GAIN_MARGIN_DB:
            return rounded_force
        force *= FORCE_REDUCTION_FACTOR
    return None


def _smallest_gain_margin(hand: Hand, gains: Gains, rate_hz: float) -> tuple[str, float]:
    """Return the tendon whose motion loop has the smallest gain margin, and this margin [dB]."""
    from handctl.tune.loops.linear_models import LoopKind, open_loop
    from handctl.tune.loops.margins import margins_of_loop

    model = HandModel.from_hand(hand, gains, rate_hz)
    margin_by_digit = {
        name: margins_of_loop(open_loop(model, i, LoopKind.MOTION)).gain_db
        for i, name in enumerate(hand.tendon_names)
    }
    return min(margin_by_digit.items(), key=lambda digit_and_margin: digit_and_margin[1])


def _has_tendon_without_cell(hand: Hand, digit: str) -> bool:
    """Return True if a digit has a tendon without a load cell. Spool pairs do not count."""
    has_no_cell = ~hand.has_cell & ~hand.is_pair
    return bool(has_no_cell[hand.digit_tendons[digit]].any())


def _has_springs_without_cells(hand: Hand) -> bool:
    """Return True if a digit with springs has a tendon without a load cell.

    Spool pairs do not count.
    """
    return any(
        digit.has_springs and _has_tendon_without_cell(hand, digit.name) for digit in hand.digit
    )


def _min_unchecked_rate(hand: Hand) -> float:
    """Return the lowest control rate at which the motion loops of a hand need not be checked [Hz]."""
    for digit in hand.digit:
        tendons = hand.digit_tendons[digit.name]
        coordinates = len(digit.joints) if digit.coupling is None else len(digit.coupling[0])
        # A digit with more tendons than coordinates has antagonists instead of springs.
        if tendons.stop - tendons.start > coordinates and _has_tendon_without_cell(
            hand, digit.name
        ):
            return MIN_UNCHECKED_RATE_WITHOUT_CELLS_HZ
    return MIN_UNCHECKED_RATE_HZ
