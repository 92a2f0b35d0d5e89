"""One motor: the rotor at the spool and the servo inside its drive, integrated with the plant's step.

The control loop of a real drive (10 to 20 kHz) is faster than the step of the plant. The simulation
integrates the loop implicitly, so that gains that are stable in the drive are also stable in the
simulation, without sub-steps.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from firmware_sim.compiled import array_of
from firmware_sim.description import MotorSpec
from firmware_sim.plant.drivetrain import compute_command, encoded, integrate, measure_angle
from firmware_sim.plant.structs import RotorStruct, Servo

CURRENT_LAG_S = 0.3e-3
"""Time constant of the current loop [s], for a bandwidth of about 500 Hz."""
VELOCITY_LAG_S = 1e-3
"""Time constant of the drive's velocity estimate [s]."""


def step_factors(step_s: float) -> tuple[float, float, float]:
    """Compute step [s], current lag and velocity lag of a motor for a step length [s].

    A lag is the fraction by which a first-order filter approaches its input in one step.
    """
    return step_s, 1.0 - math.exp(-step_s / CURRENT_LAG_S), 1.0 - math.exp(-step_s / VELOCITY_LAG_S)


class Motor:
    """The rotor of one motor. The kernels of a motor are in ``drivetrain``.

    Attributes:
        theta: spool angle, positive winds [rad].
        omega: spool velocity [rad/s].
        torque: torque that the drive derives from its current [N m].
        velocity: velocity estimate of the drive [rad/s].
        heat: integral of the squared torque since the node's last thermal update [N2 m2 s].
        servo: setpoints and gains that the drive regulates. A fault can replace it by another
            motor's.
        servo_row: the same values in the memory of the rotor, for kernels.
        inertia: inertia of the rotor [kg m2].
        viscous: viscous friction [N m s/rad].
        coulomb: Coulomb friction [N m].
        gain: true torque divided by the torque that the drive believes.
        top_speed: no-load speed [rad/s], 0 for a motor without a speed limit.
        stall_torque: torque at standstill if only the supply voltage limited it [N m].
        step: step of the plant [s].
        lag: fraction by which the current approaches its command in one step.
        velocity_lag: fraction by which the estimate approaches the velocity in one step.
        load: torque of the tendon [N m].
        angle: spool angle as measured by the servo [rad].
        command: torque command of the current loop [N m].
        drag: load plus Coulomb friction [N m].
        impedance: inertia divided by step, plus the slope of the friction [N m s/rad].
        steps_alone: True if the rotor is stepped by Python and not by ``step_drivetrain``.
        number: row among the rotors of a hand.
        encoder_fault: change of the measured angle [rad], None without fault.
        power_stage_fault: change of the torque command [N m], None without fault.
        faulty: True with a fault of encoder or power stage.
    """

    servo_row: Servo
    number = 0
    _encoder_fault: Callable[[float], float] | None
    _power_stage_fault: Callable[[float], float] | None

    def __init__(self, spec: MotorSpec, step_s: float) -> None:
        """Set up the rotor at rest.

        Args:
            spec: the motor.
            step_s: step of the plant [s].
        """
        self.servo_row = Servo()
        self._describe(spec, step_s)

    def _describe(self, spec: MotorSpec, step_s: float) -> None:
        """Set the parameters and the state at rest."""
        self.theta = self.omega = self.torque = self.velocity = self.heat = 0.0
        self.inertia = spec.inertia
        self.viscous = spec.viscous
        self.coulomb = spec.coulomb
        self.gain = spec.torque_gain
        self.top_speed = spec.top_speed
        self.stall_torque = spec.stall_torque
        self.set_step(step_s)
        self.load = self.angle = self.command = self.drag = self.impedance = 0.0
        self.steps_alone = False
        self.servo = self.servo_row
        self._encoder_fault = self._power_stage_fault = None
        self.faulty = False

    @property
    def encoder_fault(self) -> Callable[[float], float] | None:
        """Return the fault of the encoder."""
        return self._encoder_fault

    @encoder_fault.setter
    def encoder_fault(self, fault: Callable[[float], float] | None) -> None:
        self._encoder_fault = fault
        self.faulty = fault is not None or self._power_stage_fault is not None

    @property
    def power_stage_fault(self) -> Callable[[float], float] | None:
        """Return the fault of the power stage."""
        return self._power_stage_fault

    @power_stage_fault.setter
    def power_stage_fault(self, fault: Callable[[float], float] | None) -> None:
        self._power_stage_fault = fault
        self.faulty = fault is not None or self._encoder_fault is not None

    def set_step(self, step_s: float) -> None:
        """Set the length of the next steps [s]."""
        self.step, self.lag, self.velocity_lag = step_factors(step_s)

    def encoder(self) -> float:
        """Return the spool angle as measured by the drive [rad]."""
        angle = encoded(self.theta)
        encoder_fault = self._encoder_fault
        return encoder_fault(angle) if encoder_fault else angle

    def advance(self, load: float) -> None:
        """Integrate one step against a tendon torque [N m], semi-implicitly."""
        self.load = load
        self.step_alone()

    def step_alone(self) -> None:
        """Integrate one step against the present load, with the faults of encoder and power stage."""
        measure_angle(self)
        if self._encoder_fault and (self.servo.kp or self.servo.kd):
            self.angle = self._encoder_fault(self.angle)
        compute_command(self)
        if self._power_stage_fault:
            self.command = self._power_stage_fault(self.command)
        integrate(self)


class MotorRow(RotorStruct, Motor):
    """A motor whose numbers are a row of an array."""


def motor_rows(specs: Sequence[MotorSpec], step_s: float) -> tuple[list[Motor], Any]:
    """Make motors whose numbers are the rows of one array.

    Args:
        specs: the motors.
        step_s: step of the plant [s].

    Returns:
        The motors, and the array.
    """
    memory = (MotorRow * len(specs))()
    motors: list[Motor] = list(memory)
    for number, (motor, spec) in enumerate(zip(motors, specs, strict=True)):
        motor._describe(spec, step_s)
        motor.number = number
    return motors, array_of(memory, RotorStruct)
