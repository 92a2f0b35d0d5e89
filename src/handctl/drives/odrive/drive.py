"""State machine that configures, enables and disables an ODrive with CANSimple.

In every tick, a remote frame requests the position of the motor, so that the position belongs to
the same tick as the command. With the option ``encoder_period_ms``, the host instead uses the
position messages that the drive sends periodically. CANSimple has no message that reads back mode
and limits, and no message that sets the watchdog. The host reads and writes the watchdog and the
torque limit by SDO, at the endpoints in ``settings``. Only a heartbeat reports the state of the
drive.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from handctl.drives import readback
from handctl.drives.contract import (
    MAX_TIME_NS,
    NO_STEADY_STATUS,
    DriveFaultCause,
    DrivePhase,
    DriveProperty,
    DriveState,
    DriveTarget,
)
from handctl.drives.frame import REMOTE_FLAG, Frame
from handctl.drives.motor_description import MotorDescription
from handctl.drives.odrive import codec
from handctl.drives.odrive import settings as endpoints
from handctl.drives.odrive.options import OPTIONS, pop_options
from handctl.drives.odrive.progress import (
    IGNORED_FAULT_COUNT,
    MAX_MISSED_HEARTBEATS,
    REPEAT_PERIOD_NS,
    SERIAL_NUMBER_TRIES,
    SETTING_MISMATCH_ERROR,
    TEMPERATURE_PERIOD_NS,
    VERSION_TRIES,
    OdriveProgress,
    cause_of_error,
    get_progress,
    on_heartbeat,
    start_disabling,
    state_after_timeout,
)
from handctl.drives.option_checks import refuse_unknown_options
from handctl.drives.readback import ReadbackCursor, SettingRecheck
from handctl.drives.signals import CyclicMessages, SignalTable
from handctl.drives.state_machine import (
    enter_fault,
    request_recheck,
    state_after_recheck_reply,
)
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = DriveTarget
SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase


@dataclass(frozen=True, slots=True)
class OdriveDrive:
    """Motor on an ODrive, with the interface ``contract.Drive``.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus of the drive.
        node_id: node number, from 1 to 0x3e.
        command_limit: largest torque command [N m at the spool].
        ratio: turns of the motor's shaft per turn of the spool, negative if positive torque of the
            motor unwinds the tendon.
        zero: angle of the shaft when the spool angle is zero [rad].
        limits: payload of the message Set_Limits, with velocity [turn/s] and current [A].
        settings: settings of the drive that the host verifies by SDO.
        encoder_period_s: period of the drive's unrequested position messages [s], 0 to request the position
            in every tick.
        torque_feedback: True to request the torque in every tick.
        heartbeat_timeout_ns: time without a heartbeat after which the drive counts as lost [ns].
        firmware_05: True for firmware 0.5, see the module ``firmware_05``.
        command: signal table of the command, built from the other attributes.
        encoder: signal table of the position, built from the other attributes.
        torques: signal table of the torque feedback, built from the other attributes.
    """

    name: str
    bus: int
    node_id: int
    command_limit: float
    ratio: float
    zero: float
    limits: bytes
    settings: tuple[endpoints.OdriveSetting, ...]
    encoder_period_s: float
    torque_feedback: bool
    heartbeat_timeout_ns: int
    firmware_05: bool = False
    command: SignalTable = field(init=False, repr=False, compare=False)
    encoder: SignalTable = field(init=False, repr=False, compare=False)
    torques: SignalTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        object.__setattr__(
            self,
            "command",
            SignalTable(codec.torque_message(self.node_id, self.ratio, self.command_limit)),
        )
        encoder = codec.encoder_message(
            self.node_id, self.ratio, self.zero, is_requested=not self.encoder_period_s
        )
        object.__setattr__(self, "encoder", SignalTable(encoder))
        object.__setattr__(
            self, "torques", SignalTable(codec.torques_message(self.node_id, self.ratio))
        )

    @staticmethod
    def from_motor(motor: MotorDescription, bus: int) -> "OdriveDrive":
        """Return the drive object for a motor description in the hand file.

        Raises:
            ConfigError: an option is unknown or wrong, or the node number is not from 1 to 0x3e.
        """
        options = dict(motor.options)
        location = f"motor[{motor.name}].options"
        if not 0 < motor.node_id <= codec.LAST_NODE_ID:
            raise ConfigError(
                str(motor.node_id), f"motor[{motor.name}].node_id", f"1 to {codec.LAST_NODE_ID}"
            )
        motor_options = pop_options(options, location)
        settings = endpoints.pop_settings(
            options, location, motor.watchdog_ms / 1e3, motor.torque_max_N_m / motor_options.ratio
        )
        refuse_unknown_options(options, location, OPTIONS)
        return OdriveDrive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            command_limit=motor.torque_max_N_m,
            ratio=motor.direction * motor_options.ratio,
            zero=motor.zero_rad,
            limits=codec.encode_floats(
                motor.velocity_range_rad_s * motor_options.ratio / math.tau, motor_options.current
            ),
            settings=settings,
            encoder_period_s=motor_options.encoder_period_s,
            torque_feedback=motor_options.torque_feedback,
            heartbeat_timeout_ns=round(motor_options.heartbeat * MAX_MISSED_HEARTBEATS * 1e6),
            firmware_05=motor_options.firmware_05,
        )

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the drive in a tick: torque command, remote frames, and the requested messages."""
        return (
            (4, False),
            *(((0, False), (8, False)) * ((not self.encoder_period_s) + self.torque_feedback)),
        )

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the frames whose rate is not the control rate.

        The returned frames are heartbeats, periodic positions, temperatures, and SDO messages. With
        factory settings the drive sends its position periodically, even if the host does not use
        the position messages.
        """
        temperature_rate = 0.0 if self.firmware_05 else 1e9 / TEMPERATURE_PERIOD_NS
        encoder_rate = 1.0 / (self.encoder_period_s or codec.ENCODER_PERIOD_MS * 1e-3)
        recheck_rate = readback.RECHECKS_PER_SECOND if self.settings else 0.0
        frame_rate = MAX_MISSED_HEARTBEATS * 1e9 / self.heartbeat_timeout_ns + encoder_rate
        return (
            (8, False, frame_rate),
            (0, False, temperature_rate),
            (8, False, temperature_rate),
            (4, False, recheck_rate),
            (8, False, recheck_rate),
        )

    @property
    def has_extended_ids(self) -> bool:
        """Return False, because all identifiers of CANSimple have 11 bits."""
        return False

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from a host to the drive: commands and remote frames."""
        commands = frozenset(
            codec.message_id(self.node_id, command) for command in codec.HOST_COMMANDS
        )
        return commands | {
            codec.message_id(self.node_id, command) | REMOTE_FLAG
            for command in codec.REQUESTABLE_MESSAGES
        }

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from the drive: answers, heartbeats, and cyclic messages."""
        return frozenset(
            codec.message_id(self.node_id, command) for command in codec.DRIVE_MESSAGES
        )

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return one line for each of the drive's protections that handctl cannot verify."""
        return endpoints.unverified_protections(self.settings, self.firmware_05)

    @property
    def unchecked_properties(self) -> Mapping[DriveProperty, str]:
        """Return the properties that handctl cannot check with the present options of the motor, with reasons."""
        return endpoints.unchecked_properties(self.settings, self.firmware_05)

    @property
    def sends_one_reply_per_command(self) -> bool:
        """Return False, because the drive also sends messages without a command."""
        return False

    @property
    def position_step(self) -> float:
        """Return 0 (unknown resolution), because the drive does not report the resolution of its encoder."""
        return 0.0

    @property
    def feedback_period_s(self) -> float:
        """Return the period of position messages that the drive sends without a request [s].

        The period is 0 if the host requests the position in every tick.
        """
        return self.encoder_period_s

    @property
    def cyclic_messages(self) -> CyclicMessages:
        """Return the signal tables of position and torque, the torque command, and the remote frames."""
        requests = [codec.ENCODER_ESTIMATES] * (not self.encoder_period_s) + [
            codec.TORQUES
        ] * self.torque_feedback
        request_messages = [codec.request_message(self.node_id, command) for command in requests]
        return CyclicMessages(
            (self.encoder.message, self.torques.message), (self.command.message, *request_messages)
        )

    def steady_status(self, state: DriveState) -> int:
        """Return the status 0, because the frames with positions and torques contain no status.

        Only a heartbeat reports the state of the drive.
        """
        return (
            0
            if state.phase == ENABLED and get_progress(state).disable_command_ns < 0
            else NO_STEADY_STATUS
        )

    def due_ns(self, state: DriveState) -> int:
        """Return the time of the next heartbeat timeout or temperature request, whichever is earlier [ns]."""
        progress = get_progress(state)
        temperature_rate = (
            MAX_TIME_NS
            if self.firmware_05
            else progress.temperature_request_ns + TEMPERATURE_PERIOD_NS
        )
        return min(
            temperature_rate,
            progress.heartbeat_ns + self.heartbeat_timeout_ns + 1
            if progress.heartbeat_ns >= 0
            else MAX_TIME_NS,
        )

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return request and reply for each endpoint that the host reads again, see ``contract.Drive``."""
        return tuple(
            SettingRecheck(
                setting.name,
                self._data_frame(codec.RX_SDO, codec.sdo_request(codec.SDO_READ, setting.endpoint)),
                self._data_frame(codec.TX_SDO, codec.sdo_reply(setting.endpoint, setting.raw)),
                key_byte_range=(1, 3),
                compared_byte_range=(1, 4 + len(setting.raw)),
            )
            for setting in self.settings
        )

    def initial_state(self) -> DriveState:
        """Return the state of the drive before the first frame."""
        return DriveState(protocol_state=OdriveProgress(version=self.firmware_05))

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        command = frame.can_id & 0x1F
        if (
            frame.bus != self.bus
            or frame.can_id >> 5 != self.node_id
            or command not in codec.DRIVE_MESSAGES
        ):
            return state
        # From firmware 0.6.11 on, the TxSdo that confirms a write contains no value. Before
        # firmware 0.6.11, the message Address has 7 bytes.
        min_payload_size = {codec.TX_SDO: 4, codec.ADDRESS: 7}.get(command, 8)
        if not min_payload_size <= len(frame.data) <= 8:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        if command == codec.HEARTBEAT:
            return on_heartbeat(state, frame, self.firmware_05)
        if command == codec.GET_VERSION:
            return self._on_version_message(state, frame.data)
        if command == codec.TX_SDO:
            return self._on_setting_message(state, frame.data)
        if command == codec.ADDRESS:
            return self._on_address_message(state, frame.data)
        return self._on_value_message(state, command, frame)

    def _on_value_message(self, state: DriveState, command: int, frame: Frame) -> DriveState:
        """Return the drive state after a frame with values: position and velocity, torque, or temperatures."""
        if (
            command == codec.TEMPERATURE
            and (hottest := codec.decode_highest_temperature(frame.data)) is not None
        ):
            return state._replace(temperature=hottest)
        table = self.torques if command == codec.TORQUES else self.encoder
        values = table.unpack(frame.data)
        if command == codec.TEMPERATURE or any(map(math.isnan, values)):
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        if command == codec.TORQUES:
            return state._replace(torque=values[0])
        return state.with_feedback(
            values[0], values[1], state.torque, state.temperature, frame.t_ns
        )

    def _on_version_message(self, state: DriveState, data: bytes) -> DriveState:
        """Return the drive state after the message Get_Version, with the protocol version."""
        if state.phase not in (SILENT, CONFIGURING):
            return state
        if data[0] != codec.PROTOCOL_VERSION:
            return enter_fault(
                state,
                SETTING_MISMATCH_ERROR,
                f"has CANSimple version {data[0]}, expected {codec.PROTOCOL_VERSION}",
            )
        return state._replace(
            phase=CONFIGURING,
            protocol_state=get_progress(state)._replace(
                version=True, tries=0, sent_ns=-REPEAT_PERIOD_NS
            ),
        )

    def _on_address_message(self, state: DriveState, data: bytes) -> DriveState:
        """Return the drive state after the message Address.

        The message contains the node number and the serial number (48 bits) of the drive.
        """
        if state.phase != CONFIGURING or data[0] != self.node_id:
            return state
        serial = int.from_bytes(data[1:7], "little")
        return state._replace(
            protocol_state=get_progress(state)._replace(
                serial=serial, serial_requests=SERIAL_NUMBER_TRIES
            )
        )

    def _on_setting_message(self, state: DriveState, data: bytes) -> DriveState:
        """Return the drive state after a TxSdo with the value of a setting."""
        progress = get_progress(state)
        if state.phase == ENABLED and state.recheck.is_waiting:
            return self._on_recheck_reply(state, data)
        if state.phase != CONFIGURING or progress.cursor.step >= len(self.settings):
            return state
        cursor, problem = endpoints.on_reply(progress.cursor, self.settings, data)
        next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
        return enter_fault(next_state, SETTING_MISMATCH_ERROR, problem) if problem else next_state

    def _on_recheck_reply(self, state: DriveState, data: bytes) -> DriveState:
        """Check a setting of the enabled drive after the host has read the setting again."""
        setting = self.settings[state.recheck.step]
        endpoint, raw_bytes = codec.decode_sdo_reply(data)
        if endpoint != setting.endpoint or len(raw_bytes) < len(setting.raw):
            return state
        is_equal = raw_bytes[: len(setting.raw)] == setting.raw
        answer = f"reads {endpoints.value_as_text(raw_bytes, setting)}"
        expected = endpoints.value_as_text(setting.raw, setting)
        return state_after_recheck_reply(
            state,
            SETTING_MISMATCH_ERROR,
            len(self.settings),
            is_equal,
            setting.name,
            answer,
            expected,
        )

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``."""
        progress = get_progress(state)
        if target == LISTEN:
            return state, ()
        if (
            0 <= progress.heartbeat_ns < t_ns - self.heartbeat_timeout_ns
            and state.phase != FAULT
            and progress.disable_command_ns < 0
        ):
            state = state_after_timeout(state, self.firmware_05)
            progress = get_progress(state)
        if target == DISABLE or (
            state.phase == ENABLED and (target != ENABLE or progress.disable_command_ns >= 0)
        ):
            return start_disabling(state, progress, t_ns), (self._axis_state_frame(codec.IDLE),)
        if state.phase == ENABLED:
            state, requests = self._feedback_requests(state, t_ns)
            state, recheck = request_recheck(state, self, SETTING_MISMATCH_ERROR, t_ns)
            return state, (self._command_frame(command), *recheck, *requests)
        if state.phase == FAULT:
            return state, self.torque_cut_frames() if progress.may_be_enabled else ()
        if progress.disable_command_ns >= 0:
            state = state._replace(protocol_state=progress._replace(disable_command_ns=-1))
        if state.phase == READY and progress.is_configured:
            return self._advance_configured_drive(state, t_ns, target)
        return self._configure(
            state._replace(phase=SILENT if progress.heartbeat_ns < 0 else CONFIGURING), t_ns
        )

    def _advance_configured_drive(
        self, state: DriveState, t_ns: int, target: DriveTarget
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of a configured drive, and the frames to send.

        The returned frames request feedback. If the requested drive state is ENABLE, the returned
        frames also enable the drive. The host sends the enable command once, because a repeated
        enable command would also enable a drive that has restarted. After the enable command, the
        host sends torque commands of 0 N m until the drive reports the state enabled.
        """
        state, requests = self._feedback_requests(state, t_ns)
        progress = get_progress(state)
        if target != ENABLE:
            if progress.is_just_verified:
                state = state._replace(protocol_state=progress._replace(is_just_verified=False))
            return state, requests
        if progress.enable_command_ns >= 0:
            return state, (self._command_frame(self._command_at_rest(state)), *requests)
        if not progress.is_just_verified:
            unverified_progress = progress._replace(cursor=ReadbackCursor(), is_configured=False)
            return state._replace(phase=CONFIGURING, protocol_state=unverified_progress), requests
        first_cursor = readback.first_recheck(self.node_id, t_ns)
        next_state = state._replace(
            recheck=first_cursor,
            protocol_state=progress._replace(
                enable_command_ns=t_ns, enable_attempts=progress.enable_attempts + 1
            ),
        )
        return next_state, (
            *self._setup_frames(), self._command_frame(self._command_at_rest(state)),
            self._axis_state_frame(codec.CLOSED_LOOP), *requests,
        )  # fmt: skip

    def _configure(self, state: DriveState, t_ns: int) -> tuple[DriveState, tuple[Frame, ...]]:
        """Do the next action in the configuration of the drive.

        The configuration has five actions: set the axis to idle, request the version, request the
        serial number, verify the endpoints, and send mode and limits.
        """
        progress = get_progress(state)
        if progress.axis > codec.IDLE:
            text = f"in axis state {progress.axis} without a command, and does not go idle"
            return state._replace(error_text=text), (self._axis_state_frame(codec.IDLE),)
        if not progress.version:
            return self._request_version(state, progress, t_ns)
        if progress.serial_requests < SERIAL_NUMBER_TRIES and not self.firmware_05:
            return self._request_serial(state, progress, t_ns)
        if progress.cursor.step < len(self.settings):
            return self._next_setting(state, progress, t_ns)
        if progress.heartbeat_ns < 0:
            return state, ()
        configured_progress = progress._replace(is_configured=True, is_just_verified=True)
        state, requests = self._requests_during_verification(
            state._replace(phase=READY, error_text="", protocol_state=configured_progress), t_ns
        )
        return state, (*self._setup_frames(), *requests)

    def _next_setting(
        self, state: DriveState, progress: OdriveProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, the request for the next endpoint, and the requests for feedback."""
        cursor, data, problem = endpoints.next_request(progress.cursor, self.settings, t_ns)
        next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
        if problem:
            return enter_fault(next_state, SETTING_MISMATCH_ERROR, problem), ()
        next_state, requests = self._requests_during_verification(next_state, t_ns)
        return next_state, (*((self._data_frame(codec.RX_SDO, data),) if data else ()), *requests)

    def _requests_during_verification(
        self, state: DriveState, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the requests for feedback of a drive that has sent feedback before.

        Before each enable command, the host verifies the settings of the drive again, while other
        drives may already be enabled. During the verification, the host also requests feedback from
        the drive, because missing feedback would count as a fault.
        """
        return self._feedback_requests(state, t_ns) if state.feedback_count else (state, ())

    def _setup_frames(self) -> tuple[Frame, ...]:
        """Return the frames that set the control mode and the limits.

        The drive does not confirm control mode and limits, so the host sends both before each
        enable command.
        """
        mode = self._data_frame(
            codec.SET_MODE, codec.encode_integers(self._control_mode, codec.PASSTHROUGH_INPUT_MODE)
        )
        return mode, self._data_frame(codec.SET_LIMITS, self.limits)

    @property
    def _control_mode(self) -> int:
        """Return the control mode in the message Set_Controller_Mode."""
        return codec.TORQUE_MODE

    def _request_version(
        self, state: DriveState, progress: OdriveProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and a frame that requests the version or clears errors.

        The host sends the frame at most once per ``REPEAT_PERIOD_NS``.
        """
        if t_ns - progress.sent_ns < REPEAT_PERIOD_NS:
            return state, ()
        if progress.heartbeat_ns >= 0 and progress.tries >= VERSION_TRIES:
            return enter_fault(
                state, SETTING_MISMATCH_ERROR, "sends heartbeats, but does not report its version"
            ), ()
        requests = progress._replace(
            sent_ns=t_ns, tries=progress.tries + 1 if progress.heartbeat_ns >= 0 else 0
        )
        frame = (
            self._data_frame(codec.CLEAR_ERRORS, b"")
            if progress.errors_to_ignore
            else self._remote_frame(codec.GET_VERSION)
        )
        return state._replace(protocol_state=requests), (frame,)

    def _request_serial(
        self, state: DriveState, progress: OdriveProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Request the serial number of the drive a few times.

        Early versions of firmware 0.6 do not answer the request for the serial number.
        """
        if t_ns - progress.sent_ns < REPEAT_PERIOD_NS:
            return state, ()
        requests = progress._replace(sent_ns=t_ns, serial_requests=progress.serial_requests + 1)
        return state._replace(protocol_state=requests), (self._remote_frame(codec.ADDRESS),)

    def _feedback_requests(
        self, state: DriveState, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the remote frames to request feedback in a tick."""
        frames = [self._remote_frame(codec.ENCODER_ESTIMATES)] * (not self.encoder_period_s) + [
            self._remote_frame(codec.TORQUES)
        ] * self.torque_feedback
        progress = get_progress(state)
        if t_ns - progress.temperature_request_ns >= TEMPERATURE_PERIOD_NS and not self.firmware_05:
            frames.append(self._remote_frame(codec.TEMPERATURE))
            state = state._replace(protocol_state=progress._replace(temperature_request_ns=t_ns))
        return state, tuple(frames)

    def _command_frame(self, command: float) -> Frame:
        """Return the frame of a command, which is given in the unit of ``command_limit``."""
        try:
            return Frame(self.command.message.can_id, self.command.pack(command), 0, self.bus)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    def _command_at_rest(self, state: DriveState) -> float:
        """Return a command of zero torque, for a drive that is being enabled."""
        return 0.0

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return no release frames, because the watchdog of a disabled drive is not active."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Return the serial number, or the node number if the serial number is unknown.

        Firmware 0.5 and early versions of 0.6 do not report a serial number.
        """
        return (
            f"{serial:012X}" if (serial := get_progress(state).serial) else f"node {self.node_id}"
        )

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return cause_of_error(error_code)

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return the frame of a torque command [N m at the spool].

        A torque command alone does not enable the drive.
        """
        return (self._command_frame(torque),)

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frame Estop, which disables the drive.

        After the frame Estop, the drive latches an error.
        """
        return (self._data_frame(codec.ESTOP, b""),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the frames that clear the latched error of the drive.

        After the clear command, the host configures the drive again.
        """
        initial_progress = OdriveProgress(
            version=self.firmware_05,
            axis=get_progress(state).axis,
            errors_to_ignore=IGNORED_FAULT_COUNT,
        )
        next_state = state._replace(
            phase=SILENT, error=0, error_text="", protocol_state=initial_progress
        )
        return next_state, (self._data_frame(codec.CLEAR_ERRORS, b""),)

    def _axis_state_frame(self, state: int) -> Frame:
        """Return the frame that sets the axis state of the drive."""
        return self._data_frame(codec.SET_AXIS_STATE, codec.encode_integers(state))

    def _data_frame(self, command: int, data: bytes) -> Frame:
        """Return a data frame to the drive, with the given command number and payload."""
        return Frame(codec.message_id(self.node_id, command), data, 0, self.bus)

    def _remote_frame(self, command: int) -> Frame:
        """Return a remote frame that requests a message from the drive."""
        return Frame(codec.message_id(self.node_id, command) | REMOTE_FLAG, b"", 0, self.bus)
