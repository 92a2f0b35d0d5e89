"""Tendons: their elasticity, their friction on pulleys, and conversions between quantities of tendons and of joints."""

import math
from dataclasses import dataclass

import numpy as np

from handctl.hand.digit import Array, DigitModel, JointValues
from handctl.hand.file.section_models import Tendon

CAPSTAN_FRICTION_SPEED_M_S = 1e-3
"""Speed v0 in the factor tanh(v / v0) of the friction [m/s].

The factor tanh(v / v0) avoids a jump of the friction when the motion reverses.
"""


@dataclass(frozen=True, slots=True)
class TendonElasticity:
    """Tension of a tendon as a function of its stretch.

    The tension increases linearly with the stretch up to a point that is called the knee. Beyond
    the knee, the stiffness changes smoothly to a different value.

    The tension f at the stretch dl is k dl up to the knee. Beyond the knee, with x = dl - f_k / k,
    the tension is f = f_k + k2 x + (k - k2) w (1 - exp(-x / w)). The tendon is slack at dl <= 0.

    Attributes:
        stiffness: k, stiffness up to the knee [N/m].
        stiffness_beyond_knee: k2, stiffness far beyond the knee [N/m].
        knee: f_k, tension at the knee [N].
        knee_width: w, change of stretch over which the stiffness changes [m].
        damping: c, tension per rate of change of the stretch [N s/m].
    """

    stiffness: float
    stiffness_beyond_knee: float
    knee: float
    knee_width: float
    damping: float

    @staticmethod
    def from_tendon(tendon: Tendon) -> "TendonElasticity":
        """Return the elasticity of a tendon that a hand file describes."""
        return TendonElasticity(
            stiffness=tendon.stiffness_N_per_m,
            stiffness_beyond_knee=tendon.stiffness_beyond_ratio * tendon.stiffness_N_per_m,
            knee=tendon.knee_N,
            knee_width=tendon.knee_width_m,
            damping=tendon.damping_N_s_per_m,
        )

    def elastic_tension(self, stretch: float) -> float:
        """Return the elastic tension [N] at a given constant stretch [m]."""
        excess = stretch - self.knee / self.stiffness
        if excess <= 0.0:
            return self.stiffness * max(stretch, 0.0)
        return self.knee + self._tension_above_knee(excess)

    def tension(self, stretch: float, stretch_rate: float) -> float:
        """Return the tension [N] of the tendon, including the damping.

        The tension of a slack tendon is 0. The tension is never below 0.

        Args:
            stretch: stretch of the tendon [m].
            stretch_rate: rate of change of the stretch [m/s].
        """
        if stretch <= 0.0:
            return 0.0
        return max(0.0, self.elastic_tension(stretch) + self.damping * stretch_rate)

    def tangent_stiffness(self, stretch: float) -> float:
        """Return the derivative [N/m] of the elastic tension with respect to the stretch.

        The derivative is 0 for a slack tendon.
        """
        excess = stretch - self.knee / self.stiffness
        if stretch <= 0.0:
            return 0.0
        return self.stiffness if excess <= 0.0 else self._slope(excess)

    def stretch(self, tension: float) -> float:
        """Return the stretch [m] at a given constant tension [N].

        This method is the inverse of the method ``elastic_tension``.

        Beyond the knee, Newton's method starts from the stretch of a linear tendon. The Newton
        steps approach the solution from one side, because the curvature of the tension has the same
        sign everywhere.

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
            # The Newton step is smaller than the resolution of float64.
            if abs(step) <= 1e-15 * excess:
                break
        return self.knee / self.stiffness + excess

    def _tension_above_knee(self, x: float) -> float:
        """Return the rise of the tension [N] above the tension at the knee, for a stretch x [m] beyond the knee."""
        # The function expm1 is accurate even for x close to 0.
        stiffness_decrease = self.stiffness - self.stiffness_beyond_knee
        return self.stiffness_beyond_knee * x - stiffness_decrease * self.knee_width * math.expm1(
            -x / self.knee_width
        )

    def _slope(self, x: float) -> float:
        """Return the stiffness [N/m] for a stretch that is x [m] larger than the stretch at the knee."""
        return self.stiffness_beyond_knee + (
            self.stiffness - self.stiffness_beyond_knee
        ) * math.exp(-x / self.knee_width)


NEWTON_STEPS = 100
"""Largest number of Newton steps. Usually about six Newton steps are sufficient."""


def pulley_factors(digit: DigitModel, q: JointValues, speed: JointValues) -> Array:
    """Return the ratio of the tension at each joint pulley to the load-cell tension: exp(-mu phi_i tanh(v / v0)).

    The angle phi_i is the sum of the wrap angle before the first joint and the angles of the
    crossed joints up to joint i. While the spool winds the tendon up, friction reduces the tension
    towards the tip, and the ratios are below 1. While the spool unwinds the tendon, friction
    increases the tension towards the tip, and the ratios are above 1. If the tendon is at rest, the
    tension is the same at all pulleys, and the ratios are 1. Source: capstan equation.

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        speed: winding speed of each tendon (n_t,) [m/s].

    Returns:
        Friction factor for each tendon and joint (n_t, n).
    """
    # Only the hinges that a tendon crosses increase the wrap angle of the tendon.
    has_pulley = (digit.moment_arms != 0.0) & ~digit.is_prismatic
    wrapped_angles = np.cumsum(has_pulley * np.asarray(q), axis=1)
    exponent = digit.friction * np.tanh(np.divide(speed, CAPSTAN_FRICTION_SPEED_M_S))
    return np.asarray(np.exp(-exponent[:, None] * (digit.wrap[:, None] + wrapped_angles)))


def effective_moment_arms(digit: DigitModel, q: JointValues, speed: JointValues) -> Array:
    """Return the effective moment arms (n_t, n) [m]: the moment arms R times the friction factors.

    The joint torques are the transposed effective moment arms times the load-cell tensions.
    """
    return digit.moment_arms_at(q) * pulley_factors(digit, q, speed)


def excursions(digit: DigitModel, q: JointValues) -> Array:
    """Return the excursion (n_t,) [m] of each tendon at given joint angles.

    The excursion of a tendon is the integral of its moment arms over the joint angles.
    """
    return digit.excursion_at_angles(q)


def reflected_inertia(digit: DigitModel) -> Array:
    """Return the inertia (n_c, n_c) [kg m2] of the rotors, converted to the coordinates of the digit.

    The computation assumes rigid tendons. The result is (R B)^T (J_m / r_a^2) R B, with the moment
    arms R, the coupling B, the rotor inertias J_m and the spool radii r_a.
    """
    arms = digit.reduced_moment_arms
    return np.asarray(arms.T @ (digit.motor_mass[:, None] * arms))
