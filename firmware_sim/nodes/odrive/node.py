"""A motor with the firmware of an ODrive, 0.6.x or 0.5.x, on CANSimple. Source: facts, odrive_cansimple.

Choices where the fact sheet says "assumption": the heartbeat's error is active errors or else the disarm reason; only
setpoints feed the watchdog; NaN as a setpoint disarms with "missing input"; a disarm reason is kept until Clear_Errors
and refuses closed loop until then. Endpoints have the numbers that the hand file gives them. Position and velocity
control have no integrator and no ramps: one proportional cascade, whatever the input mode.
"""

import math
import struct

from firmware_sim.bus.frame import FDF, REMOTE, Frame
from firmware_sim.description import MotorSpec
from firmware_sim.nodes.thermal import Thermal
from firmware_sim.plant.motor import Motor

MISSING_INPUT, MOTOR_HOT, WATCHDOG, ESTOP = 1 << 6, 1 << 13, 1 << 24, 1 << 25
IDLE, CLOSED_LOOP = 1, 8
SUCCESS, DISARMED, INVALID_STATE = 0, 3, 13
BROADCAST = 0x3F
TORQUE_CONTROL, VELOCITY_CONTROL, POSITION_CONTROL = 1, 2, 3
PASSTHROUGH, TORQUE_RAMP = 1, 6
POSITION_GAIN, VELOCITY_GAIN = 20.0, 0.167
"""Vendor's defaults [1/s], [N m s/turn]."""
HEARTBEAT_MS, ENCODER_MS = 100, 10
"""Vendor's defaults."""
SERIAL = 0x0D_5A_11_00_00_00
HOT_C = 120.0
_SIZES = {0x02: 0, 0x04: 4, 0x07: 4, 0x0B: 8, 0x0C: 8, 0x0D: 8, 0x0E: 4, 0x0F: 8, 0x16: 0, 0x18: 0, 0x1A: 4, 0x1B: 8}
"""Shortest payload of each message that is taken."""
_OLD_ANSWERS = {0x09, 0x14, 0x17}
_OLD_ERRORS = {MISSING_INPUT: 1 << 0, MOTOR_HOT: 1 << 6, WATCHDOG: 1 << 11, ESTOP: 1 << 14}
"""Firmware 0.5.x: what it tells, and its axis errors."""
_TURN = 2.0 * math.pi


class OdriveNode:
    """One axis.

    Attributes:
        state: axis state. active: errors that are present. reason: what disarmed it last.
        endpoints: value by number, as bytes: enable_watchdog, watchdog_timeout, torque maximum and minimum.
        mode: control and input mode. velocity_limit: [turn/s]. current_limit: [A].
        gains: of position [1/s] and velocity [N m s/turn].
        thermal: temperatures. ids: None: many. malformed: frames that it could not read.
        wake_ns: when time must pass next [ns]. fed_ns: last setpoint [ns].
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Args: the motor's description; its rotor; shaft angle at theta = 0 [rad]."""
        self.motor, self._offset = motor, offset
        self.ids: frozenset[int] | None = None
        self._node, options = spec.node_id, spec.options
        self._serial = SERIAL + spec.node_id if spec.serial is None else spec.serial
        self._gear = float(options.get("gear_ratio", 1.0))
        self._sign, self._kt = spec.direction, spec.torque_constant
        self._peak = spec.torque_peak
        self.thermal = Thermal(spec.torque_constant)
        self.state, self.active, self.reason, self.result = IDLE, 0, 0, SUCCESS
        self.mode = (POSITION_CONTROL, PASSTHROUGH)
        self.gains = (POSITION_GAIN, VELOCITY_GAIN)
        self.velocity_limit, self.current_limit = 50.0, 20.0
        self._numbers = {
            key: int(options.get(f"endpoint_{key}", 0))
            for key in ("enable_watchdog", "watchdog_timeout", "torque_max", "torque_min")
        }
        self.endpoints = {
            self._numbers["enable_watchdog"]: b"\0",
            self._numbers["watchdog_timeout"]: struct.pack("<f", 0.0),
            self._numbers["torque_max"]: struct.pack("<f", math.inf),
            self._numbers["torque_min"]: struct.pack("<f", -math.inf),
        }
        self.endpoints.pop(0, None)
        self._old = options.get("firmware") == "0.5"
        if usb := options.get("usb_watchdog_s"):  # set where no frame can reach it
            self._numbers |= {"enable_watchdog": -1, "watchdog_timeout": -2}
            self.endpoints |= {-1: b"\1", -2: struct.pack("<f", usb)}
        self._saved = dict(self.endpoints)
        self._setpoint = 0.0
        self._periods = {0x01: HEARTBEAT_MS, 0x09: int(options.get("encoder_period_ms", ENCODER_MS))}
        self._due = dict.fromkeys(self._periods, 0)
        self.fed_ns, self._warmed_ns = 0, -1
        self.malformed = 0
        self.wake_ns = 0

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return the answers to a frame; None if it is not for this axis."""
        can_id = frame.can_id & ~REMOTE
        node, command = can_id >> 5, can_id & 0x1F
        if node not in (self._node, BROADCAST) or frame.flags & FDF:
            return None
        if frame.can_id & REMOTE:
            return self._asked(node, command)
        if command not in _SIZES:
            return [] if node == self._node else None
        if len(frame.data) < _SIZES[command]:
            self.malformed += 1
            return []
        return self._told(command, frame.data, t_ns)

    def _asked(self, node: int, command: int) -> list[Frame]:
        if node == BROADCAST and command != 0x06:
            return []
        answer = self._answer(command)
        return [Frame(self._node << 5 | command, answer)] if answer else []

    def _answer(self, command: int) -> bytes:
        """Return the payload of a Get message; empty if there is no such message."""
        gear, sign = self._gear, self._sign
        if self._old and command not in _OLD_ANSWERS:
            return b""
        if command == 0x00:
            return bytes((2, 4, 4, 58, 0, 6, 10, 0))
        if command == 0x03:
            return struct.pack("<II", self.active, self.reason)
        if command == 0x06:
            return bytes((self._node,)) + self._serial.to_bytes(6, "little") + b"\0"
        if command == 0x09:
            return struct.pack("<ff", self._turns(), sign * gear * self.motor.velocity / _TURN)
        current = sign * self.motor.torque / self._kt
        pairs = {
            0x14: (self._setpoint * gear / self._kt, current),
            0x15: (self.thermal.mosfet, self.thermal.winding),
            0x17: (24.0, abs(current) * 0.1),
            0x1C: (self._setpoint, sign * self.motor.torque / gear),
            0x1D: (abs(current) * 2.4, self.motor.torque * self.motor.velocity),
        }
        return struct.pack("<ff", *pairs[command]) if command in pairs else b""

    def _turns(self) -> float:
        return (self._sign * self._gear * self.motor.encoder() + self._offset) / _TURN

    def _told(self, command: int, data: bytes, t_ns: int) -> list[Frame]:
        if command == 0x02:
            self.disarm(ESTOP)
        elif command == 0x04:
            return self._sdo(data)
        elif command == 0x07:
            self._set_state(int.from_bytes(data[:4], "little"), t_ns)
        elif command == 0x0B:
            self._set_mode(*struct.unpack("<II", data))
        elif command == 0x0C:
            position, velocity, torque = struct.unpack("<fhh", data)
            self._set_motion(POSITION_CONTROL, position, velocity * 1e-3, torque * 1e-3, t_ns)
        elif command == 0x0D:
            velocity, torque = struct.unpack("<ff", data)
            self._set_motion(VELOCITY_CONTROL, 0.0, velocity, torque, t_ns)
        elif command == 0x0E:
            self._set_torque(struct.unpack_from("<f", data)[0], t_ns)
        elif command in (0x1A, 0x1B):
            gain = max(0.0, struct.unpack_from("<f", data)[0])
            self.gains = (gain, self.gains[1]) if command == 0x1A else (self.gains[0], gain)
        elif command == 0x0F:
            self._set_limits(*struct.unpack("<ff", data))
        elif command == 0x16:
            self._reboot()
        elif command == 0x18:
            self.active = self.reason = 0
            self.result = SUCCESS
        self._schedule()
        return []

    def _set_state(self, state: int, t_ns: int) -> None:
        if state == IDLE:
            self._release(SUCCESS)
        elif state != CLOSED_LOOP or self.active or self.reason:
            self.result = INVALID_STATE if self.state == IDLE else self.result
        elif self.state != CLOSED_LOOP:
            self.state, self.result, self.fed_ns = CLOSED_LOOP, SUCCESS, t_ns
            self._set_motion(POSITION_CONTROL, self._turns(), 0.0, 0.0, t_ns)  # stays where it is, if in that mode

    def _set_mode(self, control: int, entry: int) -> None:
        if self.state == IDLE:
            self.mode = (control, entry)

    def _set_limits(self, velocity: float, current: float) -> None:
        if velocity > 0.0 and current > 0.0:
            self.velocity_limit, self.current_limit = velocity, current

    def _set_torque(self, torque: float, t_ns: int) -> None:
        if not math.isfinite(torque):
            self.disarm(MISSING_INPUT)
            return
        self.fed_ns, self._setpoint = t_ns, torque
        if self.state == CLOSED_LOOP and self.mode[0] == TORQUE_CONTROL and self.mode[1] in (PASSTHROUGH, TORQUE_RAMP):
            low, high = self._limit("torque_min", -math.inf), self._limit("torque_max", math.inf)
            self.motor.servo.limit = min(self._peak, self.current_limit * self._kt)
            self.motor.servo.torque = self._sign * self._gear * min(high, max(low, torque))

    def _set_motion(self, kind: int, position: float, velocity: float, torque: float, t_ns: int) -> None:
        """Follow a position [turn] or velocity [turn/s] with feed-forward torque [N m], all at the shaft."""
        if not math.isfinite(position + velocity + torque):
            self.disarm(MISSING_INPUT)
            return
        self.fed_ns, servo = t_ns, self.motor.servo
        if self.state != CLOSED_LOOP or self.mode[0] != kind:
            return
        stiff = self.gains[1] / _TURN * self._gear**2
        servo.kd, servo.kp = stiff, self.gains[0] * stiff if kind == POSITION_CONTROL else 0.0
        servo.position = self._sign * (position * _TURN - self._offset) / self._gear
        servo.velocity = self._sign * velocity * _TURN / self._gear
        servo.torque = self._sign * self._gear * torque
        servo.limit = min(self._peak, self.current_limit * self._kt)

    def _limit(self, name: str, default: float) -> float:
        raw = self.endpoints.get(self._numbers[name])
        return float(struct.unpack("<f", raw)[0]) if raw else default

    def _sdo(self, data: bytes) -> list[Frame]:
        """Answer a read; a write is taken without a word, as firmware before 0.6.11 does."""
        operation, endpoint = data[0], int.from_bytes(data[1:3], "little")
        held = self.endpoints.get(endpoint)
        if held is None or operation > 1 or self._old:
            return []
        if operation == 1:
            if len(data) - 4 >= len(held):
                self.endpoints[endpoint] = data[4 : 4 + len(held)]
            return []
        return [Frame(self._node << 5 | 0x05, b"\0" + endpoint.to_bytes(2, "little") + b"\0" + held)]

    def _reboot(self) -> None:
        """Lose what was not saved."""
        self._release(SUCCESS)
        self.active = self.reason = 0
        self.mode = (POSITION_CONTROL, PASSTHROUGH)
        self.velocity_limit, self.current_limit = 50.0, 20.0
        self.endpoints = dict(self._saved)

    def forget(self) -> None:
        """Fall back to what was saved, and go on as before."""
        self.velocity_limit, self.current_limit = 50.0, 20.0
        self.endpoints = dict(self._saved)

    def _release(self, result: int) -> None:
        self.motor.servo.release()
        self.state, self.result, self._setpoint = IDLE, result, 0.0

    def disarm(self, error: int) -> None:
        """Enter idle because of an error; the motor coasts."""
        self.reason |= error
        self._release(DISARMED)

    def wake(self, t_ns: int) -> list[Frame]:
        """Judge watchdog and temperature; return the cyclic messages that are due."""
        if self._warmed_ns < 0 or t_ns - self._warmed_ns >= 100_000_000:
            self._warm(t_ns)
        if self._watched() and t_ns >= self.fed_ns + self._timeout_ns():
            self.disarm(WATCHDOG)
        frames = []
        for command, due_ns in self._due.items():
            if t_ns >= due_ns:
                data = self._heartbeat() if command == 0x01 else self._answer(command)
                frames.append(Frame(self._node << 5 | command, data))
                self._due[command] = max(due_ns, t_ns - 1) + self._periods[command] * 1_000_000
        self._schedule()
        return frames

    def _heartbeat(self) -> bytes:
        if self._old:
            errors = sum(old for new, old in _OLD_ERRORS.items() if (self.active | self.reason) & new)
            return struct.pack("<IBBBB", errors, self.state, errors == _OLD_ERRORS[MOTOR_HOT], 0, 0)
        return struct.pack("<IBBBB", self.active | self.reason, self.state, self.result, 0, 0)

    def _watched(self) -> bool:
        armed = self.state == CLOSED_LOOP
        return armed and self.endpoints.get(self._numbers["enable_watchdog"]) == b"\1" and self._timeout_ns() > 0

    def _timeout_ns(self) -> int:
        seconds = self._limit("watchdog_timeout", 0.0)
        return int(seconds * 1e9) if 0.0 < seconds < 1e6 else 0

    def _schedule(self) -> None:
        self.wake_ns = min(self._warmed_ns + 100_000_000, *self._due.values())
        if self._watched():
            self.wake_ns = min(self.wake_ns, self.fed_ns + self._timeout_ns())

    def _warm(self, t_ns: int) -> None:
        if self._warmed_ns >= 0:
            self.thermal.advance((t_ns - self._warmed_ns) * 1e-9, self.motor.heat)
        self.motor.heat, self._warmed_ns = 0.0, t_ns
        if self.thermal.winding > HOT_C and self.state == CLOSED_LOOP:
            self.disarm(MOTOR_HOT)
