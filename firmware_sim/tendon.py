"""One tendon: an elastic rope that pulls and never pushes, and rubs on the pulleys it passes."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.description import TendonSpec
from firmware_sim.rows import RopeRow, array_of


class Tendon(RopeRow):
    """The rope; its law is in ``drivetrain``.

    Attributes:
        tension: at the load cell, between spool and first pulley, as of the last pull [N].
        speed: of the rope towards the spool, positive when the digit closes, as of the last pull [m/s].
        longer: by how much it is longer than described [m].
        slope: rope damping plus friction over speed, for an implicit integrator [N s/m].
    """

    def _describe(self, spec: TendonSpec, spool_radius: float) -> None:
        self.radius = spool_radius
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


class Routing:
    """The tendons of a hand and the joints that each of them passes.

    Attributes:
        tendons: the ropes. rows: the array of them.
        joints: index of each pulley's joint, tendon by tendon. arms: of each pulley [m].
    """

    def __init__(self, specs: Sequence[TendonSpec], joints: list[str], motors: list[str], radii: list[float]) -> None:
        """Args: the tendons; names of the hand's joints and motors; radius of each motor's spool [m]."""
        memory = (Tendon * len(specs))()
        self.tendons: list[Tendon] = list(memory)
        self.rows: Any = array_of(memory, RopeRow)
        path: list[tuple[int, float]] = []
        for rope, spec in zip(self.tendons, specs, strict=True):
            rope.motor = motors.index(spec.motor)
            rope._describe(spec, radii[rope.motor])
            rope.first = len(path)
            path += [(joints.index(name), arm) for name, arm in spec.arms.items() if arm]
            rope.end = len(path)
        self.joints = np.array([joint for joint, _ in path], np.int64)
        self.arms = np.array([arm for _, arm in path], np.float64)
