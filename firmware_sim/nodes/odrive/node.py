"""A motor on an ODrive with firmware 0.6.x or 0.5.x and CANSimple.

Source: fact sheet odrive_cansimple.

Identifiers have the node number in bits 10..5 and the command in bits 4..0. Payloads are
little-endian:

    0x01  Heartbeat              u32 errors, u8 state, u8 result, u8 trajectory done, u8, cyclic
    0x02  Estop                  -
    0x03  Get_Error              u32 active errors, u32 disarm reason
    0x04  RxSdo                  u8 operation (0 read, 1 write), u16 endpoint, u8, value
    0x05  TxSdo                  u8, u16 endpoint, u8, value
    0x06  Get_Address            u8 node, u48 serial number, u8
    0x07  Set_Axis_State         u32 state
    0x09  Get_Encoder_Estimates  f32 position [turn], f32 velocity [turn/s], cyclic
    0x0B  Set_Controller_Mode    u32 control mode, u32 input mode
    0x0C  Set_Input_Pos          f32 position, i16 velocity, i16 torque, both in thousandths
    0x0D  Set_Input_Vel          f32 velocity [turn/s], f32 torque [N m]
    0x0E  Set_Input_Torque       f32 torque [N m]
    0x0F  Set_Limits             f32 velocity [turn/s], f32 current [A]
    0x11  Set_Traj_Vel_Limit     f32 velocity [turn/s]
    0x12  Set_Traj_Accel_Limits  f32 acceleration, f32 deceleration [turn/s2]
    0x13  Set_Traj_Inertia       f32 torque per acceleration [N m s2/turn]
    0x16  Reboot                 u8 action: 0 none, 1 save settings, 2 erase settings
    0x18  Clear_Errors           u8
    0x19  Set_Absolute_Position  f32 position [turn], firmware 0.5: i32 position [count]
    0x1A  Set_Pos_Gain           f32 gain [1/s]
    0x1B  Set_Vel_Gains          f32 gain [N m s/turn], f32 integrator gain

To request a Get message, a host sends a remote frame or an empty data frame with the identifier of
the message.

Choices of this simulator where the fact sheet has only an assumption:

- The error field of the heartbeat combines the active errors and the disarm reason.
- Only setpoint messages feed the watchdog.
- A setpoint of NaN disarms the axis with the error *missing input*.
- A disarm reason stays until Clear_Errors. With a disarm reason, the axis refuses closed-loop
  control.
- The hand file gives the numbers of the endpoints.
- With the option ``confirms_writes``, the axis has firmware 0.6.11, which confirms the write of an
  endpoint. The confirmation of a write is a TxSdo without a value.
- A calibration takes ``CALIBRATION_DURATION_NS`` and does not move the motor. With the option
  ``uncalibrated``, the axis refuses closed-loop control before a calibration.
- The module ``motion_modes`` has position control, velocity control and their input modes.
"""

import math
import struct
from typing import Any

from firmware_sim.bus.frame import FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.drive_temperatures import DriveTemperatures
from firmware_sim.nodes.odrive.kernels import (
    CLOSED_LOOP,
    IDLE_STATE,
    PASSTHROUGH_MODE,
    THERMAL_PERIOD_NS,
    TURN_RAD,
    OdriveStruct,
    next_period_ns,
    position_in_turns,
    schedule_wake,
    set_torque,
    velocity_in_turns_per_s,
    watchdog_expired,
)
from firmware_sim.nodes.odrive.motion_modes import (
    MOTION_ENDPOINTS,
    POSITION_CONTROL,
    MotionModes,
    MotionSettings,
)
from firmware_sim.plant.motor import Motor

MISSING_INPUT_ERROR = 1 << 6
"""Error bit: a setpoint is not finite."""
MOTOR_OVERHEATED_ERROR = 1 << 13
"""Error bit: over-temperature of the motor."""
WATCHDOG_ERROR = 1 << 24
"""Error bit: the watchdog has fired."""
ESTOP_ERROR = 1 << 25
"""Error bit: the host has requested an emergency stop."""
SUCCESS_RESULT = 0
"""Procedure result: the last procedure has succeeded."""
DISARMED_RESULT = 3
"""Procedure result: an error has disarmed the axis."""
BUSY_RESULT = 1
"""Procedure result: a procedure still runs."""
CANCELLED_RESULT = 2
"""Procedure result: the host has ended a procedure early."""
INVALID_STATE = 13
"""Procedure result: the requested state is not possible."""
NOT_CALIBRATED = 14
"""Procedure result: closed-loop control requires an earlier calibration."""
CALIBRATION_DURATION_NS = {3: 4_000_000_000, 4: 2_000_000_000, 7: 2_000_000_000}
"""Duration of each calibration (full, motor, encoder offset) by its axis state [ns].

The durations of the calibrations are assumptions.
"""
COUNTS_PER_TURN = 8192
"""Encoder counts of one turn: the vendor's default of firmware 0.5."""
BROADCAST_NUMBER = 0x3F
"""Node number of messages to all nodes."""
HEARTBEAT_PERIOD_MS = 100
"""Vendor's default period of the heartbeat [ms]."""
ENCODER_PERIOD_MS = 10
"""Vendor's default period of the encoder estimates [ms]."""
FIRST_SERIAL_NUMBER = 0x0D_5A_11_00_00_00
"""Serial number of the axis with node number 0. Other nodes add their node number."""
OVERHEATING_C = 120.0
"""Winding temperature at which the axis disarms itself [degC]."""
_MIN_PAYLOAD_BYTES = {
    0x02: 0, 0x04: 4, 0x07: 4, 0x0B: 8, 0x0C: 8, 0x0D: 8, 0x0E: 4, 0x0F: 8, 0x11: 4, 0x12: 8,
    0x13: 4, 0x16: 0, 0x18: 0, 0x19: 4, 0x1A: 4, 0x1B: 8,
}  # fmt: skip
"""Minimum length of the payload of each accepted message, by command number [bytes]."""
_LEGACY_ANSWERS = {0x09, 0x14, 0x17}
"""Command numbers of the Get messages that firmware 0.5.x answers."""
_LEGACY_ERROR_BY_ERROR = {
    MISSING_INPUT_ERROR: 1 << 0,
    MOTOR_OVERHEATED_ERROR: 1 << 6,
    WATCHDOG_ERROR: 1 << 11,
    ESTOP_ERROR: 1 << 14,
}
"""Axis error bit of firmware 0.5.x for each error bit of firmware 0.6.x."""


class OdriveNode:
    """A simulated axis of an ODrive.

    Attributes:
        state: present axis state.
        active_errors: bits of the present errors.
        disarm_reason: bits of the errors that have disarmed the axis since the last Clear_Errors.
        result: result of the last procedure.
        endpoints: stored settings as bytes, by endpoint number. Examples are enable_watchdog,
            watchdog_timeout and the torque limits.
        control_mode: control mode, which selects the controlled quantity.
        input_mode: input mode, which selects how setpoints follow the inputs.
        setpoint: torque setpoint in torque control, or feedforward torque in other control modes [N
            m].
        motion: position control, velocity control and input modes of the axis.
        motion_due_ns: time of the next update of ``motion_modes`` [ns], 0 in torque control without a
            ramp.
        torque_min: lower torque limit, from its endpoint [N m].
        torque_max: upper torque limit, from its endpoint [N m].
        timeout_ns: timeout of the watchdog, from its endpoints [ns], 0 if the watchdog is off.
        velocity_limit: velocity limit of the axis [turn/s].
        current_limit: current limit of the axis [A].
        velocity_gain: gain of the velocity loop [N m s/turn].
        thermal: temperatures of motor and drive.
        ids: None, because the node answers many identifiers.
        malformed_frame_count: number of frames that the node could not decode.
        wake_ns: time of the next call of ``wake`` [ns].
        watchdog_fed_ns: time of the last setpoint [ns].
        thermal_ns: time of the last update of the temperatures [ns].
        heartbeat_due_ns: time of the next heartbeat [ns].
        encoder_due_ns: time of the next encoder estimates [ns].
        accepted_ids: identifiers of the frames that the node answers.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set up the axis in the state after power-up.

        Args:
            spec: description of the motor.
            motor: rotor of the motor.
            offset: shaft angle at the spool angle theta = 0 [rad].
        """
        self.motor = motor
        self.offset = offset
        self.ids: frozenset[int] | None = None
        self.node_id = spec.node_id
        options = spec.options
        own_ids = [
            node << 5 | command
            for node in (spec.node_id, BROADCAST_NUMBER)
            for command in range(0x20)
        ]
        self.accepted_ids = frozenset((*own_ids, *(can_id | REMOTE_FLAG for can_id in own_ids)))
        self._serial = FIRST_SERIAL_NUMBER + spec.node_id if spec.serial is None else spec.serial
        self.gear = float(options.get("gear_ratio", 1.0))
        self.direction = spec.direction
        self.torque_constant = spec.torque_constant
        self.peak = spec.torque_peak
        self.thermal = DriveTemperatures(spec.torque_constant)
        self.state = IDLE_STATE
        self.active_errors = 0
        self.disarm_reason = 0
        self.result = SUCCESS_RESULT
        self._set_modes(POSITION_CONTROL, PASSTHROUGH_MODE)
        self.velocity_gain = MotionSettings().velocity_gain
        self.motion_due_ns = 0
        self.motion = MotionModes(self)
        self.velocity_limit = 50.0
        self.current_limit = 20.0
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
        # If the hand file gives another endpoint the number of a default endpoint, the number
        # stands for the endpoint of the hand file.
        defaults = {
            number: struct.pack("<f", value) for number, (_, value) in MOTION_ENDPOINTS.items()
        }
        self.endpoints = defaults | self.endpoints
        self.legacy = options.get("firmware") == "0.5"
        if (
            usb := options.get("usb_watchdog_s")
        ):  # A host can change the setting below only over USB. No CAN frame can change the setting.
            self._numbers |= {"enable_watchdog": -1, "watchdog_timeout": -2}
            self.endpoints |= {-1: b"\1", -2: struct.pack("<f", usb)}
        self._confirms_writes = bool(options.get("confirms_writes", False))
        self.calibrated = not options.get("uncalibrated", False)
        self.busy_until_ns = 0
        self._factory = self._storable_settings()
        self._saved = self._factory
        self.setpoint = 0.0
        self.heartbeat_period_ns = HEARTBEAT_PERIOD_MS * 1_000_000
        self.encoder_period_ns = (
            int(options.get("encoder_period_ms", ENCODER_PERIOD_MS)) * 1_000_000
        )
        self.heartbeat_due_ns = self.encoder_due_ns = 0
        self.watchdog_fed_ns = 0
        self.thermal_ns = -1
        self._update_derived_values()
        self.malformed_frame_count = 0
        self.wake_ns = 0

    def _set_modes(self, control_mode: int, input_mode: int) -> None:
        """Set the control mode and the input mode."""
        self.control_mode = control_mode
        self.input_mode = input_mode

    def _update_derived_values(self) -> None:
        """Update the attributes of the axis that are derived from endpoints."""
        self.torque_min, self.torque_max = (
            self._endpoint_limit("torque_min", -math.inf),
            self._endpoint_limit("torque_max", math.inf),
        )
        enabled = self.endpoints.get(self._numbers["enable_watchdog"])
        timeout_s = self._endpoint_limit("watchdog_timeout", 0.0)
        self.timeout_ns = int(timeout_s * 1e9) if enabled == b"\1" and 0.0 < timeout_s < 1e6 else 0

    @property
    def mode(self) -> tuple[int, int]:
        """Return the control mode and the input mode."""
        return self.control_mode, self.input_mode

    @property
    def cyclic_ids(self) -> tuple[int, ...]:
        """Return the identifiers of the frames that the node receives in every tick."""
        return self.node_id << 5 | 0x0E, self.node_id << 5 | 0x09 | REMOTE_FLAG

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Process a frame from the bus, and answer it.

        Returns:
            The answers. None if the frame is not for this axis.
        """
        can_id = frame.can_id & ~REMOTE_FLAG
        node = can_id >> 5
        command = can_id & 0x1F
        if node not in (self.node_id, BROADCAST_NUMBER) or frame.flags & FDF:
            return None
        if frame.can_id & REMOTE_FLAG or (not frame.data and command not in _MIN_PAYLOAD_BYTES):
            return self._answer_remote_frame(node, command)
        if command not in _MIN_PAYLOAD_BYTES:
            return [] if node == self.node_id else None
        if len(frame.data) < _MIN_PAYLOAD_BYTES[command]:
            self.malformed_frame_count += 1
            return []
        return self._execute_message(command, frame.data, t_ns)

    def _answer_remote_frame(self, node: int, command: int) -> list[Frame]:
        """Answer a request for a Get message.

        Only the request for Get_Address is allowed to be a broadcast.
        """
        if node == BROADCAST_NUMBER and command != 0x06:
            return []
        answer = self._get_payload(command)
        return [Frame(self.node_id << 5 | command, answer)] if answer else []

    def _get_payload(self, command: int) -> bytes:
        """Return the payload of a Get message.

        If the firmware version does not support the Get message, the payload is empty.
        """
        gear = self.gear
        sign = self.direction
        if self.legacy and command not in _LEGACY_ANSWERS:
            return b""
        if command == 0x00:
            return bytes((2, 4, 4, 58, 0, 6, 11 if self._confirms_writes else 10, 0))
        if command == 0x03:
            return struct.pack("<II", self.active_errors, self.disarm_reason)
        if command == 0x06:
            return bytes((self.node_id,)) + self._serial.to_bytes(6, "little") + b"\0"
        if command == 0x09:
            return struct.pack(
                "<ff",
                position_in_turns(self, self.motor.encoder()),
                velocity_in_turns_per_s(self, self.motor.velocity),
            )
        current = sign * self.motor.torque / self.torque_constant
        pairs = {
            0x14: (self.setpoint * gear / self.torque_constant, current),
            0x15: (self.thermal.mosfet, self.thermal.winding),
            0x17: (24.0, abs(current) * 0.1),
            0x1C: (self.setpoint, sign * self.motor.torque / gear),
            0x1D: (abs(current) * 2.4, self.motor.torque * self.motor.velocity),
        }
        return struct.pack("<ff", *pairs[command]) if command in pairs else b""

    def _execute_message(self, command: int, data: bytes, t_ns: int) -> list[Frame]:
        """Execute a message from the host."""
        if command == 0x02:
            self.disarm(ESTOP_ERROR)
        elif command == 0x04:
            return self._execute_sdo_request(data)
        elif command == 0x07:
            self._set_state(int.from_bytes(data[:4], "little"), t_ns)
        elif command == 0x0B:
            self._set_mode(*struct.unpack("<II", data))
        elif command in (0x0C, 0x0D):
            self._set_input(command, data, t_ns)
        elif command == 0x0E:
            self._set_torque(struct.unpack_from("<f", data)[0], t_ns)
        elif command == 0x0F:
            self._set_limits(*struct.unpack("<ff", data))
        elif command in (0x11, 0x12, 0x13, 0x1A, 0x1B):
            self._set_motion(command, data)
        elif command == 0x16:
            self._reboot(data[0] if data else 0)
        elif command == 0x19:
            self._set_position(data)
        elif command == 0x18:
            self.active_errors = self.disarm_reason = 0
            self.result = SUCCESS_RESULT
        schedule_wake(self)
        return []

    def _set_state(self, state: int, t_ns: int) -> None:
        """Set the axis state as the host requests.

        If the axis has an error, the axis refuses closed-loop control.
        """
        if state == IDLE_STATE:
            self._release_axis(CANCELLED_RESULT if self.busy_until_ns else SUCCESS_RESULT)
        elif self._is_calibration_possible(state):
            self.state = state
            self.result = BUSY_RESULT
            self.busy_until_ns = t_ns + CALIBRATION_DURATION_NS[state]
        elif state == CLOSED_LOOP and not self.calibrated:
            self.result = NOT_CALIBRATED
        elif state != CLOSED_LOOP or self.active_errors or self.disarm_reason:
            self.result = INVALID_STATE if self.state == IDLE_STATE else self.result
        elif self.state != CLOSED_LOOP:
            self.state = CLOSED_LOOP
            self.result = SUCCESS_RESULT
            self.watchdog_fed_ns = t_ns
            self.motion.start(t_ns)

    def _is_calibration_possible(self, state: int) -> bool:
        """Return True if an axis state is a calibration that can start now."""
        has_error = self.active_errors or self.disarm_reason
        return state in CALIBRATION_DURATION_NS and self.state == IDLE_STATE and not has_error

    def _set_mode(self, control_mode: int, input_mode: int) -> None:
        """Set the control mode and the input mode, but only while the axis is idle."""
        if self.state == IDLE_STATE:
            self._set_modes(control_mode, input_mode)

    def _set_motion(self, command: int, data: bytes) -> None:
        """Apply a message that sets gains, or limits of trajectories."""
        values = struct.unpack_from("<ff" if command in (0x12, 0x1B) else "<f", data)
        self.motion.set(command, values)
        self.velocity_gain = self.motion.settings.velocity_gain

    def _set_limits(self, velocity: float, current_limit: float) -> None:
        """Set the velocity limit [turn/s] and the current limit [A], if both values are positive."""
        if velocity > 0.0 and current_limit > 0.0:
            self.velocity_limit = velocity
            self.current_limit = current_limit

    def _set_torque(self, torque: float, t_ns: int) -> None:
        """Set a torque setpoint [N m], or disarm the axis if the setpoint is not finite."""
        if not math.isfinite(torque):
            self.disarm(MISSING_INPUT_ERROR)
            return
        set_torque(self, self.motor.servo, torque, t_ns)
        self.motion.advance(t_ns, is_forced=True)

    def _set_input(self, command: int, data: bytes, t_ns: int) -> None:
        """Set the inputs of Set_Input_Pos (0x0C) or Set_Input_Vel (0x0D).

        A frame can contain inputs that the active control mode of the drive does not use.
        """
        if command == 0x0C:
            position, velocity, torque = struct.unpack("<fhh", data)
            values = position, velocity * 1e-3, torque * 1e-3
        else:
            values = (self.motion.input_position, *struct.unpack("<ff", data))
        if not all(map(math.isfinite, values)):
            self.disarm(MISSING_INPUT_ERROR)
            return
        self.motion.take(command == 0x0C, *values[:2])
        set_torque(self, self.motor.servo, values[2], t_ns)
        self.motion.advance(t_ns, is_forced=True)

    def _endpoint_limit(self, name: str, default: float) -> float:
        """Return the value of a named endpoint as a float.

        If the hand file does not give the number of the endpoint, return ``default``.
        """
        limit_bytes = self.endpoints.get(self._numbers[name])
        return float(struct.unpack("<f", limit_bytes)[0]) if limit_bytes else default

    def endpoint_float(self, endpoint: int) -> float:
        """Return a setting of ``MOTION_ENDPOINTS``.

        If the hand file assigns this endpoint number to another setting, return the default value
        of the setting in ``MOTION_ENDPOINTS``.
        """
        if endpoint in self._numbers.values():
            return MOTION_ENDPOINTS[endpoint][1]
        (value,) = struct.unpack("<f", self.endpoints[endpoint])
        return max(0.0, float(value)) if math.isfinite(value) else 0.0

    def _execute_sdo_request(self, data: bytes) -> list[Frame]:
        """Read or write an endpoint.

        Firmware before 0.6.11 does not answer a write request. Firmware from 0.6.11 on confirms a
        write.
        """
        operation = data[0]
        endpoint = int.from_bytes(data[1:3], "little")
        stored_value = self.endpoints.get(endpoint)
        if stored_value is None or operation > 1 or self.legacy:
            return []
        if operation == 1:
            if len(data) - 4 >= len(stored_value):
                self.endpoints[endpoint] = data[4 : 4 + len(stored_value)]
                self._update_derived_values()
            confirmation = b"\0" + endpoint.to_bytes(2, "little") + b"\0"
            return [Frame(self.node_id << 5 | 0x05, confirmation)] if self._confirms_writes else []
        return [
            Frame(
                self.node_id << 5 | 0x05,
                b"\0" + endpoint.to_bytes(2, "little") + b"\0" + stored_value,
            )
        ]

    def _set_position(self, data: bytes) -> None:
        """Shift the zero position until the present position has the given value.

        The host gives the value in turns, or in counts with firmware 0.5.
        """
        (value,) = struct.unpack_from("<i" if self.legacy else "<f", data)
        position = value / COUNTS_PER_TURN if self.legacy else value
        if math.isfinite(position):
            self.offset = position * TURN_RAD - self.direction * self.gear * self.motor.encoder()

    def _storable_settings(self) -> dict[str, Any]:
        """Return the settings that a Reboot command with the action *save* stores."""
        return {
            "endpoints": dict(self.endpoints),
            "modes": (self.control_mode, self.input_mode),
            "velocity_limit": self.velocity_limit,
            "current_limit": self.current_limit,
            "motion": self.motion.settings,
            "calibrated": self.calibrated,
        }

    def _reboot(self, reboot_action: int) -> None:
        """Restart with the saved settings.

        Before the restart, the Reboot action 1 saves the present settings, and the Reboot action 2
        erases the saved settings.
        """
        self._saved = {1: self._storable_settings(), 2: self._factory}.get(
            reboot_action, self._saved
        )
        self._release_axis(SUCCESS_RESULT)
        self.active_errors = self.disarm_reason = 0
        self._set_modes(*self._saved["modes"])
        self.lose_settings()

    def lose_settings(self) -> None:
        """Restore the saved settings, but keep the axis state."""
        saved_settings = self._saved
        self.velocity_limit = saved_settings["velocity_limit"]
        self.current_limit = saved_settings["current_limit"]
        self.motion.settings = saved_settings["motion"]
        self.velocity_gain = self.motion.settings.velocity_gain
        self.calibrated = saved_settings["calibrated"]
        self.endpoints = dict(saved_settings["endpoints"])
        self._update_derived_values()

    def _release_axis(self, procedure_result: int) -> None:
        """Enter the axis state *idle* with a procedure result. In this state, the motor turns freely."""
        self.motor.servo.release()
        self.motion_due_ns = 0
        self.state = IDLE_STATE
        self.busy_until_ns = 0
        self.result = procedure_result
        self.setpoint = 0.0

    def disarm(self, error_bit: int) -> None:
        """Enter the axis state *idle* because of an error. In this state, the motor turns freely."""
        self.disarm_reason |= error_bit
        self._release_axis(DISARMED_RESULT)

    def wake(self, t_ns: int) -> list[Frame]:
        """Do the work that is due: temperatures, watchdog, calibration, motion and cyclic messages.

        Returns:
            The cyclic messages that are due.
        """
        if self.thermal_ns < 0 or t_ns - self.thermal_ns >= THERMAL_PERIOD_NS:
            self._update_temperatures(t_ns)
        if watchdog_expired(self, t_ns):
            self.disarm(WATCHDOG_ERROR)
        if 0 < self.busy_until_ns <= t_ns:
            self.calibrated = True
            self._release_axis(SUCCESS_RESULT)
        self.motion.advance(t_ns)
        frames = []
        if t_ns >= self.heartbeat_due_ns:
            frames.append(Frame(self.node_id << 5 | 0x01, self._heartbeat_payload()))
            self.heartbeat_due_ns = next_period_ns(
                self.heartbeat_due_ns, t_ns, self.heartbeat_period_ns
            )
        if t_ns >= self.encoder_due_ns:
            frames.append(Frame(self.node_id << 5 | 0x09, self._get_payload(0x09)))
            self.encoder_due_ns = next_period_ns(self.encoder_due_ns, t_ns, self.encoder_period_ns)
        schedule_wake(self)
        return frames

    def _heartbeat_payload(self) -> bytes:
        """Return the payload of a heartbeat."""
        if self.legacy:
            errors = sum(
                legacy_error
                for new_error, legacy_error in _LEGACY_ERROR_BY_ERROR.items()
                if (self.active_errors | self.disarm_reason) & new_error
            )
            trajectory_done_bit = self.motion.done << 7
            return struct.pack(
                "<IBBBB",
                errors,
                self.state,
                errors == _LEGACY_ERROR_BY_ERROR[MOTOR_OVERHEATED_ERROR],
                0,
                trajectory_done_bit,
            )
        errors = self.active_errors | self.disarm_reason
        return struct.pack("<IBBBB", errors, self.state, self.result, self.motion.done, 0)

    def _update_temperatures(self, t_ns: int) -> None:
        """Advance the temperatures, and disarm the axis on over-temperature of the motor."""
        if self.thermal_ns >= 0:
            self.thermal.advance((t_ns - self.thermal_ns) * 1e-9, self.motor.heat)
        self.motor.heat = 0.0
        self.thermal_ns = t_ns
        if self.thermal.winding > OVERHEATING_C and self.state == CLOSED_LOOP:
            self.disarm(MOTOR_OVERHEATED_ERROR)


class OdriveNodeRow(OdriveStruct, OdriveNode):
    """A simulated ODrive axis whose state is one row of an array, which compiled kernels can read."""

    layout = OdriveStruct

    def initialise(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Initialize the array row of the axis. The class ``OdriveNode`` explains the arguments."""
        OdriveNode.__init__(self, spec, motor, offset)
        self.motor_number = motor.number
