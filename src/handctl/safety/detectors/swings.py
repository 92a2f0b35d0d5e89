"""Detect a tension that swings about its command, whatever makes it swing: torque ripple, a loop that rings.

A motor whose torque ripples by a tenth of a newton metre near the resonance of rotor and tendon (about 20 Hz) swings a
tendon by tens of newtons, below every other threshold. The current does not show cogging, so that N14 is blind to it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel, square

Vector = NDArray[np.float64]

SLOW_S, MEAN_S = 0.02, 0.025
"""Time constants: of the slow part of the deviation, which is taken off (corner at 8 Hz); of the mean square [s]."""
SWING_N, LASTS_S = 8.0, 0.25
"""RMS of a swing [N], 11 N of amplitude, and how long it lasts until it relaxes [s]. A step of the command by 75 N at
5000 N/s is above it for 0.15 s."""


def initial(n: int) -> Vector:
    """Return the state of n tendons before the first reading: (3, N) slow part [N], mean square [N^2], time [s]."""
    return np.zeros((3, n))


def step(state: Vector, deviation: Vector, period: float) -> Vector:
    """Take in (N,) measured less commanded tension [N], NaN where there is none, after a ``period`` [s]."""
    return _step(state, deviation, period, 1.0 - math.exp(-period / SLOW_S), 1.0 - math.exp(-period / MEAN_S))


@kernel("matrix", "vector", "real", "real", "real")
def _step(state: Vector, deviation: Vector, period: float, slow_share: float, mean_share: float) -> Vector:
    """Take in one tick, of which the slow part and the mean square take a share each; see ``step``."""
    after = state.copy()
    for n in range(len(deviation)):
        quick = 0.0
        if not math.isnan(deviation[n]):
            after[0, n] += slow_share * (deviation[n] - after[0, n])
            quick = deviation[n] - after[0, n]
        after[1, n] += mean_share * (quick * quick - after[1, n])
        after[2, n] = after[2, n] + period if after[1, n] > square(SWING_N) else 0.0
    return after


def swinging(state: Vector) -> list[tuple[int, float]]:
    """Return (tendon, RMS [N]) of each tension that has been swinging for long enough."""
    if state[2].max(initial=0.0) <= LASTS_S:
        return []
    return [(i, math.sqrt(square)) for i, (_, square, lasts) in enumerate(state.T.tolist()) if lasts > LASTS_S]
