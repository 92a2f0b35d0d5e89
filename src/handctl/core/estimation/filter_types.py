"""Types of the tension filter: states and regimes of a tendon, and filter designs of all tendons."""

import enum
import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

STATE_COUNT = 7
INPUT_COUNT = 2
MEASUREMENT_COUNT = 3
X, V, S, W, D, E, O = range(STATE_COUNT)  # noqa: E741 - the names of the states, as below
"""States of a tendon in the tension filter.

The states are travel [m] and speed [m/s] at the spool, excursion [m] and its rate [m/s],
disturbance force on the motor [N], load-cell error [N], stretch offset [m].
"""


class TendonRegime(enum.IntEnum):
    """Regime of a tendon: free, held or slack.

    In each regime, the tendon connects motor and digit in a different way.
    """

    FREE = 0
    """The tendon is taut, and the digit follows it freely.

    The tension of a free tendon changes slowly. The fastest change is the change of friction when
    the digit reverses its motion.
    """
    HELD = 1
    """The tendon is taut.

    The digit rests on an object, or on its stop at full opening. The digit hardly moves, and the
    stiffness of the contact is unknown.
    """
    SLACK = 2
    """The tendon is slack.

    The motor moves alone, springs hold the digit open, and the load cell measures only its own
    error.
    """


FREE_REGIME = int(TendonRegime.FREE)
HELD_REGIME = int(TendonRegime.HELD)
SLACK_REGIME = int(TendonRegime.SLACK)
"""Values of ``TendonRegime``, for compiled code."""


@dataclass(frozen=True, slots=True)
class FilterBlock:
    """Kalman filter with constant gains for one tendon in one regime.

    Attributes:
        F: (7, 7) transition of the states over a period.
        B: (7, 2) effect of the inputs on the states over a period in which the inputs are constant.
        H: (3, 7) expected measurements per unit of each state.
        K: steady-state gain of the update, (7, 3).
        Q: (7, 7) covariance of the process noise over a period.
        R: (2,) variances of encoder and load cell.
        P: (7, 7) constant covariance of the predicted states.
        is_cell_error_observable: True if the measurements distinguish a load-cell error from tension.
        cell_error_variance: part of ``tension_variance`` that an unobservable load-cell error
            causes [N^2].
        tension_row: (7,) tension per unit of each state.
        tension_variance: variance of the predicted tension [N^2].
        innovation_information: (2, 2) inverse covariance of the innovations of encoder and load
            cell.
        cell_sigma: standard deviation of the innovation of the load cell [N].
    """

    F: Matrix
    B: Matrix
    H: Matrix
    K: Matrix
    Q: Matrix
    R: Matrix
    P: Matrix
    is_cell_error_observable: bool
    cell_error_variance: float
    tension_row: Matrix
    tension_variance: float
    innovation_information: Matrix
    cell_sigma: float


class StateTransition(NamedTuple):
    """Transition of the states of all tendons over a period.

    For N tendons there are 7 N states. The first N states are the travels of the tendons, the next
    N states are the speeds, and so on.

    Attributes:
        F: (7N, 7N) transition of the states.
        B: (7N, 2N) effect of the inputs on the states.
    """

    F: Matrix
    B: Matrix


TRANSITION_CACHE_SIZE = 256
"""Largest number of ``StateTransition`` objects in the cache.

The ``StateTransition`` of a hand with eleven tendons takes 60 kB of memory, and the tendons of the
hand have 6^11 combinations of design kinds.
"""


@dataclass(frozen=True, slots=True)
class FilterDesign:
    """Filters of all tendons. Each tendon has one filter for each kind of design.

    A kind of design is a regime (free, held or slack) with or without added process noise.

    Attributes:
        blocks: filter of each tendon and each kind of design, ``blocks[tendon][kind]``. The index
            of a kind is the value of the regime, plus 3 for a filter with added process noise.
        transition: function that returns the ``StateTransition`` of all tendons. The argument of
            ``transition`` contains the kinds of design of the N tendons, as the bytes of int64
            numbers. The results of ``transition`` are cached, because the kinds of design rarely
            change.
    """

    blocks: tuple[tuple[FilterBlock, ...], ...]
    transition: "Callable[[bytes], StateTransition]" = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Create the cache for the transition matrices."""
        object.__setattr__(
            self, "transition", functools.lru_cache(TRANSITION_CACHE_SIZE)(self._stacked_transition)
        )

    @property
    def held_tension_sigma(self) -> Matrix:
        """Return the standard deviation of each tendon's tension in the regime ``HELD`` (N,) [N]."""
        return np.sqrt([tendon[TendonRegime.HELD].tension_variance for tendon in self.blocks])

    def _stacked_transition(self, kinds: bytes) -> StateTransition:
        selected_blocks = [
            tendon[kind]
            for tendon, kind in zip(self.blocks, np.frombuffer(kinds, np.int64), strict=True)
        ]
        return StateTransition(
            _stack_blocks([block.F for block in selected_blocks]),
            _stack_blocks([block.B for block in selected_blocks]),
        )


def _stack_blocks(blocks: list[Matrix]) -> Matrix:
    """Return a matrix that contains the blocks of N tendons, each of shape (rows, columns).

    Row i of the block of tendon n becomes row i N + n of the matrix. Column j of the same block
    becomes column j N + n of the matrix.
    """
    n, (rows, columns), indices = len(blocks), blocks[0].shape, np.arange(len(blocks))
    # The indices are (row, tendon, column, tendon), because each tendon is coupled only with
    # itself.
    matrix = np.zeros((rows, n, columns, n))
    matrix[:, indices, :, indices] = blocks
    return matrix.reshape(rows * n, columns * n)
