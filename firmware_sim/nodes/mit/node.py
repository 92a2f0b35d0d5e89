"""A motor with the firmware of a Damiao drive. The drive sends frames only as answers.

Source: fact sheet mit_damiao.

Choices of this simulator where the fact sheet has only an assumption:

- Commands to ESC_ID restart the watchdog, but requests for registers do not. The condition for the
  watchdog in the manual is only "no CAN commands within the interval". Therefore the option
  ``watchdog`` can select another behaviour from ``WATCHDOG_BEHAVIOURS``.
- The special command FE (set zero) has an effect only while the motor is disabled.
- The motor answers a command for another mode than the mode in CTRL_MODE, but the command has no
  effect.
- The position and velocity modes use cascaded controllers with fixed gains, see ``motion_modes``.
- In the feedback, positions beyond PMAX are replaced by PMAX.
- The motor does not answer requests for unknown registers.

Register request to 0x7FF (8 bytes):

    byte 0..1  ESC_ID, low byte first
    byte 2     0x33 read, 0x55 write, 0xAA save, 0xCC request feedback
    byte 3     register
    byte 4..7  value, uint32 or float32, low byte first

The reply to a register request has the identifier MST_ID and the same layout as the request. A
special command has seven bytes FF, followed by FC (enable), FD (disable), FE (set zero) or FB
(clear error).
"""

import enum
import math
import struct

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.drive_temperatures import DriveTemperatures, ThermalStruct
from firmware_sim.nodes.mit import registers as reg
from firmware_sim.nodes.mit.codec import (
    PAYLOAD_WORD_STRUCT,
    THERMAL_PERIOD_NS,
    MitStruct,
    apply_command,
    feedback_word,
    schedule_wake,
)
from firmware_sim.nodes.mit.motion_modes import MotionModes
from firmware_sim.plant.motor import Motor

REGISTER_ID = 0x7FF
"""Identifier of register requests, the same for all motors."""
WATCHDOG_UNIT_NS = 50_000
"""Unit of the register TIMEOUT [ns]."""
_SPECIAL_COMMAND_START = b"\xff" * 7
_MOTION_STRUCTS = {1: struct.Struct("<ff"), 2: struct.Struct("<f"), 3: struct.Struct("<fHH")}
"""Layouts of the commands to 0x100 + ESC_ID, 0x200 + ESC_ID and 0x300 + ESC_ID."""
MAX_FORCE_POSITION_CODE = 10_000
"""Largest code in force-position mode, for a speed of 100 rad/s or the largest current.
"""
_ENABLE_COMMAND = 0xFC
_DISABLE_COMMAND = 0xFD
_ZERO_COMMAND = 0xFE
_CLEAR_COMMAND = 0xFB
_READ_REQUEST = 0x33
_WRITE_REQUEST = 0x55
_SAVE_REQUEST = 0xAA
_REFRESH_REQUEST = 0xCC


FED_BY_COMMANDS, FED_BY_FRAMES, FIRES_ALWAYS = "commands", "frames", "always"
WATCHDOG_BEHAVIOURS = {
    FED_BY_COMMANDS: "commands feed it, and it fires while the motor is enabled",
    FED_BY_FRAMES: "register requests feed it too",
    FIRES_ALWAYS: "commands feed it, and it also fires while the motor is disabled",
}
"""Possible behaviours of the drive's watchdog, by the value of the option ``watchdog``."""
EACH_CLEAR_ANSWERED, ERROR_CLEAR_ANSWERED, NO_CLEAR_ANSWERED = "each", "error", "never"
CLEAR_COMMAND_ANSWERS = {
    EACH_CLEAR_ANSWERED: "each clear command is answered",
    ERROR_CLEAR_ANSWERED: "only one that clears an error",
    NO_CLEAR_ANSWERED: "none is answered",
}
"""Possible answers to the command *clear error*, which the manual does not document."""


class FeedbackState(enum.IntEnum):
    """State nibble in the feedback.

    Every state with a code above ENABLED is an error. In an error state, the motor makes no torque.
    """

    DISABLED = 0x0
    ENABLED = 0x1
    OVER_CURRENT = 0xA
    MOSFET_OVERHEATED = 0xB
    WINDING_OVERHEATED = 0xC
    COMMUNICATION_LOST = 0xD
    OVERLOAD = 0xE


_ENABLED = FeedbackState.ENABLED
"""The state ENABLED as a module constant, which ``_process_command`` can look up faster than an attribute."""


class MitNode:
    """A simulated Damiao motor on the bus.

    Attributes:
        state: state nibble of the motor.
        registers: registers of the motor.
        offset: angle that the motor reports when the spool angle theta is 0 [rad].
        thermal: temperatures of the motor and its drive.
        ids: identifiers of the frames that the node answers.
        malformed_frame_count: number of frames with an identifier of the node that the node could not decode.
        wake_ns: time of the next call of ``wake`` [ns].
        watchdog_fed_ns: time of the last frame that restarted the watchdog [ns].
        timeout_ns: timeout of the watchdog [ns], or 0 if the watchdog is off.
        thermal_ns: time of the last update of the temperatures [ns], negative before the
            first update.
        node_id: identifier of commands to the motor, register 8.
        reply_id: identifier of the motor's answers, register 7.
        position_range: largest position in frames, register 21 [rad].
        velocity_range: largest velocity in frames, register 22 [rad/s].
        mode: control mode, register 10.
        torque_range: largest torque in frames, register 23 [N m].
        direction: +1 if the motor angle grows with the spool angle, and -1 if the motor angle
            falls.
    """

    state: int

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set up the node in the state after power-up.

        Args:
            spec: description of the motor.
            motor: rotor of the motor.
            offset: angle that the motor reports when the spool angle theta is 0 [rad].
        """
        self.motor = motor
        self.offset = offset
        self.registers = reg.MitRegisters(spec)
        self.thermal = self._temperatures(spec.torque_constant)
        self.state = FeedbackState.DISABLED
        self.malformed_frame_count = 0
        self.wake_ns = 0
        self.direction = spec.direction
        self.mode = reg.MODE_MIT
        self.torque_peak = spec.torque_peak
        self._clear_answers = str(spec.options.get("clear_answers", EACH_CLEAR_ANSWERED))
        self._watchdog = str(spec.options.get("watchdog", FED_BY_COMMANDS))
        self.watchdog_fed_ns = 0
        self.thermal_ns = -1
        self._motion_modes = MotionModes(self)
        self._update_derived_values()

    def _temperatures(self, torque_constant: float) -> DriveTemperatures:
        """Create the temperatures of a drive, all at ambient temperature."""
        return DriveTemperatures(torque_constant)

    @property
    def cyclic_ids(self) -> tuple[int, ...]:
        """Return the identifiers of the frames that the node receives in every tick."""
        return (self.node_id,)

    def _update_derived_values(self) -> None:
        """Update the attributes derived from registers."""
        self.node_id = int(self.registers[reg.ESC_ID])
        self.reply_id = int(self.registers[reg.MST_ID])
        self._mode_ids = {self.node_id + offset for offset in (0x100, 0x200, 0x300)}
        self.ids = frozenset((self.node_id, REGISTER_ID, *self._mode_ids))
        ranges = self.registers[reg.PMAX], self.registers[reg.VMAX], self.registers[reg.TMAX]
        self.position_range, self.velocity_range, self.torque_range = ranges
        self.motor.servo.limit = min(self.torque_peak, self.torque_range)
        self.timeout_ns = int(self.registers[reg.TIMEOUT]) * WATCHDOG_UNIT_NS
        mode = int(self.registers[reg.CTRL_MODE])
        if mode != self.mode:
            # A setpoint is valid only in the mode in which a host has sent the setpoint.
            self._release_motor()
        self.mode = mode

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Process a frame, and answer in the same frame format.

        Returns:
            The answers, or None if the frame is not meant for this motor.
        """
        can_id, data, flags, bus, _ = frame
        if can_id == self.node_id:
            if t_ns >= self.wake_ns:
                self.wake(t_ns)
            answer = self._process_command(data, t_ns)
        elif can_id == REGISTER_ID:
            if len(data) < 4 or int.from_bytes(data[:2], "little") != self.node_id:
                return None
            self.wake(t_ns)
            if self._watchdog == FED_BY_FRAMES:
                self.watchdog_fed_ns = t_ns
            answer = self._process_register_request(data)
        elif can_id in self._mode_ids:
            self.wake(t_ns)
            # Some hosts send the special commands FD and FE to the identifier of a motion mode.
            is_special = data[:7] == _SPECIAL_COMMAND_START and len(data) == 8
            answer = (
                self._process_special_command(data, t_ns)
                if is_special
                else self._process_motion_command(can_id - self.node_id >> 8, data, t_ns)
            )
        else:
            return None
        self._schedule()
        if answer is None:
            self.malformed_frame_count += 1
        if not answer:
            return []
        return [Frame(self.reply_id, answer, flags, bus, t_ns)]

    def _process_command(self, data: bytes, t_ns: int) -> bytes | None:
        """Process a frame with the identifier ESC_ID, and return the payload of the answer.

        Return None if the frame is malformed.
        """
        if len(data) != 8:
            return None
        # The code compares the last byte of the payload first, because this byte differs in most
        # commands. So the code rarely compares the other seven bytes.
        if data[7] >= _CLEAR_COMMAND and data[7] != 0xFF and data[:7] == _SPECIAL_COMMAND_START:
            return self._process_special_command(data, t_ns)
        self.watchdog_fed_ns = t_ns
        if self.state == _ENABLED and self.mode == reg.MODE_MIT:
            apply_command(self, self.motor.servo, PAYLOAD_WORD_STRUCT.unpack(data)[0])
        return self.feedback()

    def _process_motion_command(self, mode_number: int, data: bytes, t_ns: int) -> bytes | None:
        """Process a command of the position-velocity (1), velocity (2) or force-position mode (3).

        Returns:
            Payload of the feedback, or None if the command is malformed.
        """
        layout = _MOTION_STRUCTS[mode_number]
        if len(data) < layout.size:
            return None
        self.watchdog_fed_ns = t_ns
        if self.state != _ENABLED or self.mode != mode_number + 1:
            return self.feedback()
        values = layout.unpack_from(data)
        if not all(map(math.isfinite, values)):
            return None
        if mode_number == 2:
            self._motion_modes.follow_velocity(values[0])
        elif mode_number == 1:
            self._motion_modes.follow_position(values[0], abs(values[1]))
        else:
            speed, current = values[1:]
            if speed > MAX_FORCE_POSITION_CODE or current > MAX_FORCE_POSITION_CODE:
                return None
            self._motion_modes.follow_force_position(
                values[0], speed / 100.0, current / MAX_FORCE_POSITION_CODE
            )
        self._motion_modes.start(t_ns)
        return self.feedback()

    def _process_special_command(self, data: bytes, t_ns: int) -> bytes | None:
        """Execute a special command, and return the payload of the answer, or None if the command is malformed."""
        if len(data) != 8 or data[:7] != _SPECIAL_COMMAND_START:
            return None
        self.watchdog_fed_ns = t_ns
        code = data[7]
        if code == _ENABLE_COMMAND:
            self._enable()
        elif code == _DISABLE_COMMAND:
            self._disable()
        elif code == _ZERO_COMMAND:
            if self.state != FeedbackState.ENABLED:
                self.offset = -self.direction * self.motor.encoder()
        elif code == _CLEAR_COMMAND:
            had_error = self.state > FeedbackState.ENABLED
            self._clear()
            if self._clear_answers == NO_CLEAR_ANSWERED or (
                self._clear_answers == ERROR_CLEAR_ANSWERED and not had_error
            ):
                return b""
        else:
            return None
        return self.feedback()

    def _release_motor(self) -> None:
        """Let the motor turn freely until the next command."""
        self._motion_modes.end()
        self.motor.servo.release()

    def _enable(self) -> None:
        if self.state == FeedbackState.DISABLED:
            self._release_motor()
            self.state = FeedbackState.ENABLED

    def _disable(self) -> None:
        self._release_motor()
        if self.state == FeedbackState.ENABLED:
            self.state = FeedbackState.DISABLED

    def _clear(self) -> None:
        if self.state > FeedbackState.ENABLED:
            self.state = FeedbackState.DISABLED

    def trip(self, state: FeedbackState) -> None:
        """Enter an error state.

        The motor makes torque again only after the error has been cleared and the motor has been
        enabled.
        """
        self._release_motor()
        self.state = state

    def feedback(self) -> bytes:
        """Return the payload of the present feedback."""
        motor = self.motor
        thermal = self.thermal
        return PAYLOAD_WORD_STRUCT.pack(
            feedback_word(self, motor, motor.encoder(), thermal.mosfet, thermal.winding)
        )

    def _process_register_request(self, data: bytes) -> bytes | None:
        """Execute a register request, and return the payload of the reply, or None if the request is malformed."""
        operation = data[2]
        register = data[3]
        if operation == _REFRESH_REQUEST:
            return self.feedback()
        request_head = data[:3]
        if operation == _SAVE_REQUEST and self.state != FeedbackState.ENABLED:
            self.registers.save()
            return request_head + b"\x01\0\0\0\0"
        if operation not in (_READ_REQUEST, _WRITE_REQUEST) or register not in self.registers:
            return None
        if operation == _WRITE_REQUEST:
            if len(data) != 8:
                return None
            self.registers.write(register, data[4:])
            self._update_derived_values()
        self._update_measured_registers()
        return request_head + data[3:4] + self.registers.read(register)

    def _update_measured_registers(self) -> None:
        """Update the registers that hold measured values."""
        position = self.direction * self.motor.encoder() + self.offset
        self.registers.set_measured(reg.MOTOR_POSITION, position)
        self.registers.set_measured(reg.OUTPUT_POSITION, position)
        self.registers.set_measured(reg.BOARD_TEMPERATURE, self.thermal.mosfet)
        self.registers.set_measured(reg.WINDING_TEMPERATURE, self.thermal.winding)

    def power_cycle(self) -> None:
        """Restart the motor, disabled and with the saved registers."""
        self.registers.power_cycle()
        self._release_motor()
        self.state = FeedbackState.DISABLED
        self._update_derived_values()

    def lose_settings(self, torque_max: float) -> None:
        """Restore the saved registers, but keep the state of the motor.

        Args:
            torque_max: new value of the register TMAX [N m], or 0 to keep the saved value.
        """
        self.registers.power_cycle()
        if torque_max:
            self.registers.set_measured(reg.TMAX, torque_max)
        self._update_derived_values()

    def wake(self, t_ns: int) -> None:
        """Do the work that is due: update the temperatures and the motion mode, check the watchdog."""
        if t_ns - self.thermal_ns >= THERMAL_PERIOD_NS or self.thermal_ns < 0:
            self._update_temperatures(t_ns)
        watched_states = (
            FeedbackState.ENABLED,
            *[FeedbackState.DISABLED] * (self._watchdog == FIRES_ALWAYS),
        )
        silence_ns = t_ns - self.watchdog_fed_ns
        if self.state in watched_states and self.timeout_ns and silence_ns >= self.timeout_ns:
            self.trip(FeedbackState.COMMUNICATION_LOST)
        self._motion_modes.advance(t_ns)
        self._schedule()

    def _schedule(self) -> None:
        """Schedule the next wake of the motor, including the wakes for its motion mode.

        Compiled code does not handle motion modes.
        """
        schedule_wake(self)
        self.wake_ns = min(self.wake_ns, self._motion_modes.due_ns)

    def _update_temperatures(self, t_ns: int) -> None:
        """Advance the temperatures. If the winding is too hot, enter an error state."""
        if self.thermal_ns >= 0:
            self.thermal.advance((t_ns - self.thermal_ns) * 1e-9, self.motor.heat)
        self.motor.heat = 0.0
        self.thermal_ns = t_ns
        if (
            self.state == FeedbackState.ENABLED
            and self.thermal.winding > self.registers[reg.OVER_TEMPERATURE]
        ):
            self.trip(FeedbackState.WINDING_OVERHEATED)


class MitNodeRow(MitStruct, MitNode):
    """A simulated Damiao motor whose state is in an array row, for compiled kernels."""

    layout = MitStruct

    def initialise(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set the array row of the node to the state after power-up.

        The class ``MitNode`` explains the arguments.
        """
        MitNode.__init__(self, spec, motor, offset)
        self.motor_number = motor.number

    def _temperatures(self, torque_constant: float) -> DriveTemperatures:
        thermal: ThermalStruct = self.temperatures
        DriveTemperatures.__init__(thermal, torque_constant)
        return thermal
