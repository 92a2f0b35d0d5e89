"""Generators of setpoints, and cascaded controllers, for the position and velocity modes of the drives.

In a real drive, the position and velocity controllers run at 10 to 20 kHz. In the simulation, the
position loop runs once per millisecond. The velocity loop is a part of the servo (``plant.motor``),
which is integrated implicitly. The drives of all protocols use the same cascade of controllers:

    velocity demand = position gain (position - angle) + velocity, within +-speed
    torque          = velocity gain (velocity demand - omega) + integral + feedforward, within +-limit

Position, velocity and torque are values at the spool. A positive value winds the tendon up.
"""

import math
from typing import NamedTuple

from firmware_sim.plant.motor import Motor

PERIOD_NS = 1_000_000
"""Period of the setpoint generators and position loops [ns]."""
VELOCITY_BANDWIDTH = 200.0
"""Assumed bandwidth of the velocity loop of drives without a documented gain [1/s]."""
INTEGRAL_GAIN_RATIO = 20.0
"""Integral gain divided by velocity gain, for drives without a documented gain [1/s].

The ratio of the gains is an assumption.
"""
POSITION_GAIN = 10.0
"""Assumed position gain of drives without a documented gain [1/s]."""
INTEGRAL_DECAY = 0.99**8
"""Factor by which the integral of the velocity loop decays in each period while the torque is limited.

Source: ODrive firmware, controller.cpp: the integral decays by a factor of 0.99 in each of eight
loops per millisecond.
"""


class LoopGains(NamedTuple):
    """Gains of a position loop around a velocity loop, converted to the spool.

    Attributes:
        position: gain of the position loop [1/s], or 0 in velocity mode.
        velocity: gain of the velocity loop [N m s/rad].
        integral: integral gain of the velocity loop [N m/rad].
    """

    position: float
    velocity: float
    integral: float


def assumed_gains(inertia: float, position: float = POSITION_GAIN) -> LoopGains:
    """Return assumed gains for a drive without documented gains.

    The assumed gains follow from an inertia [kg m2] and a position gain [1/s].
    """
    velocity = VELOCITY_BANDWIDTH * inertia
    return LoopGains(position, velocity, INTEGRAL_GAIN_RATIO * velocity)


class MotionSetpoint:
    """A setpoint of position, velocity and acceleration that changes from step to step.

    Attributes:
        position: position setpoint [rad].
        velocity: velocity setpoint [rad/s].
        acceleration: acceleration of the setpoint in the last step [rad/s2].
    """

    def __init__(self, position: float = 0.0, velocity: float = 0.0) -> None:
        """Start the setpoint at a position [rad] with a velocity [rad/s]."""
        self.jump_to(position, velocity)

    def jump_to(self, position: float, velocity: float = 0.0) -> None:
        """Set the setpoint at once, without a ramp."""
        self.position = position
        self.velocity = velocity
        self.acceleration = 0.0

    def ramp(
        self, velocity: float, acceleration: float, deceleration: float, step_s: float
    ) -> None:
        """Change the setpoint's velocity towards a target [rad/s], and advance the position of the setpoint.

        Args:
            velocity: target velocity [rad/s].
            acceleration: largest acceleration while the speed increases [rad/s2].
            deceleration: largest deceleration while the speed decreases [rad/s2].
            step_s: duration of the step [s].
        """
        is_decelerating = self.velocity * (velocity - self.velocity) < 0.0
        largest = (deceleration if is_decelerating else acceleration) * step_s
        change = min(largest, max(-largest, velocity - self.velocity))
        if is_decelerating and abs(change) > abs(self.velocity):
            # When the motion reverses, the velocity is zero for one step, because the acceleration
            # limit can differ from the deceleration limit.
            change = -self.velocity
        self.velocity += change
        self.acceleration = change / step_s
        self.position += step_s * self.velocity

    def trapezoid(
        self, target: float, speed: float, acceleration: float, deceleration: float, step_s: float
    ) -> bool:
        """Move the setpoint towards a position with a trapezoidal velocity profile.

        Each step plans the remaining motion again, from the present position and velocity of the
        setpoint.

        Args:
            target: target position [rad].
            speed: largest speed [rad/s].
            acceleration: largest acceleration [rad/s2].
            deceleration: largest deceleration [rad/s2].
            step_s: duration of the step [s].

        Returns:
            True if the setpoint has reached the target.
        """
        remaining_distance = target - self.position
        if math.isinf(deceleration):
            stopping_speed = abs(remaining_distance) / step_s
        else:
            # The lines below compute the largest speed from which the setpoint can stop within the
            # remaining distance, if each step changes the velocity by fall * step_s.
            half_speed_step = 0.5 * deceleration * step_s
            stopping_speed = (
                math.sqrt(
                    half_speed_step * half_speed_step + 2.0 * deceleration * abs(remaining_distance)
                )
                - half_speed_step
            )
        # In the last step, the setpoint jumps to the target. The jump requires up to twice the
        # deceleration limit.
        min_speed = deceleration * step_s
        if (
            abs(remaining_distance) <= min(min_speed, speed) * step_s
            and abs(self.velocity) <= 2.0 * min_speed
        ):
            self.jump_to(target)
            return True
        self.ramp(
            math.copysign(
                min(speed, stopping_speed, abs(remaining_distance) / step_s), remaining_distance
            ),
            acceleration,
            deceleration,
            step_s,
        )
        return False

    def filter(self, position: float, velocity: float, bandwidth: float, step_s: float) -> None:
        """Move the setpoint towards a position [rad] with a critically damped filter of second order.

        Source: ODrive firmware, controller.cpp, INPUT_MODE_POS_FILTER.
        """
        damping = 2.0 * bandwidth
        change = 0.25 * damping * damping * (position - self.position) + damping * (
            velocity - self.velocity
        )
        self.acceleration = change
        self.velocity += step_s * change
        self.position += step_s * self.velocity


class CascadeController:
    """A position loop and a velocity loop with an integrator, for the servo of a motor.

    Attributes:
        integral: torque of the integrator [N m].
    """

    def __init__(self, motor: Motor) -> None:
        """Connect the controller to the encoder and the servo of a motor."""
        self._motor = motor
        self.integral = 0.0

    def regulate(
        self,
        setpoint: MotionSetpoint,
        gains: LoopGains,
        speed: float,
        limit: float,
        step_s: float,
        torque: float = 0.0,
    ) -> None:
        """Compute the velocity demand and the torque, and set the servo of the motor for the next step.

        Args:
            setpoint: setpoint of the generator.
            gains: gains of both loops.
            speed: largest velocity demand [rad/s].
            limit: torque limit [N m].
            step_s: time since the last call [s]. If the time is 0, the integrator keeps its value.
            torque: feedforward torque [N m].
        """
        motor = self._motor
        servo = motor.servo
        demand = setpoint.velocity
        if gains.position:
            demand += gains.position * (setpoint.position - motor.encoder())
        demand = min(speed, max(-speed, demand))
        error = demand - motor.velocity
        if abs(gains.velocity * error + self.integral + torque) > limit:
            self.integral *= INTEGRAL_DECAY if step_s else 1.0
        else:
            self.integral += gains.integral * error * step_s
        servo.kp = servo.speed_gain = 0.0
        servo.kd = gains.velocity
        servo.velocity = demand
        servo.torque = self.integral + torque
        servo.limit = limit
