"""Steps of a position that no rotor and no joint makes: the sample is dropped, and said."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import chosen, only

Vector = NDArray[np.float64]


class Accepted(NamedTuple):
    """Attributes: value: (n,) last accepted [rad], NaN before the first. gap: (n,) ticks since then."""

    value: Vector
    gap: Vector

    @staticmethod
    def initial(n: int) -> "Accepted":
        """Nothing accepted yet."""
        return Accepted(np.full(n, np.nan), np.zeros(n))


def screen(state: Accepted, value: Vector, step_most: Vector) -> tuple[Accepted, Vector]:
    """Drop what cannot be.

    Args:
        state: from the last tick.
        value: (n,) new positions [rad], NaN where missing.
        step_most: (n,) largest step of one tick [rad].

    Returns:
        state, and how far each dropped sample jumped [rad], 0 where none was.
    """
    step, gap = np.abs(value - state.value), state.gap + 1.0
    wrong = step > step_most * gap
    fresh = (value == value) & ~wrong
    return Accepted(chosen(fresh, value, state.value), gap * ~fresh), only(wrong, step)
