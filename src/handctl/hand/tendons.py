"""Tendons: the elastic rope, its friction over the pulleys, and how forces and motions pass between cable and joint."""

import math
from dataclasses import dataclass

import numpy as np

from handctl.hand.digit import Array, DigitModel, Values
from handctl.hand.file.sections import Tendon

ROPE_FRICTION_SPEED = 1e-3
"""Winding speed at which capstan friction is mostly developed, v0 of tanh(v / v0) [m/s]; a regularisation."""


@dataclass(frozen=True, slots=True)
class TendonLaw:
    """Tension of a rope by its stretch: straight up to a knee, then bending over smoothly to another stiffness.

    phi = k dl up to f_k; beyond, with x = dl - f_k / k: phi = f_k + k2 x + (k - k2) w (1 - exp(-x / w)).
    The rope is slack at dl <= 0.

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
    def of(tendon: Tendon) -> "TendonLaw":
        """Law of a tendon of a hand file."""
        return TendonLaw(
            stiffness=tendon.stiffness_N_per_m,
            stiffness_beyond=tendon.stiffness_beyond_ratio * tendon.stiffness_N_per_m,
            knee=tendon.knee_N,
            knee_width=tendon.knee_width_m,
            damping=tendon.damping_N_s_per_m,
        )

    def elastic(self, stretch: float) -> float:
        """Tension of a stretch [m] held still [N]."""
        beyond = stretch - self.knee / self.stiffness
        if beyond <= 0.0:
            return self.stiffness * max(stretch, 0.0)
        return self.knee + self._beyond(beyond)

    def tension(self, stretch: float, stretch_rate: float) -> float:
        """Tension with damping [N]; a rope cannot push, so never below zero, and nothing when slack.

        Args:
            stretch: [m].
            stretch_rate: [m/s].
        """
        if stretch <= 0.0:
            return 0.0
        return max(0.0, self.elastic(stretch) + self.damping * stretch_rate)

    def tangent_stiffness(self, stretch: float) -> float:
        """Slope of the elastic tension [N/m]; zero when slack."""
        beyond = stretch - self.knee / self.stiffness
        if stretch <= 0.0:
            return 0.0
        return self.stiffness if beyond <= 0.0 else self._slope(beyond)

    def stretch(self, tension: float) -> float:
        """Inverse of ``elastic``: the stretch that holds a tension [m].

        Beyond the knee by Newton's method from the straight law's value: the law bends one way only, so that the
        steps approach the solution from one side and cannot miss it.

        Raises:
            ValueError: the tension is negative or not finite.
        """
        if not 0.0 <= tension < math.inf:
            raise ValueError(f"no stretch holds a tension of {tension} N")
        if tension <= self.knee:
            return tension / self.stiffness
        beyond = (tension - self.knee) / self.stiffness
        for _ in range(NEWTON_STEPS):
            step = (tension - self.knee - self._beyond(beyond)) / self._slope(beyond)
            beyond += step
            if abs(step) <= 1e-15 * beyond:
                break
        return self.knee / self.stiffness + beyond

    def _beyond(self, x: float) -> float:
        """Tension above the knee's, x beyond its stretch."""
        softer = self.stiffness - self.stiffness_beyond
        return self.stiffness_beyond * x - softer * self.knee_width * math.expm1(-x / self.knee_width)

    def _slope(self, x: float) -> float:
        return self.stiffness_beyond + (self.stiffness - self.stiffness_beyond) * math.exp(-x / self.knee_width)


NEWTON_STEPS = 100
"""Upper bound; about six are needed."""


def pulley_factors(digit: DigitModel, q: Values, speed: Values) -> Array:
    """Share of the load cell's tension that acts at each joint pulley: exp(-mu phi_i tanh(v / v0)).

    phi_i is the wrap before the first joint plus the joint angles passed up to and including joint i. Winding loses
    tension towards the tip, paying out gains (above 1), standing still does neither. Source: capstan equation.

    Args:
        digit: the digit.
        q: (n,) [rad].
        speed: (n_t,) winding speed of each tendon [m/s].

    Returns:
        (n_t, n).
    """
    passed = np.cumsum((digit.moment_arms != 0.0) * np.asarray(q), axis=1)
    exponent = digit.friction * np.tanh(np.divide(speed, ROPE_FRICTION_SPEED))
    return np.asarray(np.exp(-exponent[:, None] * (digit.wrap[:, None] + passed)))


def effective_moment_arms(digit: DigitModel, q: Values, speed: Values) -> Array:
    """R with friction: joint torque is its transpose times the tension at the load cells, (n_t, n) [m]."""
    return digit.moment_arms * pulley_factors(digit, q, speed)


def excursion(digit: DigitModel, q: Values) -> Array:
    """Travel of each tendon that joint angles take up, R q, (n_t,) [m]."""
    return np.asarray(digit.moment_arms @ np.asarray(q))


def reflected_inertia(digit: DigitModel) -> Array:
    """Rotor inertia as the digit's coordinates feel it through stiff ropes, (R B)^T (J_m / r_a^2) R B, (n_c, n_c)."""
    arms = digit.reduced_moment_arms
    return np.asarray(arms.T @ (digit.motor_mass[:, None] * arms))
