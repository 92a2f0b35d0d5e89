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
from firmware_sim.nodes.odrive.laws import (
    CLOSED_LOOP,
    IDLE,
    PASSTHROUGH,
    TURN,
    WARM_PERIOD_NS,
    OdriveRow,
    make_torque,
    next_due,
    schedule,
    starves,
    turns,
    turns_per_s,
)
from firmware_sim.nodes.thermal import Thermal
from firmware_sim.plant.motor import Motor

MISSING_INPUT, MOTOR_HOT, WATCHDOG, ESTOP = 1 << 6, 1 << 13, 1 << 24, 1 << 25
SUCCESS, DISARMED, INVALID_STATE = 0, 3, 13
BROADCAST = 0x3F
VELOCITY_CONTROL, POSITION_CONTROL = 2, 3
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


class OdriveNode:
    """One axis.

    Attributes:
        state: axis state. active: errors that are present. reason: what disarmed it last.
        endpoints: value by number, as bytes: enable_watchdog, watchdog_timeout, torque maximum and minimum.
        control_mode, input_mode, mode: what it follows; both in one. setpoint: of the torque [N m].
        torque_min, torque_max, timeout_ns: limits [N m] and watchdog [ns], 0 if it is off, by the endpoints.
        velocity_limit: [turn/s]. current_limit: [A].
        gains: of position [1/s] and velocity [N m s/turn].
        thermal: temperatures. ids: None: many. malformed: frames that it could not read.
        wake_ns: when time must pass next [ns]. fed_ns: last setpoint [ns]. warmed_ns: of the temperatures [ns].
        heartbeat_due_ns, encoder_due_ns: when it sends its cyclic messages next [ns], in periods [ns].
        takes: identifiers that it may answer.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Args: the motor's description; its rotor; shaft angle at theta = 0 [rad]."""
        self.motor, self.offset = motor, offset
        self.ids: frozenset[int] | None = None
        self.node_id, options = spec.node_id, spec.options
        own = [node << 5 | command for node in (spec.node_id, BROADCAST) for command in range(0x20)]
        self.takes = frozenset((*own, *(can_id | REMOTE for can_id in own)))
        self._serial = SERIAL + spec.node_id if spec.serial is None else spec.serial
        self.gear = float(options.get("gear_ratio", 1.0))
        self.direction, self.torque_constant = spec.direction, spec.torque_constant
        self.peak = spec.torque_peak
        self.thermal = Thermal(spec.torque_constant)
        self.state, self.active, self.reason, self.result = IDLE, 0, 0, SUCCESS
        self._set_modes(POSITION_CONTROL, PASSTHROUGH)
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
        self.old = options.get("firmware") == "0.5"
        if usb := options.get("usb_watchdog_s"):  # set where no frame can reach it
            self._numbers |= {"enable_watchdog": -1, "watchdog_timeout": -2}
            self.endpoints |= {-1: b"\1", -2: struct.pack("<f", usb)}
        self._saved = dict(self.endpoints)
        self.setpoint = 0.0
        self.heartbeat_period_ns = HEARTBEAT_MS * 1_000_000
        self.encoder_period_ns = int(options.get("encoder_period_ms", ENCODER_MS)) * 1_000_000
        self.heartbeat_due_ns = self.encoder_due_ns = 0
        self.fed_ns, self.warmed_ns = 0, -1
        self._renew()
        self.malformed = 0
        self.wake_ns = 0

    def _set_modes(self, control: int, entry: int) -> None:
        self.control_mode, self.input_mode = control, entry

    def _renew(self) -> None:
        """Take over what depends on endpoints."""
        self.torque_min, self.torque_max = self._limit("torque_min", -math.inf), self._limit("torque_max", math.inf)
        enabled, seconds = self.endpoints.get(self._numbers["enable_watchdog"]), self._limit("watchdog_timeout", 0.0)
        self.timeout_ns = int(seconds * 1e9) if enabled == b"\1" and 0.0 < seconds < 1e6 else 0

    @property
    def mode(self) -> tuple[int, int]:
        """Control and input mode."""
        return self.control_mode, self.input_mode

    @property
    def cyclic(self) -> tuple[int, ...]:
        """Identifiers of the frames that come in every tick."""
        return self.node_id << 5 | 0x0E, self.node_id << 5 | 0x09 | REMOTE

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return the answers to a frame; None if it is not for this axis."""
        can_id = frame.can_id & ~REMOTE
        node, command = can_id >> 5, can_id & 0x1F
        if node not in (self.node_id, BROADCAST) or frame.flags & FDF:
            return None
        if frame.can_id & REMOTE:
            return self._asked(node, command)
        if command not in _SIZES:
            return [] if node == self.node_id else None
        if len(frame.data) < _SIZES[command]:
            self.malformed += 1
            return []
        return self._told(command, frame.data, t_ns)

    def _asked(self, node: int, command: int) -> list[Frame]:
        if node == BROADCAST and command != 0x06:
            return []
        answer = self._answer(command)
        return [Frame(self.node_id << 5 | command, answer)] if answer else []

    def _answer(self, command: int) -> bytes:
        """Return the payload of a Get message; empty if there is no such message."""
        gear, sign = self.gear, self.direction
        if self.old and command not in _OLD_ANSWERS:
            return b""
        if command == 0x00:
            return bytes((2, 4, 4, 58, 0, 6, 10, 0))
        if command == 0x03:
            return struct.pack("<II", self.active, self.reason)
        if command == 0x06:
            return bytes((self.node_id,)) + self._serial.to_bytes(6, "little") + b"\0"
        if command == 0x09:
            return struct.pack("<ff", turns(self, self.motor.encoder()), turns_per_s(self, self.motor.velocity))
        current = sign * self.motor.torque / self.torque_constant
        pairs = {
            0x14: (self.setpoint * gear / self.torque_constant, current),
            0x15: (self.thermal.mosfet, self.thermal.winding),
            0x17: (24.0, abs(current) * 0.1),
            0x1C: (self.setpoint, sign * self.motor.torque / gear),
            0x1D: (abs(current) * 2.4, self.motor.torque * self.motor.velocity),
        }
        return struct.pack("<ff", *pairs[command]) if command in pairs else b""

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
        schedule(self)
        return []

    def _set_state(self, state: int, t_ns: int) -> None:
        if state == IDLE:
            self._release(SUCCESS)
        elif state != CLOSED_LOOP or self.active or self.reason:
            self.result = INVALID_STATE if self.state == IDLE else self.result
        elif self.state != CLOSED_LOOP:
            self.state, self.result, self.fed_ns = CLOSED_LOOP, SUCCESS, t_ns
            self._set_motion(
                POSITION_CONTROL, turns(self, self.motor.encoder()), 0.0, 0.0, t_ns
            )  # stays where it is, if in that mode

    def _set_mode(self, control: int, entry: int) -> None:
        if self.state == IDLE:
            self._set_modes(control, entry)

    def _set_limits(self, velocity: float, current: float) -> None:
        if velocity > 0.0 and current > 0.0:
            self.velocity_limit, self.current_limit = velocity, current

    def _set_torque(self, torque: float, t_ns: int) -> None:
        if not math.isfinite(torque):
            self.disarm(MISSING_INPUT)
            return
        make_torque(self, self.motor.servo, torque, t_ns)

    def _set_motion(self, kind: int, position: float, velocity: float, torque: float, t_ns: int) -> None:
        """Follow a position [turn] or velocity [turn/s] with feed-forward torque [N m], all at the shaft."""
        if not math.isfinite(position + velocity + torque):
            self.disarm(MISSING_INPUT)
            return
        self.fed_ns, servo = t_ns, self.motor.servo
        if self.state != CLOSED_LOOP or self.control_mode != kind:
            return
        stiff = self.gains[1] / TURN * self.gear**2
        servo.kd, servo.kp = stiff, self.gains[0] * stiff if kind == POSITION_CONTROL else 0.0
        servo.position = self.direction * (position * TURN - self.offset) / self.gear
        servo.velocity = self.direction * velocity * TURN / self.gear
        servo.torque = self.direction * self.gear * torque
        servo.limit = min(self.peak, self.current_limit * self.torque_constant)

    def _limit(self, name: str, default: float) -> float:
        raw = self.endpoints.get(self._numbers[name])
        return float(struct.unpack("<f", raw)[0]) if raw else default

    def _sdo(self, data: bytes) -> list[Frame]:
        """Answer a read; a write is taken without a word, as firmware before 0.6.11 does."""
        operation, endpoint = data[0], int.from_bytes(data[1:3], "little")
        held = self.endpoints.get(endpoint)
        if held is None or operation > 1 or self.old:
            return []
        if operation == 1:
            if len(data) - 4 >= len(held):
                self.endpoints[endpoint] = data[4 : 4 + len(held)]
                self._renew()
            return []
        return [Frame(self.node_id << 5 | 0x05, b"\0" + endpoint.to_bytes(2, "little") + b"\0" + held)]

    def _reboot(self) -> None:
        """Lose what was not saved."""
        self._release(SUCCESS)
        self.active = self.reason = 0
        self._set_modes(POSITION_CONTROL, PASSTHROUGH)
        self.forget()

    def forget(self) -> None:
        """Fall back to what was saved, and go on as before."""
        self.velocity_limit, self.current_limit = 50.0, 20.0
        self.endpoints = dict(self._saved)
        self._renew()

    def _release(self, result: int) -> None:
        self.motor.servo.release()
        self.state, self.result, self.setpoint = IDLE, result, 0.0

    def disarm(self, error: int) -> None:
        """Enter idle because of an error; the motor coasts."""
        self.reason |= error
        self._release(DISARMED)

    def wake(self, t_ns: int) -> list[Frame]:
        """Judge watchdog and temperature; return the cyclic messages that are due."""
        if self.warmed_ns < 0 or t_ns - self.warmed_ns >= WARM_PERIOD_NS:
            self._warm(t_ns)
        if starves(self, t_ns):
            self.disarm(WATCHDOG)
        frames = []
        if t_ns >= self.heartbeat_due_ns:
            frames.append(Frame(self.node_id << 5 | 0x01, self._heartbeat()))
            self.heartbeat_due_ns = next_due(self.heartbeat_due_ns, t_ns, self.heartbeat_period_ns)
        if t_ns >= self.encoder_due_ns:
            frames.append(Frame(self.node_id << 5 | 0x09, self._answer(0x09)))
            self.encoder_due_ns = next_due(self.encoder_due_ns, t_ns, self.encoder_period_ns)
        schedule(self)
        return frames

    def _heartbeat(self) -> bytes:
        if self.old:
            errors = sum(old for new, old in _OLD_ERRORS.items() if (self.active | self.reason) & new)
            return struct.pack("<IBBBB", errors, self.state, errors == _OLD_ERRORS[MOTOR_HOT], 0, 0)
        return struct.pack("<IBBBB", self.active | self.reason, self.state, self.result, 0, 0)

    def _warm(self, t_ns: int) -> None:
        if self.warmed_ns >= 0:
            self.thermal.advance((t_ns - self.warmed_ns) * 1e-9, self.motor.heat)
        self.motor.heat, self.warmed_ns = 0.0, t_ns
        if self.thermal.winding > HOT_C and self.state == CLOSED_LOOP:
            self.disarm(MOTOR_HOT)


class OdriveNodeRow(OdriveRow, OdriveNode):
    """An axis whose numbers are a row of an array."""

    layout = OdriveRow

    def prepare(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Fill the row; see ``OdriveNode``."""
        OdriveNode.__init__(self, spec, motor, offset)
        self.motor_number = motor.number
