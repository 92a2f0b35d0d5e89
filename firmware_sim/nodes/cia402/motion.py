"""Position, velocity and homing modes of a CiA 402 drive. Source: facts, cia402, and CiA 402-2 (IEC 61800-7-201).

    mode               targets                             control word            status word
    1  profile position  0x607A, 0x6081, 0x6083, 0x6084    4 new set-point         10 target reached
                                                           5 change immediately    12 set-point acknowledged
                                                           6 relative, 8 halt      13 following error
    6  homing            0x6098, 0x6099:2, 0x609A          4 start, 8 halt         10 target reached
                                                                                   12 homing attained
    8  cyclic position   0x607A + 0x60B0, 0x60B1, 0x60B2   -                       12 follows, 13 following error
    9  cyclic velocity   0x60FF + 0x60B1, 0x60B2           -                       12 follows

Units: count, 1/min, 1/min/s, thousandths of the rated torque, as 0x6064, 0x606C and 0x6071. Bit 11 of
the status word is set while a position limit (0x607D) or the speed limit (0x6080) acts. A following
error above 0x6065 for longer than 0x6066 is fault 0x8611, and 0xFFFFFFFF switches it off.

Choices:

- Enabling, or a change of the mode, takes the present position as 0x607A and as demand. 0x60FF is kept.
- Cyclic positions are interpolated over 0x60C2.
- Profile position keeps one set-point beside the active one.
- After homing the home position reads 0x607C. Methods: 33 and 34 (index pulse), 35 and 37 (here).
- The gains of the cascade are assumed.
"""

import math
from typing import Any

from firmware_sim.nodes.cia402.dictionary import OUT_OF_RANGE, Abort
from firmware_sim.nodes.cia402.kernels import TURN
from firmware_sim.nodes.motion import PERIOD_NS, Cascade, Setpoint, assumed_gains

PROFILE_POSITION = 1
HOMING = 6
CYCLIC_POSITION = 8
CYCLIC_VELOCITY = 9
"""Modes of operation."""
MODES = (PROFILE_POSITION, HOMING, CYCLIC_POSITION, CYCLIC_VELOCITY)
FOLLOWING_ERROR = 0x8611
"""Emergency code: following error."""
REACHED = 1 << 10
LIMITED = 1 << 11
FOLLOWS = 1 << 12
DEVIATES = 1 << 13
"""Bits of the status word. FOLLOWS is also set-point acknowledged and homing attained."""
NEW_SETPOINT = 1 << 4
IMMEDIATELY = 1 << 5
RELATIVE = 1 << 6
HALT = 1 << 8
"""Bits of the control word. NEW_SETPOINT is also the start of homing."""
INDEX_NEGATIVE, INDEX_POSITIVE = 33, 34
"""Homing methods: next index pulse in a direction."""
HOMING_METHODS = (INDEX_NEGATIVE, INDEX_POSITIVE, 35, 37)
"""Homing methods of the drive."""
NO_WINDOW = 0xFFFFFFFF
"""Following error window that is off."""
POSITION_GAIN = 20.0
"""Position gain [1/s], an assumption."""


def check_write(index: int, value: int) -> None:
    """Check a value before it is written.

    Raises:
        Abort: the drive has no such homing method.
    """
    if index == 0x6098 and value not in HOMING_METHODS:
        raise Abort(OUT_OF_RANGE)


class MotionModes:
    """Demand and cascade of one drive. The demand is the position on the wire [count] at the shaft."""

    def __init__(self, node: Any) -> None:
        """Use objects and rotor of a ``node.Cia402Node``."""
        self._node = node
        self._demand = Setpoint()
        self._at_spool = Setpoint()
        self._cascade = Cascade(node.motor)
        self._mode = 0
        self._updated_ns = self._late_ns = 0
        self._target = 0.0
        self._rest_s = 0.0
        self._next: float | None = None
        self._control = 0
        self._bits = 0
        self._attained = False
        self._homing = False
        self._acknowledged = False

    @property
    def running(self) -> bool:
        """Return True if a motion mode is active and enabled."""
        return self._mode != 0

    def start(self, mode: int, t_ns: int) -> None:
        """Enter a mode in the present position, or stay in it."""
        if mode == self._mode:
            return
        node = self._node
        self._mode = mode
        self._updated_ns = self._late_ns = t_ns
        self._control = node.objects[0x6040, 0]
        self._cascade.integral = 0.0
        self._next = None
        self._attained = self._homing = self._acknowledged = False
        self._rest_s = 0.0
        self._bits = 0
        self._demand.jump(self._position(), self._velocity() if mode == CYCLIC_VELOCITY else 0.0)
        self._target = self._demand.position
        node.objects[0x607A, 0] = round(self._target)
        node.motion_due_ns = max(1, t_ns)
        self.advance(t_ns)

    def end(self) -> None:
        """Leave the mode, and clear the status bits of the mode."""
        self._mode = 0
        self._node.motion_due_ns = 0
        self._node.mode_bits = -1

    def take(self, index: int) -> None:
        """Apply an object that was written."""
        if index == 0x6040:
            self._take_control(self._node.objects[0x6040, 0])
        elif index == 0x607A and self._mode == CYCLIC_POSITION:
            self._rest_s = self._node.objects[0x60C2, 1] * 10.0 ** self._node.objects[0x60C2, 2]

    def _take_control(self, word: int) -> None:
        """Apply the bits of the mode in a control word. Only a rising edge of bit 4 acts."""
        edge = word & ~self._control & NEW_SETPOINT
        self._control = word
        if self._mode == HOMING:
            if edge:
                self._start_homing()
            elif not word & NEW_SETPOINT:
                self._homing = False
            return
        if self._mode != PROFILE_POSITION:
            return
        if not edge:
            return
        objects = self._node.objects
        target = float(objects[0x607A, 0])
        if word & RELATIVE:
            target += self._target
        if word & IMMEDIATELY or self._bits & REACHED:
            self._target = self._limited(target)
            self._next = None
        elif self._next is None:
            self._next = target
        self._acknowledged = True
        # The bit belongs to the previous target.
        self._bits &= ~REACHED

    def _start_homing(self) -> None:
        """Start the method of 0x6098."""
        node = self._node
        self._homing = True
        self._attained = False
        self._bits &= ~(REACHED | FOLLOWS)
        method = node.objects[0x6098, 0]
        self._target = self._position()
        if method in (INDEX_NEGATIVE, INDEX_POSITIVE):
            # The index pulse is at whole turns of the encoder, independent of the zero of the
            # position.
            turn = node.counts
            raw = self._position() - node.offset / TURN * turn
            edge = math.floor(raw / turn) if method == INDEX_NEGATIVE else math.ceil(raw / turn)
            self._target += edge * turn - raw
        self._demand.jump(self._position())

    def _finish_homing(self) -> None:
        """Make the present position read 0x607C."""
        node = self._node
        home = node.objects[0x607C, 0]
        node.offset += (home - self._position()) / node.counts * TURN
        self._demand.jump(home)
        self._target = float(home)
        self._attained = True

    def advance(self, t_ns: int) -> None:
        """Update demand, status bits and servo if it is time [ns]."""
        node = self._node
        if not self._mode or t_ns < node.motion_due_ns:
            return
        step_s = (t_ns - self._updated_ns) * 1e-9
        self._updated_ns = t_ns
        node.motion_due_ns = t_ns + PERIOD_NS
        self._bits &= ~LIMITED
        if step_s:
            self._generate(step_s)
        if self._watch_error(t_ns):
            return
        self._regulate(step_s)
        node.mode_bits = self._status_bits()
        node.objects[0x6062, 0] = round(self._demand.position)

    def _generate(self, step_s: float) -> None:
        """Compute the demand of the mode."""
        if self._mode == CYCLIC_VELOCITY:
            self._demand.jump(self._position(), self._rate_of(0x60FF) + self._rate_of(0x60B1))
        elif self._mode == CYCLIC_POSITION:
            self._interpolate(step_s)
        elif self._mode == HOMING:
            self._approach(step_s, 0x6099, 2, 0x609A, 0x609A)
            if self._homing and not self._attained and self._is_reached():
                self._finish_homing()
        else:
            if self._approach(step_s, 0x6081, 0, 0x6083, 0x6084) and self._next is not None:
                self._target = self._limited(self._next)
                self._next = None

    def _approach(self, step_s: float, speed: int, sub: int, rise: int, fall: int) -> bool:
        """Move the demand towards the target, within the speed and the ramps of objects. Return True at the target."""
        slope = max(1.0, self._counts(self._node.objects[fall, 0]))
        if self._control & HALT:
            self._demand.ramp(0.0, slope, slope, step_s)
            return False
        fastest = self._counts(min(self._node.objects[speed, sub], self._node.objects[0x6080, 0]))
        return self._demand.trapezoid(
            self._target, fastest, max(1.0, self._counts(self._node.objects[rise, 0])), slope, step_s
        )

    def _interpolate(self, step_s: float) -> None:
        """Move the demand linearly to the cyclic target, to arrive at the end of the interpolation period."""
        objects = self._node.objects
        self._target = self._limited(float(objects[0x607A, 0] + objects[0x60B0, 0]))
        part = step_s / self._rest_s if self._rest_s > step_s else 1.0
        self._rest_s = max(0.0, self._rest_s - step_s)
        change = part * (self._target - self._demand.position)
        self._demand.jump(self._demand.position + change, change / step_s + self._rate_of(0x60B1))

    def _limited(self, target: float) -> float:
        """Return the target, clamped to the software position limits (object 0x607D)."""
        objects = self._node.objects
        inside = min(float(objects[0x607D, 2]), max(float(objects[0x607D, 1]), target))
        if inside != target:
            self._bits |= LIMITED
        return inside

    def _watch_error(self, t_ns: int) -> bool:
        """Check the following error. Return True after a fault."""
        node = self._node
        error = self._demand.position - self._position()
        node.objects[0x60F4, 0] = round(error)
        window = node.objects[0x6065, 0]
        if self._mode == CYCLIC_VELOCITY or window == NO_WINDOW or abs(error) <= window:
            self._late_ns = t_ns
            self._bits &= ~DEVIATES
        else:
            self._bits |= DEVIATES
        if t_ns - self._late_ns < node.objects[0x6066, 0] * 1_000_000 or t_ns == self._late_ns:
            return False
        node.trip(FOLLOWING_ERROR)
        return True

    def _is_reached(self) -> bool:
        """Return True if demand and position are at the target."""
        window = self._node.objects[0x6067, 0]
        arrived = self._demand.position == self._target and self._next is None
        return arrived and abs(self._position() - self._target) <= window

    def _status_bits(self) -> int:
        """Return the bits of the mode in the status word."""
        if self._mode in (CYCLIC_POSITION, CYCLIC_VELOCITY):
            return self._bits | FOLLOWS
        if self._control & HALT:
            stopped = self._demand.velocity == 0.0
            self._bits = self._bits | REACHED if stopped else self._bits & ~REACHED
            return self._bits
        reached = self._attained if self._mode == HOMING else self._is_reached()
        self._bits = self._bits | REACHED if reached else self._bits & ~REACHED
        # Profile position: acknowledged until the host clears the bit and the buffer is free.
        self._acknowledged = self._next is not None or (self._acknowledged and bool(self._control & NEW_SETPOINT))
        follows = self._attained if self._mode == HOMING else self._acknowledged
        self._bits = self._bits | FOLLOWS if follows else self._bits & ~FOLLOWS
        return self._bits

    def _regulate(self, step_s: float) -> None:
        """Set the servo to the demand, from counts at the shaft to radians at the spool."""
        node = self._node
        objects = node.objects
        scale = node.direction * TURN / node.counts / node.gear
        angle = node.direction * (self._demand.position / node.counts * TURN - node.offset) / node.gear
        self._at_spool.jump(angle, self._demand.velocity * scale)
        speed = objects[0x6080, 0] * TURN / 60.0 / node.gear
        if abs(self._at_spool.velocity) > speed:
            self._bits |= LIMITED
        thousandth = node.gear * node.rated / 1000.0
        limit = min(node.peak, objects[0x6072, 0] * thousandth)
        gains = assumed_gains(node.motor.inertia, 0.0 if self._mode == CYCLIC_VELOCITY else POSITION_GAIN)
        torque = node.direction * objects[0x60B2, 0] * thousandth
        self._cascade.regulate(self._at_spool, gains, speed, limit, step_s, torque)

    def _position(self) -> float:
        """Return the position [count] at the shaft."""
        node = self._node
        return float((node.direction * node.gear * node.motor.encoder() + node.offset) / TURN * node.counts)

    def _velocity(self) -> float:
        """Return the velocity [count/s] at the shaft."""
        node = self._node
        return float(node.direction * node.gear * node.motor.velocity / TURN * node.counts)

    def _counts(self, per_minute: float) -> float:
        """Return a speed [1/min] in count/s, or an acceleration [1/min/s] in count/s2."""
        return float(per_minute / 60.0 * self._node.counts)

    def _rate_of(self, index: int) -> float:
        """Return a velocity object in count/s."""
        return self._counts(self._node.objects[index, 0])
