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
"""Cable travel [m] and speed [m/s] at the spool, excursion [m] and its rate [m/s], disturbance force on the motor [N],
load-cell error [N], stretch offset [m]."""


class Regime(enum.IntEnum):
    """How a tendon's model is coupled."""

    FREE = 0
    """Taut, the digit moves freely: it follows its rope, and the tension changes no faster than friction turns."""
    HELD = 1
    """Taut, the digit rests on an object or on its open stop, of unknown stiffness: it moves little, that is all."""
    SLACK = 2
    """No tension: the motor moves alone, springs hold the digit on its open stop, the load cell shows its own error."""


def kinds(regimes: tuple[int, ...], wary: Matrix) -> tuple[int, ...]:
    """Index the block of each tendon in ``FilterDesign.blocks``.

    Args:
        regimes: per tendon, a ``Regime``.
        wary: (N,) time for which the filter still doubts its model [s].
    """
    if not np.count_nonzero(wary):
        return regimes
    return tuple([regime + len(Regime) * (left > 0.0) for regime, left in zip(regimes, wary.tolist(), strict=True)])


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


MOST_KEPT = 256
"""Combinations of regimes that are kept at a time: one of eleven tendons takes 110 kB, and there are 3^11."""


@dataclass(frozen=True, slots=True)
class FilterDesign:
    """Blocks of every tendon and kind; ``blocks[tendon][kind]``. A kind is a regime, or 3 + a regime in doubt.

    Attributes:
        stacked: the N tendons as one filter, each in its regime; kept, since regimes change far more rarely than ticks.
        spread: the N tendons' noise, likewise.
    """

    blocks: tuple[tuple[Block, ...], ...]
    stacked: "Callable[[tuple[int, ...]], Stacked]" = field(init=False, compare=False, repr=False)
    spread: "Callable[[tuple[int, ...]], Spread]" = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        kept = functools.lru_cache(MOST_KEPT)
        object.__setattr__(self, "stacked", kept(self._stacked))
        object.__setattr__(self, "spread", kept(self._spread))

    def _chosen(self, chosen: tuple[int, ...]) -> list[Block]:
        return [tendon[kind] for tendon, kind in zip(self.blocks, chosen, strict=True)]

    def _spread(self, of_tendons: tuple[int, ...]) -> "Spread":
        return Spread.of(self._chosen(of_tendons))

    def _stacked(self, of_tendons: tuple[int, ...]) -> "Stacked":
        chosen = self._chosen(of_tendons)
        regimes = np.array(of_tendons) % len(Regime)
        information, doubted = _information(chosen), max(of_tendons) >= len(Regime)
        usual = _information(self._chosen(tuple(regimes.tolist()))) if doubted else information
        return Stacked(
            F=_diagonal([block.F for block in chosen]),
            B=_diagonal([block.B for block in chosen]),
            H=_diagonal([block.H for block in chosen]),
            K=_diagonal([block.K for block in chosen]),
            tension=_diagonal([block.tension_row[None] for block in chosen]),
            sigma=np.sqrt([block.tension_variance for block in chosen]),
            information=information,
            usual_information=usual,
            doubted=doubted,
            free=regimes == Regime.FREE,
            slack=regimes == Regime.SLACK,
            cell_sigma=np.array([block.cell_sigma for block in chosen]),
        )


def _information(blocks: list[Block]) -> tuple[Matrix, ...]:
    """Inverse covariance of the innovations, (N,) each: of encoder squared, both, load cell squared."""
    return tuple(
        np.array([block.innovation_information.flat[at] * times for block in blocks])
        for at, times in ((0, 1.0), (1, 2.0), (3, 1.0))
    )


def _diagonal(blocks: list[Matrix]) -> Matrix:
    """Blocks of one shape along the diagonal: scipy's takes ten times as long, and the tick of a touch pays for it."""
    n, (rows, columns), each = len(blocks), blocks[0].shape, np.arange(len(blocks))
    found = np.zeros((n, rows, n, columns))
    found[each, :, each] = blocks
    return found.reshape(n * rows, n * columns)


@dataclass(frozen=True, slots=True)
class Stacked:
    """All tendons as one filter of 7 N states; matrices block diagonal.

    Attributes:
        F: (7N, 7N). B: (7N, 2N). H: (3N, 7N). K: (7N, 3N).
        tension: (N, 7N), tension of a state.
        sigma: (N,), standard deviation of the predicted tension [N].
        information: (N,) each: the innovations' inverse covariance, of encoder squared, both, load cell squared.
        usual_information: the same without any doubt.
        doubted: whether any tendon is in doubt.
        free, slack: (N,) whether a tendon is in this regime.
        cell_sigma: (N,), standard deviation of the load-cell innovation [N].
    """

    F: Matrix
    B: Matrix
    H: Matrix
    K: Matrix
    tension: Matrix
    sigma: Matrix
    information: tuple[Matrix, ...]
    usual_information: tuple[Matrix, ...]
    doubted: bool
    free: NDArray[np.bool_]
    slack: NDArray[np.bool_]
    cell_sigma: Matrix


class Spread(NamedTuple):
    """What the covariance of N tendons needs, each in its regime; see ``covariance``.

    Attributes:
        F, Q, P: (N, 7, 7), see ``Block``. H: (N, 2, 7) encoder and load cell. R: (N, 2).
        told: (N, 7) 1, or 0 for a load cell's error that cannot be told from tension.
        tension: (N, 7) of a state. drift: (N,) what that error adds to the variance of the tension [N^2].
        steady: (N, 8) variances of the states, 0 for what is not told, and of the tension, in steady state.
    """

    F: Matrix
    Q: Matrix
    P: Matrix
    H: Matrix
    R: Matrix
    told: Matrix
    tension: Matrix
    drift: Matrix
    steady: Matrix

    @staticmethod
    def of(blocks: list[Block]) -> "Spread":
        """Of a block for each tendon."""
        H, told = np.array([block.H[:2] for block in blocks]), np.ones((len(blocks), STATES))
        told[:, E] = [block.known for block in blocks]
        H[:, 1, E] = told[:, E]
        F, Q, P, R, tension, drift = (
            np.array([getattr(block, name) for block in blocks])
            for name in ("F", "Q", "P", "R", "tension_row", "drift")
        )
        return Spread(F, Q, P, H, R, told, tension, drift, variances(P, told, tension))


def variances(P: Matrix, told: Matrix, tension: Matrix) -> Matrix:
    """(N, 8) of the states, 0 for what is not told, and of the tension [N^2]; see ``Spread``."""
    return np.column_stack((np.diagonal(P, axis1=1, axis2=2) * told, variance_of_tension(P, tension)))


def variance_of_tension(P: Matrix, tension: Matrix) -> Matrix:
    """(N,) [N^2], of covariances (N, 7, 7) and tension rows (N, 7)."""
    return np.asarray(np.matmul(np.matmul(tension[:, None, :], P), tension[:, :, None])[:, 0, 0])
