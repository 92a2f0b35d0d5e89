"""Warning about a control rate at which a hand may oscillate although the buses can carry all frames."""

from handctl.controller.bus_load import split_motors_over_buses
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.hand.description import Hand

LOWEST_UNCHECKED_RATE_HZ = 250.0
"""Control rate at and above which the loops of a hand are not checked [Hz].

All packaged hands and the hands of ``config init`` run at this rate.
"""
LOWEST_UNCHECKED_WITHOUT_CELLS_HZ = 500.0
"""The same rate for a hand with tendons that have neither load cells nor springs to act against [Hz].

Such tendons hold each other, and the filter without load cells has a larger phase lag. At 250 Hz, their tensions
oscillated in simulation, and the freely closing digits were taken for torn tendons (fault T01).
"""


def rate_warnings(hand: Hand, gains: Gains, rate_hz: float) -> list[str]:
    """Return a warning if the gain margin of a tendon's motion loop is too small at a control rate.

    If the load of a bus is high, the control rate must be low. At a low control rate, the tensions
    of fingers with light links may oscillate. The run then ends with an oscillation fault (N14b) or
    an over-tension fault (T03).

    Args:
        hand: description of the hand.
        gains: gains with which the run would be controlled.
        rate_hz: control rate of the run [Hz].
    """
    unchecked_hz = _lowest_unchecked_rate(hand)
    if rate_hz >= unchecked_hz:
        return []
    # The compiled core computes the control loops, and is imported only here. The other checks of a
    # hand do not need the compiled core.
    from handctl.tune.loops.linear import LoopKind, open_loop
    from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB, margins_of_loop

    model = HandModel.from_hand(hand, gains, rate_hz)
    found = {
        name: margins_of_loop(open_loop(model, i, LoopKind.MOTION))
        for i, name in enumerate(hand.tendon_names)
    }
    name, worst = min(found.items(), key=lambda item: item[1].gain_db)
    if worst.gain_db >= MIN_GAIN_MARGIN_DB:
        return []
    buses = split_motors_over_buses(hand, unchecked_hz)
    remedy = (
        f"{len(buses)} buses allow {unchecked_hz:g} Hz (bus plan --rate {unchecked_hz:g})"
        if buses
        else "a faster bus"
    )
    faults = "N14b or T03" if unchecked_hz == LOWEST_UNCHECKED_RATE_HZ else "T01"
    return [
        f"{name}: at {rate_hz:g} Hz, which the buses allow, its motion loop has a gain margin of "
        f"{worst.gain_db:.1f} dB instead of {MIN_GAIN_MARGIN_DB:g} dB, and a run may oscillate and "
        f"end with {faults}; {remedy}"
    ]


def _lowest_unchecked_rate(hand: Hand) -> float:
    """Return the lowest control rate at which the loops of a hand need not be checked [Hz]."""
    blind = ~hand.has_cell & ~hand.is_pair
    for digit in hand.digit:
        tendons = hand.digit_tendons[digit.name]
        coordinates = len(digit.joints) if digit.coupling is None else len(digit.coupling[0])
        # A digit with more tendons than coordinates has antagonists instead of springs.
        if tendons.stop - tendons.start > coordinates and blind[tendons].any():
            return LOWEST_UNCHECKED_WITHOUT_CELLS_HZ
    return LOWEST_UNCHECKED_RATE_HZ
