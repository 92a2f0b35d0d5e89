"""A motor with the firmware of a CubeMars AK drive in MIT mode: no registers, no watchdog, no state in its feedback.

Source: facts, mit_damiao (variants). Choices where they say nothing: a motor that is not enabled answers commands, too;
an error takes the torque away and goes when its cause does; unknown codes behind seven bytes of FF are not answered.
"""

import enum

from firmware_sim.bus.frame import Frame
from firmware_sim.description import MotorSpec
from firmware_sim.nodes.kind import Kind, Shaft
from firmware_sim.nodes.mit.codec import Ranges, decode_command, to_code
from firmware_sim.nodes.thermal import Thermal
from firmware_sim.plant.motor import Motor

FULL_SCALE = {
    "ak60-6": (12.5, 50.0, 15.0),
    "ak70-10": (12.5, 50.0, 25.0),
    "ak80-6": (12.5, 76.0, 12.0),
    "ak80-9": (12.5, 50.0, 18.0),
    "ak10-9": (12.5, 50.0, 65.0),
}
"""Position [rad], velocity [rad/s], torque [N m] of a model."""
USUAL = "ak80-9"
WARM_PERIOD_NS = 100_000_000
HOT_C, COOL_C = 100.0, 90.0
ZEROING_NS = 1_000_000_000
"""Silence while it takes a new zero."""
_SPECIAL = b"\xff" * 7
COLDEST_C = -40
"""What the byte of the temperature counts from; the manual's example of a reply takes 40 away."""
_ENABLE, _DISABLE, _ZERO = 0xFC, 0xFD, 0xFE


class Error(enum.IntEnum):
    """Byte 7 of the feedback."""

    NONE = 0
    HOT = 1
    OVER_CURRENT = 2
    OVER_VOLTAGE = 3
    UNDER_VOLTAGE = 4
    ENCODER = 5
    IMBALANCE = 6


class CubemarsNode:
    """One motor node.

    Attributes:
        enabled: whether it follows commands. error: what is wrong.
        offset: wire angle at theta = 0 [rad]. thermal: temperatures.
        short: whether it answers with six bytes, as older firmware does.
        ids: its own. malformed: frames on its identifier that it could not read.
        wake_ns: when time must pass for it next [ns]. fed_ns: below 0: it has no watchdog.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Args: the motor's description; its rotor; wire angle at theta = 0 [rad]."""
        self.motor, self.offset = motor, offset
        self.thermal = Thermal(spec.torque_constant)
        self.enabled, self.error = False, Error.NONE
        self.short = bool(spec.options.get("short", False))
        self.malformed, self.wake_ns, self.fed_ns = 0, 0, -1
        self._id, self._direction = spec.node_id, spec.direction
        self.ids = frozenset((spec.node_id,))
        self._ranges = Ranges(*FULL_SCALE[str(spec.options.get("motor_type", USUAL))])
        motor.servo.limit = min(spec.torque_peak, self._ranges.torque)
        self._warmed_ns = -1
        self._silent_until_ns = 0

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return the answer to a frame, on the same identifier; None if it is not for this motor."""
        if frame.can_id != self._id:
            return None
        data = frame.data
        if len(data) != 8:
            self.malformed += 1
            return []
        if t_ns < self._silent_until_ns:
            return []
        if data[:7] == _SPECIAL and data[7] != 0xFF:
            return self._special(data[7], frame, t_ns)
        self._follow(data)
        return [self._answer(frame, t_ns)]

    def _special(self, code: int, frame: Frame, t_ns: int) -> list[Frame]:
        if code == _ENABLE:
            self._switch(on=self.error == Error.NONE)
        elif code == _DISABLE:
            self._switch(on=False)
        elif code == _ZERO:
            self.offset = -self._direction * self.motor.encoder()
            self._silent_until_ns = t_ns + ZEROING_NS
            return []
        else:
            self.malformed += 1
            return []
        return [self._answer(frame, t_ns)]

    def _switch(self, on: bool) -> None:
        if not (on and self.enabled):
            self.motor.servo.release()
        self.enabled = on

    def _follow(self, data: bytes) -> None:
        if not self.enabled:
            return
        command, servo, sign = decode_command(data, self._ranges), self.motor.servo, self._direction
        servo.kp, servo.kd = command.kp, command.kd
        servo.position, servo.velocity = sign * (command.position - self.offset), sign * command.velocity
        servo.torque = sign * command.torque

    def _answer(self, frame: Frame, t_ns: int) -> Frame:
        motor, sign, ranges = self.motor, self._direction, self._ranges
        position = to_code(sign * motor.encoder() + self.offset, ranges.position, 16)
        velocity = to_code(sign * motor.velocity, ranges.velocity, 12)
        torque = to_code(sign * motor.torque, ranges.torque, 12)
        word = self._id & 0xFF
        for code, bits in ((position, 16), (velocity, 12), (torque, 12)):
            word = word << bits | code
        data = word.to_bytes(6, "big")
        if not self.short:
            data += bytes((min(255, max(0, int(self.thermal.mosfet) - COLDEST_C)), self.error))
        return Frame(self._id, data, frame.flags, frame.bus, t_ns)

    def trip(self, error: Error) -> None:
        """Lose the torque because of an error, which stays until it is taken away."""
        self.error = error
        if error != Error.NONE:
            self._switch(on=False)

    def power_cycle(self) -> None:
        """Start disabled."""
        self.error = Error.NONE
        self._switch(on=False)

    def wake(self, t_ns: int) -> None:
        """Judge the temperatures."""
        if self._warmed_ns < 0 or t_ns - self._warmed_ns >= WARM_PERIOD_NS:
            if self._warmed_ns >= 0:
                self.thermal.advance((t_ns - self._warmed_ns) * 1e-9, self.motor.heat)
            self.motor.heat, self._warmed_ns = 0.0, t_ns
            if self.thermal.winding > HOT_C:
                self.trip(Error.HOT)
            elif self.error == Error.HOT and self.thermal.winding < COOL_C:
                self.trip(Error.NONE)
        self.wake_ns = self._warmed_ns + WARM_PERIOD_NS


def shaft(motor_type: str) -> Shaft:
    """Return the shaft of a model; its inertia is an assumption."""
    position, velocity, peak = FULL_SCALE[motor_type]
    return Shaft(peak, 2e-4 * peak, 1.0, position, velocity, {"motor_type": motor_type})


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return node_id, bytes(8)


def _mishear(frame: Frame) -> Frame:
    """A command without torque in place of disable."""
    return frame._replace(data=b"\x7f\xff\x7f\xf0\0\0\x07\xff") if frame.data == _SPECIAL + b"\xfd" else frame


KIND = Kind(CubemarsNode, range(1, 0x100), shaft(USUAL), _host_frame, _mishear)
