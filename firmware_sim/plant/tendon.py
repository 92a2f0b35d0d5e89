"""An elastic tendon that pulls but never pushes, with friction on the pulleys that it passes."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.compiled import structure_array
from firmware_sim.description.hand_description import MOMENT_ARM_COEFFICIENT_COUNT, TendonSpec
from firmware_sim.plant.plant_structs import TendonStruct

PRISMATIC_FLAG_INDEX = 4 + MOMENT_ARM_COEFFICIENT_COUNT
"""Index of the prismatic flag: 1 at a prismatic joint, where the tendon does not bend, and 0 at a hinge."""
PARAMETERS_PER_PULLEY = PRISMATIC_FLAG_INDEX + 1
"""Number of parameters of a pulley.

The parameters are the mean moment arm [m], 1 if the moment arm varies, two joint limits [rad], the
coefficients, and the flag at ``PRISMATIC_FLAG_INDEX``.
"""


def _pulley_parameters(spec: TendonSpec, joint: str) -> tuple[float, ...]:
    """Return the parameters of a tendon's pulley at a joint, see ``PARAMETERS_PER_PULLEY``."""
    if joint not in spec.curves:
        prismatic_flag = float(joint in spec.prismatic_joints)
        return (spec.arms[joint], *(0.0,) * (PARAMETERS_PER_PULLEY - 2), prismatic_flag)
    curve = spec.curves[joint]
    return (spec.arms[joint], 1.0, curve.low, curve.high, *curve.coefficients, 0.0)


class Tendon:
    """One tendon of the plant. The kernels of tendons are in ``drivetrain``.

    Attributes:
        tension: tension at the load cell, between spool and first pulley, in the last step [N].
        speed: speed of the tendon towards the spool in the last step [m/s]. The speed is positive
            when the digit closes.
        slope: damping, plus the friction force divided by the tendon speed, for the implicit
            integrator [N s/m].
        extra_length: length of the tendon beyond the length in its description [m].
        radius: radius of the spool [m], negative if a positive spool angle pays the tendon
            out.
        stiffness: stiffness of the tendon at tensions below the knee [N/m].
        after_knee: stiffness of the tendon at tensions far above the knee [N/m].
        knee: highest tension at which the stiffness is constant [N].
        knee_stretch: stretch of the tendon at the knee [m].
        knee_width: width of the transition at the knee, as a difference of the tendon's stretch
            [m].
        damping: viscous damping of the tendon [N s/m].
        friction: coefficient of friction of the tendon in the capstan equation.
        wrap: wrap angle of the tendon before the first joint [rad].
        motor: index of the rotor that winds the tendon, in the array of rotors.
        first: index of the tendon's first pulley.
        end: index of the tendon's last pulley, plus 1.
    """

    first: int
    end: int

    def set_parameters(self, spec: TendonSpec, motor: int, spool_radius: float) -> None:
        """Set the parameters of the tendon. At first, the tendon has no tension.

        Args:
            spec: description of the tendon.
            motor: index of the rotor that winds the tendon, in the array of rotors.
            spool_radius: radius of the spool that winds the tendon [m].
        """
        self.tension = self.speed = self.slope = 0.0
        # The pretension of a spool pair is below the tension at the knee, where the stiffness is
        # constant.
        self.extra_length = -spec.pretension / spec.stiffness if spec.pretension else 0.0
        self.motor = motor
        self.radius = spec.winding_sign * spool_radius
        self.stiffness = spec.stiffness
        self.damping = spec.damping
        self.after_knee = spec.stiffness * spec.stiffness_ratio_above_knee
        self.knee_width = spec.knee_width
        self.knee = spec.knee
        self.knee_stretch = spec.knee / spec.stiffness if spec.stiffness else math.inf
        self.friction = spec.friction
        self.wrap = spec.wrap

    def break_tendon(self) -> Callable[[], None]:
        """Break the tendon, so that the tendon carries no tension.

        Returns:
            Function that repairs the tendon.
        """
        stiffness_before = self.stiffness, self.damping, self.knee_stretch
        self.stiffness = 0.0
        self.damping = 0.0
        self.knee_stretch = math.inf

        def restore_stiffness() -> None:
            self.stiffness, self.damping, self.knee_stretch = stiffness_before

        return restore_stiffness


class TendonRow(TendonStruct, Tendon):
    """A tendon whose state is in an array row, for compiled kernels."""


class TendonRouting:
    """The tendons of a hand, and the pulleys along each tendon.

    Attributes:
        tendons: tendons of the hand.
        rows: array with a row for each tendon, for compiled kernels. Without compiled kernels, the
            attribute is the list ``tendons``.
        joints: joint index of each pulley, tendon by tendon, as an array or a list.
        arms: ``PARAMETERS_PER_PULLEY`` numbers of each pulley, as an array or a list.
    """

    def __init__(
        self,
        specs: Sequence[TendonSpec],
        joints: list[str],
        motors: list[str],
        radii: list[float],
        is_compiled: bool,
    ) -> None:
        """Build the tendons of a hand and their pulleys.

        Args:
            specs: descriptions of the tendons.
            joints: names of the joints.
            motors: names of the motors.
            radii: radius of each spool [m].
            is_compiled: True to create arrays for compiled kernels.
        """
        rows_or_objects = (TendonRow * len(specs))() if is_compiled else [Tendon() for _ in specs]
        self.tendons: list[Tendon] = list(rows_or_objects)
        path: list[tuple[int, tuple[float, ...]]] = []
        for tendon, spec in zip(self.tendons, specs, strict=True):
            motor = motors.index(spec.motor)
            tendon.set_parameters(spec, motor, radii[motor])
            tendon.first = len(path)
            # At a joint with a moment arm of 0, the tendon passes through the joint's axis. So the
            # tendon has no pulley at this joint.
            passed_joints = [name for name, arm in spec.arms.items() if arm]
            path += [(joints.index(name), _pulley_parameters(spec, name)) for name in passed_joints]
            tendon.end = len(path)
        self.rows: Any = (
            structure_array(rows_or_objects, TendonStruct) if is_compiled else self.tendons
        )
        self.joints: Any = [joint for joint, _ in path]
        self.arms: Any = [number for _, pulley in path for number in pulley]
        if is_compiled:
            self.joints = np.array(self.joints, np.int64)
            self.arms = np.array(self.arms, np.float64)
