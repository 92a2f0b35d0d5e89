"""One tendon: an elastic rope that pulls and never pushes, and rubs on the pulleys it passes."""

import math
from collections.abc import Callable, Sequence
from math import exp, tanh

from firmware_sim.description import TendonSpec

CAPSTAN_SPEED = 1e-3
"""Rope speed at which friction is 76 % developed [m/s]. Source: MODEL, section 3, v0."""


class Tendon:
    """The rope's law, in scalars because a hand has few tendons and numpy costs more than the arithmetic.

    Attributes:
        tension: at the load cell, between spool and first pulley, as of the last ``pull`` [N].
        speed: of the rope towards the spool, positive when the digit closes, as of the last ``pull`` [m/s].
        longer: by how much it is longer than described [m].
        slope: rope damping plus friction over speed, for an implicit integrator [N s/m].
    """

    __slots__ = (
        "_c", "_friction", "_k", "_k2", "_knee", "_knee_stretch", "_width", "_wrap",
        "longer", "path", "radius", "slope", "speed", "tension",
    )  # fmt: skip

    def __init__(self, spec: TendonSpec, joints: list[str], spool_radius: float) -> None:
        """Args: the tendon; the hand's joints in order; the spool's radius [m]."""
        self.radius = spool_radius
        self.path = [(joints.index(name), arm) for name, arm in spec.arms.items() if arm]
        self._k, self._c = spec.stiffness, spec.damping
        self._k2, self._width, self._knee = spec.stiffness * spec.beyond_ratio, spec.knee_width, spec.knee
        self._knee_stretch = spec.knee / spec.stiffness if spec.stiffness else math.inf
        self._friction, self._wrap = spec.friction, spec.wrap
        self.tension = self.speed = self.slope = self.longer = 0.0

    def tear(self) -> Callable[[], None]:
        """Bear nothing any more; returns what mends the rope."""
        before = self._k, self._c, self._knee_stretch
        self._k, self._c, self._knee_stretch = 0.0, 0.0, math.inf

        def mend() -> None:
            self._k, self._c, self._knee_stretch = before

        return mend

    def elastic(self, stretch: float) -> float:
        """Return the tension of a rope at rest [N] stretched by so much [m]: linear, then softer beyond the knee.

        Source: MODEL, section 3, ``phi``; the softening is a parameter, the paper prints no curve.
        """
        if stretch <= 0.0:
            return 0.0
        x = stretch - self._knee_stretch
        if x <= 0.0:
            return self._k * stretch
        return self._knee + self._k2 * x + (self._k - self._k2) * self._width * (1.0 - math.exp(-x / self._width))

    def tension_at(self, q: Sequence[float], dq: Sequence[float], theta: float, omega: float) -> float:
        """Return the tension at the load cell [N].

        Args:
            q: joint angles, shape (joints,) [rad].
            dq: joint velocities, shape (joints,) [rad/s].
            theta: spool angle, positive winds, 0 where the rope is just taut at q = 0 [rad].
            omega: spool velocity [rad/s].
        """
        stretch, rate = self.radius * theta - self.longer, self.radius * omega
        for joint, arm in self.path:
            stretch -= arm * q[joint]
            rate -= arm * dq[joint]
        if stretch <= 0.0:
            return 0.0
        return max(0.0, self.elastic(stretch) + self._c * rate)

    def pull(self, q: Sequence[float], dq: Sequence[float], theta: float, omega: float, torque: list[float]) -> float:
        """Add the rope's joint torques to ``torque`` [N m] and return the tension at the load cell [N].

        The tension at a pulley is that behind it, its own joint angle's wrap included. Source: MODEL, section 3.
        """
        path, radius = self.path, self.radius
        stretch, speed = radius * theta - self.longer, 0.0
        for joint, arm in path:
            stretch -= arm * q[joint]
            speed += arm * dq[joint]
        self.speed = speed
        if stretch <= 0.0:
            self.tension = self.slope = 0.0
            return 0.0
        elastic = self._k * stretch if stretch <= self._knee_stretch else self.elastic(stretch)
        tension = elastic + self._c * (radius * omega - speed)
        if tension <= 0.0:
            self.tension = self.slope = 0.0
            return 0.0
        rub, angle, least, most = self._friction * tanh(speed / CAPSTAN_SPEED), self._wrap, tension, tension
        for joint, arm in path:
            angle += q[joint]
            local = tension * exp(-rub * angle)
            torque[joint] += arm * local
            if local < least:
                least = local
            elif local > most:
                most = local
        loss = tension - least if tension - least > most - tension else most - tension
        self.slope = self._c + self._secant(loss, tension * angle, speed)
        self.tension = tension
        return tension

    def _secant(self, loss: float, tension_angle: float, speed: float) -> float:
        """Return friction over speed [N s/m]; the secant, because the tangent lets friction reverse a light link.

        Args:
            loss: of tension by friction [N].
            tension_angle: tension times angle of wrap [N rad].
            speed: of the rope [m/s].
        """
        if abs(speed) < 1e-3 * CAPSTAN_SPEED:
            return tension_angle * self._friction / CAPSTAN_SPEED
        return loss / abs(speed)
