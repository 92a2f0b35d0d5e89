"""One motor: the rotor at the spool and the servo law inside its drive, integrated with the plant's step.

The drive's own loop (10 to 20 kHz in reality) is faster than the plant's step. It is therefore integrated implicitly:
gains that are stable in the drive are stable here, without sub-steps.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from firmware_sim.compiled import array_of
from firmware_sim.description import MotorSpec
from firmware_sim.plant.drivetrain import decide, encoded, see, turn
from firmware_sim.plant.rows import RotorRow, Servo

CURRENT_LAG_S = 0.3e-3
"""Time constant of the current loop, of the order of a 500 Hz bandwidth."""
VELOCITY_LAG_S = 1e-3
"""Time constant of the drive's velocity estimate."""


def paced(step_s: float) -> tuple[float, float, float]:
    """Return step, lag and velocity lag of a motor for steps of a length [s]."""
    return step_s, 1.0 - math.exp(-step_s / CURRENT_LAG_S), 1.0 - math.exp(-step_s / VELOCITY_LAG_S)


class Motor:
    """The rotor; its laws are in ``drivetrain``.

    Attributes:
        theta: spool angle, positive winds [rad]. omega: [rad/s].
        torque: what the drive believes to make, from its current [N m].
        velocity: the drive's estimate [rad/s].
        heat: integral of torque squared since the node last asked [N2 m2 s].
        servo, law: what the drive regulates.
        inertia: [kg m2]. viscous: [N m s/rad]. coulomb: friction [N m]. gain: torque that appears over that believed.
        step: of the plant [s]. lag, velocity_lag: shares by which current and estimate follow in a step.
        load: torque of the rope [N m]. angle: of the spool as the servo sees it [rad]. command: to the current [N m].
        drag: load and Coulomb friction [N m]. stiff: inertia over step, and the slope of the friction [N m s/rad].
        waits: whether it turns by itself, not with the others.
        number: of its row among the rotors of a hand.
        misread, disobeys: faults of its encoder, and of its power stage, on an angle [rad] and a torque [N m].
        faulty: whether it has either fault.
    """

    law: Servo
    number = 0
    _misread: Callable[[float], float] | None
    _disobeys: Callable[[float], float] | None

    def __init__(self, spec: MotorSpec, step_s: float) -> None:
        """Args: the motor; the plant's step [s]."""
        self.law = Servo()
        self._describe(spec, step_s)

    def _describe(self, spec: MotorSpec, step_s: float) -> None:
        self.theta = self.omega = self.torque = self.velocity = self.heat = 0.0
        self.inertia, self.viscous, self.coulomb = spec.inertia, spec.viscous, spec.coulomb
        self.gain = spec.torque_gain
        self.pace(step_s)
        self.load = self.angle = self.command = self.drag = self.stiff = 0.0
        self.waits, self.servo = False, self.law
        self._misread = self._disobeys = None
        self.faulty = False

    @property
    def misread(self) -> Callable[[float], float] | None:
        """The fault of its encoder."""
        return self._misread

    @misread.setter
    def misread(self, fault: Callable[[float], float] | None) -> None:
        self._misread = fault
        self.faulty = fault is not None or self._disobeys is not None

    @property
    def disobeys(self) -> Callable[[float], float] | None:
        """The fault of its power stage."""
        return self._disobeys

    @disobeys.setter
    def disobeys(self, fault: Callable[[float], float] | None) -> None:
        self._disobeys = fault
        self.faulty = fault is not None or self._misread is not None

    def pace(self, step_s: float) -> None:
        """Change the length of the next steps [s]."""
        self.step, self.lag, self.velocity_lag = paced(step_s)

    def encoder(self) -> float:
        """Return the spool angle as the drive measures it [rad]."""
        angle, misread = encoded(self.theta), self._misread
        return misread(angle) if misread else angle

    def advance(self, load: float) -> None:
        """Integrate one step, semi-implicitly, against the rope's torque [N m]."""
        self.load = load
        self.follow()

    def follow(self) -> None:
        """Integrate one step against the load that is there, with the faults of encoder and power stage."""
        see(self)
        if self._misread and (self.servo.kp or self.servo.kd):
            self.angle = self._misread(self.angle)
        decide(self)
        if self._disobeys:
            self.command = self._disobeys(self.command)
        turn(self)


class MotorRow(RotorRow, Motor):
    """A motor whose numbers are a row of an array."""


def row_by_row(specs: Sequence[MotorSpec], step_s: float) -> tuple[list[Motor], Any]:
    """Return motors that lie one behind the other, and the array of them; the step is the plant's [s]."""
    memory = (MotorRow * len(specs))()
    motors: list[Motor] = list(memory)
    for number, (motor, spec) in enumerate(zip(motors, specs, strict=True)):
        motor._describe(spec, step_s)
        motor.number = number
    return motors, array_of(memory, RotorRow)
