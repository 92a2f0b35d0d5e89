"""A motor: the rotor at the spool and the servo of the drive, integrated with the time step of the plant.

The control loop of a real drive runs at 10 to 20 kHz, which is faster than the time steps of the
plant. Because of the long time steps, the simulation integrates the drive's control loop
implicitly. With the implicit integration, gains that are stable in the drive are stable in the
simulation, without sub-steps.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from firmware_sim.compiled import structure_array
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.plant.drivetrain import (
    compute_command,
    encoder_angle,
    integrate_motor,
    measure_angle,
)
from firmware_sim.plant.plant_structs import RotorStruct, Servo

CURRENT_LAG_S = 0.3e-3
"""Time constant of the drive's current loop [s], for a bandwidth of about 500 Hz."""
VELOCITY_LAG_S = 1e-3
"""Time constant of the drive's velocity estimate [s]."""


def time_step_factors(step_s: float) -> tuple[float, float, float]:
    """Compute the motor parameters for a given time step.

    The parameters are the time step [s], the lag of the current, and the lag of the velocity
    estimate. A lag is the fraction by which a first-order filter approaches its input in one step.
    """
    return step_s, 1.0 - math.exp(-step_s / CURRENT_LAG_S), 1.0 - math.exp(-step_s / VELOCITY_LAG_S)


class Motor:
    """The rotor of one motor. The kernels of a motor are in ``drivetrain``.

    Attributes:
        theta: spool angle, positive in the winding direction [rad].
        omega: angular velocity of the spool [rad/s].
        torque: torque of the motor, which the drive derives from the current [N m].
        velocity: angular velocity that the drive estimates [rad/s].
        heat: integral of the squared torque since the node last updated its temperatures [N2 m2 s].
        servo: setpoints and gains of the drive. A fault can replace the servo by the servo of
            another motor.
        own_servo: setpoints and gains of the motor itself in the memory of the rotor, for kernels.
        inertia: inertia of the rotor [kg m2].
        viscous: viscous friction of the rotor [N m s/rad].
        coulomb: Coulomb friction of the rotor [N m].
        gain: true torque divided by the torque that the drive derives from its current.
        top_speed: speed of the motor without load [rad/s], 0 for a motor without a speed
            limit.
        stall_torque: torque of the motor at standstill, if only the supply voltage limits the
            torque [N m].
        step: time step of the plant [s].
        lag: fraction by which the motor current approaches its command in one step.
        velocity_lag: fraction by which the estimated velocity approaches the true velocity in one
            step.
        load: torque of the tendons on the spool [N m].
        angle: spool angle as measured by the servo [rad].
        command: torque command of the current loop [N m].
        drag: torque of the load plus Coulomb friction [N m].
        impedance: inertia divided by the step, plus the slope of the friction [N m s/rad].
        steps_alone: True if Python code steps the rotor, and False if ``step_drivetrain`` steps the
            rotor.
        number: index of the rotor in the array of all rotors of a hand.
        encoder_fault: function that changes the measured angle [rad], or None without a fault.
        power_stage_fault: function that changes the torque command [N m], or None without a fault.
        faulty: True if the encoder or the power stage has a fault.
    """

    own_servo: Servo
    number = 0
    _encoder_fault: Callable[[float], float] | None
    _power_stage_fault: Callable[[float], float] | None

    def __init__(self, spec: MotorSpec, step_s: float) -> None:
        """Set the parameters of the rotor, and put the rotor at rest.

        Args:
            spec: description of the motor.
            step_s: time step of the plant [s].
        """
        self.own_servo = Servo()
        self._set_parameters(spec, step_s)

    def _set_parameters(self, spec: MotorSpec, step_s: float) -> None:
        """Set the parameters of the motor, and put the motor at rest."""
        self.theta = self.omega = self.torque = self.velocity = self.heat = 0.0
        self.inertia = spec.inertia
        self.viscous = spec.viscous
        self.coulomb = spec.coulomb
        self.gain = spec.torque_gain
        self.top_speed = spec.top_speed
        self.stall_torque = spec.stall_torque
        self.set_step_duration(step_s)
        self.load = self.angle = self.command = self.drag = self.impedance = 0.0
        self.steps_alone = False
        self.servo = self.own_servo
        self._encoder_fault = self._power_stage_fault = None
        self.faulty = False

    @property
    def encoder_fault(self) -> Callable[[float], float] | None:
        """Return the function that changes the measured angle, or None if the encoder has no fault."""
        return self._encoder_fault

    @encoder_fault.setter
    def encoder_fault(self, fault: Callable[[float], float] | None) -> None:
        self._encoder_fault = fault
        self.faulty = fault is not None or self._power_stage_fault is not None

    @property
    def power_stage_fault(self) -> Callable[[float], float] | None:
        """Return the function that changes the torque command, or None if the power stage has no fault."""
        return self._power_stage_fault

    @power_stage_fault.setter
    def power_stage_fault(self, fault: Callable[[float], float] | None) -> None:
        self._power_stage_fault = fault
        self.faulty = fault is not None or self._encoder_fault is not None

    def set_step_duration(self, step_s: float) -> None:
        """Set the length of the following time steps [s]."""
        self.step, self.lag, self.velocity_lag = time_step_factors(step_s)

    def encoder(self) -> float:
        """Return the spool angle as the drive measures it [rad]."""
        angle = encoder_angle(self.theta)
        encoder_fault = self._encoder_fault
        return encoder_fault(angle) if encoder_fault else angle

    def advance(self, load: float) -> None:
        """Integrate the motor over one time step against the torque of the tendons [N m] (semi-implicit Euler)."""
        self.load = load
        self.step_without_plant()

    def step_without_plant(self) -> None:
        """Integrate the motor over a step against the present load, and apply faults of encoder and power stage."""
        measure_angle(self)
        if self._encoder_fault and (self.servo.kp or self.servo.kd):
            self.angle = self._encoder_fault(self.angle)
        compute_command(self)
        if self._power_stage_fault:
            self.command = self._power_stage_fault(self.command)
        integrate_motor(self)


class MotorRow(RotorStruct, Motor):
    """A motor whose state is in an array row, for compiled kernels."""


def motor_rows(specs: Sequence[MotorSpec], step_s: float) -> tuple[list[Motor], Any]:
    """Create motors that keep their state in the rows of one array.

    Args:
        specs: descriptions of the motors.
        step_s: time step of the plant [s].

    Returns:
        The motors, and the array with the rows of the motors.
    """
    rows = (MotorRow * len(specs))()
    motors: list[Motor] = list(rows)
    for number, (motor, spec) in enumerate(zip(motors, specs, strict=True)):
        motor._set_parameters(spec, step_s)
        motor.number = number
    return motors, structure_array(rows, RotorStruct)
