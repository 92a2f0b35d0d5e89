"""A motor with RobStride's firmware and private protocol.

Source: docs/facts/robstride.md.

    type   identifier 23..16   15..8   7..0     payload
    0      0                   host    motor    identity request, answered by motor in 15..8, 0xFE, 64 bits
    1      torque in 23..8             motor    position, velocity, kp, kd: 16 bits each, high byte first
    2      mode 2, fault 6     motor   host     position, velocity, torque, 10 x degC: 16 bits each
    3      0                   host    motor    enable
    4      0                   host    motor    stop, byte 0 = 1 also clears faults
    6      0                   host    motor    byte 0 = 1: the present position is zero
    7      new number          host    motor    change of the number
    0x11   0                   host    motor    u16 parameter, u16, value, 1 in 23..16 if it failed
    0x12   0                   host    motor    u16 parameter, u16, value
    0x15   0                   motor   host     u32 faults, u32 warnings
    0x16   0                   host    motor    01 .. 08: save the parameters

The motor answers frames of the types 1, 3, 4, 6, 0x12 and 0x16 with a frame of type 2.

Choices of this simulator where the fact sheet has only an assumption:

- The answer to a control command goes to the host that sent the latest request.
- Enable commands and control commands restart the watchdog. When the watchdog fires, the motor
  enters reset mode without a fault.
- Faults other than over-temperature stay until a host clears them. A motor with a fault refuses to
  be enabled.
- After each new fault, the motor sends a fault report to the host that sent the latest request.
- The motor does not answer a request for a mode of operation other than 0, or for another bit rate
  or protocol.
"""

import math
import struct

from firmware_sim.bus.frame import EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.drive_temperatures import DriveTemperatures
from firmware_sim.plant.motor import Motor

FULL_SCALE_BY_MOTOR_TYPE = {
    "rs00": (33.0, 14.0, 500.0, 5.0),
    "rs01": (44.0, 17.0, 500.0, 5.0),
    "rs02": (44.0, 17.0, 500.0, 5.0),
    "rs03": (20.0, 60.0, 5000.0, 100.0),
    "rs04": (15.0, 120.0, 5000.0, 100.0),
    "rs05": (50.0, 5.5, 500.0, 5.0),
}
"""Velocity [rad/s], torque [N m], kp [N m/rad] and kd [N m s/rad] at full scale, by motor model."""
DEFAULT_MOTOR_TYPE = "rs05"
"""Motor model if the hand file gives none."""
POSITION_RANGE = 4.0 * math.pi
"""Largest position in frames, for all motor models [rad]."""
RESET_MODE = 0
RUN_MODE = 2
"""This constant and the constant above are motor modes, as in the identifier of the feedback."""
UNDER_VOLTAGE = 1 << 0
OVER_CURRENT = 1 << 1
OVER_TEMPERATURE_FAULT = 1 << 2
ENCODER_FAULT = 1 << 3
OVERLOAD_FAULT = 1 << 4
UNCALIBRATED_FAULT = 1 << 5
"""This constant and the five constants above are fault bits in the identifier of the feedback."""
FAULT_REPORT_BITS = {
    UNDER_VOLTAGE: 1 << 2, OVER_CURRENT: 1 << 4, OVER_TEMPERATURE_FAULT: 1 << 0, ENCODER_FAULT: 1 << 9,
    OVERLOAD_FAULT: 1 << 14, UNCALIBRATED_FAULT: 1 << 7,
}  # fmt: skip
"""Bit of each fault in the fault report, by the bit of the same fault in the feedback."""
FEEDBACK_FAULTS = 0x3F
"""Mask of the faults that the feedback can report.

Faults with higher bit numbers appear only in the fault report, see ``FAULT_REPORT_SHIFT``.
"""
FAULT_REPORT_SHIFT = 8
"""Number of the bit in ``fault`` that corresponds to bit 0 of the fault report."""
OVERHEATING_C = 135.0
"""Winding temperature above which the motor reports a fault [degC]."""
THERMAL_PERIOD_NS = 100_000_000
"""Period of the update of the temperatures [ns]."""
TIMEOUT_UNIT_NS = 50_000
"""Duration of one count of the watchdog's timeout [ns]: 20000 counts are a second."""
FIRST_SERIAL_NUMBER = 0x5253_0500_0000_0000
"""Identity (64 bits) of motor 0. Other motors add their number."""
FACTORY_HOST_ID = 0xFD
"""Number of the host that gets feedback before any host has sent a request."""
WRITABLE_PARAMETERS = {
    0x7005: "B",
    0x700B: "f",
    0x7017: "f",
    0x7018: "f",
    0x7026: "H",
    0x7028: "I",
    0x7029: "B",
    0x702B: "f",
}
"""Parameters that can be written, with their format characters of ``struct``."""
READ_ONLY_PARAMETERS = (0x7019, 0x701A, 0x701B, 0x701C)
"""Parameters that can only be read: position, current, velocity and voltage."""


def value_to_code(value: float, largest: float) -> int:
    """Encode a value between -largest and largest as 16 bits.

    A value outside of the range is limited to the range.
    """
    return round((min(largest, max(-largest, value)) + largest) / (2.0 * largest) * 65535)


def code_to_value(code: int, low: float, high: float) -> float:
    """Decode 16 bits into a value between low and high."""
    return low + (high - low) * code / 65535


class RobstrideNode:
    """A simulated RobStride motor.

    Attributes:
        mode: mode of the motor, reset or run.
        fault: bits of the present faults.
        parameters: bytes of each parameter that can be written, by the number of the parameter.
        thermal: temperatures of the motor and the drive.
        offset: angle that the motor reports when the spool angle theta is 0 [rad].
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
            offset: angle that the motor reports when the spool angle theta is 0 [rad].
        """
        self.motor = motor
        self.offset = offset
        self.ids: frozenset[int] | None = None
        self.node_id = spec.node_id
        self.thermal = DriveTemperatures(spec.torque_constant)
        self.mode = RESET_MODE
        self.fault = 0
        self.malformed_frame_count = 0
        self.wake_ns = 0
        self.watchdog_fed_ns = 0
        motor_type = str(spec.options.get("motor_type", DEFAULT_MOTOR_TYPE))
        self._velocity, self._torque, self._kp, self._kd = FULL_SCALE_BY_MOTOR_TYPE[motor_type]
        self._direction = spec.direction
        self._peak = spec.torque_peak
        self._torque_constant = spec.torque_constant
        self._serial = FIRST_SERIAL_NUMBER + spec.node_id if spec.serial is None else spec.serial
        self._saved = {number: bytes(4) for number in WRITABLE_PARAMETERS}
        self._saved[0x700B] = struct.pack("<f", self._torque)
        self._saved[0x7017] = struct.pack("<f", 2.0)
        self._saved[0x7018] = struct.pack("<f", self._torque / 0.5)
        self._saved[0x7026] = struct.pack("<HH", 1, 0)
        self.parameters = dict(self._saved)
        self._host = FACTORY_HOST_ID
        self._reports: list[int] = []
        self._thermal_ns = -1

    @property
    def run_mode(self) -> int:
        """Return the number of the mode of operation."""
        return self.parameters[0x7005][0]

    @property
    def timeout_ns(self) -> int:
        """Return the timeout of the watchdog [ns], or 0 if the watchdog is off.

        If no command arrives within the timeout, the watchdog fires.
        """
        return int.from_bytes(self.parameters[0x7028], "little") * TIMEOUT_UNIT_NS

    @property
    def torque_limit(self) -> float:
        """Return the torque limit in effect [N m]."""
        limit = float(struct.unpack("<f", self.parameters[0x700B])[0])
        return min(self._peak, self._torque, limit)

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Execute and answer a frame.

        Returns:
            The answers, or None if the frame is not for the motor.
        """
        number = frame.can_id & ~EXTENDED_FLAG
        if (
            not frame.can_id & EXTENDED_FLAG
            or frame.can_id & REMOTE_FLAG
            or frame.flags & FDF
            or number & 0xFF != self.node_id
        ):
            return None
        kind = number >> 24 & 0x1F
        if kind == 2 or kind == 0x15:
            return None
        if len(frame.data) != 8:
            self.malformed_frame_count += 1
            return []
        if kind == 1:
            self._follow_control_command(number >> 8 & 0xFFFF, frame.data, t_ns)
            return [self._feedback_frame(frame)]
        self._host = number >> 8 & 0xFF
        return self._execute_request(kind, number >> 16 & 0xFF, frame, t_ns)

    def _execute_request(
        self, frame_type: int, data_area: int, frame: Frame, t_ns: int
    ) -> list[Frame]:
        """Execute a request of a host, and return the answers."""
        if frame_type in (0, 7):
            # A new motor number takes effect at once, and the motor answers with its identity.
            if frame_type == 7 and 0 < data_area < 0x80:
                self.node_id = data_area
            return [self._identity_frame(frame)]
        if frame_type == 0x11:
            return [self._read_parameter(frame.data, frame)]
        requests = {
            3: self._enable,
            4: self._stop_on_request,
            6: self._set_zero,
            0x12: self._write_parameter,
            0x16: self._save_parameters,
        }
        if frame_type not in requests:
            self.malformed_frame_count += 1
            return []
        requests[frame_type](frame.data, t_ns)
        return [self._feedback_frame(frame)]

    def _identity_frame(self, frame: Frame) -> Frame:
        """Return the frame with the identity of the motor."""
        return Frame(
            EXTENDED_FLAG | self.node_id << 8 | 0xFE, self._serial.to_bytes(8, "big"), 0, frame.bus
        )

    def _enable(self, _data: bytes, t_ns: int) -> None:
        """Enter run mode, if the motor has no fault and the mode of operation is 0 (operation control)."""
        if self.fault or self.run_mode != 0:
            return
        self.watchdog_fed_ns = t_ns
        if self.mode != RUN_MODE:
            self.motor.servo.release()
            self.mode = RUN_MODE
        self._schedule()

    def _stop_on_request(self, data: bytes, _t_ns: int) -> None:
        """Enter reset mode. If byte 0 of the request is 1, also clear all faults."""
        self._stop(clear_faults=data[0] == 1)

    def _set_zero(self, data: bytes, _t_ns: int) -> None:
        """Make the present position zero."""
        if data[0] == 1:
            self.offset = -self._direction * self.motor.encoder()

    def _save_parameters(self, data: bytes, _t_ns: int) -> None:
        """Save the present parameters."""
        if data == bytes(range(1, 9)):
            self._saved = dict(self.parameters)

    def _stop(self, clear_faults: bool) -> None:
        """Enter reset mode, and clear the faults if ``clear_faults`` is True."""
        self.motor.servo.release()
        self.mode = RESET_MODE
        if clear_faults:
            self.fault = 0
        self._schedule()

    def _follow_control_command(self, torque: int, data: bytes, t_ns: int) -> None:
        """Follow a control command in run mode."""
        self.watchdog_fed_ns = t_ns
        if self.mode == RUN_MODE:
            self.follow(torque, data)
        self._schedule()

    def follow(self, torque: int, data: bytes) -> None:
        """Set the servo from a control command.

        ``torque`` is a 16-bit code, and ``data`` (8 bytes) contains all other values.
        """
        position, velocity, kp, kd = struct.unpack(">4H", data)
        servo = self.motor.servo
        sign = self._direction
        limit = self.torque_limit
        servo.kp = code_to_value(kp, 0.0, self._kp)
        servo.kd = code_to_value(kd, 0.0, self._kd)
        servo.position = sign * (
            code_to_value(position, -POSITION_RANGE, POSITION_RANGE) - self.offset
        )
        servo.velocity = sign * code_to_value(velocity, -self._velocity, self._velocity)
        feedforward = code_to_value(torque, -self._torque, self._torque)
        servo.torque = sign * max(-limit, min(limit, feedforward))
        servo.limit = limit

    def _read_parameter(self, data: bytes, frame: Frame) -> Frame:
        """Return the reply to a request that reads a parameter."""
        number = int.from_bytes(data[:2], "little")
        value = self.parameters.get(number)
        if value is None and number in READ_ONLY_PARAMETERS:
            value = struct.pack("<f", self._measured_parameter(number))
        reply_id = (
            EXTENDED_FLAG | 0x11 << 24 | (value is None) << 16 | self.node_id << 8 | self._host
        )
        return Frame(reply_id, data[:2] + b"\0\0" + (value or bytes(4)), 0, frame.bus)

    def _measured_parameter(self, parameter: int) -> float:
        """Return the present value of a measured parameter."""
        sign = self._direction
        values = {
            0x7019: sign * self.motor.encoder() + self.offset,
            0x701A: sign * self.motor.torque / self._torque_constant,
            0x701B: sign * self.motor.velocity,
            0x701C: 48.0,
        }
        return values[parameter]

    def _write_parameter(self, data: bytes, _t_ns: int) -> None:
        """Write a parameter. The motor ignores unknown parameters and values out of range."""
        number = int.from_bytes(data[:2], "little")
        value_coding = WRITABLE_PARAMETERS.get(number)
        if value_coding is None:
            return
        (value,) = struct.unpack_from(f"<{value_coding}", data, 4)
        if number == 0x7005 and (value not in (0, 1, 2, 3, 5) or self.mode == RUN_MODE):
            return
        if number == 0x700B and not 0.0 <= value <= self._torque:
            return
        self.parameters[number] = struct.pack(f"<{value_coding}", value).ljust(4, b"\0")

    def _feedback_frame(self, frame: Frame) -> Frame:
        """Return the feedback frame for the host that has sent the latest request."""
        motor = self.motor
        sign = self._direction
        position = value_to_code(sign * motor.encoder() + self.offset, POSITION_RANGE)
        velocity = value_to_code(sign * motor.velocity, self._velocity)
        torque = value_to_code(sign * motor.torque, self._torque)
        data = struct.pack(">HHHh", position, velocity, torque, int(10 * self.thermal.winding))
        status = self.mode << 6 | self.fault & FEEDBACK_FAULTS
        return Frame(
            EXTENDED_FLAG | 2 << 24 | status << 16 | self.node_id << 8 | self._host,
            data,
            0,
            frame.bus,
        )

    def trip(self, fault: int) -> None:
        """Enter reset mode with a fault.

        The watchdog calls this method with the fault value 0, which sets no fault bit.
        """
        self.motor.servo.release()
        self.mode = RESET_MODE
        self.fault |= fault
        if fault:
            self._reports.append(fault)
        self._schedule()

    def power_cycle(self) -> None:
        """Restart the motor in reset mode (without torque), with the saved parameters."""
        self._stop(clear_faults=True)
        self.parameters = dict(self._saved)
        self._host = FACTORY_HOST_ID

    def lose_settings(self) -> None:
        """Restore the saved parameters, but keep the mode."""
        self.parameters = dict(self._saved)

    def _schedule(self) -> None:
        """Set the time of the next call of ``wake``."""
        self.wake_ns = self._thermal_ns + THERMAL_PERIOD_NS
        if self.mode == RUN_MODE and self.timeout_ns:
            self.wake_ns = min(self.wake_ns, self.watchdog_fed_ns + self.timeout_ns + 1)
        if self._reports:
            self.wake_ns = 0

    def wake(self, t_ns: int) -> list[Frame]:
        """Check the watchdog and the temperature, and report new faults.

        Returns:
            The fault reports.
        """
        if (
            self.mode == RUN_MODE
            and self.timeout_ns
            and t_ns - self.watchdog_fed_ns > self.timeout_ns
        ):
            self.trip(0)
        if self._thermal_ns < 0 or t_ns - self._thermal_ns >= THERMAL_PERIOD_NS:
            if self._thermal_ns >= 0:
                self.thermal.advance((t_ns - self._thermal_ns) * 1e-9, self.motor.heat)
            self.motor.heat = 0.0
            self._thermal_ns = t_ns
            if self.thermal.winding > OVERHEATING_C and not self.fault & OVER_TEMPERATURE_FAULT:
                self.trip(OVER_TEMPERATURE_FAULT)
        reports = [self._fault_report_frame(fault) for fault in self._reports]
        self._reports.clear()
        self._schedule()
        return reports

    def _fault_report_frame(self, fault: int) -> Frame:
        """Return the frame that reports a new fault."""
        bits = (
            sum(report_bit for bit, report_bit in FAULT_REPORT_BITS.items() if fault & bit)
            | fault >> FAULT_REPORT_SHIFT
        )
        warning = int(self.thermal.winding > OVERHEATING_C)
        return Frame(
            EXTENDED_FLAG | 0x15 << 24 | self.node_id << 8 | self._host,
            struct.pack("<II", bits, warning),
        )
