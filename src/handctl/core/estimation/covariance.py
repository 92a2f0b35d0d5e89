"""The filter's covariance where it is not the steady one: while measurements are missing, and until that is made up.

The steady gains are those of a measurement in every tick. Of one that comes every second tick only they would take a
speed to be wrong by twice as much as it is, and correct it for longer than they mean to: an estimate that swings, or
worse. So once something is missing every tendon's covariance is carried along, until it is the steady one again.
"""

from typing import NamedTuple

import numpy as np

from handctl.choose import Array
from handctl.core.estimation.filter_stack import MEASUREMENTS, STATES, Spread, Stacked, variance_of_tension, variances

UNIT = np.eye(STATES)
MISSING = 1e12
"""Times its noise variance, a measurement that is not there says as much as none."""
STEADY_SHARE = 0.02
"""A covariance is steady if none of its variances, nor that of the tension, is further from the steady one."""


class Update(NamedTuple):
    """What the measurements of one tick are worth.

    Attributes:
        gain: (N, 7, 2) of encoder and load cell.
        after: (N, 7, 7) covariance once they were used.
        information: (N,) each: the innovations' inverse covariance, of encoder squared, both, load cell squared.
        cell_sigma: (N,) standard deviation of the load-cell innovation [N].
    """

    gain: Array
    after: Array
    information: tuple[Array, Array, Array]
    cell_sigma: Array

    def corrected(self, x: Array, steady: Stacked, innovation: Array) -> Array:
        """The state (7N,) with innovations (3N,) taken in, 0 for what is missing; joint encoders have steady gains."""
        table = innovation.reshape(-1, MEASUREMENTS)
        own = np.matmul(self.gain, table[:, :2, None]).reshape(-1)
        joints = table.copy()
        joints[:, :2] = 0.0
        return np.asarray(x + own + steady.K.dot(joints.reshape(-1)))


def missing(steady: Stacked, z: Array) -> bool:
    """Whether a measurement of this tick is missing that the steady gains count on; in slack a load cell is none.

    Args:
        steady: the filter of this tick.
        z: (3N,) measurements, NaN where missing.
    """
    encoder, cell = z[0::MEASUREMENTS], z[1::MEASUREMENTS]
    if np.count_nonzero(encoder != encoder):
        return True
    lost = cell != cell
    return bool(np.count_nonzero(lost)) and bool(np.count_nonzero(lost & ~steady.slack))


def update(spread: Spread, P: Array | None, z: Array) -> Update:
    """Gains of this tick.

    Args:
        spread: noise of each tendon in its regime.
        P: (N, 7, 7) covariance of the prediction; None for the steady one.
        z: (3N,) measurements, NaN where missing.
    """
    P = spread.P if P is None else P
    table = z.reshape(-1, MEASUREMENTS)[:, :2]
    noise = spread.R * np.where(table != table, MISSING, 1.0)
    crossed = np.matmul(P, spread.H.transpose(0, 2, 1))
    innovation = np.matmul(spread.H, crossed)
    a, b, d = innovation[:, 0, 0] + noise[:, 0], innovation[:, 0, 1], innovation[:, 1, 1] + noise[:, 1]
    size = a * d - b * b
    own, mixed, other = d / size, -b / size, a / size
    inverse = np.array([[own, mixed], [mixed, other]]).transpose(2, 0, 1)
    gain = np.matmul(crossed, inverse) * spread.told[:, :, None]
    rest = UNIT - np.matmul(gain, spread.H)
    after = np.matmul(np.matmul(rest, P), rest.transpose(0, 2, 1))
    after += np.matmul(gain * noise[:, None, :], gain.transpose(0, 2, 1))
    return Update(gain, after, (own, 2.0 * mixed, other), np.sqrt(d))


def predicted(spread: Spread, P: Array) -> Array:
    """The covariance (N, 7, 7) one period later."""
    return np.asarray(np.matmul(np.matmul(spread.F, P), spread.F.transpose(0, 2, 1)) + spread.Q)


def carried(spread: Spread, after: Array, changed: list[int], periods: int) -> Array | None:
    """The covariance of the next tick's prediction; None once it is the steady one.

    Args:
        spread: noise of each tendon in the regime that it is in now.
        after: (N, 7, 7) once the measurements were used.
        changed: tendons whose regime has just changed, which begin with the steady one.
        periods: from this tick to the next.
    """
    P = after
    for _ in range(periods):
        P = predicted(spread, P)
    P[changed] = spread.P[changed]
    far = np.abs(variances(P, spread.told, spread.tension) - spread.steady) > STEADY_SHARE * spread.steady
    return P if np.count_nonzero(far) else None


def sigma(spread: Spread, P: Array) -> Array:
    """(N,) standard deviation of the predicted tension [N]."""
    return np.asarray(np.sqrt(variance_of_tension(P, spread.tension) + spread.drift))
