"""The tension filter as numbers: states, regimes, one tendon's blocks, and all tendons as one filter."""

import enum
import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

STATES, INPUTS, MEASUREMENTS = 7, 2, 3
X, V, S, W, D, E, O = range(STATES)  # noqa: E741 - the names of the states, as below
"""Tendon travel [m] and speed [m/s] at the spool, excursion [m] and its rate [m/s], disturbance force on the motor [N],
load-cell error [N], stretch offset [m]."""


class Regime(enum.IntEnum):
    """How a tendon's model is coupled."""

    FREE = 0
    """Taut, the digit moves freely: it follows its tendon, and the tension changes no faster than friction turns."""
    HELD = 1
    """Taut, the digit rests on an object or on its open stop, of unknown stiffness: it moves little, that is all."""
    SLACK = 2
    """No tension: the motor moves alone, springs hold the digit on its open stop, the load cell shows its own error."""


@dataclass(frozen=True, slots=True)
class Block:
    """One tendon's filter in one regime.

    Attributes:
        F: transition over one period, (7, 7).
        B: inputs held over one period, (7, 2).
        H: measurements, (3, 7).
        K: steady-state gain of the update, (7, 3).
        Q: covariance of what a period adds, (7, 7).
        R: variances of encoder and load cell, (2,).
        P: covariance of the prediction in steady state, (7, 7).
        known: whether the load cell's error can be told from tension.
        drift: what it adds to the tension's variance if not [N^2].
        tension_row: tension of a state, (7,).
        tension_variance: of the predicted tension [N^2].
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
    known: bool
    drift: float
    tension_row: Matrix
    tension_variance: float
    innovation_information: Matrix
    cell_sigma: float


class Transition(NamedTuple):
    """All tendons as one filter of 7 N states, state after state: the travels of all tendons, then the speeds, ...

    Attributes:
        F: (7N, 7N). B: (7N, 2N).
    """

    F: Matrix
    B: Matrix


KEPT = 256
"""Combinations of kinds whose matrices are kept: one of eleven tendons takes 60 kB, and there are 6^11."""


@dataclass(frozen=True, slots=True)
class FilterDesign:
    """Blocks of every tendon and kind; ``blocks[tendon][kind]``. A kind is a regime, or 3 + a regime in doubt.

    Attributes:
        transition: matrices of N kinds, as bytes of int64; kept, since kinds change far more rarely than ticks.
    """

    blocks: tuple[tuple[Block, ...], ...]
    transition: "Callable[[bytes], Transition]" = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "transition", functools.lru_cache(KEPT)(self._transition))

    def _transition(self, kinds: bytes) -> Transition:
        chosen = [tendon[kind] for tendon, kind in zip(self.blocks, np.frombuffer(kinds, np.int64), strict=True)]
        return Transition(_stacked([block.F for block in chosen]), _stacked([block.B for block in chosen]))


def _stacked(blocks: list[Matrix]) -> Matrix:
    """Return blocks (rows, columns) of N tendons as one matrix, in which the tendons are the inner index of both."""
    n, (rows, columns), each = len(blocks), blocks[0].shape, np.arange(len(blocks))
    found = np.zeros((rows, n, columns, n))
    found[:, each, :, each] = blocks
    return found.reshape(rows * n, columns * n)
