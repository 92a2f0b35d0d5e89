"""One tendon: elastic, pulls but never pushes, with friction on the pulleys it passes."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.compiled import array_of
from firmware_sim.description import POWERS, TendonSpec
from firmware_sim.plant.structs import TendonStruct

PULLEY = 4 + POWERS
"""Numbers of a pulley: mean arm [m], 1 if it depends on the angle, joint limits [rad], and the powers."""


def _pulley(spec: TendonSpec, joint: str) -> tuple[float, ...]:
    """Return the numbers of a tendon's pulley at a joint."""
    if joint not in spec.curves:
        return (spec.arms[joint], *(0.0,) * (PULLEY - 1))
    curve = spec.curves[joint]
    return (spec.arms[joint], 1.0, curve.low, curve.high, *curve.powers)


class Tendon:
    """The tendon. The kernels of a tendon are in ``drivetrain``.

    Attributes:
        tension: tension at the load cell, between spool and first pulley, in the last step [N].
        speed: speed towards the spool in the last step, positive when the digit closes [m/s].
        slope: damping plus friction divided by speed, for the implicit integrator [N s/m].
        extra_length: length beyond the described length [m].
        radius: radius of the spool [m], negative if a positive spool angle pays the tendon out.
        stiffness: stiffness up to the knee [N/m].
        after_knee: stiffness far beyond the knee [N/m].
        knee: tension of the knee [N].
        knee_stretch: stretch of the knee [m].
        knee_width: width of the transition [m].
        damping: damping [N s/m].
        friction: capstan friction coefficient.
        wrap: wrap angle before the first joint [rad].
        motor: row of its rotor.
        first: index of its first pulley.
        end: index after its last pulley.
    """

    first: int
    end: int

    def describe(self, spec: TendonSpec, motor: int, spool_radius: float) -> None:
        """Set the parameters.

        Args:
            spec: the tendon.
            motor: row of its rotor.
            spool_radius: radius of the spool [m].
        """
        self.tension = self.speed = self.slope = 0.0
        # The pretension of a spool pair is below the knee.
        self.extra_length = -spec.pretension / spec.stiffness if spec.pretension else 0.0
        self.motor = motor
        self.radius = spec.winding * spool_radius
        self.stiffness = spec.stiffness
        self.damping = spec.damping
        self.after_knee = spec.stiffness * spec.after_knee_ratio
        self.knee_width = spec.knee_width
        self.knee = spec.knee
        self.knee_stretch = spec.knee / spec.stiffness if spec.stiffness else math.inf
        self.friction = spec.friction
        self.wrap = spec.wrap

    def snap(self) -> Callable[[], None]:
        """Break the tendon, so that it carries no tension.

        Returns:
            Function that mends the tendon.
        """
        before = self.stiffness, self.damping, self.knee_stretch
        self.stiffness = 0.0
        self.damping = 0.0
        self.knee_stretch = math.inf

        def mend() -> None:
            self.stiffness, self.damping, self.knee_stretch = before

        return mend


class TendonRow(TendonStruct, Tendon):
    """A tendon whose numbers are a row of an array."""


class Routing:
    """The tendons of a hand and the pulleys that each of them passes.

    Attributes:
        tendons: the tendons.
        rows: array of the tendons for compiled kernels, otherwise the same list.
        joints: joint index of each pulley, in the order of the tendons, an array or a list.
        arms: ``PULLEY`` numbers of each pulley, an array or a list.
    """

    def __init__(
        self, specs: Sequence[TendonSpec], joints: list[str], motors: list[str], radii: list[float], compiled: bool
    ) -> None:
        """Build the tendons and their pulleys.

        Args:
            specs: the tendons.
            joints: names of the joints.
            motors: names of the motors.
            radii: radius of each spool [m].
            compiled: True for compiled kernels.
        """
        memory = (TendonRow * len(specs))() if compiled else [Tendon() for _ in specs]
        self.tendons: list[Tendon] = list(memory)
        path: list[tuple[int, tuple[float, ...]]] = []
        for tendon, spec in zip(self.tendons, specs, strict=True):
            motor = motors.index(spec.motor)
            tendon.describe(spec, motor, radii[motor])
            tendon.first = len(path)
            # A joint with moment arm 0 is passed at its axis: no pulley.
            passed = [name for name, arm in spec.arms.items() if arm]
            path += [(joints.index(name), _pulley(spec, name)) for name in passed]
            tendon.end = len(path)
        self.rows: Any = array_of(memory, TendonStruct) if compiled else self.tendons
        self.joints: Any = [joint for joint, _ in path]
        self.arms: Any = [number for _, pulley in path for number in pulley]
        if compiled:
            self.joints = np.array(self.joints, np.int64)
            self.arms = np.array(self.arms, np.float64)
