"""One tendon: an elastic rope that pulls and never pushes, and rubs on the pulleys it passes."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.compiled import array_of
from firmware_sim.description import TendonSpec
from firmware_sim.plant.rows import RopeRow


class Tendon:
    """The rope; its laws are in ``drivetrain``.

    Attributes:
        tension: at the load cell, between spool and first pulley, as of the last pull [N].
        speed: of the rope towards the spool, positive when the digit closes, as of the last pull [m/s].
        slope: rope damping plus friction over speed, for an implicit integrator [N s/m].
        longer: by how much it is longer than described [m].
        radius: of the spool [m].
        stiffness, beyond: up to the knee and far beyond it [N/m]. knee: [N]. knee_stretch, knee_width: [m].
        damping: [N s/m]. friction: coefficient. wrap: angle on the way to the first joint [rad].
        motor: number of its rotor. first, end: numbers of its pulleys, ``first`` to before ``end``.
    """

    first: int
    end: int

    def describe(self, spec: TendonSpec, motor: int, spool_radius: float) -> None:
        """Take over the parameters: of the tendon, the number of its motor, the spool's radius [m]."""
        self.tension = self.speed = self.slope = self.longer = 0.0
        self.motor, self.radius = motor, spool_radius
        self.stiffness, self.damping = spec.stiffness, spec.damping
        self.beyond, self.knee_width, self.knee = spec.stiffness * spec.beyond_ratio, spec.knee_width, spec.knee
        self.knee_stretch = spec.knee / spec.stiffness if spec.stiffness else math.inf
        self.friction, self.wrap = spec.friction, spec.wrap

    def tear(self) -> Callable[[], None]:
        """Bear nothing any more; returns what mends the rope."""
        before = self.stiffness, self.damping, self.knee_stretch
        self.stiffness, self.damping, self.knee_stretch = 0.0, 0.0, math.inf

        def mend() -> None:
            self.stiffness, self.damping, self.knee_stretch = before

        return mend


class TendonRow(RopeRow, Tendon):
    """A tendon whose numbers are a row of an array."""


class Routing:
    """The tendons of a hand and the joints that each of them passes.

    Attributes:
        tendons: the ropes. rows: the array of them, for compiled laws; otherwise the same list.
        joints: of each pulley, tendon by tendon, the joint's index. arms: of each pulley [m]. Arrays, or lists.
    """

    def __init__(
        self, specs: Sequence[TendonSpec], joints: list[str], motors: list[str], radii: list[float], compiled: bool
    ) -> None:
        """Args: the tendons; names of joints and motors; radius of each spool [m]; whether for compiled laws."""
        memory = (TendonRow * len(specs))() if compiled else [Tendon() for _ in specs]
        self.tendons: list[Tendon] = list(memory)
        path: list[tuple[int, float]] = []
        for rope, spec in zip(self.tendons, specs, strict=True):
            motor = motors.index(spec.motor)
            rope.describe(spec, motor, radii[motor])
            rope.first = len(path)
            path += [(joints.index(name), arm) for name, arm in spec.arms.items() if arm]
            rope.end = len(path)
        self.rows: Any = array_of(memory, RopeRow) if compiled else self.tendons
        self.joints: Any = [joint for joint, _ in path]
        self.arms: Any = [arm for _, arm in path]
        if compiled:
            self.joints, self.arms = np.array(self.joints, np.int64), np.array(self.arms, np.float64)
