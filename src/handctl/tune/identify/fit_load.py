"""What a rope's load cell should read, given where its motor is: on the open stop, and in free motion of a digit.

On the stop the rope alone decides: f = k (x - o). In free motion each joint is in balance,

    S k_i (q_i + P p_i) + b_i q_i' + m (a_i q'' + g_i) = r_i f exp(-mu sgn(w) (phi_0 + q_1 + .. + q_i)),

and the joints' excursions and the rope's stretch add up to the travel: sum r_i q_i + f / k = x - o. Solved for f, since
the encoder's noise is negligible beside the load cell's. S, P, m scale springs, preloads, masses of the hand file.
Source: capstan equation; virtual work; equations of motion of ``hand.dynamics``.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handctl.hand.digit import DigitModel
from handctl.hand.dynamics import gravity_torque, mass_matrix
from handctl.tune.identify.data import Array, Mask, TendonData

BIN_S = 0.01
"""Samples are averaged over this long: motion is slow beside it, and a fit has a fifth of the rows."""
LEAST_SPEED_M_S = 4e-3
"""Below it the direction of friction is not known for every pulley."""
GRID = np.radians(np.linspace(0.0, 110.0, 23))
STEPS = 14
FRICTION_MOST = 3.0
"""Exponent of the capstan equation that no rope reaches; it keeps a solver's wild guess finite."""


class LoadParameters(NamedTuple):
    """What is fitted: SI units, or factors on the hand file.

    Attributes:
        stiffness: of the rope [N/m]. spring, preload: factors. friction: capstan coefficient.
        damping: of the joints, factor. mass: of the links, factor. offset: stretch offset [m].
    """

    stiffness: float
    spring: float
    preload: float
    friction: float
    damping: float
    mass: float
    offset: float


@dataclass(frozen=True, slots=True)
class Bins:
    """Averages over short times, (m,) each.

    Attributes:
        t: [s]. travel: [m]. tension: [N]. speed: of the cable [m/s]. acceleration: [m/s^2]. count: samples in each.
    """

    t: Array
    travel: Array
    tension: Array
    speed: Array
    acceleration: Array
    count: int


def bins(data: TendonData, use: Mask, moving: bool, bin_s: float = BIN_S) -> Bins:
    """Average what is marked; a bin counts if all of it is marked, was read, and moves in one direction if it shall."""
    count = max(1, round(bin_s / data.period))
    n = len(data.t) // count
    reach = max(2, round(BIN_S / data.period))
    speed, acceleration = _rates(data.travel, data.period, reach)

    def table(values: Array) -> Array:
        return values[: n * count].reshape(n, count)

    whole = table(use.astype(float)).all(axis=1) & np.isfinite(table(data.tension + data.travel)).all(axis=1)
    if moving:
        speeds = table(speed)
        whole &= np.abs(speeds).min(axis=1) > LEAST_SPEED_M_S
        whole &= np.abs(np.sign(speeds).sum(axis=1)) == count

    def mean(values: Array) -> Array:
        return np.asarray(table(values).mean(axis=1)[whole])

    return Bins(mean(data.t), mean(data.travel), mean(data.tension), mean(speed), mean(acceleration), count)


def _rates(travel: Array, period: float, reach: int) -> tuple[Array, Array]:
    """Speed and acceleration by central differences over ``reach`` periods; zero at the ends."""
    speed, acceleration = np.zeros_like(travel), np.zeros_like(travel)
    ahead, behind, here = travel[2 * reach :], travel[: -2 * reach], travel[reach:-reach]
    speed[reach:-reach] = (ahead - behind) / (2 * reach * period)
    acceleration[reach:-reach] = (ahead - 2.0 * here + behind) / (reach * period) ** 2
    return np.nan_to_num(speed), np.nan_to_num(acceleration)


@dataclass(frozen=True, slots=True)
class DigitLoad:
    """One digit with one tendon, as numbers per joint, (n,) each.

    Attributes:
        arms: [m]. spring: [N m/rad]. preload: [rad]. damping: [N m s/rad]. wrap: before the first pulley [rad].
        inertia, weight: torque per mean joint acceleration and per gravity, (grid, n).
    """

    arms: Array
    spring: Array
    preload: Array
    damping: Array
    wrap: float
    inertia: Array
    weight: Array

    @staticmethod
    def of(digit: DigitModel) -> "DigitLoad":
        """Constants of a digit."""
        n = digit.joint_count
        return DigitLoad(
            arms=np.asarray(digit.moment_arms[0]),
            spring=np.array(digit.spring_stiffness),
            preload=np.array(digit.spring_preload),
            damping=np.array(digit.joint_damping),
            wrap=float(digit.wrap[0]),
            inertia=np.array([mass_matrix(digit, [q] * n).sum(axis=1) for q in GRID.tolist()]),
            weight=np.array([gravity_torque(digit, [q] * n) for q in GRID.tolist()]),
        )

    def tension(self, p: LoadParameters, seen: Bins) -> Array:
        """(m,) load-cell tension of a digit that moves freely [N]."""
        total = self.arms.sum()
        mean = np.clip((seen.travel - p.offset) / total, 0.0, GRID[-1])
        rate, rise = seen.speed / total, seen.acceleration / total
        extra = [
            p.damping * self.damping[i] * rate
            + p.mass * (np.interp(mean, GRID, self.inertia[:, i]) * rise + np.interp(mean, GRID, self.weight[:, i]))
            for i in range(len(self.arms))
        ]
        side = -p.friction * np.sign(seen.speed)
        stiffness = p.spring * self.spring
        q = [mean.copy() for _ in self.arms]
        f = np.full_like(mean, 10.0)
        for _ in range(STEPS):
            angle, excursion, slope = (
                np.full_like(mean, self.wrap),
                f / p.stiffness,
                np.full_like(mean, 1.0 / p.stiffness),
            )
            for i, arm in enumerate(self.arms.tolist()):
                share = np.exp(np.clip(side * (angle + q[i]), -FRICTION_MOST, FRICTION_MOST))
                q[i] = (arm * f * share - extra[i]) / stiffness[i] - p.preload * self.preload[i]
                angle = angle + q[i]
                excursion = excursion + arm * q[i]
                slope = slope + arm * arm * share / stiffness[i]
            f = np.maximum(f + (seen.travel - p.offset - excursion) / slope, 0.1)
        return np.asarray(f)
