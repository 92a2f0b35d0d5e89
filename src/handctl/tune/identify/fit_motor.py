"""The motor's equation in its weak form: averaged with a smooth window, so that nothing measured is differentiated.

    K u(t - d) = J/r w' + b/r w + tau_c/r sgn w + r f      per window: all terms times a window, integrated by parts

with u the force asked of the drive at the cable, w the spool's speed, f the load cell. All in newtons at the cable.
Source: modulating functions (Shinbrot 1954): the derivatives go to the window, which is known exactly.
"""

from dataclasses import dataclass

import numpy as np

from handctl.tune.identify.data import Array, TendonData

HALF_S, HALF_LEAST = 0.022, 6
"""Half the length of a window [s]: passes what a hand's motor does, and ten load-cell samples at 500 Hz; and its least
in samples. A whole number of them, or sums are not the integrals that they stand for."""
EVERY = 0.4
"""Distance of windows, as a share of their half length."""
LEAST_SPEED_RAD_S = 0.25
"""Friction that depends on the sign of the speed is known only where the sign is."""


@dataclass(frozen=True, slots=True)
class MotorWindows:
    """Windowed signals, (m,) each; forces at the cable.

    Attributes:
        t: centre [s].
        tension: [N].
        acceleration: of the cable [m/s^2]. speed: [m/s]. sign: of the speed.
        commands: (m, taps) commands around each window [N].
        offsets: (taps + 1,) edges of the commands' intervals from the centre [s].
        half_s: half the length of a window [s].
        spread: of the tension's noise that a window leaves [1].
    """

    t: Array
    tension: Array
    acceleration: Array
    speed: Array
    sign: Array
    commands: Array
    offsets: Array
    half_s: float
    spread: float

    def command(self, delay: float) -> Array:
        """(m,) windowed command that acts ``delay`` [s] late [N]."""
        share = np.diff(_cumulative((self.offsets + delay) / self.half_s))
        return np.asarray(self.commands @ share)


def motor_windows(data: TendonData, spool: float) -> MotorWindows:
    """Window the signals of a tendon; windows in which the speed is too small or something is missing are left out."""
    period = data.period
    half = max(HALF_LEAST, round(HALF_S / period))
    half_s, at = half * period, np.arange(-half, half + 1)
    s = np.asarray(at / half, np.float64)
    weight = _window(s) / half
    first, second = _slope(s) / half_s / half, _bend(s) / half_s**2 / half
    centres = np.arange(half + 3, len(data.t) - half - 3, max(1, round(EVERY * half)))
    rows = centres[:, None] + at
    travel = data.travel[rows]
    speed = -travel @ first
    quick = _quick_speed(data.travel, period)
    known = data.acting[rows].all(axis=1) & np.isfinite(travel + data.tension[rows]).all(axis=1)
    moving = np.abs(quick[rows]).min(axis=1) > LEAST_SPEED_RAD_S * spool
    keep = known & moving & (np.abs(np.sign(quick[rows]).sum(axis=1)) == len(at))
    taps = np.arange(-half - 2, half + 3)
    return MotorWindows(
        t=data.t[centres][keep],
        tension=(data.tension[rows] @ weight)[keep],
        acceleration=(travel @ second)[keep],
        speed=speed[keep],
        sign=np.sign(speed[keep]),
        commands=data.command[centres[keep][:, None] + taps],
        offsets=np.append(taps, taps[-1] + 1) * period,
        half_s=half_s,
        spread=float(np.sqrt((weight**2).sum())),
    )


def _quick_speed(travel: Array, period: float, reach: int = 3) -> Array:
    """Speed over a few periods [m/s]; NaN at the ends."""
    speed = np.full(len(travel), np.nan)
    speed[reach:-reach] = (travel[2 * reach :] - travel[: -2 * reach]) / (2 * reach * period)
    return np.asarray(np.nan_to_num(speed))


def _window(s: Array) -> Array:
    """cos^4 over [-1, 1], of area 1; 0 outside."""
    return np.asarray(np.where(np.abs(s) < 1.0, 4.0 / 3.0 * np.cos(0.5 * np.pi * s) ** 4, 0.0))


def _slope(s: Array) -> Array:
    inside = -8.0 / 3.0 * np.pi * np.cos(0.5 * np.pi * s) ** 3 * np.sin(0.5 * np.pi * s)
    return np.asarray(np.where(np.abs(s) < 1.0, inside, 0.0))


def _bend(s: Array) -> Array:
    c2 = np.cos(0.5 * np.pi * s) ** 2
    inside = 4.0 / 3.0 * np.pi**2 * c2 * (3.0 - 4.0 * c2)
    return np.asarray(np.where(np.abs(s) < 1.0, inside, 0.0))


def _cumulative(s: Array) -> Array:
    """Integral of the window from -1."""
    c = np.clip(s, -1.0, 1.0)
    return np.asarray(
        0.5 + 0.5 * c + np.sin(np.pi * c) * 2.0 / (3.0 * np.pi) + np.sin(2.0 * np.pi * c) / (12.0 * np.pi)
    )
