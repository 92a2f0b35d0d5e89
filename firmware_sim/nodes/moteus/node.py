"""A motor with a moteus controller. Source: docs/facts/moteus.md.

The drive executes a frame subframe by subframe. If the frame writes the mode register, all written
registers take effect at the end of the frame. The drive builds the reply before the written
registers take effect. Therefore the reply contains the mode that the drive had before the frame. If
a subframe is unknown, the drive ignores the rest of the frame.

In position mode, the drive moves the commanded position with the commanded velocity until the next
command. A command without a position keeps the present target position.

Choices of this simulator where the fact sheet has only an assumption:

- The drive needs 10 ms to prepare the power stage (modes 2, 3 and 4).
- The drive is already calibrated, and has the gains of ``text_channel.FACTORY_CONFIGURATION``. The
  integrator of the drive is not simulated.
- Limits of velocity, acceleration and slip have no effect in the simulation. The target position
  moves as if these limits were nan.
- Stop position, fixed current and the voltage modes are not simulated. The drive refuses a command
  with one of these modes, in the same way as an invalid value.
- Beyond a position limit, the feedforward torque cannot push the motor farther beyond this limit.
"""

import math
import struct

from firmware_sim.bus.frame import BRS, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.drive_temperatures import DriveTemperatures
from firmware_sim.nodes.moteus import multiplex as mp
from firmware_sim.nodes.moteus import registers as reg
from firmware_sim.nodes.moteus.text_channel import TextChannel
from firmware_sim.plant.motor import Motor

STOPPED, FAULT, ENABLING, CALIBRATING, CALIBRATED = range(5)
POSITION, TIMEOUT, ZERO_VELOCITY, STAY_WITHIN_MODE = range(10, 14)
BRAKE = 15
"""This constant and the constants above are the numbers of modes, as in the mode register."""
COMMANDABLE_MODES = {STOPPED, POSITION, ZERO_VELOCITY, STAY_WITHIN_MODE, BRAKE}
"""Modes that a host can command in this simulation."""
MAX_MODE_NUMBER = 16
"""Largest number of a mode."""
OVER_TEMPERATURE = 38
"""Fault code: the motor or the drive is too hot."""
POSITION_LIMIT_FAULT = 39
"""Fault code: the position is outside its limits at the start of position mode."""
UNDER_VOLTAGE = 40
"""Fault code: the supply voltage is too low."""
TORQUE_LIMIT_ACTIVE = 102
"""Code for an active mode: the commanded torque limit reduces the torque."""
BROADCAST_NUMBER = 0x7F
"""Destination number of frames to all drives."""
ENABLING_DURATION_NS = 10_000_000
"""Assumed duration of the preparation of the power stage [ns]."""
THERMAL_PERIOD_NS = 100_000_000
"""Period of the update of the temperatures [ns]."""
BRAKE_DAMPING = 0.05
"""Assumed damping of a motor whose phases are shorted (mode brake) [N m s/rad]."""
FIRST_SERIAL_NUMBER = 0x6D6F7465_75730000_00000000
"""Serial number of node 0. Other nodes add their node number."""
FIRMWARE_VERSION = 0x00010001
"""Firmware version 1.0.1, with one byte for each of the three numbers."""
TURN_RAD = 2.0 * math.pi
"""A full turn [rad]."""
INT32_ONLY_REGISTERS = frozenset(
    (0x100, 0x101, 0x102, 0x110, 0x120, 0x121, 0x122, 0x150, 0x151, 0x152, 0x153, 0x158)
)
"""Registers that a host can read only as int32."""


class MoteusNode:
    """A simulated moteus controller.

    Attributes:
        mode: present mode of the controller.
        fault: present fault code, or the code of a limit that is in effect.
        command: values of the command registers.
        channel: text channel of the controller, which contains the configuration.
        thermal: temperatures of motor and drive.
        offset: angle that the drive reports when the spool angle theta is 0 [rad].
        ids: None, because the node answers many identifiers.
        malformed_frame_count: number of frames that the node could not decode.
        wake_ns: time of the next call of ``wake`` [ns].
        watchdog_fed_ns: time of the last command, which has restarted the watchdog [ns].
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set up the node in the state after power-up.

        Args:
            spec: description of the motor.
            motor: rotor of the motor.
            offset: angle that the drive reports when the spool angle theta is 0 [rad].
        """
        self.motor = motor
        self.offset = offset
        self.ids: frozenset[int] | None = None
        self.node_id = spec.node_id
        self.thermal = DriveTemperatures(spec.torque_constant)
        self.mode = STOPPED
        self.fault = 0
        self.command = dict(reg.REGISTER_DEFAULTS)
        self.channel = TextChannel(lambda: self._stop())
        self.malformed_frame_count = 0
        self.wake_ns = 0
        self.watchdog_fed_ns = 0
        self._direction = spec.direction
        self._peak = spec.torque_peak
        self._torque_constant = spec.torque_constant
        self._serial = FIRST_SERIAL_NUMBER + spec.node_id if spec.serial is None else spec.serial
        self._next_mode = STOPPED
        self._pending: int | None = None
        self._has_target = False
        self._enabling_ns = 0
        self._thermal_ns = -1
        self._t_ns = 0

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Execute and answer a frame.

        Returns:
            The answers, or None if the frame is not for this controller.
        """
        number = frame.can_id & ~EXTENDED_FLAG
        if (
            frame.can_id & REMOTE_FLAG
            or number >> 16
            or number & 0xFF not in (self.node_id, BROADCAST_NUMBER)
        ):
            return None
        self._t_ns = t_ns
        self._pending = None
        reply = self._execute_payload(frame.data)
        if self._pending is not None:
            self._apply_mode(self._pending, t_ns)
        if not number & 0x8000:
            return []
        return [self._reply_frame(reply, number >> 8 & 0x7F, frame)]

    def _reply_frame(self, data: bytes, host: int, frame: Frame) -> Frame:
        """Build the frame that carries a reply to a host.

        If the reply is too long for the frame format of the request, the returned frame has the
        format CAN FD.
        """
        number = self.node_id << 8 | host
        can_id = number | EXTENDED_FLAG if number >= 0x800 else number
        classical = not frame.flags & FDF and len(data) <= 8
        flags = 0 if classical else FDF | frame.flags & BRS
        return Frame(
            can_id, data if classical else mp.padded_payload(data), flags, frame.bus, self._t_ns
        )

    def _execute_payload(self, data: bytes) -> bytes:
        """Execute the subframes of a payload, and return the reply."""
        reader = mp.PayloadReader(data)
        reply_bytes = b""
        try:
            while reader.has_more:
                (kind,) = reader.take(1)
                if kind == mp.PADDING_SUBFRAME[0]:
                    continue
                if kind < 0x20:
                    subframe_reply = self._execute_register_subframe(kind, reader)
                    if subframe_reply is None:
                        return reply_bytes
                    reply_bytes += subframe_reply
                elif kind in (0x40, 0x42):
                    reply_bytes += self._execute_text_subframe(kind, reader)
                else:
                    raise mp.MalformedPayload
        except mp.MalformedPayload:
            self.malformed_frame_count += 1
        return reply_bytes

    def _execute_register_subframe(self, subframe: int, reader: mp.PayloadReader) -> bytes | None:
        """Execute a subframe that writes or reads registers.

        Returns:
            The bytes to add to the reply, or None if the rest of the payload is meant for another
            controller.
        """
        value_type = subframe >> 2 & 3
        count = subframe & 3 or reader.varuint()
        first_register = reader.varuint()
        reply_bytes = b""
        if subframe >= 0x10:
            return self._read_registers(value_type, count, first_register)
        for number in range(first_register, first_register + count):
            raw_bytes = reader.take(mp.REGISTER_STRUCTS[value_type].size)
            if reg.UUID_MASK <= number < reg.UUID_MASK + 4:
                expected = struct.pack("<I", self._uuid_word(number - reg.UUID_MASK))
                if value_type != mp.INT32 or raw_bytes != expected:
                    return None
                continue
            if error := self._write_register(number, value_type, raw_bytes):
                reply_bytes += b"\x30" + mp.encode_varuint(number) + mp.encode_varuint(error)
        return reply_bytes

    def _read_registers(self, value_type: int, count: int, first_register: int) -> bytes:
        """Return the reply to a request that reads registers.

        If a requested register has no value, the reply ends with an error for this register.
        """
        values = list[bytes]()
        error = b""
        for number in range(first_register, first_register + min(count, 64)):
            raw_bytes = self._read_register(number, value_type)
            if raw_bytes is None:
                error = (
                    b"\x31"
                    + mp.encode_varuint(number)
                    + mp.encode_varuint(reg.UNKNOWN_REGISTER_ERROR)
                )
                break
            values.append(raw_bytes)
        return (
            mp.subframe_head(0x20, value_type, len(values), first_register) + b"".join(values)
            if values
            else b""
        ) + error

    def _write_register(self, register: int, value_type: int, register_bytes: bytes) -> int:
        """Write a register, and return an error number. The error number 0 means no error."""
        register = reg.COMMAND_REGISTER_BY_ALIAS.get(register, register)
        if register == reg.MODE:
            mode = mp.decode_register(register_bytes, value_type, mp.UNSCALED_LSB)
            if mode not in COMMANDABLE_MODES:
                return reg.INVALID_VALUE_ERROR
            self._pending = int(mode)
            self.command = dict(reg.REGISTER_DEFAULTS)
        elif register in reg.LSB_BY_COMMAND_REGISTER:
            self.command[register] = mp.decode_register(
                register_bytes, value_type, reg.LSB_BY_COMMAND_REGISTER[register]
            )
        elif register in (reg.SET_OUTPUT_NEAREST, reg.SET_OUTPUT_EXACT):
            self._set_position(
                mp.decode_register(register_bytes, value_type, mp.POSITION_LSB),
                register == reg.SET_OUTPUT_NEAREST,
            )
        elif register == reg.RECAPTURE_POSITION:
            self._apply_mode(self.mode, self._t_ns)
        elif register in reg.LSB_BY_MEASURED_REGISTER or register in INT32_ONLY_REGISTERS:
            return reg.NOT_WRITEABLE_ERROR
        else:
            return reg.UNKNOWN_REGISTER_ERROR
        return 0

    def _set_position(self, turns: float, to_nearest_turn: bool) -> None:
        """Shift the zero of the position, so that the drive reports a given value.

        If ``to_nearest_turn`` is True, the shift is a whole number of turns. The reported position
        then differs from ``turns`` by at most half a turn.
        """
        if math.isfinite(turns):
            shift = turns - self._position
            self.offset += TURN_RAD * (round(shift) if to_nearest_turn else shift)

    def _read_register(self, register: int, value_type: int) -> bytes | None:
        """Return the bytes of a register.

        Return None if the register is unknown or cannot be read with the given type.
        """
        register = reg.COMMAND_REGISTER_BY_ALIAS.get(register, register)
        if register in INT32_ONLY_REGISTERS:
            return (
                struct.pack("<I", self._integer_register(register))
                if value_type == mp.INT32
                else None
            )
        if register == reg.MODE:
            return mp.encode_register(self.mode, value_type, mp.UNSCALED_LSB)
        if register in reg.LSB_BY_COMMAND_REGISTER:
            return mp.encode_register(
                self.command[register], value_type, reg.LSB_BY_COMMAND_REGISTER[register]
            )
        lsb_values = reg.LSB_BY_MEASURED_REGISTER.get(register)
        return (
            None
            if lsb_values is None
            else mp.encode_register(self._measured_value(register), value_type, lsb_values)
        )

    def _integer_register(self, register: int) -> int:
        """Return the value of a register that a host can read only in the format int32."""
        if 0x120 <= register <= 0x122:
            return self._serial >> 32 * (register - 0x120) & 0xFFFFFFFF
        if reg.UUID <= register < reg.UUID + 4:
            return self._uuid_word(register - reg.UUID)
        # The registers below contain the model number, the firmware version, the version of the
        # register map, the node number, and the support of the UUID mask.
        value_by_register = {
            0x100: 3,
            0x101: FIRMWARE_VERSION,
            0x102: 6,
            reg.MULTIPLEX_ID: self.node_id,
            0x158: 1,
        }
        return value_by_register[register]

    def _uuid_word(self, word_index: int) -> int:
        """Return 32 of the 128 bits of the drive's UUID."""
        return (self._serial << 32 | 0x5AFE) >> 32 * word_index & 0xFFFFFFFF

    @property
    def _position(self) -> float:
        """Return the position that the drive reports in frames [turn]."""
        return (self._direction * self.motor.encoder() + self.offset) / TURN_RAD

    @property
    def _target(self) -> float:
        """Return the position that the drive approaches, in the unit of CAN frames [turn]."""
        return (self._direction * self.motor.servo.position + self.offset) / TURN_RAD

    @property
    def _fault_code(self) -> int:
        """Return the fault code of the drive.

        If a limit reduces the torque of the position loop in the modes position and *stay within*,
        return the code of this limit.
        """
        motor = self.motor
        servo = motor.servo
        if self.fault or self.mode not in (POSITION, STAY_WITHIN_MODE):
            return self.fault
        torque = servo.kp * (servo.position - motor.encoder()) + servo.kd * (
            servo.velocity - motor.velocity
        )
        return TORQUE_LIMIT_ACTIVE if abs(torque + servo.torque) > servo.limit else 0

    def _measured_value(self, register: int) -> float:
        """Return the measured value of a register."""
        motor = self.motor
        sign = self._direction
        torque = sign * motor.torque
        velocity = sign * motor.velocity / TURN_RAD
        commanded_torque = sign * motor.servo.torque
        values: dict[int, float] = {
            0x001: self._position, 0x002: velocity, 0x003: torque, 0x004: torque / self._torque_constant,
            0x006: self._position, 0x007: motor.torque * motor.velocity, 0x00A: self.thermal.winding, 0x00B: 1.0,
            0x00C: 1.0, 0x00D: 24.0, 0x00E: self.thermal.mosfet, 0x00F: self._fault_code, 0x033: commanded_torque,
            0x034: commanded_torque, 0x038: self._target, 0x039: sign * motor.servo.velocity / TURN_RAD,
            0x03A: commanded_torque,
            0x03D: torque - commanded_torque, 0x050: self._position, 0x051: velocity,
            0x070: self._t_ns // 1_000_000 % 8388608,
        }  # fmt: skip
        return values.get(register, 0.0)

    def _execute_text_subframe(self, subframe: int, reader: mp.PayloadReader) -> bytes:
        """Execute a subframe of the text channel.

        Return as many bytes of the channel's answers as fit into the reply.
        """
        channel = reader.varuint()
        length = reader.varuint()
        data = reader.take(length) if subframe == 0x40 else b""
        if channel != 1:
            return b""
        self.channel.write(data)
        text_bytes = self.channel.read(min(length, 61)) if subframe == 0x42 else b""
        return (
            b"\x41" + mp.encode_varuint(channel) + mp.encode_varuint(len(text_bytes)) + text_bytes
        )

    def _apply_mode(self, mode: int, t_ns: int) -> None:
        """Execute the commanded mode. Only a stop command ends the mode *fault* or the mode *timeout*."""
        if mode == STOPPED:
            self._stop()
            return
        if self.mode in (FAULT, TIMEOUT):
            return
        self.watchdog_fed_ns = t_ns
        self._next_mode = mode
        if self.mode == STOPPED:
            self.mode = ENABLING
            self._enabling_ns = t_ns
        elif self.mode not in (ENABLING, CALIBRATING, CALIBRATED):
            self.mode = mode
            self._update_servo()
        self._schedule()

    def _stop(self) -> None:
        """Switch the power stage off, and clear the fault if one exists."""
        self.motor.servo.release()
        self._has_target = False
        self.mode = STOPPED
        self.fault = 0
        self._schedule()

    def _configuration_item(self, name: str) -> float:
        """Return the present value of a configuration item."""
        return self.channel.items[name]

    def _update_servo(self) -> None:
        """Set the servo according to the present mode and the command registers."""
        command = self.command
        kp = self._configuration_item("servo.pid_position.kp") / TURN_RAD
        kd = self._configuration_item("servo.pid_position.kd") / TURN_RAD
        limit = command[reg.MAX_TORQUE]
        if self.mode == BRAKE:
            self._set_servo(0.0, BRAKE_DAMPING, 0.0, 0.0, 0.0, math.nan)
        elif self.mode == ZERO_VELOCITY:
            timeout_limit = self._configuration_item("servo.timeout_max_torque_Nm")
            self._set_servo(0.0, kd * command[reg.KD_SCALE], 0.0, 0.0, 0.0, timeout_limit)
        elif self.mode == STAY_WITHIN_MODE:
            target = self._violated_bound()
            scale = 0.0 if target is None else 1.0
            kp *= scale * command[reg.KP_SCALE]
            kd *= scale * command[reg.KD_SCALE]
            self._set_servo(kp, kd, target or 0.0, 0.0, command[reg.FEEDFORWARD], limit)
        else:
            position = command[reg.POSITION]
            velocity = command[reg.VELOCITY]
            if math.isnan(position):
                position = self._target if self._has_target else self._position
            velocity = 0.0 if math.isnan(velocity) else velocity
            kp *= command[reg.KP_SCALE]
            kd *= command[reg.KD_SCALE]
            self._set_servo(kp, kd, position, velocity, command[reg.FEEDFORWARD], limit)
        self._has_target = self.mode == POSITION

    def _violated_bound(self) -> float | None:
        """Return the violated bound of the mode *stay within* [turn].

        If the position is within both bounds, return None.
        """
        lower = self.command[reg.LOWER_BOUND]
        upper = self.command[reg.UPPER_BOUND]
        if self._position < lower:
            return lower
        return upper if self._position > upper else None

    def _set_servo(
        self, kp: float, kd: float, position: float, velocity: float, torque: float, limit: float
    ) -> None:
        """Set gains and setpoints of the servo from values in turn, turn/s and N m.

        A torque limit of NaN stands for the peak torque of the motor.
        """
        servo = self.motor.servo
        sign = self._direction
        peak = min(
            self._peak, self._configuration_item("servo.max_current_A") * self._torque_constant
        )
        largest = peak if math.isnan(limit) else min(peak, abs(limit))
        finite_torque = torque if math.isfinite(torque) else 0.0
        if not self.command[reg.IGNORE_POSITION_BOUNDS]:
            if self._position > self._configuration_item("servopos.position_max"):
                finite_torque = min(0.0, finite_torque)
            if self._position < self._configuration_item("servopos.position_min"):
                finite_torque = max(0.0, finite_torque)
        self.fault = TORQUE_LIMIT_ACTIVE if abs(finite_torque) > largest else 0
        servo.kp = kp
        servo.kd = kd
        servo.position = sign * (position * TURN_RAD - self.offset)
        servo.velocity = servo.target_speed = sign * velocity * TURN_RAD
        servo.torque = sign * max(-largest, min(largest, finite_torque))
        servo.limit = largest

    def trip(self, fault: int) -> None:
        """Enter the mode *fault* with a given code.

        With the fault code TIMEOUT, enter the mode *timeout* and set no fault code.
        """
        self.motor.servo.release()
        self._has_target = False
        self.mode = TIMEOUT if fault == TIMEOUT else FAULT
        self.fault = 0 if fault == TIMEOUT else fault
        self._schedule()

    def power_cycle(self) -> None:
        """Restart in the mode *stopped*, with the stored configuration."""
        self._stop()
        self.command = dict(reg.REGISTER_DEFAULTS)
        self.channel.restore_saved()

    def lose_settings(self) -> None:
        """Restore the stored configuration, but keep the present mode."""
        self.channel.restore_saved()

    @property
    def _timeout_ns(self) -> int:
        """Return the timeout of the watchdog [ns], or 0 if the watchdog is off.

        If no command arrives within the timeout, the watchdog fires.
        """
        seconds = self.command[reg.TIMEOUT]
        if seconds == 0.0:
            seconds = self._configuration_item("servo.default_timeout_s")
        return int(seconds * 1e9) if 0.0 < seconds < 1e6 else 0

    def _schedule(self) -> None:
        """Set the time of the next call of ``wake``."""
        due_times = [self._thermal_ns + THERMAL_PERIOD_NS]
        if self.mode in (ENABLING, CALIBRATING, CALIBRATED):
            due_times.append(self._enabling_ns + ENABLING_DURATION_NS)
        if self.mode in (POSITION, STAY_WITHIN_MODE) and self._timeout_ns:
            due_times.append(self.watchdog_fed_ns + self._timeout_ns + 1)
        self.wake_ns = min(due_times)

    def wake(self, t_ns: int) -> None:
        """Do the work that is due: end the preparation of the power stage, check the watchdog, update temperatures."""
        self._t_ns = t_ns
        if self.mode == ENABLING and t_ns - self._enabling_ns >= ENABLING_DURATION_NS:
            self._start_mode()
        timeout_ns = self._timeout_ns
        if (
            self.mode in (POSITION, STAY_WITHIN_MODE)
            and timeout_ns
            and t_ns - self.watchdog_fed_ns > timeout_ns
        ):
            self._enter_timeout_mode()
        if self._thermal_ns < 0 or t_ns - self._thermal_ns >= THERMAL_PERIOD_NS:
            self._update_temperatures(t_ns)
        self._schedule()

    def _start_mode(self) -> None:
        """Enter the commanded mode after the preparation of the power stage.

        At the start of position mode, a position outside of the position limits is a fault.
        """
        position = self._position
        is_outside = position < self._configuration_item(
            "servopos.position_min"
        ) or position > self._configuration_item("servopos.position_max")
        if (
            self._next_mode == POSITION
            and is_outside
            and not self.command[reg.IGNORE_POSITION_BOUNDS]
        ):
            self.trip(POSITION_LIMIT_FAULT)
            return
        self.mode = self._next_mode
        self._update_servo()

    def _enter_timeout_mode(self) -> None:
        """Enter the mode *timeout*.

        The configuration item ``servo.timeout_mode`` selects the effect of the mode *timeout*.
        """
        effect = int(self._configuration_item("servo.timeout_mode"))
        self.mode = effect if effect in (POSITION, ZERO_VELOCITY, BRAKE) else STOPPED
        if self.mode == STOPPED:
            self.motor.servo.release()
        else:
            self.command |= {reg.FEEDFORWARD: 0.0, reg.POSITION: math.nan, reg.VELOCITY: 0.0}
            self._update_servo()
        self.mode = TIMEOUT
        self.fault = 0

    def _update_temperatures(self, t_ns: int) -> None:
        """Advance the temperatures.

        If the winding or the MOSFETs are too hot, enter the mode *fault*.
        """
        if self._thermal_ns >= 0:
            self.thermal.advance((t_ns - self._thermal_ns) * 1e-9, self.motor.heat)
        self.motor.heat = 0.0
        self._thermal_ns = t_ns
        is_overheated = self.thermal.winding > self._configuration_item(
            "servo.motor_fault_temperature"
        ) or self.thermal.mosfet > self._configuration_item("servo.fault_temperature")
        if is_overheated and self.mode not in (STOPPED, FAULT):
            self.trip(OVER_TEMPERATURE)
