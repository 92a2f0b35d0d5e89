"""Steps of a position that no rotor and no joint makes: the sample is dropped, and said."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import chosen, nothing, only, zeros

Vector = NDArray[np.float64]


class Accepted(NamedTuple):
    """What was accepted last.

    Attributes:
        value: (n,) [rad]; NaN before the first.
        gap: (n,) ticks by which it may be older than the last one: those since then, and those that were missed before
            it came, since it may answer a question of before them.
        dropped: (n,) readings that were dropped in a row; a missing one is none.
    """

    value: Vector
    gap: Vector
    dropped: Vector

    @staticmethod
    def initial(n: int) -> "Accepted":
        """Nothing accepted yet."""
        return Accepted(nothing(n), zeros(n), zeros(n))


def screen(state: Accepted, value: Vector, step_most: Vector, missed: int = 0) -> tuple[Accepted, Vector | None]:
    """Drop what cannot be.

    Args:
        state: from the last tick.
        value: (n,) new positions [rad], NaN where missing.
        step_most: (n,) largest step in a period [rad].
        missed: ticks that were skipped before this one: what moves went on meanwhile.

    Returns:
        state, and how far each dropped sample jumped [rad], 0 where none was; None if none was at all.
    """
    step, late = np.abs(value - state.value), zeros(len(value)) + missed
    if np.count_nonzero(step <= step_most) == len(step):  # nearly always: nothing is missing, nothing jumps
        return Accepted(value, late, zeros(len(value))), None
    gap = state.gap + (1.0 + missed)
    wrong = step > step_most * gap
    fresh = (value == value) & ~wrong
    jumped = only(wrong, step) if np.count_nonzero(wrong) else None
    dropped = (state.dropped + wrong) * ~fresh
    return Accepted(chosen(fresh, value, state.value), chosen(fresh, late, gap), dropped), jumped


def unread(state: Accepted, missed: int = 0) -> Accepted:
    """One tick in which nothing was measured; ``missed``: ticks that were skipped before it."""
    return state._replace(gap=state.gap + (1.0 + missed))
