"""One motor: the rotor at the spool and the servo law inside its drive, integrated with the plant's step.

The drive's own loop (10 to 20 kHz in reality) is faster than the plant's step. It is therefore integrated implicitly:
gains that are stable in the drive are stable here, without sub-steps.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import tanh

from firmware_sim.description import MotorSpec

CURRENT_LAG_S = 0.3e-3
"""Time constant of the current loop, of the order of a 500 Hz bandwidth."""
COULOMB_SPEED = 0.05
"""Spool speed at which Coulomb friction is 76 % developed [rad/s]; 0.25 mm/s of rope."""
ENCODER_STEP = 2.0 * math.pi / (1 << 14)
"""14 bit at the spool [rad]. Source: MODEL, section 4."""
VELOCITY_LAG_S = 1e-3
"""Time constant of the drive's velocity estimate."""


@dataclass(slots=True)
class Servo:
    """What the drive regulates, in the hand's sign (positive winds): kp (p - theta) + kd (v - omega) + torque.

    Attributes:
        kp: [N m/rad]. kd: [N m s/rad]. position: [rad]. velocity: [rad/s]. torque: [N m].
        limit: the drive's own limit on the sum [N m].
    """

    kp: float = 0.0
    kd: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    limit: float = 0.0

    def release(self) -> None:
        """Command no torque: the motor coasts."""
        self.kp = self.kd = self.position = self.velocity = self.torque = 0.0


class Motor:
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

    __slots__ = (
        "_gain", "_inertia", "_lag", "_step", "_velocity_lag", "_viscous",
        "coulomb", "disobeys", "heat", "misread", "omega", "servo", "theta", "torque", "velocity",
    )  # fmt: skip

    def __init__(self, spec: MotorSpec, step_s: float) -> None:
        """Args: the motor; the plant's step [s]."""
        self._inertia, self._viscous, self.coulomb = spec.inertia, spec.viscous, spec.coulomb
        self.misread: Callable[[float], float] | None = None
        self.disobeys: Callable[[float], float] | None = None
        self._gain, self._step = spec.torque_gain, step_s
        self._lag = 1.0 - math.exp(-step_s / CURRENT_LAG_S)
        self._velocity_lag = 1.0 - math.exp(-step_s / VELOCITY_LAG_S)
        self.theta = self.omega = self.torque = self.velocity = self.heat = 0.0
        self.servo = Servo()

    def encoder(self) -> float:
        """Return the spool angle as the drive measures it [rad]."""
        angle = math.floor(self.theta / ENCODER_STEP) * ENCODER_STEP
        return self.misread(angle) if self.misread else angle

    def advance(self, load: float) -> None:
        """Integrate one step, semi-implicitly, against the rope's torque [N m]."""
        h, servo, omega, torque = self._step, self.servo, self.omega, self.torque
        command, limit, coulomb = servo.torque, servo.limit, self.coulomb
        bend = tanh(omega / COULOMB_SPEED)
        slope = coulomb * (1.0 - bend * bend) / COULOMB_SPEED
        inertia = self._inertia / h + slope
        drag = load + coulomb * bend
        if servo.kp or servo.kd:
            command = self._regulate(inertia, drag)
        if command > limit:
            command = limit
        elif command < -limit:
            command = -limit
        if self.disobeys:
            command = self.disobeys(command)
        torque += self._lag * (command - torque)
        omega = (inertia * omega + self._gain * torque - drag) / (inertia + self._viscous)
        self.torque, self.omega = torque, omega
        self.theta += h * omega
        self.velocity += self._velocity_lag * (omega - self.velocity)
        self.heat += h * torque * torque

    def _regulate(self, inertia: float, drag: float) -> float:
        """Return the law's torque [N m] at the velocity that the rotor will have at the end of the step."""
        servo, lag, gain = self.servo, self._lag, self._gain
        fixed = servo.torque + servo.kp * (servo.position - self.encoder()) + servo.kd * servo.velocity
        stiff = servo.kd + self._step * servo.kp
        push = inertia * self.omega + gain * ((1.0 - lag) * self.torque + lag * fixed) - drag
        return fixed - stiff * push / (inertia + self._viscous + gain * lag * stiff)
