"""Position-velocity mode, velocity mode and force-position mode of a Damiao motor.

Frames (little-endian). The motor follows the commands of a mode only if register 10 selects this
mode.

    0x100 + ESC_ID  float32 position [rad], float32 largest speed [rad/s]
    0x200 + ESC_ID  float32 velocity [rad/s]
    0x300 + ESC_ID  float32 position [rad], uint16 speed [0.01 rad/s], uint16 current [1/10000 of the largest]

Source: fact sheet mit_damiao and the manual of DM-J4310-2EC. According to the manual, the ramps in
registers ACC and DEC act in position-velocity and velocity mode, and the codes of force-position
mode end at 10000. The gains of the controllers are assumptions. Another assumption is that a value
of 0 in ACC or DEC, as delivered, means no ramp.
"""

import math
from typing import Any

from firmware_sim.nodes.mit import registers as reg
from firmware_sim.nodes.motion_control import (
    PERIOD_NS,
    CascadeController,
    LoopGains,
    MotionSetpoint,
    assumed_gains,
)

NEVER_NS = (1 << 63) - 1
"""Time of the next update for a motor without a setpoint, which means never [ns]."""


class MotionModes:
    """The motion modes of a motor, with the setpoint and the controllers of each mode.

    Attributes:
        due_ns: time of the next update of the setpoint [ns].
    """

    def __init__(self, node: Any) -> None:
        """Connect the modes to the registers and the rotor of a motor, see ``node.MitNode``."""
        self._node = node
        self._setpoint = MotionSetpoint()
        self._cascade = CascadeController(node.motor)
        self._running = False
        self._target = self._speed = 0.0
        self._fraction = 1.0
        self._gains = assumed_gains(node.motor.inertia)
        self._updated_ns = 0
        self.due_ns = NEVER_NS

    def follow_velocity(self, velocity: float) -> None:
        """Take the target velocity [rad/s] from a frame."""
        self._set_target(
            assumed_gains(self._node.motor.inertia, 0.0),
            self._node.direction * velocity,
            math.inf,
            1.0,
        )

    def follow_position(self, position: float, speed: float) -> None:
        """Take the target position [rad] and the largest speed [rad/s] from a frame."""
        self._set_target(
            assumed_gains(self._node.motor.inertia), self._position_at_spool(position), speed, 1.0
        )

    def follow_force_position(self, position: float, speed: float, fraction: float) -> None:
        """Store target position [rad], largest speed [rad/s] and largest current (as a fraction) from a frame."""
        self._set_target(
            assumed_gains(self._node.motor.inertia),
            self._position_at_spool(position),
            speed,
            fraction,
        )

    def _position_at_spool(self, position: float) -> float:
        return float(self._node.direction * (position - self._node.offset))

    def _set_target(self, gains: LoopGains, target: float, speed: float, fraction: float) -> None:
        """Store the gains, a target at the spool, and the limits of the motion.

        The limits are the largest speed and a fraction of the largest torque.
        """
        self._gains = gains
        self._target = target
        self._speed = speed
        self._fraction = fraction

    def start(self, t_ns: int) -> None:
        """Follow the target from a given time on [ns].

        If the motor followed no target before, the ramps start from the present motion of the
        motor.
        """
        if not self._running:
            self._running = True
            self._updated_ns = t_ns
            self._setpoint.jump_to(self._node.motor.encoder(), self._node.motor.velocity)
            self._cascade.integral = 0.0
            self.due_ns = t_ns
        self.advance(t_ns)

    def end(self) -> None:
        """Stop following the target."""
        self._running = False
        self.due_ns = NEVER_NS

    def advance(self, t_ns: int) -> None:
        """Update the setpoint and the servo if the update is due at the present time [ns]."""
        if not self._running or t_ns < self.due_ns:
            return
        step_s = (t_ns - self._updated_ns) * 1e-9
        self._updated_ns = t_ns
        self.due_ns = t_ns + PERIOD_NS
        node = self._node
        registers = node.registers
        max_speed = min(registers[reg.MAX_SPEED], node.velocity_range)
        speed = min(self._speed, max_speed)
        acceleration = registers[reg.ACCELERATION] or math.inf
        deceleration = -registers[reg.DECELERATION] or math.inf
        if self._gains.position == 0.0:
            self._setpoint.position = node.motor.encoder()
            target = min(max_speed, max(-max_speed, self._target))
            if acceleration == deceleration == math.inf:
                self._setpoint.velocity = target
            elif step_s:
                self._setpoint.ramp(target, acceleration, deceleration, step_s)
        elif node.mode == reg.MODE_FORCE or acceleration == deceleration == math.inf:
            # In force-position mode, the controllers limit the speed, and the setpoint does not.
            self._setpoint.jump_to(self._target)
        elif step_s:
            self._setpoint.trapezoid(self._target, speed, acceleration, deceleration, step_s)
        limit = min(1.0, self._fraction) * min(node.torque_peak, node.torque_range)
        self._cascade.regulate(self._setpoint, self._gains, speed, limit, step_s)
