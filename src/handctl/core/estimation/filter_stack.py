"""Arrays of the tension filter: its states and regimes, the design of a tendon, and all tendons as a single filter."""

import enum
import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

STATES = 7
INPUTS = 2
MEASUREMENTS = 3
X, V, S, W, D, E, O = range(STATES)  # noqa: E741 - the names of the states, as below
"""States of a tendon.

Travel [m] and speed [m/s] at the spool, excursion [m] and rate [m/s], disturbance force on the
motor [N], load-cell error [N], stretch offset [m].
"""


class Regime(enum.IntEnum):
    """Regime of a tendon: the coupling of motor and digit in the filter's model."""

    FREE = 0
    """Taut and free: the digit follows the tendon, and the tension changes no faster than friction reverses."""
    HELD = 1
    """Taut, and the digit rests on an object or on the open stop, of unknown stiffness. The digit hardly moves."""
    SLACK = 2
    """No tension: the motor moves alone, springs hold the digit on the open stop, the load cell shows its error."""


@dataclass(frozen=True, slots=True)
class FilterBlock:
    """Steady-state filter of a tendon in a regime.

    Attributes:
        F: transition over a period, (7, 7).
        B: inputs held over a period, (7, 2).
        H: measurements, (3, 7).
        K: steady-state gain of the update, (7, 3).
        Q: process noise covariance of a period, (7, 7).
        R: variances of encoder and load cell, (2,).
        P: covariance of the prediction in steady state, (7, 7).
        cell_error_observable: True if the load-cell error is observable.
        cell_error_variance: variance of an unobservable load-cell error, a part of
            ``tension_variance`` [N^2].
        tension_row: tension per state, (7,).
        tension_variance: variance of the predicted tension [N^2].
        innovation_information: inverse covariance of encoder and load-cell innovations, (2, 2).
        cell_sigma: standard deviation of the load-cell innovation [N].
    """

    F: Matrix
    B: Matrix
    H: Matrix
    K: Matrix
    Q: Matrix
    R: Matrix
    P: Matrix
    cell_error_observable: bool
    cell_error_variance: float
    tension_row: Matrix
    tension_variance: float
    innovation_information: Matrix
    cell_sigma: float


class Transition(NamedTuple):
    """Transition of all tendons over a period. The 7 N states are the travels of all tendons, then the speeds, ...

    Attributes:
        F: transition of the states, (7N, 7N).
        B: effect of the inputs, (7N, 2N).
    """

    F: Matrix
    B: Matrix


TRANSITION_CACHE_SIZE = 256
"""Number of cached transitions. One of eleven tendons takes 60 kB, and there are 6^11 combinations of kinds."""


@dataclass(frozen=True, slots=True)
class FilterDesign:
    """Filters of all tendons.

    Attributes:
        blocks: ``blocks[tendon][kind]``. The kind is the regime, plus 3 for a filter with added
            noise.
        transition: function from the N kinds, as bytes of int64, to the transition of all tendons.
            It is cached, because kinds change in few ticks.
    """

    blocks: tuple[tuple[FilterBlock, ...], ...]
    transition: "Callable[[bytes], Transition]" = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Make the cache of the transition matrices."""
        object.__setattr__(self, "transition", functools.lru_cache(TRANSITION_CACHE_SIZE)(self._transition))

    @property
    def held_sigma(self) -> Matrix:
        """Return the standard deviation of the tension of each held tendon, (N,) [N]."""
        return np.sqrt([tendon[Regime.HELD].tension_variance for tendon in self.blocks])

    def _transition(self, kinds: bytes) -> Transition:
        in_use = [tendon[kind] for tendon, kind in zip(self.blocks, np.frombuffer(kinds, np.int64), strict=True)]
        return Transition(_stack_blocks([block.F for block in in_use]), _stack_blocks([block.B for block in in_use]))


def _stack_blocks(blocks: list[Matrix]) -> Matrix:
    """Return the matrix of N tendons from a block (rows, columns) of each. The tendon is the inner index of rows and
    columns."""
    n, (rows, columns), each = len(blocks), blocks[0].shape, np.arange(len(blocks))
    # Index (row, tendon, column, tendon): only equal tendons are coupled.
    matrix = np.zeros((rows, n, columns, n))
    matrix[:, each, :, each] = blocks
    return matrix.reshape(rows * n, columns * n)
