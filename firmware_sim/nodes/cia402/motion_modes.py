"""Position, velocity and homing modes of a CiA 402 drive.

Source: fact sheet cia402 and CiA 402-2 (IEC 61800-7-201).

    mode               targets                             control word            status word
    1  profile position  0x607A, 0x6081, 0x6083, 0x6084    4 new set-point         10 target reached
                                                           5 change immediately    12 set-point acknowledged
                                                           6 relative, 8 halt      13 following error
    6  homing            0x6098, 0x6099:2, 0x609A          4 start, 8 halt         10 target reached
                                                                                   12 homing attained
    8  cyclic position   0x607A + 0x60B0, 0x60B1, 0x60B2   -                       12 follows, 13 following error
    9  cyclic velocity   0x60FF + 0x60B1, 0x60B2           -                       12 follows

The units are count, 1/min, 1/min/s and thousandths of the rated torque, as in 0x6064, 0x606C and
0x6071. Bit 11 of the status word is set while a position limit (0x607D) or the speed limit (0x6080)
acts. A following error above the value of object 0x6065 causes fault 0x8611 after the time in
object 0x6066. With the value 0xFFFFFFFF in object 0x6065, no following error causes a fault.

Choices of this simulation:

- When the drive is enabled or changes its mode, 0x607A and the demand become the present position.
  Object 0x60FF keeps its value.
- In cyclic position mode, positions are interpolated over the period in object 0x60C2.
- In profile position mode, the drive stores one set-point in addition to the active set-point.
- After homing, the position at home equals the value of object 0x607C. The methods 33 and 34 move
  to the next index pulse. With the methods 35 and 37, the present position becomes the home
  position.
- The gains of the position and velocity controllers are assumed.
"""

import math
from typing import Any

from firmware_sim.nodes.cia402.kernels import TURN_RAD
from firmware_sim.nodes.cia402.object_dictionary import ABORT_VALUE_OUT_OF_RANGE, SdoAbort
from firmware_sim.nodes.motion_control import (
    PERIOD_NS,
    CascadeController,
    MotionSetpoint,
    assumed_gains,
)

PROFILE_POSITION = 1
HOMING_MODE = 6
CYCLIC_POSITION = 8
CYCLIC_VELOCITY = 9
"""This constant and the three constants above are modes of operation, as in object 0x6060."""
MOTION_MODES = (PROFILE_POSITION, HOMING_MODE, CYCLIC_POSITION, CYCLIC_VELOCITY)
FOLLOWING_ERROR = 0x8611
"""Emergency code: following error."""
TARGET_REACHED_BIT = 1 << 10
INTERNAL_LIMIT_BIT = 1 << 11
SETPOINT_FOLLOWED_BIT = 1 << 12
FOLLOWING_ERROR_BIT = 1 << 13
"""This constant and the three constants above are bits of the status word.

SETPOINT_FOLLOWED_BIT also stands for *set-point acknowledged* and *homing attained*.
"""
NEW_SETPOINT_BIT = 1 << 4
CHANGE_IMMEDIATELY_BIT = 1 << 5
RELATIVE_BIT = 1 << 6
HALT_BIT = 1 << 8
"""This constant and the three constants above are bits of the control word.

In homing mode, NEW_SETPOINT_BIT starts homing.
"""
INDEX_NEGATIVE, INDEX_POSITIVE = 33, 34
"""Homing methods that move to the next index pulse, in negative or positive direction."""
HOMING_METHODS = (INDEX_NEGATIVE, INDEX_POSITIVE, 35, 37)
"""All homing methods of the drive."""
FOLLOWING_ERROR_WINDOW_OFF = 0xFFFFFFFF
"""Value of object 0x6065 (following error window) that switches the supervision of the following error off."""
POSITION_GAIN = 20.0
"""Assumed gain of the position controller [1/s]."""


def check_object_value(object_index: int, value: int) -> None:
    """Check a value before it is written to an object.

    Raises:
        SdoAbort: the value is a homing method that the drive does not have.
    """
    if object_index == 0x6098 and value not in HOMING_METHODS:
        raise SdoAbort(ABORT_VALUE_OUT_OF_RANGE)


class MotionModes:
    """The position, velocity and homing modes of a drive, with demand values and controllers.

    The demand value is the desired shaft position in the unit of the frames [count].
    """

    def __init__(self, node: Any) -> None:
        """Connect the modes to the objects and the rotor of a drive, see ``node.Cia402Node``."""
        self._node = node
        self._demand = MotionSetpoint()
        self._position_at_spool = MotionSetpoint()
        self._cascade = CascadeController(node.motor)
        self._mode = 0
        self._updated_ns = self._in_window_ns = 0
        self._target = 0.0
        self._remaining_s = 0.0
        self._queued_target: float | None = None
        self._control_word = 0
        self._bits = 0
        self._is_homed = False
        self._homing = False
        self._acknowledged = False

    @property
    def is_active(self) -> bool:
        """Return True if the drive is enabled in a motion mode."""
        return self._mode != 0

    def start(self, mode: int, t_ns: int) -> None:
        """Enter a motion mode at the present position, unless the axis is already in this mode."""
        if mode == self._mode:
            return
        node = self._node
        self._mode = mode
        self._updated_ns = self._in_window_ns = t_ns
        self._control_word = node.objects[0x6040, 0]
        self._cascade.integral = 0.0
        self._queued_target = None
        self._is_homed = self._homing = self._acknowledged = False
        self._remaining_s = 0.0
        self._bits = 0
        self._demand.jump_to(self._position(), self._velocity() if mode == CYCLIC_VELOCITY else 0.0)
        self._target = self._demand.position
        node.objects[0x607A, 0] = round(self._target)
        node.motion_due_ns = max(1, t_ns)
        self.advance(t_ns)

    def end(self) -> None:
        """Leave the active motion mode, and clear the status bits of the mode."""
        self._mode = 0
        self._node.motion_due_ns = 0
        self._node.mode_bits = -1

    def take(self, object_index: int) -> None:
        """Apply the new value of an object that a host has written."""
        if object_index == 0x6040:
            self._take_control(self._node.objects[0x6040, 0])
        elif object_index == 0x607A and self._mode == CYCLIC_POSITION:
            self._remaining_s = (
                self._node.objects[0x60C2, 1] * 10.0 ** self._node.objects[0x60C2, 2]
            )

    def _take_control(self, control_word: int) -> None:
        """Apply the mode-specific bits of a control word to the active mode.

        Bit 4 of the control word starts a motion only on its rising edge.
        """
        rising_edge = control_word & ~self._control_word & NEW_SETPOINT_BIT
        self._control_word = control_word
        if self._mode == HOMING_MODE:
            if rising_edge:
                self._start_homing()
            elif not control_word & NEW_SETPOINT_BIT:
                self._homing = False
            return
        if self._mode != PROFILE_POSITION:
            return
        if not rising_edge:
            return
        objects = self._node.objects
        target = float(objects[0x607A, 0])
        if control_word & RELATIVE_BIT:
            target += self._target
        if control_word & CHANGE_IMMEDIATELY_BIT or self._bits & TARGET_REACHED_BIT:
            self._target = self._within_position_limits(target)
            self._queued_target = None
        elif self._queued_target is None:
            self._queued_target = target
        self._acknowledged = True
        # At this point, the bit *target reached* still refers to the previous target.
        self._bits &= ~TARGET_REACHED_BIT

    def _start_homing(self) -> None:
        """Start homing with the method in object 0x6098."""
        node = self._node
        self._homing = True
        self._is_homed = False
        self._bits &= ~(TARGET_REACHED_BIT | SETPOINT_FOLLOWED_BIT)
        method = node.objects[0x6098, 0]
        self._target = self._position()
        if method in (INDEX_NEGATIVE, INDEX_POSITIVE):
            # The index pulse occurs at whole turns of the encoder, wherever the position is zero.
            turn = node.counts
            raw_position = self._position() - node.offset / TURN_RAD * turn
            index_turn = (
                math.floor(raw_position / turn)
                if method == INDEX_NEGATIVE
                else math.ceil(raw_position / turn)
            )
            self._target += index_turn * turn - raw_position
        self._demand.jump_to(self._position())

    def _finish_homing(self) -> None:
        """Finish homing: shift the zero until the present position has the value of 0x607C."""
        node = self._node
        home = node.objects[0x607C, 0]
        node.offset += (home - self._position()) / node.counts * TURN_RAD
        self._demand.jump_to(home)
        self._target = float(home)
        self._is_homed = True

    def advance(self, t_ns: int) -> None:
        """Update the demand, the status bits and the servo if the update is due at the present time [ns]."""
        node = self._node
        if not self._mode or t_ns < node.motion_due_ns:
            return
        step_s = (t_ns - self._updated_ns) * 1e-9
        self._updated_ns = t_ns
        node.motion_due_ns = t_ns + PERIOD_NS
        self._bits &= ~INTERNAL_LIMIT_BIT
        if step_s:
            self._generate_demand(step_s)
        if self._check_following_error(t_ns):
            return
        self._regulate_servo(step_s)
        node.mode_bits = self._status_bits()
        node.objects[0x6062, 0] = round(self._demand.position)

    def _generate_demand(self, step_s: float) -> None:
        """Compute the next demand of the active mode."""
        if self._mode == CYCLIC_VELOCITY:
            self._demand.jump_to(
                self._position(), self._speed_from_object(0x60FF) + self._speed_from_object(0x60B1)
            )
        elif self._mode == CYCLIC_POSITION:
            self._interpolate(step_s)
        elif self._mode == HOMING_MODE:
            self._approach_target(step_s, 0x6099, 2, 0x609A, 0x609A)
            if self._homing and not self._is_homed and self._is_target_reached():
                self._finish_homing()
        else:
            if (
                self._approach_target(step_s, 0x6081, 0, 0x6083, 0x6084)
                and self._queued_target is not None
            ):
                self._target = self._within_position_limits(self._queued_target)
                self._queued_target = None

    def _approach_target(
        self,
        step_s: float,
        speed: int,
        sub_index: int,
        acceleration_index: int,
        deceleration_index: int,
    ) -> bool:
        """Move the demand towards the target, with the speed and the ramps from objects of the drive.

        Return True if the demand has reached the target.
        """
        slope = max(1.0, self._counts_per_s(self._node.objects[deceleration_index, 0]))
        if self._control_word & HALT_BIT:
            self._demand.ramp(0.0, slope, slope, step_s)
            return False
        max_speed = self._counts_per_s(
            min(self._node.objects[speed, sub_index], self._node.objects[0x6080, 0])
        )
        return self._demand.trapezoid(
            self._target,
            max_speed,
            max(1.0, self._counts_per_s(self._node.objects[acceleration_index, 0])),
            slope,
            step_s,
        )

    def _interpolate(self, step_s: float) -> None:
        """Move the demand linearly, to reach the cyclic target at the end of the interpolation period."""
        objects = self._node.objects
        self._target = self._within_position_limits(float(objects[0x607A, 0] + objects[0x60B0, 0]))
        step_fraction = step_s / self._remaining_s if self._remaining_s > step_s else 1.0
        self._remaining_s = max(0.0, self._remaining_s - step_s)
        change = step_fraction * (self._target - self._demand.position)
        self._demand.jump_to(
            self._demand.position + change, change / step_s + self._speed_from_object(0x60B1)
        )

    def _within_position_limits(self, target: float) -> float:
        """Return the target, limited to the software position limits (object 0x607D)."""
        objects = self._node.objects
        limited_position = min(float(objects[0x607D, 2]), max(float(objects[0x607D, 1]), target))
        if limited_position != target:
            self._bits |= INTERNAL_LIMIT_BIT
        return limited_position

    def _check_following_error(self, t_ns: int) -> bool:
        """Check the following error. Return True if the following error has caused a fault."""
        node = self._node
        error = self._demand.position - self._position()
        node.objects[0x60F4, 0] = round(error)
        following_error_window = node.objects[0x6065, 0]
        if (
            self._mode == CYCLIC_VELOCITY
            or following_error_window == FOLLOWING_ERROR_WINDOW_OFF
            or abs(error) <= following_error_window
        ):
            self._in_window_ns = t_ns
            self._bits &= ~FOLLOWING_ERROR_BIT
        else:
            self._bits |= FOLLOWING_ERROR_BIT
        if (
            t_ns - self._in_window_ns < node.objects[0x6066, 0] * 1_000_000
            or t_ns == self._in_window_ns
        ):
            return False
        node.trip(FOLLOWING_ERROR)
        return True

    def _is_target_reached(self) -> bool:
        """Return True if both the demand and the measured position have reached the target."""
        position_window = self._node.objects[0x6067, 0]
        has_arrived = self._demand.position == self._target and self._queued_target is None
        return has_arrived and abs(self._position() - self._target) <= position_window

    def _status_bits(self) -> int:
        """Return the status word bits that the active mode of the drive sets."""
        if self._mode in (CYCLIC_POSITION, CYCLIC_VELOCITY):
            return self._bits | SETPOINT_FOLLOWED_BIT
        if self._control_word & HALT_BIT:
            is_stopped = self._demand.velocity == 0.0
            self._bits = (
                self._bits | TARGET_REACHED_BIT if is_stopped else self._bits & ~TARGET_REACHED_BIT
            )
            return self._bits
        is_reached = self._is_homed if self._mode == HOMING_MODE else self._is_target_reached()
        self._bits = (
            self._bits | TARGET_REACHED_BIT if is_reached else self._bits & ~TARGET_REACHED_BIT
        )
        # In profile position mode, a set-point stays acknowledged until the host clears the bit
        # *new set-point* and the set-point buffer is free.
        self._acknowledged = self._queued_target is not None or (
            self._acknowledged and bool(self._control_word & NEW_SETPOINT_BIT)
        )
        is_followed = self._is_homed if self._mode == HOMING_MODE else self._acknowledged
        self._bits = (
            self._bits | SETPOINT_FOLLOWED_BIT
            if is_followed
            else self._bits & ~SETPOINT_FOLLOWED_BIT
        )
        return self._bits

    def _regulate_servo(self, step_s: float) -> None:
        """Set the servo to the demand, after conversion from counts at the shaft to radians at the spool."""
        node = self._node
        objects = node.objects
        scale = node.direction * TURN_RAD / node.counts / node.gear
        angle = (
            node.direction
            * (self._demand.position / node.counts * TURN_RAD - node.offset)
            / node.gear
        )
        self._position_at_spool.jump_to(angle, self._demand.velocity * scale)
        speed = objects[0x6080, 0] * TURN_RAD / 60.0 / node.gear
        if abs(self._position_at_spool.velocity) > speed:
            self._bits |= INTERNAL_LIMIT_BIT
        thousandth = node.gear * node.rated / 1000.0
        limit = min(node.peak, objects[0x6072, 0] * thousandth)
        gains = assumed_gains(
            node.motor.inertia, 0.0 if self._mode == CYCLIC_VELOCITY else POSITION_GAIN
        )
        torque = node.direction * objects[0x60B2, 0] * thousandth
        self._cascade.regulate(self._position_at_spool, gains, speed, limit, step_s, torque)

    def _position(self) -> float:
        """Return the measured position of the shaft [count]."""
        node = self._node
        return float(
            (node.direction * node.gear * node.motor.encoder() + node.offset)
            / TURN_RAD
            * node.counts
        )

    def _velocity(self) -> float:
        """Return the measured velocity of the shaft [count/s]."""
        node = self._node
        return float(node.direction * node.gear * node.motor.velocity / TURN_RAD * node.counts)

    def _counts_per_s(self, value_per_min: float) -> float:
        """Convert a speed from 1/min to count/s, or an acceleration from 1/min/s to count/s2."""
        return float(value_per_min / 60.0 * self._node.counts)

    def _speed_from_object(self, object_index: int) -> float:
        """Return the value of a velocity object, converted to count/s."""
        return self._counts_per_s(self._node.objects[object_index, 0])
