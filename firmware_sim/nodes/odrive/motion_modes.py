"""Position control, velocity control and the input modes of an ODrive.

    control mode 1 torque, 2 velocity, 3 position
    input mode   1 setpoint as received, 2 velocity ramp, 3 position filter, 5 trapezoid, 6 torque ramp

The inputs are the values of Set_Input_Pos, Set_Input_Vel and Set_Input_Torque. Each of the three
messages sets its inputs in every mode. Each control mode uses only the inputs that it needs. Gains,
filter, ramps and integrator are the same as in the ODrive firmware (MIT licence), controller.cpp.
While the torque is limited, the integrator decays. In each step, the drive plans the rest of the
trapezoid again. The simulated trapezoid differs from the trapezoid of the firmware (trapTraj.cpp)
only if the target changes during the motion.

The simulation differs from the firmware in the following points. A speed above the velocity limit
is not an error, because the position controller limits the velocity demand. Input mode 0 (inactive)
keeps the last setpoint. The simulation has only the control modes and input modes in the two lists
above. The firmware refuses other modes, but the simulation ignores commands in other modes.
"""

import math
from typing import Any, NamedTuple

from firmware_sim.nodes.motion_control import (
    PERIOD_NS,
    CascadeController,
    LoopGains,
    MotionSetpoint,
)
from firmware_sim.nodes.odrive.kernels import (
    CLOSED_LOOP,
    PASSTHROUGH_MODE,
    TORQUE_CONTROL,
    TORQUE_RAMP,
    TURN_RAD,
    follow_torque,
    position_in_turns,
)

VELOCITY_CONTROL = 2
"""Control mode: velocity control."""
POSITION_CONTROL = 3
"""Control mode: position control."""
VELOCITY_RAMP = 2
"""Input mode: the velocity follows the input with a ramp."""
POSITION_FILTER = 3
"""Input mode: the position follows the input through a filter of second order."""
TRAPEZOID = 5
"""Input mode: the position follows a trajectory with a trapezoidal velocity profile."""
MOTION_ENDPOINTS = {
    205: ("vel_ramp_rate", 1.0),
    206: ("torque_ramp_rate", 0.01),
    207: ("input_filter_bandwidth", 2.0),
}
"""Name and vendor's default of each setting that no message can set, by its endpoint number.

The units of the defaults are turn/s2, N m/s and 1/s. The endpoint numbers are assumptions, as in
``bench.ENDPOINT_NUMBERS``. Source of the defaults: ODrive firmware 0.5.6.
"""
VELOCITY_RAMP_RATE, TORQUE_RAMP_RATE, FILTER_BANDWIDTH = MOTION_ENDPOINTS


class MotionSettings(NamedTuple):
    """Settings that the messages 0x11 to 0x1B change, with the vendor's defaults.

    Attributes:
        velocity_limit: velocity limit of trajectories [turn/s].
        acceleration: acceleration of trajectories [turn/s2].
        deceleration: deceleration of trajectories [turn/s2].
        inertia: feedforward torque, divided by the acceleration of the setpoint [N m s2/turn].
        position_gain: gain of the position loop [1/s].
        velocity_gain: gain of the velocity loop [N m s/turn].
        integral_gain: integrator gain of the velocity loop [N m/turn].
    """

    velocity_limit: float = 2.0
    acceleration: float = 0.5
    deceleration: float = 0.5
    inertia: float = 0.0
    position_gain: float = 20.0
    velocity_gain: float = 0.167
    integral_gain: float = 0.333


_FIELDS_BY_MESSAGE = {
    0x11: ("velocity_limit",),
    0x12: ("acceleration", "deceleration"),
    0x13: ("inertia",),
    0x1A: ("position_gain",),
    0x1B: ("velocity_gain", "integral_gain"),
}
"""Settings that each message changes, by the command number of the message."""
_MESSAGES_THAT_ALLOW_ZERO = {0x13, 0x1A, 0x1B}
"""Command numbers of the messages whose values are allowed to be 0."""


class MotionModes:
    """The motion modes of one axis, with inputs, setpoints and controllers.

    Setpoints are given in turns of the shaft.

    Attributes:
        input_position: position of the last Set_Input_Pos [turn].
        input_velocity: velocity of the last Set_Input_Pos or Set_Input_Vel [turn/s].
        settings: settings that messages of the host have set.
        done: True if the axis has completed a trajectory.
    """

    def __init__(self, node: Any) -> None:
        """Connect the modes to the settings and the rotor of an axis, see ``node.OdriveNode``."""
        self._node = node
        self.settings = MotionSettings()
        self.input_position = self.input_velocity = 0.0
        self.done = False
        self._setpoint = MotionSetpoint()
        self._position_at_spool = MotionSetpoint()
        self._torque = 0.0
        self._cascade = CascadeController(node.motor)
        self._updated_ns = 0

    def set(self, command: int, values: tuple[float, ...]) -> None:
        """Apply the settings of a message, if all values in the message are possible."""
        min_value = 0.0 if command in _MESSAGES_THAT_ALLOW_ZERO else math.ulp(0.0)
        if all(min_value <= value < math.inf for value in values):
            self.settings = self.settings._replace(
                **dict(zip(_FIELDS_BY_MESSAGE[command], values, strict=True))
            )

    def take(self, has_position: bool, position: float, velocity: float) -> None:
        """Set the position input and the velocity input.

        Args:
            has_position: True if the message contains a position, which begins a new trajectory.
            position: position input [turn].
            velocity: velocity input [turn/s].
        """
        self.input_position = position
        self.input_velocity = velocity
        self.done = self.done and not has_position

    def start(self, t_ns: int) -> None:
        """Enter the axis state closed loop.

        The input position becomes the present position. The input velocity and the input torque
        become zero.
        """
        node = self._node
        self.input_position = position_in_turns(node, node.motor.encoder())
        self.input_velocity = 0.0
        node.setpoint = self._torque = 0.0
        self._setpoint.jump_to(self.input_position)
        self._cascade.integral = 0.0
        self.done = False
        self._updated_ns = t_ns
        is_plain_torque = (
            node.control_mode == TORQUE_CONTROL and node.input_mode == PASSTHROUGH_MODE
        )
        node.motion_due_ns = 0 if is_plain_torque else max(1, t_ns)
        self.advance(t_ns)

    def advance(self, t_ns: int, is_forced: bool = False) -> None:
        """Update the setpoint and the servo if the update is due.

        Args:
            t_ns: present time [ns].
            is_forced: True to use new inputs at once, even if no update is due.
        """
        node = self._node
        if (
            node.motion_due_ns == 0
            or node.state != CLOSED_LOOP
            or (t_ns < node.motion_due_ns and not is_forced)
        ):
            return
        step_s = (t_ns - self._updated_ns) * 1e-9
        self._updated_ns = t_ns
        node.motion_due_ns = t_ns + PERIOD_NS
        if node.control_mode == TORQUE_CONTROL:
            self._ramp_torque(step_s)
            follow_torque(node, node.motor.servo, self._torque)
            return
        if step_s or node.input_mode == PASSTHROUGH_MODE:
            self._generate_setpoint(step_s)
        self._regulate_servo(step_s)

    def _ramp_torque(self, step_s: float) -> None:
        """Move the torque towards the torque input, if the input mode is the torque ramp."""
        node = self._node
        if node.input_mode == TORQUE_RAMP:
            largest = node.endpoint_float(TORQUE_RAMP_RATE) * step_s
            self._torque += min(largest, max(-largest, node.setpoint - self._torque))

    def _generate_setpoint(self, step_s: float) -> None:
        """Compute the setpoint that the input mode generates."""
        node = self._node
        setpoint = self._setpoint
        settings = self.settings
        mode = node.input_mode
        if mode == PASSTHROUGH_MODE:
            setpoint.jump_to(self.input_position, self.input_velocity)
            self._torque = node.setpoint
        elif mode == VELOCITY_RAMP:
            rate = node.endpoint_float(VELOCITY_RAMP_RATE)
            position = setpoint.position
            setpoint.ramp(self.input_velocity, rate, rate, step_s)
            setpoint.position = position
        elif mode == POSITION_FILTER:
            bandwidth = node.endpoint_float(FILTER_BANDWIDTH)
            setpoint.filter(self.input_position, self.input_velocity, bandwidth, step_s)
        elif mode == TRAPEZOID:
            limits = settings.velocity_limit, settings.acceleration, settings.deceleration
            self.done = setpoint.trapezoid(self.input_position, *limits, step_s)
        if mode in (VELOCITY_RAMP, POSITION_FILTER, TRAPEZOID):
            self._torque = setpoint.acceleration * settings.inertia

    def _regulate_servo(self, step_s: float) -> None:
        """Set the servo to the setpoint, after conversion from turns at the shaft to radians at the spool."""
        node = self._node
        settings = self.settings
        scale = node.direction * TURN_RAD / node.gear
        self._position_at_spool.jump_to(
            node.direction * (self._setpoint.position * TURN_RAD - node.offset) / node.gear,
            self._setpoint.velocity * scale,
        )
        position_gain = settings.position_gain if node.control_mode == POSITION_CONTROL else 0.0
        spool_sign = node.gear**2 / TURN_RAD
        gains = LoopGains(
            position_gain, settings.velocity_gain * spool_sign, settings.integral_gain * spool_sign
        )
        # The drive has a torque limit for each direction. The servo has one torque limit for both
        # directions. So the servo gets the smaller limit of the drive.
        torque_limit = max(0.0, min(node.torque_max, -node.torque_min)) * node.gear
        limit = min(node.peak, node.current_limit * node.torque_constant, torque_limit)
        speed = node.velocity_limit * TURN_RAD / node.gear
        torque = node.direction * node.gear * self._torque
        self._cascade.regulate(self._position_at_spool, gains, speed, limit, step_s, torque)
