"""Springs and friction of a digit with several tendons: its joints in balance, by load cells and joint encoders.

    sum_j R_ji f_j exp(-mu_j sgn(w_j) (phi_j + q_1 + .. + q_i)) = S k_i (q_i + P p_i) + b_i q_i' + m (M q'' + g)_i

in free motion, with the wrap and the angles that rope j has passed by joint i. The tendons' own fits give the load
cells' drift. Every load cell counts once: rows are balances in units of what the load cells' noise makes of them.
Source: as in ``fit_load``; errors of joint encoders are a tenth of those of load cells here and are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.hand.digit import DigitModel
from handctl.hand.dynamics import inverse_dynamics
from handctl.tune.identify.contact import Ramp, steepest
from handctl.tune.identify.data import Array, TendonData
from handctl.tune.identify.fit import LEAST, MOST, NAMES, PRIOR, VAGUE, Fit
from handctl.tune.identify.fit_load import FRICTION_MOST
from handctl.tune.identify.solve import Solution, solve

SHARED = ("spring_stiffness", "spring_preload", "joint_damping", "link_mass")
"""Factors on the hand file for the whole digit; a capstan coefficient for every tendon follows."""
HALF_S = 0.01
"""Signals are averaged this long to either side of a joint reading."""
LEAST_SPEED_M_S = 2.5e-3
"""Of every rope: below it the direction of friction is not known for every pulley."""
LEAST_ROWS = 20
"""Moments that a fit takes at least."""


@dataclass(frozen=True, slots=True)
class Balance:
    """Moments at which a digit moves freely and its joints were read.

    Attributes:
        digit: the digit. t: (m,) [s]. q, dq: (m, joints) [rad], [rad/s]. rigid: (m, joints) inertia and weight [N m].
        tension: (m, tendons), drift taken off [N]. side: (m, tendons) direction of the ropes. noise: (tendons,) [N].
        doubt: (tendons,) standard deviation of what is left of the load cells' drift [N].
    """

    digit: DigitModel
    t: Array
    q: Array
    dq: Array
    rigid: Array
    tension: Array
    side: Array
    noise: Array
    doubt: Array

    @staticmethod
    def of(digit: DigitModel, data: Sequence[TendonData], fits: Sequence[Fit]) -> "Balance | None":
        """Put together what the tendons' data and fits tell of a digit; None if it is too little.

        Args:
            digit: the digit.
            data: of its tendons, in order.
            fits: of the same.
        """
        first, reach = data[0], max(1, round(HALF_S / data[0].period))
        free = np.all([_averaged(one.free.astype(float), reach) > 0.999 for one in data], axis=0)
        cells = [_averaged(one.tension - _drift(one, own), reach) for one, own in zip(data, fits, strict=True)]
        tension = np.column_stack(cells)
        speed, rise = (np.column_stack(values) for values in zip(*(_rates(one, reach) for one in data), strict=True))
        to_joints = digit.excursion_to_joints.T
        sure = (np.abs(speed) > LEAST_SPEED_M_S).all(axis=1)
        known = np.isfinite(np.hstack([first.joints, tension, speed])).all(axis=1)
        keep = _apart(np.flatnonzero(free & sure & known), 2 * reach)
        if len(keep) < LEAST_ROWS:
            return None
        q, dq, ddq = first.joints[keep], speed[keep] @ to_joints, rise[keep] @ to_joints
        rigid = [inverse_dynamics(digit, *row) for row in zip(q.tolist(), dq.tolist(), ddq.tolist(), strict=True)]
        return Balance(
            digit=digit,
            t=first.t[keep],
            q=q,
            dq=dq,
            rigid=np.array(rigid),
            tension=tension[keep],
            side=np.sign(speed[keep]),
            noise=np.array([f.problem.sigma for f in fits]) / (2 * reach + 1) ** 0.5,
            doubt=np.array([_doubt(f, first.t[keep]) for f in fits]),
        )

    def pull(self, friction: Array, offset: Array) -> Array:
        """(m, joints) torque of the ropes at the joints [N m].

        Args:
            friction: (tendons,) capstan coefficients.
            offset: (tendons,) of the load cells [N].
        """
        torque = np.zeros_like(self.q)
        for j, arms in enumerate(self.digit.moment_arms):
            angle = np.full(len(self.t), self.digit.wrap[j])
            for i, arm in enumerate(arms.tolist()):
                angle = angle + self.q[:, i] * (arm != 0.0)
                lost = np.clip(-friction[j] * self.side[:, j] * angle, -FRICTION_MOST, FRICTION_MOST)
                torque[:, i] += arm * (self.tension[:, j] - offset[j]) * np.exp(lost)
        return torque

    @property
    def whiten(self) -> Array:
        """(joints, joints) that makes the torques of one moment independent, in standard deviations."""
        arms = self.digit.moment_arms
        return np.asarray(np.linalg.inv(np.linalg.cholesky(arms.T @ np.diag(self.noise**2) @ arms)).T)

    def load(self, spring: float, preload: float, damping: float, mass: float) -> Array:
        """(m, joints) torque that springs, damping, inertia and weight ask for [N m]; factors on the hand file."""
        digit = self.digit
        springs = spring * np.array(digit.spring_stiffness) * (self.q + preload * np.array(digit.spring_preload))
        return np.asarray(springs + damping * np.array(digit.joint_damping) * self.dq + mass * self.rigid)


def fit_digit(seen: Balance) -> Solution:
    """Solve for shared factors and capstan coefficients, scaled by the hand file, and for the load cells' offsets."""
    n, tendons = len(SHARED), len(seen.noise)
    arms, whiten = seen.digit.moment_arms, seen.whiten
    spread = np.array([*(PRIOR.get(name, VAGUE) for name in SHARED), *[VAGUE] * tendons])
    friction = _friction(seen.digit)

    def residuals(z: Array) -> Array:
        off = z[n + tendons :]
        gap = seen.pull(z[n : n + tendons] * friction, off) - seen.load(*z[:n].tolist())
        return np.concatenate([(gap @ whiten).ravel(), (z[: n + tendons] - 1.0) / spread, off / seen.doubt])

    start = np.append(np.ones(n + tendons), np.zeros(tendons))
    low = np.append(np.full(n + tendons, LEAST), np.full(tendons, -np.inf))
    high = np.append(np.full(n + tendons, MOST), np.full(tendons, np.inf))
    return solve(residuals, start, (low, high), np.repeat(seen.t, arms.shape[1]))


def joined(fits: Sequence[Fit], found: Solution, seen: Balance) -> list[Fit]:
    """The tendons' fits with what the digit's tells: capstan for every tendon, the shared factors with the first."""
    rows = len(seen.t) * seen.q.shape[1]
    fits = [replace(one, ramp=_ramp(found, seen)) for one in fits]
    return [_joined(one, found, rows, SHARED if j == 0 else (), len(SHARED) + j) for j, one in enumerate(fits)]


def _ramp(found: Solution, seen: Balance) -> Ramp | None:
    """Return the ramp of one joint's torque that the sweeps leave unexplained."""
    units = [np.tile(row, len(seen.t)) for row in seen.whiten]
    return steepest(found.jacobian, found.residual, 0, np.asarray(seen.q.mean(axis=1)), units)


def _joined(one: Fit, found: Solution, rows: int, shared: tuple[str, ...], capstan: int) -> Fit:
    """One tendon's fit with some of the digit's parameters in the place of its own."""
    names = (*shared, "capstan")
    to = [NAMES.index(name) for name in names]
    come = [*range(len(shared)), capstan]
    z, covariance, freedom = one.z.copy(), one.covariance.copy(), one.freedom.copy()
    z[to], freedom[to] = found.z[come], found.freedom[come]
    covariance[to, :] = covariance[:, to] = 0.0
    covariance[np.ix_(to, to)] = found.covariance[np.ix_(come, come)]
    more = np.zeros((rows, len(NAMES)))
    more[:, to] = found.jacobian[:rows, come]
    return replace(one, z=z, covariance=covariance, freedom=freedom, sensitivity=np.vstack([one.sensitivity, more]))


def _friction(digit: DigitModel) -> Array:
    """(tendons,) scale of each capstan coefficient, as the tendons' fits have it."""
    return np.where(digit.friction > 0.0, digit.friction, 1e-3)


def _apart(places: NDArray[np.intp], least: int) -> NDArray[np.intp]:
    """Those that are at least so far from the one before, so that no sample counts twice."""
    kept: list[int] = []
    for place in places.tolist():
        if not kept or place - kept[-1] >= least:
            kept.append(place)
    return np.array(kept, dtype=np.intp)


def _averaged(values: Array, reach: int) -> Array:
    """Means over ``reach`` samples to either side; NaN at the ends."""
    found = np.full(len(values), np.nan)
    width = 2 * reach + 1
    if len(values) >= width:
        found[reach:-reach] = np.convolve(values, np.full(width, 1.0 / width), "valid")
    return found


def _rates(data: TendonData, reach: int) -> tuple[Array, Array]:
    """Speed [m/s] and acceleration [m/s^2] of a cable over twice the averaging time; NaN at the ends."""
    x, step = data.travel, 2 * reach
    speed, rise = np.full(len(x), np.nan), np.full(len(x), np.nan)
    ahead, behind, here = x[2 * step :], x[: -2 * step], x[step:-step]
    speed[step:-step] = (ahead - behind) / (2 * step * data.period)
    rise[step:-step] = (ahead - 2.0 * here + behind) / (step * data.period) ** 2
    return speed, rise


def _drift(data: TendonData, fit: Fit) -> Array:
    return np.asarray(np.interp(data.t, fit.problem.knots, fit.z[len(NAMES) :]))


def _doubt(fit: Fit, t: Array) -> float:
    """Standard deviation of a tendon's drift while the digit moves freely [N]."""
    knots = fit.problem.knots
    used = np.flatnonzero((knots >= t.min() - 1.0) & (knots <= t.max() + 1.0)) + len(NAMES)
    return max(float(np.sqrt(np.diag(fit.covariance)[used].mean())), 1e-3)
