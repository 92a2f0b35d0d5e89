"""State machine that configures, enables and stops a moteus controller.

A moteus controller answers requests and sends no other frame. A torque command selects position
mode with gains 0 and a feedforward torque. A position command also contains a position, a velocity,
and fractions of the drive's gains. Torque commands and position commands also contain the torque
limit and the watchdog timeout of the drive, and a request for feedback. Torque commands and
position commands enable the drive. If an enabled drive reports a mode other than position mode, the
drive is in fault, and the host sends the stop command. The stop command also clears a fault of the
drive. After a stop command, the host still regards the drive as faulty until the operator clears
the fault.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from handctl.drives import readback
from handctl.drives.contract import (
    NO_STEADY_STATUS,
    DriveFaultCause,
    DrivePhase,
    DriveProperty,
    DriveState,
    DriveTarget,
)
from handctl.drives.frame import Frame
from handctl.drives.moteus import codec
from handctl.drives.moteus import settings as items
from handctl.drives.moteus.progress import (
    CAUSE_BY_ERROR,
    IGNORED_FAULT_COUNT,
    SERIAL_NUMBER_TRIES,
    SETTING_MISMATCH_ERROR,
    MoteusProgress,
    apply_mode,
    get_progress,
)
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import refuse_unknown_options
from handctl.drives.readback import SettingRecheck
from handctl.drives.signals import CyclicMessages, SignalTable
from handctl.drives.state_machine import (
    enter_fault,
    is_steady,
    may_have_lost_power,
    start_disabling,
    start_enabling,
    state_after_configuration,
    state_after_recheck_reply,
)
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = DriveTarget
SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase
"""Phases of a drive as constants of this module, for speed.

Reading a phase from the enumeration takes longer than comparing two phases.
"""
SERIAL_REQUEST = codec.padded_payload(
    bytes((codec.READ | codec.INT32 << 2 | 3,)) + codec.encode_varuint(codec.SERIAL_NUMBER)
)
"""Payload of the request that reads the three registers with the serial number."""


@dataclass(frozen=True, slots=True)
class MoteusDrive:
    """Moteus controller with its motor, with the interface ``contract.Drive``.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus of the drive.
        node_id: node number, from 1 to 0x7e.
        command_limit: largest torque command, and torque limit in the drive [N m at the spool].
        direction: 1 if positive torque of the motor winds the tendon, else -1.
        zero: angle of the motor when the spool angle is zero [rad].
        timeout_s: timeout of the watchdog [s].
        top_speed: largest velocity command [rad/s].
        gains: gains of the drive's position loop, None for torque commands only.
        command: signal table of the command, built from the other attributes.
        feedback: signal table of the feedback, built from the other attributes.
        configuration: configuration items that are read again while the drive is enabled. The
            configuration items are computed from the other attributes.
        required_settings: settings with the values that the settings must have before arming. The
            required values are computed from the other attributes.
    """

    name: str
    bus: int
    node_id: int
    command_limit: float
    direction: int
    zero: float
    timeout_s: float
    top_speed: float
    gains: codec.PositionGains | None
    command: SignalTable = field(init=False, repr=False, compare=False)
    feedback: SignalTable = field(init=False, repr=False, compare=False)
    configuration: tuple[items.MoteusSetting, ...] = field(init=False, repr=False, compare=False)
    required_settings: tuple[items.MoteusSetting, ...] = field(
        init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        command = codec.command_message(
            self.node_id, self.command_limit, self.timeout_s, self.direction
        )
        object.__setattr__(self, "command", SignalTable(command))
        object.__setattr__(
            self,
            "feedback",
            SignalTable(codec.feedback_message(self.node_id, self.direction, self.zero)),
        )
        configuration = (
            items.REQUIRED_CONFIGURATION
            if self.gains is None
            else items.position_configuration(self.gains)
        )
        required_settings = items.required_settings(
            self.command_limit, self.timeout_s, configuration
        )
        object.__setattr__(self, "configuration", configuration)
        object.__setattr__(self, "required_settings", required_settings)

    @staticmethod
    def from_motor(motor: MotorDescription, bus: int) -> "MoteusDrive":
        """Return the drive object for a motor description in the hand file.

        Raises:
            ConfigError: an option is unknown or wrong, the node number exceeds 0x7e, or the gains
                of the drive's position loop are missing.
        """
        if not 0 < motor.node_id <= codec.LAST_NODE_ID:
            raise ConfigError(
                str(motor.node_id), f"motor[{motor.name}].node_id", f"1 to {codec.LAST_NODE_ID}"
            )
        refuse_unknown_options(motor.options, f"motor[{motor.name}].options", {})
        return MoteusDrive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            command_limit=motor.torque_max_N_m,
            direction=motor.direction,
            zero=motor.zero_rad,
            timeout_s=motor.watchdog_ms * 1e-3,
            top_speed=motor.velocity_range_rad_s,
            gains=_position_gains(motor),
        )

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the drive in a tick: command and feedback."""
        return ((self.command.message.length, True), (codec.FEEDBACK_LENGTH, True))

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the frames of the read-back of an enabled drive.

        A read-back over the text channel has two requests and two replies.
        """
        rate = readback.RECHECKS_PER_SECOND
        return ((48, True, rate), (3, True, rate), (4, True, rate), (16, True, rate))

    @property
    def has_extended_ids(self) -> bool:
        """Return True, because requests have 29-bit identifiers."""
        return True

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of requests from any host that are addressed to this drive or to all drives."""
        return frozenset(
            codec.request_id(node, source)
            for node in (self.node_id, codec.BROADCAST)
            for source in codec.SOURCE_NODES
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifier of the drive's replies to this host."""
        return frozenset((codec.reply_id(self.node_id),))

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return no unverified protections, because the host reads back every setting of the drive."""
        return ()

    @property
    def unchecked_properties(self) -> Mapping[DriveProperty, str]:
        """Return no unchecked properties, because handctl can check every property of the drive."""
        return {}

    @property
    def sends_one_reply_per_command(self) -> bool:
        """Return True, because the drive sends a single reply per request."""
        return True

    @property
    def position_step(self) -> float:
        """Return 0 (unknown resolution), because the drive does not report the resolution of its encoder."""
        return 0.0

    @property
    def feedback_period_s(self) -> float:
        """Return 0 (no unrequested feedback), because the drive sends feedback only in reply to a request."""
        return 0.0

    @property
    def cyclic_messages(self) -> CyclicMessages:
        """Return the signal tables of command and feedback."""
        torque = self.command.message
        position = None
        if self.gains is not None:
            position = codec.position_message(
                torque, self.gains, self.timeout_s, self.top_speed, self.direction, self.zero
            )
        return CyclicMessages(
            (self.feedback.message,),
            (torque,),
            position=position,
            integrates_velocity=position is not None,
        )

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return no settings that compiled code reads again, because each text read-back needs several frames."""
        return ()

    def steady_status(self, state: DriveState) -> int:
        """Return the status of feedback in position mode without a fault code, or NO_STEADY_STATUS."""
        if not is_steady(state) or state.recheck.is_waiting:
            return NO_STEADY_STATUS
        return codec.join_mode_and_fault(codec.POSITION, 0)

    def due_ns(self, state: DriveState) -> int:
        """Return the time of the next read-back request [ns]."""
        return state.recheck.due_ns

    def initial_state(self) -> DriveState:
        """Return the state of the drive before the first frame."""
        return DriveState(protocol_state=MoteusProgress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        if bus != self.bus or can_id != self.feedback.message.can_id:
            return state
        if codec.is_feedback(data):
            return self._on_feedback(state, data, t_ns)
        reply = codec.decode_reply(data)
        if reply is None:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        progress = get_progress(state)
        if reply.error_by_register and state.phase == CONFIGURING:
            register, error = next(iter(reply.error_by_register.items()))
            return enter_fault(
                state,
                SETTING_MISMATCH_ERROR,
                f"refuses register {register:#x} with error {error}: firmware too old?",
            )
        if reply.text is not None:
            return self._on_text_reply(state, progress, reply.text)
        if codec.SERIAL_NUMBER in reply.values:
            return self._on_serial_number(state, progress, reply.values, t_ns)
        setting = self._requested_setting(state, progress)
        if setting is None or setting.register not in reply.values:
            return state
        return self._on_setting_value(state, progress, setting, reply.values[setting.register], "")

    def _on_feedback(self, state: DriveState, data: bytes, t_ns: int) -> DriveState:
        """Return the drive state after feedback.

        The returned state contains the values of the feedback, and the effect of the mode and the
        fault code.
        """
        *status, position, velocity, torque, board, motor = self.feedback.unpack(data)
        if math.isnan(position + velocity + torque):
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        next_state = state.with_feedback(position, velocity, torque, max(board, motor), t_ns)
        return apply_mode(next_state, int(status[1]), int(status[3]))

    def _requested_setting(
        self, state: DriveState, progress: MoteusProgress
    ) -> items.MoteusSetting | None:
        """Return the setting in the unanswered request, or None if every request has an answer."""
        if (
            state.phase == CONFIGURING
            and progress.cursor.is_waiting
            and progress.cursor.step < len(self.required_settings)
        ):
            return self.required_settings[progress.cursor.step]
        if state.phase == ENABLED and state.recheck.is_waiting:
            return self.configuration[state.recheck.step]
        return None

    def _on_text_reply(
        self, state: DriveState, progress: MoteusProgress, text: bytes
    ) -> DriveState:
        """Return the drive state after the host has received a part of an answer over the text channel."""
        is_channel_read = progress.channel.request_sent_ns < 0
        channel, line = progress.channel.take_line(text)
        progress = progress._replace(channel=channel)
        if is_channel_read:
            # The received frame answers a read that empties the text channel. The host can send the
            # next request at once.
            cursor = progress.cursor
            progress = progress._replace(
                cursor=cursor._replace(sent_ns=-1, tries=max(0, cursor.tries - 1))
            )
        state = state._replace(protocol_state=progress)
        setting = self._requested_setting(state, progress) if line else None
        if setting is None or setting.register:
            return state
        if state.phase == CONFIGURING and progress.cursor.must_write:
            return state._replace(
                protocol_state=progress._replace(cursor=progress.cursor.cursor_after_write())
            )
        return self._on_setting_value(
            state, progress, setting, items.value_in_answer(line), line.decode(errors="replace")
        )

    def _on_setting_value(
        self,
        state: DriveState,
        progress: MoteusProgress,
        setting: items.MoteusSetting,
        value: float | None,
        text: str,
    ) -> DriveState:
        """Return the drive state after the value of a setting was received.

        A received text that is not a number counts as a wrong value of the setting.
        """
        is_equal = value is not None and setting.is_required_value(value)
        shown_text = text if value is None else f"{value:g}"
        expected = f"{setting.value:g}"
        if state.phase == ENABLED:
            return state_after_recheck_reply(
                state,
                SETTING_MISMATCH_ERROR,
                len(self.configuration),
                is_equal,
                setting.name,
                f"reads {shown_text}",
                expected,
            )
        if progress.cursor.must_write:
            return state
        if is_equal:
            return state._replace(
                protocol_state=progress._replace(cursor=progress.cursor.next_setting())
            )
        max_write_count = items.WRITE_TRIES if value is not None else 0
        cursor, problem = readback.cursor_after_wrong_value(
            progress.cursor, setting.name, shown_text, expected, max_write_count
        )
        next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
        return enter_fault(next_state, SETTING_MISMATCH_ERROR, problem) if problem else next_state

    def _on_serial_number(
        self, state: DriveState, progress: MoteusProgress, values: dict[int, float], t_ns: int
    ) -> DriveState:
        """Return the drive state after the serial number was received.

        The host requests the serial number at the end of the configuration.
        """
        if state.phase != CONFIGURING or progress.cursor.step < len(self.required_settings):
            return state
        words = [int(values.get(codec.SERIAL_NUMBER + i, 0)) & 0xFFFFFFFF for i in range(3)]
        return state_after_configuration(state, t_ns, words[2] << 64 | words[1] << 32 | words[0])

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``."""
        progress: MoteusProgress = state.protocol_state
        if target == ENABLE and state.phase == ENABLED and not progress.is_disabling:
            sent_frame = self._frame_to_drive(self._torque_payload(command))
            # In the usual tick of a running hand, the host sends one command, and the state does
            # not change.
            if t_ns < state.recheck.due_ns and not state.recheck.is_waiting:
                return state, (sent_frame,)
            state, requests = self._next_recheck(state, progress, t_ns)
            return state, (sent_frame, *requests)
        if target == LISTEN:
            return state, ()
        if target == DISABLE or state.phase == ENABLED:
            return start_disabling(state, t_ns), self.torque_cut_frames()
        if state.phase == FAULT and progress.may_be_enabled:
            return state, self.torque_cut_frames()
        if progress.is_disabling:
            progress = progress._replace(is_disabling=False)
            state = state._replace(protocol_state=progress)
        if may_have_lost_power(state, t_ns):
            return state._replace(phase=SILENT, protocol_state=MoteusProgress()), (
                self._frame_to_drive(codec.QUERY_SUBFRAMES),
            )
        if state.phase == CONFIGURING or (state.phase == READY and not progress.is_configured):
            return self._configure(state._replace(phase=CONFIGURING), progress, t_ns)
        if state.phase == READY and target == ENABLE:
            enabling_state = start_enabling(state, self.node_id, t_ns)
            return enabling_state, (self._frame_to_drive(self._torque_payload(0.0)),)
        request_frame = (
            self.torque_cut_frames()[0]
            if progress.errors_to_ignore
            else self._frame_to_drive(codec.QUERY_SUBFRAMES)
        )
        return state, (request_frame,)

    def _next_recheck(
        self, state: DriveState, progress: MoteusProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next read-back request to the enabled drive, if a request is due.

        The read-back request reads a setting, or the next part of the drive's answer.
        """
        setting = self.configuration[state.recheck.step]
        channel = progress.channel
        data = b""
        problem = ""
        if channel.is_awaiting_answer(t_ns):
            channel, data = channel.poll()
        elif t_ns >= state.recheck.due_ns:
            # If the drive has not answered a request, the answer can still arrive. The host first
            # empties the text channel.
            channel = items.DiagnosticChannel() if state.recheck.is_waiting else channel
            check, problem = readback.cursor_after_recheck_request(
                state.recheck, setting.name, self.node_id, t_ns
            )
            state = state._replace(recheck=check)
            channel, data = self._setting_request(channel, setting, False, t_ns)
        elif channel.is_drained and channel.request_sent_ns < 0:
            channel, data = self._setting_request(channel, setting, False, t_ns)
        state = state._replace(protocol_state=progress._replace(channel=channel))
        if problem:
            state = enter_fault(state, SETTING_MISMATCH_ERROR, problem)
        return state, (self._frame_to_drive(data),) if data else ()

    def _configure(
        self, state: DriveState, progress: MoteusProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the next request of the configuration.

        If the drive is enabled, the host first stops the drive.
        """
        if progress.enabled_by_other_host:
            text = f"in mode {progress.mode} without a command, and does not stop"
            return state._replace(error_text=text), self.torque_cut_frames()
        if progress.cursor.step >= len(self.required_settings):
            return self._request_serial(state, progress, t_ns)
        setting = self.required_settings[progress.cursor.step]
        if (
            setting.register and progress.cursor.must_write
        ):  # the drive answers the write request only with feedback
            limits = self._frame_to_drive(codec.limits_request(self.command_limit, self.timeout_s))
            return state._replace(
                protocol_state=progress._replace(cursor=progress.cursor.cursor_after_write())
            ), (limits,)
        if progress.channel.is_awaiting_answer(t_ns):
            channel, data = progress.channel.poll()
            return state._replace(protocol_state=progress._replace(channel=channel)), (
                self._frame_to_drive(data),
            )
        cursor, must_send, problem = readback.request_setting(progress.cursor, setting.name, t_ns)
        if problem:
            return enter_fault(state, SETTING_MISMATCH_ERROR, problem), ()
        channel = progress.channel
        data = b""
        if must_send:
            # If the drive has not answered a request, the answer can still arrive. The host first
            # empties the text channel.
            channel = items.DiagnosticChannel() if progress.cursor.is_waiting else channel
            channel, data = self._setting_request(channel, setting, cursor.must_write, t_ns)
        next_state = state._replace(
            error_text="", protocol_state=progress._replace(cursor=cursor, channel=channel)
        )
        return next_state, (self._frame_to_drive(data),) if data else ()

    def _setting_request(
        self,
        channel: items.DiagnosticChannel,
        setting: items.MoteusSetting,
        is_write: bool,
        t_ns: int,
    ) -> tuple[items.DiagnosticChannel, bytes]:
        """Return the next state of the text channel, and the payload to read or write a setting."""
        if setting.register:
            return channel, codec.read_subframe(codec.FLOAT, setting.register)
        command = items.write_request(setting) if is_write else items.read_request(setting)
        return channel.next_request_payload(command, t_ns)

    def _request_serial(
        self, state: DriveState, progress: MoteusProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Request the serial number of the drive.

        If the drive does not answer ``SERIAL_NUMBER_TRIES`` requests, the configuration ends
        without a serial number.
        """
        cursor, must_send, unanswered = readback.request_setting(
            progress.cursor, "serial number", t_ns, SERIAL_NUMBER_TRIES
        )
        next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
        if unanswered:
            return state_after_configuration(next_state, t_ns, 0), ()
        return next_state, (self._frame_to_drive(SERIAL_REQUEST),) if must_send else ()

    def _torque_payload(self, torque: float) -> bytes:
        """Return the payload of a torque command.

        Args:
            torque: torque to command [N m at the spool].

        Raises:
            ValueError: the torque is not finite, or exceeds the torque limit.
        """
        try:
            return self.command.pack(torque)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return no torque command for a disabled drive, because every torque command enables the drive."""
        return ()

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frame of the stop command."""
        return (self._frame_to_drive(codec.STOP_PAYLOAD),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the stop command that clears the latched error.

        After a stop command that clears an error, the host reads back the settings of the drive
        again.
        """
        fresh_state = state._replace(
            phase=SILENT,
            error=0,
            error_text="",
            protocol_state=MoteusProgress(errors_to_ignore=IGNORED_FAULT_COUNT),
        )
        return fresh_state, self.torque_cut_frames()

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return no release frames, because the watchdog of a stopped drive is not active."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Return the serial number (96 bits), or the node number if the serial number is unknown."""
        return (
            f"{serial:024x}" if (serial := get_progress(state).serial) else f"node {self.node_id}"
        )

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return CAUSE_BY_ERROR.get(error_code, DriveFaultCause.UNKNOWN)

    def _frame_to_drive(self, data: bytes) -> Frame:
        """Return a frame to the drive with the given payload."""
        return Frame(self.command.message.can_id, data, codec.FD_FRAME_FLAGS, self.bus)


def _position_gains(motor: MotorDescription) -> codec.PositionGains | None:
    """Return the gains that the host writes into the drive, or None without a position loop.

    A position command contains kp and kd as fractions of the gains in the drive.

    Raises:
        ConfigError: a gain is missing in the hand file.
    """
    if not motor.closes_position_loop:
        return None
    gain_by_key = {
        "kp_N_m_per_rad": motor.kp_N_m_per_rad,
        "kd_N_m_s_per_rad": motor.kd_N_m_s_per_rad,
    }
    for key, value in gain_by_key.items():
        if value is None:
            expected = 'a number, because control = "position" writes this gain into a moteus'
            raise ConfigError("missing", f"motor[{motor.name}].{key}", expected)
    return codec.PositionGains(
        *(items.gain_per_turn(value) for value in gain_by_key.values() if value is not None)
    )
