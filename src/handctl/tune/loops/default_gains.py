"""Default gains of a hand: the packaged gains, with smaller motor forces for a sufficient gain margin.

The packaged ``motion.force_N`` was chosen for the packaged hands. Another hand can oscillate with
the packaged force, for example because of light motors, small pulleys or missing load cells. If a
digit would oscillate, its default force is the largest force with which every motion loop of the
digit has the gain margin ``MIN_GAIN_MARGIN_DB``.
"""

import math
from collections.abc import Callable, Iterable
from functools import cache, partial

from handctl.core.gains.gains import Gains, TendonForces, packaged_gains
from handctl.core.hand_model import HandModel
from handctl.hand.description import Hand
from handctl.hand.hand_loading import packaged_hands
from handctl.tune.loops.linear_models import LoopKind, open_loop
from handctl.tune.loops.margins import MIN_GAIN_MARGIN_DB, margins_of_loop

MIN_PACKAGED_MARGIN_DB = 3.0
"""Gain margin above which a digit with return springs keeps the packaged force [dB].

In simulation, hands with a gain margin of 3.5 dB did not oscillate. With a smaller force, their
tendons were slack for longer while the hand opened, and 2 of 4 runs ended with N06b. A digit without
springs keeps the packaged force only with the gain margin ``MIN_GAIN_MARGIN_DB``: antagonistic
tendons with load cells and a gain margin of 5.1 dB oscillated (N14b).
"""
FORCE_REDUCTION_FACTOR = 0.95
"""Factor between two values of ``motion.force_N`` that are candidates for the default."""
MIN_FORCE_FRACTION = 0.04
"""Smallest candidate, as a fraction of the packaged ``motion.force_N``.

With a smaller force, a digit of four joints did not follow its motion (N04) in one of three runs.
"""


def default_gains(hand: Hand, rate_hz: float) -> Gains:
    """Return the gains of a hand for which no gains file exists.

    A packaged hand keeps its packaged gains. In a hand that is not packaged, a digit keeps the
    packaged motor force (``motion.force_N``) if its motion loops have a sufficient gain margin, see
    ``MIN_PACKAGED_MARGIN_DB``. A digit also keeps the packaged motor force if no smaller force
    leads to a sufficient gain margin. ``handctl config check`` warns about digits without a
    sufficient gain margin. For all other digits, the force is reduced. The largest force of all
    digits is ``motion.force_N``, and tendons of digits with a smaller force get a force of their
    own.

    Args:
        hand: description of the hand.
        rate_hz: control rate of the run [Hz].
    """
    gains = packaged_gains(hand.name)
    if hand.name in packaged_hands():
        return gains
    force_by_digit = _default_forces(hand, gains, rate_hz)
    common_force = max(force_by_digit.values())
    tendon_forces = tuple(
        TendonForces(name=hand.tendon_names[tendon], motion_force_N=force_by_digit[digit])
        for digit, tendons in hand.digit_tendons.items()
        for tendon in range(tendons.start, tendons.stop)
        if force_by_digit[digit] < common_force
    )
    return _gains_with_force(gains, common_force).model_copy(update={"tendon": tendon_forces})


def _default_forces(hand: Hand, gains: Gains, rate_hz: float) -> dict[str, float]:
    """Return the default motor force of each digit [N]."""
    candidates = _force_candidates(gains)

    @cache
    def candidate_model(index: int) -> HandModel:
        return HandModel.from_hand(hand, _gains_with_force(gains, candidates[index]), rate_hz)

    def has_margin(tendons: Iterable[int], margin_db: float, index: int) -> bool:
        return all(_gain_margin(candidate_model(index), tendon) >= margin_db for tendon in tendons)

    force_by_digit: dict[str, float] = {}
    for digit in hand.digit:
        tendons = hand.digit_tendons[digit.name]
        indices = range(tendons.start, tendons.stop)
        margin_db = MIN_PACKAGED_MARGIN_DB if digit.has_springs else MIN_GAIN_MARGIN_DB
        best_index: int | None = 0
        if not has_margin(indices, margin_db, 0):
            best_index = _first_with_margin(
                len(candidates), partial(has_margin, indices, MIN_GAIN_MARGIN_DB)
            )
        force_by_digit[digit.name] = candidates[best_index or 0]
    return force_by_digit


def _first_with_margin(candidate_count: int, has_margin: Callable[[int], bool]) -> int | None:
    """Return the index of the first candidate with a sufficient margin, or None if the last has none.

    Each candidate is a smaller force than the candidate before, and has a larger margin. Therefore
    the function finds the first sufficient candidate by bisection.

    Args:
        candidate_count: number of candidates. The first candidate has no sufficient margin.
        has_margin: function that returns True if the candidate with an index has a sufficient margin.
    """
    low, high = 0, candidate_count - 1
    if not has_margin(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if has_margin(middle) else (middle, high)
    return high


def _force_candidates(gains: Gains) -> list[float]:
    """Return candidates for ``motion.force_N`` [N], from the value in the given gains downwards.

    All candidates except the first are rounded down to two digits.
    """
    first_force = gains.motion.force_N
    step_count = math.ceil(math.log(MIN_FORCE_FRACTION) / math.log(FORCE_REDUCTION_FACTOR))
    smaller_forces = [
        _rounded_down(first_force * FORCE_REDUCTION_FACTOR**step)
        for step in range(1, step_count + 1)
    ]
    return [first_force, *smaller_forces]


def largest_force_with_margin(hand: Hand, gains: Gains, rate_hz: float) -> float | None:
    """Return the largest ``motion.force_N`` with which every motion loop has the gain margin [N].

    The result is at most the force of the given gains. If no tested force gives the gain margin,
    the result is None. Tested forces below the force of the given gains are rounded down to two
    significant digits.

    Args:
        hand: description of the hand.
        gains: gains whose ``motion.force_N`` is replaced.
        rate_hz: control rate of the run [Hz].
    """
    candidates = _force_candidates(gains)
    tendons = list(range(len(hand.tendon)))

    def has_margin(index: int) -> bool:
        """Return True if every motion loop has the gain margin with the candidate force ``candidates[index]``."""
        model = HandModel.from_hand(hand, _gains_with_force(gains, candidates[index]), rate_hz)
        for tendon in tendons:
            if _gain_margin(model, tendon) < MIN_GAIN_MARGIN_DB:
                # The loop with the smallest margin usually fails with the next candidate, too, so
                # that it is checked first.
                tendons.remove(tendon)
                tendons.insert(0, tendon)
                return False
        return True

    if has_margin(0):
        return candidates[0]
    index = _first_with_margin(len(candidates), has_margin)
    return None if index is None else candidates[index]


def smallest_gain_margin(hand: Hand, gains: Gains, rate_hz: float) -> tuple[str, float]:
    """Return the tendon whose motion loop has the smallest gain margin, and this margin [dB].

    Args:
        hand: description of the hand.
        gains: gains of the run.
        rate_hz: control rate of the run [Hz].
    """
    model = HandModel.from_hand(hand, gains, rate_hz)
    margin_of_tendon = {name: _gain_margin(model, i) for i, name in enumerate(hand.tendon_names)}
    return min(margin_of_tendon.items(), key=lambda name_and_margin: name_and_margin[1])


def _gain_margin(model: HandModel, tendon: int) -> float:
    """Return the gain margin of the motion loop of a tendon [dB]."""
    return margins_of_loop(open_loop(model, tendon, LoopKind.MOTION)).gain_db


def _rounded_down(force: float) -> float:
    """Return a force, rounded down to two digits [N]."""
    unit = 10.0 ** (math.floor(math.log10(force)) - 1)
    return float(f"{math.floor(force / unit) * unit:.2g}")


def _gains_with_force(gains: Gains, force: float) -> Gains:
    """Return the given gains with ``motion.force_N`` replaced by a force [N]."""
    return gains.model_copy(update={"motion": gains.motion.model_copy(update={"force_N": force})})
