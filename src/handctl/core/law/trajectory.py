"""Ways of a digit through its coordinates: minimum jerk to a pose, or a curve through given points."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handctl.core.types import Vector


class Trajectory(Protocol):
    """A way of a digit, from rest to rest."""

    @property
    def duration(self) -> float:
        """Time it takes [s]."""
        ...

    def at(self, t: float) -> Vector:
        """(3, n): position [rad], velocity [rad/s] and acceleration [rad/s^2] at t [s]; the end holds after it."""
        ...


@dataclass(frozen=True, slots=True)
class MinimumJerk:
    """A straight move in coordinates with the least jerk, at rest at both ends.

    Source: Flash & Hogan (1985): position 10 s^3 - 15 s^4 + 6 s^5 of normalised time s.

    Attributes:
        start: (n,) coordinates at t = 0 [rad].
        end: (n,) coordinates at t = duration [rad].
        duration: [s], > 0.
    """

    start: Vector
    end: Vector
    duration: float

    def at(self, t: float) -> Vector:
        """See ``Trajectory``."""
        s = min(max(t / self.duration, 0.0), 1.0)
        position = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        velocity = 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.duration
        acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (self.duration * self.duration)
        way = np.array(((position,), (velocity,), (acceleration,))) * (self.end - self.start)
        way[0] += self.start
        return way


@dataclass(frozen=True, slots=True)
class Curve:
    """A cubic spline through points, at rest at both ends; all coordinates of the digit move alike.

    Attributes:
        times: (k,) of the points, rising from 0 [s].
        coefficients: (4, k - 1) of the cubic in each piece, highest power first [rad/s^3 .. rad].
        coordinates: of the digit.
    """

    times: Vector
    coefficients: Vector
    coordinates: int

    @staticmethod
    def through(times: tuple[float, ...], angles: tuple[float, ...], coordinates: int) -> "Curve":
        """The curve through angles [rad] at times [s]."""
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(times, angles, bc_type="clamped")
        return Curve(np.array(times), np.asarray(spline.c), coordinates)

    @property
    def duration(self) -> float:
        """See ``Trajectory``."""
        return float(self.times[-1])

    def at(self, t: float) -> Vector:
        """See ``Trajectory``."""
        held = min(max(t, 0.0), self.duration)
        piece = min(int(np.searchsorted(self.times, held, side="right")) - 1, len(self.times) - 2)
        s = held - float(self.times[piece])
        a, b, c, d = self.coefficients[:, piece].tolist()
        moving = 1.0 if held == t else 0.0
        values = (d + s * (c + s * (b + s * a)), moving * (c + s * (2 * b + s * 3 * a)), moving * (2 * b + 6 * a * s))
        return _alike(values, self.coordinates)

    def peak_speed(self) -> float:
        """Largest speed on the way [rad/s]: at the ends of a piece or where its acceleration vanishes."""
        a, b, c, _ = self.coefficients
        length = np.diff(self.times)
        with np.errstate(divide="ignore", invalid="ignore"):
            turning = np.clip(np.nan_to_num(-b / (3 * a)), 0.0, length)
        candidates = [c + s * (2 * b + s * 3 * a) for s in (np.zeros_like(length), turning, length)]
        return float(np.abs(candidates).max())


@dataclass(frozen=True, slots=True)
class Sample:
    """One instant of a motion that somebody else laid down, e.g. a log.

    Attributes:
        position: (n,) coordinates [rad].
        velocity: (n,) [rad/s].
        acceleration: (n,) [rad/s^2].
        duration: 0: it has no end of its own [s].
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    duration: float = 0.0

    def at(self, t: float) -> Vector:
        """See ``Trajectory``; the same at any time."""
        return np.array((self.position, self.velocity, self.acceleration))


@dataclass(frozen=True, slots=True)
class Chirp:
    """A swing about an angle whose frequency rises evenly, growing from rest and dying down to rest.

    Attributes:
        centre: [rad].
        amplitude: [rad].
        low, high: frequency at the beginning and at the end [Hz].
        duration: [s].
        coordinates: of the digit; all swing alike.
    """

    centre: float
    amplitude: float
    low: float
    high: float
    duration: float
    coordinates: int

    def at(self, t: float) -> Vector:
        """See ``Trajectory``."""
        s = min(max(t, 0.0), self.duration)
        size, growth, bend = self._envelope(s)
        rise = 2.0 * math.pi * (self.high - self.low) / self.duration
        speed = 2.0 * math.pi * self.low + rise * s
        phase = (math.pi * self.low + 0.5 * speed) * s
        sine, cosine = math.sin(phase), math.cos(phase)
        way = size * sine
        velocity = growth * sine + size * speed * cosine
        acceleration = bend * sine + 2.0 * growth * speed * cosine + size * (rise * cosine - speed**2 * sine)
        moving = self.amplitude if s == t else 0.0
        values = (self.centre + self.amplitude * way, moving * velocity, moving * acceleration)
        return _alike(values, self.coordinates)

    def _envelope(self, t: float) -> tuple[float, float, float]:
        """Size of the swing at t [s], its rate [1/s] and the rate of that [1/s^2]; smooth at both ends."""
        ramp = 0.1 * self.duration
        left = min(t, self.duration - t)
        if left >= ramp:
            return 1.0, 0.0, 0.0
        w = math.pi / ramp
        sign = 1.0 if t <= self.duration - t else -1.0
        return 0.5 - 0.5 * math.cos(w * left), sign * 0.5 * w * math.sin(w * left), 0.5 * w * w * math.cos(w * left)


def _alike(values: tuple[float, float, float], coordinates: int) -> Vector:
    """(3, n) of a motion in which all coordinates are alike."""
    return np.array([[value] * coordinates for value in values])


PEAK_SPEED = 1.875
"""Peak over mean speed of a minimum-jerk move: 15 / 8."""


def duration_for(distance: float, speed: float, shortest: float) -> float:
    """Duration [s] of a move of ``distance`` [rad] with peak speed ``speed`` [rad/s], at least ``shortest`` [s]."""
    return max(PEAK_SPEED * abs(distance) / speed, shortest)
