"""Tendons: elasticity, friction over the pulleys, and maps between tendon and joint quantities."""

import math
from dataclasses import dataclass

import numpy as np

from handctl.hand.digit import Array, DigitModel, Values
from handctl.hand.file.sections import Tendon

CAPSTAN_FRICTION_SPEED = 1e-3
"""Speed v0 of the friction's factor tanh(v / v0), which avoids a jump at a reversal [m/s]."""


@dataclass(frozen=True, slots=True)
class TendonElasticity:
    """Tension by stretch: linear up to a knee, then a smooth transition to another stiffness.

    phi = k dl up to f_k. Beyond, with x = dl - f_k / k: phi = f_k + k2 x + (k - k2) w (1 - exp(-x /
    w)). The tendon is slack at dl <= 0.

    Attributes:
        stiffness: k [N/m].
        stiffness_beyond: k2 [N/m].
        knee: f_k [N].
        knee_width: w [m].
        damping: c [N s/m].
    """

    stiffness: float
    stiffness_beyond: float
    knee: float
    knee_width: float
    damping: float

    @staticmethod
    def of(tendon: Tendon) -> "TendonElasticity":
        """Return the elasticity of a tendon from its hand file."""
        return TendonElasticity(
            stiffness=tendon.stiffness_N_per_m,
            stiffness_beyond=tendon.stiffness_beyond_ratio * tendon.stiffness_N_per_m,
            knee=tendon.knee_N,
            knee_width=tendon.knee_width_m,
            damping=tendon.damping_N_s_per_m,
        )

    def elastic(self, stretch: float) -> float:
        """Return the tension of a constant stretch [m] [N]."""
        excess = stretch - self.knee / self.stiffness
        if excess <= 0.0:
            return self.stiffness * max(stretch, 0.0)
        return self.knee + self._tension_above_knee(excess)

    def tension(self, stretch: float, stretch_rate: float) -> float:
        """Return the tension with damping [N], 0 when slack and never below 0.

        Args:
            stretch: stretch [m].
            stretch_rate: rate of the stretch [m/s].
        """
        if stretch <= 0.0:
            return 0.0
        return max(0.0, self.elastic(stretch) + self.damping * stretch_rate)

    def tangent_stiffness(self, stretch: float) -> float:
        """Return the slope of the elastic tension [N/m], 0 when slack."""
        excess = stretch - self.knee / self.stiffness
        if stretch <= 0.0:
            return 0.0
        return self.stiffness if excess <= 0.0 else self._slope(excess)

    def stretch(self, tension: float) -> float:
        """Return the stretch of a constant tension [m], the inverse of ``elastic``.

        Beyond the knee Newton's method starts from the linear law. Its steps approach the solution
        from one side, because the curvature does not change its sign.

        Raises:
            ValueError: the tension is negative or not finite.
        """
        if not 0.0 <= tension < math.inf:
            raise ValueError(f"no stretch holds a tension of {tension} N")
        if tension <= self.knee:
            return tension / self.stiffness
        excess = (tension - self.knee) / self.stiffness
        for _ in range(NEWTON_STEPS):
            step = (tension - self.knee - self._tension_above_knee(excess)) / self._slope(excess)
            excess += step
            # The step is below the resolution of float64.
            if abs(step) <= 1e-15 * excess:
                break
        return self.knee / self.stiffness + excess

    def _tension_above_knee(self, x: float) -> float:
        """Return the tension above the knee for a stretch x above that of the knee [m] [N]."""
        # expm1 keeps its accuracy for x near 0.
        softer = self.stiffness - self.stiffness_beyond
        return self.stiffness_beyond * x - softer * self.knee_width * math.expm1(-x / self.knee_width)

    def _slope(self, x: float) -> float:
        """Return the stiffness for a stretch x above that of the knee [m] [N/m]."""
        return self.stiffness_beyond + (self.stiffness - self.stiffness_beyond) * math.exp(-x / self.knee_width)


NEWTON_STEPS = 100
"""Largest number of Newton steps. About six are usual."""


def pulley_factors(digit: DigitModel, q: Values, speed: Values) -> Array:
    """Return the tension at each joint pulley per load cell tension: exp(-mu phi_i tanh(v / v0)).

    phi_i is the wrap before the first joint plus the joint angles up to and including joint i.
    Winding reduces the tension towards the tip. Paying out increases it, to factors above 1. At
    rest the factor is 1. Source: capstan equation.

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        speed: winding speed of each tendon (n_t,) [m/s].

    Returns:
        Factors (n_t, n).
    """
    # Only joints with a moment arm add to the wrap of a tendon.
    passed = np.cumsum((digit.moment_arms != 0.0) * np.asarray(q), axis=1)
    exponent = digit.friction * np.tanh(np.divide(speed, CAPSTAN_FRICTION_SPEED))
    return np.asarray(np.exp(-exponent[:, None] * (digit.wrap[:, None] + passed)))


def effective_moment_arms(digit: DigitModel, q: Values, speed: Values) -> Array:
    """Return the moment arms R times the friction factors, (n_t, n) [m].

    The joint torques are the transpose of the result times the tensions at the load cells.
    """
    return digit.arms_at(q) * pulley_factors(digit, q, speed)


def excursions(digit: DigitModel, q: Values) -> Array:
    """Return the excursion of each tendon at joint angles, the integral of R, (n_t,) [m]."""
    return digit.excursion_at(q)


def reflected_inertia(digit: DigitModel) -> Array:
    """Return the rotor inertia in the digit's coordinates for stiff tendons, (n_c, n_c) [kg m2].

    It is (R B)^T (J_m / r_a^2) R B.
    """
    arms = digit.reduced_moment_arms
    return np.asarray(arms.T @ (digit.motor_mass[:, None] * arms))
