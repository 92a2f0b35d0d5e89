"""What remains when motor torque, inertia and friction are taken off a rope's tension, and the like, filtered.

A rotor at the cable: m a = F - T - b v - c sign(v). What the load cell says besides, over a fifth of a second, is the
cell's, the motor's or the friction's fault. Thresholds are so far from the noise that it raises none of
them in ten thousand hours.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import chosen, known, nothing
from handctl.compiled import kernel, square

Vector = NDArray[np.float64]

SLOW_S, QUICK_S, ASKED_S, SLIP_S, NOISE_S, RUB_S = 0.2, 0.02, 0.08, 0.3, 0.1, 5.0
"""Time constants of the filters [s]."""
GAIN_SHARE = 0.1
"""Share of the motor's force that its torque constant may be wrong by. Source: usual tolerance of K_t."""
RUB_SPEED = 5e-3
"""Cable speed above which friction is fully developed [m/s]."""

BALANCE, FORCE, ASKED, TENSION, QUICK_FORCE, SLIP, JERK, RUB = range(8)
"""Rows of ``Filtered.low``."""
_TIMES = np.array([SLOW_S, SLOW_S, ASKED_S, QUICK_S, QUICK_S, SLIP_S, NOISE_S, RUB_S])


@dataclass(frozen=True, slots=True, eq=False)
class Rotor:
    """Constants of the motors seen at the cable, (N,) each.

    Attributes:
        mass: [kg]. damping: [N s/m]. coulomb: [N].
        period: control period [s].
        motor_period: how often each motor tells its position and torque [s].
        joint_period: how often joints are read [s].
        inertia: mass over period [N s/m].
        shares: (8, N) of what is new, that each row of ``Filtered.low`` takes when it comes.
    """

    mass: Vector
    damping: Vector
    coulomb: Vector
    period: float
    motor_period: Vector
    joint_period: float
    inertia: Vector = field(init=False)
    shares: Vector = field(init=False)

    def __post_init__(self) -> None:
        every = np.full((8, len(self.mass)), self.period)
        every[ASKED], every[SLIP] = self.motor_period, self.joint_period
        shares = 1.0 - np.exp(-every / _TIMES[:, None])
        object.__setattr__(self, "inertia", self.mass / self.period)
        object.__setattr__(self, "shares", shares)


class Filtered(NamedTuple):
    """What the residuals carry from tick to tick.

    Attributes:
        low: (8, N) low-passed rows.
        speed: (N,) of the cable, last tick [m/s].
        position: (N,) of the motors, last tick [rad].
        turned: (N,) since the tick before that [rad].
    """

    low: Vector
    speed: Vector
    position: Vector
    turned: Vector

    @staticmethod
    def initial(n: int) -> "Filtered":
        """Nothing seen."""
        return Filtered(np.zeros((8, n)), nothing(n), nothing(n), nothing(n))


class Rope(NamedTuple):
    """One tick along the ropes, (N,) each, NaN where nothing is known.

    Attributes:
        position: of the motor [rad]. speed: of the cable, estimated [m/s].
        tension: load cell [N].
        force: that the motor made, at the cable [N]. asked: that it was asked to make [N].
        slip: joint encoders against spool, as a mean joint angle [deg].
    """

    position: Vector
    speed: Vector
    tension: Vector
    force: Vector
    asked: Vector
    slip: Vector


def step(rotor: Rotor, state: Filtered, rope: Rope) -> Filtered:
    """Filter one tick."""
    low, turned = _step(*state, *rope, rotor.damping, rotor.coulomb, rotor.inertia, rotor.shares)
    return Filtered(low, rope.speed, rope.position, turned)


@kernel("matrix", *["vector"] * 12, "matrix")
def _step(
    low: Vector,
    last_speed: Vector,
    last_position: Vector,
    last_turned: Vector,
    position: Vector,
    speed: Vector,
    tension: Vector,
    force: Vector,
    asked: Vector,
    slip: Vector,
    damping: Vector,
    coulomb: Vector,
    inertia: Vector,
    shares: Vector,
) -> tuple[Vector, Vector]:
    """Return the low-passed rows (8, N), and by how far each motor has turned in this tick (N,) [rad].

    Args:
        low, last_speed, last_position, last_turned: see ``Filtered``.
        position, speed, tension, force, asked, slip: see ``Rope``.
        damping, coulomb, inertia, shares: see ``Rotor``.
    """
    low, turned, now = low.copy(), position - last_position, np.empty(8)
    for n in range(len(position)):
        made = asked[n] if math.isnan(force[n]) else force[n]
        drag = damping[n] * speed[n] + coulomb[n] * math.tanh(speed[n] * 1e3)
        balance = made - tension[n] - inertia[n] * (speed[n] - last_speed[n]) - drag
        now[BALANCE], now[FORCE], now[ASKED] = balance, made, asked[n] - force[n]
        now[TENSION], now[QUICK_FORCE], now[SLIP] = tension[n], made, slip[n]
        now[JERK] = square(turned[n] - last_turned[n])
        # Against the motion: what rubs has the sign of the speed.
        now[RUB] = math.copysign(1.0, speed[n]) * balance if abs(speed[n]) > RUB_SPEED else math.nan
        for row in range(8):
            if not math.isnan(now[row] - low[row, n]):
                low[row, n] += shares[row, n] * (now[row] - low[row, n])
    return low, turned


def begun(state: Filtered, rope: Rope) -> Filtered:
    """Before the first tick: what is filtered quickly begins at what is there, not at nothing."""
    low = state.low.copy()
    low[TENSION] = rope.tension
    low[QUICK_FORCE] = chosen(rope.force == rope.force, rope.force, rope.asked)
    return state._replace(low=known(low))


def unexplained(rotor: Rotor, state: Filtered) -> Vector:
    """(N,) tension that neither friction nor the tolerance of the torque constant explains [N], 0 or more."""
    known = rotor.coulomb + GAIN_SHARE * np.abs(state.low[FORCE])
    return np.asarray(np.maximum(np.abs(state.low[BALANCE]) - known, 0.0))


def friction(state: Filtered) -> Vector:
    """(N,) friction of a moving rotor beyond the modelled [N]."""
    return np.asarray(np.maximum(state.low[RUB] - GAIN_SHARE * np.abs(state.low[FORCE]), 0.0))


def suspicion(rotor: Rotor, limits: Vector) -> Vector:
    """(8, N) sizes of the rows below which nothing that is made of them can be above its limit.

    Args:
        rotor: whose friction explains some of it.
        limits: (8,) of what is made of each row; inf for a row of which nothing is made.
    """
    least = limits[:, None] + np.zeros(len(rotor.mass))
    least[BALANCE] += rotor.coulomb
    return np.asarray(least)
