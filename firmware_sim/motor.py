"""One motor: the rotor at the spool and the servo law inside its drive, integrated with the plant's step.

The drive's own loop (10 to 20 kHz in reality) is faster than the plant's step. It is therefore integrated implicitly:
gains that are stable in the drive are stable here, without sub-steps.
"""

import math
from collections.abc import Callable, Sequence
from math import floor
from typing import Any

from firmware_sim.description import MotorSpec
from firmware_sim.drivetrain import ENCODER_STEP, decide, follow, turn
from firmware_sim.rows import RotorRow, Servo, array_of

CURRENT_LAG_S = 0.3e-3
"""Time constant of the current loop, of the order of a 500 Hz bandwidth."""
VELOCITY_LAG_S = 1e-3
"""Time constant of the drive's velocity estimate."""


class Motor(RotorRow):
    """The rotor.

    Attributes:
        theta: spool angle, positive winds [rad]. omega: [rad/s].
        torque: what the drive believes to make, from its current [N m].
        velocity: the drive's estimate [rad/s].
        heat: integral of torque squared since the node last asked [N2 m2 s].
        servo: what the drive regulates.
        coulomb: friction [N m].
        misread, disobeys: faults of its encoder, and of its power stage, on an angle [rad] and a torque [N m].
    """

    def __init__(self, spec: MotorSpec, step_s: float) -> None:
        """Args: the motor; the plant's step [s]."""
        self._describe(spec, step_s)

    def _describe(self, spec: MotorSpec, step_s: float) -> None:
        self.servo: Servo = self.law
        self.inertia, self.viscous, self.coulomb = spec.inertia, spec.viscous, spec.coulomb
        self.misread: Callable[[float], float] | None = None
        self.disobeys: Callable[[float], float] | None = None
        self.gain, self.step = spec.torque_gain, step_s
        self.lag = 1.0 - math.exp(-step_s / CURRENT_LAG_S)
        self.velocity_lag = 1.0 - math.exp(-step_s / VELOCITY_LAG_S)
        self._row = array_of(self, RotorRow)

    @staticmethod
    def row_by_row(specs: Sequence[MotorSpec], step_s: float) -> "tuple[list[Motor], Any]":
        """Return motors that lie one behind the other, and the array of them."""
        memory = (Motor * len(specs))()
        motors = list(memory)
        for motor, spec in zip(motors, specs, strict=True):
            motor._describe(spec, step_s)
        return motors, array_of(memory, RotorRow)

    @property
    def struck(self) -> bool:
        """Whether a fault stands between it and its encoder or its power stage."""
        return bool(self.misread or self.disobeys)

    def encoder(self) -> float:
        """Return the spool angle as the drive measures it [rad]."""
        angle = floor(self.theta / ENCODER_STEP) * ENCODER_STEP
        misread = self.misread
        return misread(angle) if misread else angle

    def advance(self, load: float) -> None:
        """Integrate one step, semi-implicitly, against the rope's torque [N m]."""
        self.load = load
        self.follow()

    def follow(self) -> None:
        """Integrate one step against the load that is there, with the faults of encoder and power stage."""
        if not self.struck:
            follow(self._row)
            return
        if self.servo.kp or self.servo.kd:
            self.angle = self.encoder()
        decide(self._row)
        if self.disobeys:
            self.command = self.disobeys(self.command)
        turn(self._row)
