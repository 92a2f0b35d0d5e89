"""Motor equation in weak form: the equation is multiplied by a smooth time window and integrated.

With the weak form, no measured signal has to be differentiated.

    K u(t - d) = J/r w' + b/r w + tau_c/r sgn w + r f      per window: all terms times a window, integrated by parts

Here, u is the commanded motor torque, converted to a force at the tendon. The variable w is the
speed of the spool, and f is the tension at the load cell. All terms are forces at the tendon [N].
Source: modulating functions (Shinbrot 1954). Integration by parts moves the derivatives from the
signals to the window. The derivatives of the window function are known exactly.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.tune.identify.tendon_data import Array, TendonData

HALF_WINDOW_S = 0.022
"""Half the length of a window [s].

A window of 44 ms has enough bandwidth for the motion of a motor of a hand. Half of the window
contains eleven load-cell samples at 500 Hz.
"""
MIN_HALF_WINDOW_SAMPLES = 6
"""Smallest half length of a window [samples].

The half length of a window is a whole number of samples, because only then the sums over samples
equal the integrals.
"""
SPACING_FRACTION = 0.4
"""Distance between the centres of neighbouring windows, as a fraction of the half length of a window."""
MIN_SPEED_RAD_S = 0.25
"""Smallest speed of the spool in a window that is used [rad/s].

At lower speeds of the spool, the sign of the friction is not known.
"""


@dataclass(frozen=True, slots=True)
class MotorWindows:
    """Signals of a motor and its tendon, averaged with a time window.

    Each array has the shape (m,). Motor torques are converted to forces at the tendon.

    Attributes:
        t: time at the centre of each window [s].
        tension: tension of the tendon, averaged with the window [N].
        acceleration: acceleration of the tendon, averaged with the window [m/s^2].
        speed: speed of the tendon, averaged with the window [m/s].
        sign: sign of the speed.
        commands: (m, taps) commanded forces during each window and shortly before and after [N].
        offsets: (taps + 1,) times at which the commands change, relative to the centre of the
            window [s].
        half_window_s: half of the length of a window [s].
        noise_ratio: standard deviation of an averaged tension, divided by the standard deviation of
            one reading [1].
    """

    t: Array
    tension: Array
    acceleration: Array
    speed: Array
    sign: Array
    commands: Array
    offsets: Array
    half_window_s: float
    noise_ratio: float

    def delayed_command(self, delay: float) -> Array:
        """Average the commanded force over each window (m,) [N]. Commands take effect after a ``delay`` [s]."""
        weights = np.diff(_window_integral((self.offsets + delay) / self.half_window_s))
        return np.asarray(self.commands @ weights)


class WindowWeights(NamedTuple):
    """Weights of the samples in a window. Each array has the shape (n,).

    Attributes:
        samples: positions of the samples relative to the centre of the window.
        mean: weights that give the mean of a signal.
        first_derivative: weights that give the negative first derivative [1/s].
        second_derivative: weights that give the second derivative [1/s^2].
    """

    samples: NDArray[np.intp]
    mean: Array
    first_derivative: Array
    second_derivative: Array

    @staticmethod
    def from_period(period: float) -> "WindowWeights":
        """Return the weights for a control period [s]."""
        half_window = max(MIN_HALF_WINDOW_SAMPLES, round(HALF_WINDOW_S / period))
        half_window_s = half_window * period
        samples = np.arange(-half_window, half_window + 1)
        s = np.asarray(samples / half_window, np.float64)
        return WindowWeights(
            samples,
            _window_value(s) / half_window,
            _window_slope(s) / half_window_s / half_window,
            _window_curvature(s) / half_window_s**2 / half_window,
        )

    def derivatives(self, values: Array) -> tuple[Array, Array, Array]:
        """Return the mean, the first derivative and the second derivative of a signal.

        The signal is given in windows of n samples, with the shape (..., n). Each result has one
        value per window, with the shape (...).
        """
        # Integration by parts replaces the derivative of the signal by the negative derivative of
        # the window function.
        return values @ self.mean, -values @ self.first_derivative, values @ self.second_derivative


def motor_windows(data: TendonData, spool_radius: float) -> MotorWindows:
    """Return the signals of a tendon and its motor, averaged with time windows.

    A window is left out in three cases: the tendon moves too slowly, the tendon changes its
    direction, or a reading is missing.
    """
    period = data.period
    weights = WindowWeights.from_period(period)
    samples = weights.samples
    half_window = len(samples) // 2
    centres = np.arange(
        half_window + 3,
        len(data.t) - half_window - 3,
        max(1, round(SPACING_FRACTION * half_window)),
    )
    rows = centres[:, None] + samples
    travel = data.travel[rows]
    _, speed, acceleration = weights.derivatives(travel)
    quick_speed = speed_from_difference(data.travel, period)
    is_window_complete = data.torque_mask[rows].all(axis=1) & np.isfinite(
        travel + data.tension[rows]
    ).all(axis=1)
    is_window_moving = np.abs(quick_speed[rows]).min(axis=1) > MIN_SPEED_RAD_S * spool_radius
    # All signs in a window are equal if the absolute value of their sum is the number of readings.
    is_selected = (
        is_window_complete
        & is_window_moving
        & (np.abs(np.sign(quick_speed[rows]).sum(axis=1)) == len(samples))
    )
    taps = np.arange(-half_window - 2, half_window + 3)
    return MotorWindows(
        t=data.t[centres][is_selected],
        tension=(data.tension[rows] @ weights.mean)[is_selected],
        acceleration=acceleration[is_selected],
        speed=speed[is_selected],
        sign=np.sign(speed[is_selected]),
        commands=data.command[centres[is_selected][:, None] + taps],
        offsets=np.append(taps, taps[-1] + 1) * period,
        half_window_s=half_window * period,
        noise_ratio=float(np.sqrt((weights.mean**2).sum())),
    )


def speed_from_difference(travel: Array, period: float, half_window: int = 3) -> Array:
    """Return the speed for a series of travels, from differences over a few control periods [m/s].

    At both ends of the data, the returned speed is zero.
    """
    speed = np.full(len(travel), np.nan)
    speed[half_window:-half_window] = (travel[2 * half_window :] - travel[: -2 * half_window]) / (
        2 * half_window * period
    )
    return np.asarray(np.nan_to_num(speed))


def _window_value(s: Array) -> Array:
    """Return the window function: proportional to cos^4 over [-1, 1], and 0 outside, with an area of 1."""
    # At the ends of the window, the first three derivatives of the window function are 0. Therefore
    # integration by parts gives no boundary terms.
    return np.asarray(np.where(np.abs(s) < 1.0, 4.0 / 3.0 * np.cos(0.5 * np.pi * s) ** 4, 0.0))


def _window_slope(s: Array) -> Array:
    """Return the first derivative of the window function."""
    slope_inside_window = (
        -8.0 / 3.0 * np.pi * np.cos(0.5 * np.pi * s) ** 3 * np.sin(0.5 * np.pi * s)
    )
    return np.asarray(np.where(np.abs(s) < 1.0, slope_inside_window, 0.0))


def _window_curvature(s: Array) -> Array:
    """Return the second derivative of the window function."""
    c2 = np.cos(0.5 * np.pi * s) ** 2
    curvature_inside_window = 4.0 / 3.0 * np.pi**2 * c2 * (3.0 - 4.0 * c2)
    return np.asarray(np.where(np.abs(s) < 1.0, curvature_inside_window, 0.0))


def _window_integral(s: Array) -> Array:
    """Return the integral of the window function from -1 to s."""
    c = np.clip(s, -1.0, 1.0)
    return np.asarray(
        0.5
        + 0.5 * c
        + np.sin(np.pi * c) * 2.0 / (3.0 * np.pi)
        + np.sin(2.0 * np.pi * c) / (12.0 * np.pi)
    )
