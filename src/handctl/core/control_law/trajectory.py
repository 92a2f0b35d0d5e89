"""Trajectories of a digit's coordinates: moves to a pose, curves through points, and other motions."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handctl.core.tick_types import Vector


class Trajectory(Protocol):
    """Motion of a digit that starts and ends at rest."""

    @property
    def duration(self) -> float:
        """Return the duration of the trajectory [s]."""
        ...

    def motion_at(self, t: float) -> Vector:
        """Return position [rad], velocity [rad/s] and acceleration [rad/s^2] at time t [s], (3, n).

        After the end of the trajectory, the digit rests at the end position.
        """
        ...


@dataclass(frozen=True, slots=True)
class BlendTrajectory:
    """Blend: the part of a move in which the earlier motion of the digit fades out.

    The blend adds the sum of two polynomials of degree 5 to the position of the move. At the start
    of the move, the first polynomial has a rate of 1, and the second polynomial has an acceleration
    of 1. At the start and at the end, all other values, rates and accelerations of the two
    polynomials are 0.

    Attributes:
        speed: (n,) rate of the earlier motion at t = 0 [rad/s].
        acceleration: (n,) acceleration of the earlier motion at t = 0 [rad/s^2].
        duration: time in which the earlier motion fades out [s], > 0.
    """

    speed: Vector
    acceleration: Vector
    duration: float

    def motion_at(self, t: float) -> Vector:
        """Return the blend's position [rad], velocity [rad/s] and acceleration [rad/s^2] at time t [s], (3, n)."""
        T = self.duration
        s = min(max(t / T, 0.0), 1.0)
        speed_polynomials = np.array((
            T * s * (1.0 + s * s * (-6.0 + s * (8.0 - 3.0 * s))),
            1.0 + s * s * (-18.0 + s * (32.0 - 15.0 * s)),
            s * (-36.0 + s * (96.0 - 60.0 * s)) / T,
        ))  # fmt: skip
        acceleration_polynomials = np.array((
            0.5 * T * T * s * s * (1.0 + s * (-3.0 + s * (3.0 - s))),
            0.5 * T * s * (2.0 + s * (-9.0 + s * (12.0 - 5.0 * s))),
            1.0 + s * (-9.0 + s * (18.0 - 10.0 * s)),
        ))  # fmt: skip
        return np.outer(speed_polynomials, self.speed) + np.outer(
            acceleration_polynomials, self.acceleration
        )


@dataclass(frozen=True, slots=True)
class MinimumJerk:
    """Minimum-jerk move of a digit on a straight line in its coordinates.

    The move ends at rest.

    Source: Flash & Hogan (1985), with the position 10 s^3 - 15 s^4 + 6 s^5, where s is the fraction
        of the duration.

    Attributes:
        start: (n,) coordinates at t = 0 [rad].
        end: (n,) coordinates at t = duration [rad].
        duration: duration of the move [s], > 0.
        blend: part of the move in which an earlier motion fades out, or None if the move starts at
            rest.
    """

    start: Vector
    end: Vector
    duration: float
    blend: BlendTrajectory | None = None

    def motion_at(self, t: float) -> Vector:
        """Return the motion at time t, (3, n), see ``Trajectory.motion_at``."""
        s = min(max(t / self.duration, 0.0), 1.0)
        position = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        velocity = 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.duration
        acceleration = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (self.duration * self.duration)
        motion = np.array(((position,), (velocity,), (acceleration,))) * (self.end - self.start)
        motion[0] += self.start
        return motion if self.blend is None else np.asarray(motion + self.blend.motion_at(t))


@dataclass(frozen=True, slots=True)
class StreamedTrajectory:
    """Motion of a digit along the streamed targets of a client. The targets are in the state block.

    Attributes:
        duration: 0 [s], because the end of a stream is unknown.
    """

    duration: float = 0.0


@dataclass(frozen=True, slots=True)
class CurveTrajectory:
    """Motion of a digit along a cubic spline through given points.

    The digit is at rest at both ends of the spline. Either all coordinates of a digit share one
    spline, or each coordinate has its own spline.

    Attributes:
        times: (k,) times of the points [s], in rising order from 0.
        coefficients: (4, k - 1) coefficients of the cubic polynomial in each piece of the curve,
            highest power first [rad/s^3 .. rad]. If each coordinate has its own spline, the shape
            is (4, k - 1, n).
        coordinates: number of the digit's coordinates.
    """

    times: Vector
    coefficients: Vector
    coordinates: int

    @staticmethod
    def curve_through_points(
        times: tuple[float, ...], angles: tuple[float, ...] | Vector, coordinates: int
    ) -> "CurveTrajectory":
        """Return the curve through the angles (k,) or (k, n) [rad] at the given times [s]."""
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(times, angles, bc_type="clamped")
        return CurveTrajectory(np.array(times), np.asarray(spline.c), coordinates)

    @property
    def duration(self) -> float:
        """Return the duration of the curve [s]."""
        return float(self.times[-1])

    def motion_at(self, t: float) -> Vector:
        """Return the motion at time t, (3, n), see ``Trajectory.motion_at``."""
        clamped_time = min(max(t, 0.0), self.duration)
        segment_index = min(
            int(np.searchsorted(self.times, clamped_time, side="right")) - 1, len(self.times) - 2
        )
        s = clamped_time - float(self.times[segment_index])
        # The digit rests before the start and after the end of the curve.
        moving = 1.0 if clamped_time == t else 0.0
        if self.coefficients.ndim == 3:
            a, b, c, d = self.coefficients[:, segment_index]
            rate = moving * (c + s * (2 * b + s * 3 * a))
            return np.array((d + s * (c + s * (b + s * a)), rate, moving * (2 * b + 6 * a * s)))
        a, b, c, d = self.coefficients[:, segment_index].tolist()
        values = (
            d + s * (c + s * (b + s * a)),
            moving * (c + s * (2 * b + s * 3 * a)),
            moving * (2 * b + 6 * a * s),
        )
        return _equal_coordinates(values, self.coordinates)

    def peak_speed(self) -> float:
        """Return the largest speed on the curve [rad/s].

        The largest speed occurs at an end of a piece of the curve, or where the acceleration is 0.
        """
        a, b, c, _ = self.coefficients
        length = np.diff(self.times).reshape(-1, *(1,) * (a.ndim - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            turning_points = np.clip(np.nan_to_num(-b / (3 * a)), 0.0, length)
        candidates = [
            c + s * (2 * b + s * 3 * a) for s in (np.zeros_like(length), turning_points, length)
        ]
        return float(np.abs(candidates).max())


@dataclass(frozen=True, slots=True)
class SampledTrajectory:
    """Motion of a digit at a single instant.

    The position, the velocity and the acceleration do not come from a trajectory, but for example
    from a log.

    Attributes:
        position: (n,) coordinates [rad].
        velocity: (n,) rates of the coordinates [rad/s].
        acceleration: (n,) accelerations of the coordinates [rad/s^2].
        duration: 0 [s], because the end of the motion is unknown.
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    duration: float = 0.0

    def motion_at(self, t: float) -> Vector:
        """Return the stored motion (3, n) for every time t.

        See ``Trajectory.motion_at``.
        """
        return np.array((self.position, self.velocity, self.acceleration))


@dataclass(frozen=True, slots=True)
class ChirpTrajectory:
    """Oscillation of a digit about a joint angle, with rising frequency.

    The frequency of the oscillation rises linearly, and the amplitude grows and decays smoothly.

    Attributes:
        centre: mean joint angle [rad].
        amplitude: largest amplitude of the oscillation [rad].
        low: frequency at the start [Hz].
        high: frequency at the end [Hz].
        duration: duration of the oscillation [s].
        coordinates: number of the digit's coordinates, which all have the same motion.
    """

    centre: float
    amplitude: float
    low: float
    high: float
    duration: float
    coordinates: int

    def motion_at(self, t: float) -> Vector:
        """Return the motion at time t, (3, n), see ``Trajectory.motion_at``."""
        s = min(max(t, 0.0), self.duration)
        amplitude, amplitude_rate, amplitude_acceleration = self._amplitude_envelope(s)
        rise = 2.0 * math.pi * (self.high - self.low) / self.duration
        speed = 2.0 * math.pi * self.low + rise * s
        phase = (math.pi * self.low + 0.5 * speed) * s
        sine = math.sin(phase)
        cosine = math.cos(phase)
        position = amplitude * sine
        velocity = amplitude_rate * sine + amplitude * speed * cosine
        acceleration = (
            amplitude_acceleration * sine
            + 2.0 * amplitude_rate * speed * cosine
            + amplitude * (rise * cosine - speed**2 * sine)
        )
        moving = self.amplitude if s == t else 0.0
        values = (self.centre + self.amplitude * position, moving * velocity, moving * acceleration)
        return _equal_coordinates(values, self.coordinates)

    def _amplitude_envelope(self, t: float) -> tuple[float, float, float]:
        """Return the amplitude factor at time t [s], its rate [1/s] and its acceleration [1/s^2]."""
        ramp_duration = 0.1 * self.duration
        time_to_nearest_end = min(t, self.duration - t)
        if time_to_nearest_end >= ramp_duration:
            return 1.0, 0.0, 0.0
        w = math.pi / ramp_duration
        sign = 1.0 if t <= self.duration - t else -1.0
        return (
            0.5 - 0.5 * math.cos(w * time_to_nearest_end),
            sign * 0.5 * w * math.sin(w * time_to_nearest_end),
            0.5 * w * w * math.cos(w * time_to_nearest_end),
        )


def _equal_coordinates(values: tuple[float, float, float], coordinates: int) -> Vector:
    """Return the motion (3, n) in which all n coordinates have the given position, rate and acceleration."""
    return np.array([[value] * coordinates for value in values])


PEAK_SPEED_RATIO = 1.875
"""Ratio of peak to mean speed of a minimum-jerk move: 15 / 8."""


def minimum_jerk_duration(distance: float, speed: float, min_duration: float) -> float:
    """Return the duration of a minimum-jerk move [s].

    The move covers ``distance`` [rad] with the peak speed ``speed`` [rad/s]. The result is at least
    ``min_duration`` [s].
    """
    return max(PEAK_SPEED_RATIO * abs(distance) / speed, min_duration)
