"""State machine that configures, enables and disables a Damiao motor in MIT mode.

A motor sends frames only as answers to requests and commands. The host sends a request in each
tick, and waits for one register reply at a time. Position, velocity, and torque are NaN until the
full scale of the motor is known. The host does not unwrap motor angles beyond PMAX, because the
motors of a hand turn far less. Only feedback with state 0 or with an error proves that a motor is
disabled.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

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
from handctl.drives.frame import BRS, FDF, Frame
from handctl.drives.mit import codec
from handctl.drives.mit import settings as registers
from handctl.drives.mit.progress import (
    CAUSE_BY_ERROR,
    IGNORED_FAULT_COUNT,
    SETTING_MISMATCH_ERROR,
    WATCHDOG_FIRES_WHILE_DISABLED_TEXT,
    MitProgress,
    apply_status,
    get_progress,
)
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import MotorOption, checked_boolean, refuse_unknown_options
from handctl.drives.readback import SettingRecheck
from handctl.drives.signals import CyclicMessages, SignalTable
from handctl.drives.state_machine import (
    enter_fault,
    is_steady,
    may_have_lost_power,
    request_recheck,
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
OPTIONS = {
    "reply_id": MotorOption(
        "1 to 0x7fe (default: `node_id` + 0x10)", "CAN identifier of the replies, register MST_ID."
    ),
    "fd": MotorOption(
        "true or false (default)",
        "True if the drive uses CAN FD. The bus then needs the key `data_bitrate`.",
    ),
}
"""Options of a Damiao motor in the hand file."""


@dataclass(frozen=True, slots=True)
class MitDrive:
    """Damiao motor in MIT mode, with the interface ``contract.Drive``.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus of the motor.
        node_id: node number ESC_ID, the identifier of commands.
        reply_id: MST_ID, the identifier of answers.
        ranges: full scale PMAX, VMAX, TMAX. TMAX is also the torque limit in the drive.
        direction: 1 if positive torque of the motor winds the tendon, else -1.
        zero: angle of the motor when the spool angle is zero [rad].
        timeout: timeout of the motor's watchdog [50 us].
        flags: flags of frames to the motor, 0 for classical CAN.
        command: signal table of the command, built from the other attributes.
        feedback: signal table of the feedback, built from the other attributes.
    """

    name: str
    bus: int
    node_id: int
    reply_id: int
    ranges: codec.MotorRanges
    direction: int
    zero: float
    timeout: int
    flags: int = 0
    command: SignalTable = field(init=False, repr=False, compare=False)
    feedback: SignalTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        command = codec.command_message(self.node_id, self.ranges, self.direction, self.flags)
        feedback = codec.feedback_message(self.reply_id, self.ranges, self.direction, self.zero)
        object.__setattr__(self, "command", SignalTable(command))
        object.__setattr__(self, "feedback", SignalTable(feedback))

    @staticmethod
    def from_motor(
        motor: MotorDescription, bus: int, options_override: Mapping[str, Any] | None = None
    ) -> "MitDrive":
        """Return the drive object for a motor description in the hand file.

        Args:
            motor: description of the motor.
            bus: index of the bus of the motor.
            options_override: options to use instead of the options in the description.

        Raises:
            ConfigError: an option is unknown, or has a wrong value.
        """
        options = dict(motor.options if options_override is None else options_override)
        location = f"motor[{motor.name}].options"
        reply = options.pop("reply_id", motor.node_id + 0x10)
        fd = checked_boolean(options.pop("fd", False), f"{location}.fd")
        refuse_unknown_options(options, location, OPTIONS)
        if type(reply) is not int or not 0 < reply < codec.BROADCAST_ID:
            raise ConfigError(repr(reply), f"{location}.reply_id", "an identifier from 1 to 0x7fe")
        return MitDrive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            reply_id=reply,
            ranges=codec.MotorRanges(
                motor.position_range_rad, motor.velocity_range_rad_s, motor.torque_max_N_m
            ),
            direction=motor.direction,
            zero=motor.zero_rad,
            timeout=round(motor.watchdog_ms * codec.TIMEOUT_UNITS_PER_MS),
            flags=FDF | BRS if fd else 0,
        )

    @property
    def command_limit(self) -> float:
        """Return TMAX, the largest torque command [N m]."""
        return self.ranges.torque

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the motor in a tick: command and answer."""
        return ((8, bool(self.flags)), (8, bool(self.flags)))

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the requests and replies of the repeated read-back of the enabled motor."""
        return ((8, bool(self.flags), readback.RECHECKS_PER_SECOND),) * 2

    @property
    def has_extended_ids(self) -> bool:
        """Return False, because all identifiers of the MIT protocol have 11 bits."""
        return False

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of commands in all control modes, and the identifier of register requests."""
        return frozenset(mode + self.node_id for mode in (0x000, 0x100, 0x200, 0x300)) | {
            codec.BROADCAST_ID
        }

    @property
    def node_ids(self) -> frozenset[int]:
        """Return MST_ID, the identifier of every answer of the motor."""
        return frozenset((self.reply_id,))

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
        """Return True, because the motor sends a single answer per request."""
        return True

    @property
    def position_step(self) -> float:
        """Return the change of the position per count [rad].

        The 16 bits of the position field cover the range from -PMAX to PMAX.
        """
        return self.ranges.position_step

    @property
    def feedback_period_s(self) -> float:
        """Return 0 (no unrequested feedback), because the motor sends feedback only in answer to a request."""
        return 0.0

    @property
    def required_settings(self) -> tuple[tuple[int, float], ...]:
        """Return the registers that the host verifies before arming, as pairs (register, required value)."""
        ranges = zip((codec.PMAX, codec.VMAX, codec.TMAX), self.ranges, strict=True)
        return (*self._mode_registers, *ranges, (codec.TIMEOUT, self.timeout))

    @property
    def _mode_registers(self) -> tuple[tuple[int, float], ...]:
        """Return the registers for the control mode, as pairs (register, required value)."""
        return ((codec.CTRL_MODE, codec.MIT_MODE),)

    @property
    def rechecked_settings(self) -> tuple[tuple[int, float], ...]:
        """Return the registers with protective settings, as pairs (register, required value).

        The host reads the registers with protective settings again while the motor is enabled.
        """
        return ((codec.TIMEOUT, self.timeout), (codec.TMAX, self.ranges.torque))

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return request and reply for each register that the host reads again, see ``contract.Drive``."""
        return tuple(
            SettingRecheck(
                registers.register_name(register),
                self._register_frame(codec.register_request(self.node_id, codec.READ, register)),
                Frame(
                    self.reply_id,
                    codec.register_reply(self.node_id, codec.READ, register, value),
                    0,
                    self.bus,
                ),
                key_byte_range=(0, 4),
                compared_byte_range=(0, 8),
            )
            for register, value in self.rechecked_settings
        )

    @property
    def cyclic_messages(self) -> CyclicMessages:
        """Return the signal tables of the commands and of the feedback."""
        position = codec.impedance_message(
            self.node_id, self.ranges, self.direction, self.zero, self.flags
        )
        return CyclicMessages((self.feedback.message,), (self.command.message,), position=position)

    def steady_status(self, state: DriveState) -> int:
        """Return byte 0 of feedback from an enabled motor without an error.

        Byte 0 of feedback contains the state and the node number.
        """
        if not is_steady(state):
            return NO_STEADY_STATUS
        return codec.ENABLED << 4 | self.node_id & 0xF

    def due_ns(self, state: DriveState) -> int:
        """Return MAX_TIME_NS, because no call of the state machine of an enabled motor is scheduled."""
        return MAX_TIME_NS

    def initial_state(self) -> DriveState:
        """Return the state of the motor before the first frame."""
        return DriveState(protocol_state=MitProgress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        if can_id != self.reply_id or bus != self.bus:
            return state
        if len(data) != 8:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        if state.phase == ENABLED and state.recheck.is_waiting:
            reply = codec.decode_register_reply(data, self.node_id)
            if reply is not None and reply[:2] == (
                codec.READ,
                self.rechecked_settings[state.recheck.step][0],
            ):
                return self._on_recheck_reply(state, reply)
        # Byte 0 of feedback from an enabled motor is 0x10 | node nibble. If the node number is from
        # 0x10 to 0x1f, byte 0 of a register reply can have the same value. A frame whose byte 0 has
        # the value of feedback counts as feedback.
        if state.phase != ENABLED or self.node_id >> 4 != codec.ENABLED:
            reply = codec.decode_register_reply(data, self.node_id)
            if reply is not None:
                return self._on_register_reply(state, reply, t_ns)
        # The low nibble of byte 0 is the node number. If the nibble differs from the low nibble of
        # this motor's node number, the frame is from another motor.
        if (data[0] ^ self.node_id) & 0xF:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        return self._on_feedback(state, data, t_ns)

    def _on_register_reply(
        self, state: DriveState, reply: codec.RegisterReply, t_ns: int
    ) -> DriveState:
        """Return the drive state after a register reply during configuration."""
        if state.phase != CONFIGURING:
            return state
        progress = get_progress(state)
        if progress.cursor.step >= len(self.required_settings):
            is_serial_number = reply[:2] == (codec.READ, codec.SERIAL_NUMBER)
            return (
                state_after_configuration(state, t_ns, int.from_bytes(reply.raw, "little"))
                if is_serial_number
                else state
            )
        cursor, problem = registers.on_reply(progress.cursor, self.required_settings, reply)
        if problem:
            return enter_fault(state, SETTING_MISMATCH_ERROR, problem)
        return state._replace(protocol_state=progress._replace(cursor=cursor))

    def _on_recheck_reply(self, state: DriveState, reply: codec.RegisterReply) -> DriveState:
        """Check the value of a register that the host has read again while the motor is enabled."""
        register, value = self.rechecked_settings[state.recheck.step]
        is_equal = reply.raw == codec.register_bytes(register, value)
        answer = f"reads {reply.value:g}"
        return state_after_recheck_reply(
            state,
            SETTING_MISMATCH_ERROR,
            len(self.rechecked_settings),
            is_equal,
            registers.register_name(register),
            answer,
            f"{value:g}",
        )

    def _on_feedback(self, state: DriveState, data: bytes, t_ns: int) -> DriveState:
        """Return the drive state after a feedback frame.

        The returned state contains the values of the feedback frame and the effect of the state
        nibble.
        """
        nibble, position, velocity, torque, hot = codec.decode_feedback(data, self.feedback)
        if not get_progress(state).is_configured:
            position = velocity = torque = math.nan
        return apply_status(state.with_feedback(position, velocity, torque, hot, t_ns), nibble)

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``."""
        progress: MitProgress = state.protocol_state
        if target == ENABLE and state.phase == ENABLED and not progress.is_disabling:
            sent_command_frame = self._command_frame(command)
            state, recheck = request_recheck(state, self, SETTING_MISMATCH_ERROR, t_ns)
            return state, (sent_command_frame, *recheck)
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
            return state._replace(phase=SILENT, protocol_state=MitProgress()), (
                self._refresh_frame(),
            )
        # Some motors have a watchdog that runs even while the motor is disabled. Commands to the
        # motor restart the watchdog.
        does_watchdog_need_commands = state.error_text == WATCHDOG_FIRES_WHILE_DISABLED_TEXT
        clear_frames = (
            (self._frame_to_motor(codec.special_command(codec.CLEAR_ERROR)),)
            if progress.errors_to_ignore
            else ()
        )
        if state.phase == CONFIGURING or (state.phase == READY and not progress.is_configured):
            next_state, requests = self._configure(
                state._replace(phase=CONFIGURING), progress, t_ns
            )
            return next_state, (
                *(clear_frames or self.torque_cut_frames()),
                *requests,
            ) if does_watchdog_need_commands else requests
        if (
            state.phase == READY
            and target == ENABLE
            and not (does_watchdog_need_commands and progress.errors_to_ignore)
        ):
            enabling_state = start_enabling(state, self.node_id, t_ns)
            return enabling_state, (self._frame_to_motor(codec.special_command(codec.ENABLE)),)
        if does_watchdog_need_commands and not clear_frames:
            return state, self.torque_cut_frames()
        # The manual does not say if the clear command has an answer, so feedback is requested too.
        return state, (*clear_frames, self._refresh_frame())

    def _configure(
        self, state: DriveState, progress: MitProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the next register request.

        If the motor is enabled, the host first disables the motor.
        """
        if progress.enabled_by_other_host:
            next_state = state._replace(error_text="enabled, and does not disable")
            return next_state, self.torque_cut_frames()
        if progress.cursor.step >= len(self.required_settings):
            cursor, data, unanswered = registers.next_serial_request(
                progress.cursor, self.node_id, t_ns
            )
            next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
            return state_after_configuration(next_state, t_ns, 0) if unanswered else next_state, (
                self._register_frame(data),
            ) if data else ()
        cursor, data, problem = registers.next_request(
            progress.cursor, self.required_settings, self.node_id, t_ns
        )
        if problem:
            return enter_fault(state, SETTING_MISMATCH_ERROR, problem), ()
        text = (
            WATCHDOG_FIRES_WHILE_DISABLED_TEXT
            if state.error_text == WATCHDOG_FIRES_WHILE_DISABLED_TEXT
            else ""
        )
        next_state = state._replace(
            error_text=text, protocol_state=progress._replace(cursor=cursor)
        )
        return next_state, (self._register_frame(data),) if data else ()

    def _command_payload(self, command: float) -> bytes:
        """Return the payload of a command to the motor.

        Args:
            command: command, in the unit of ``command_limit``.

        Raises:
            ValueError: the command is not finite, or exceeds ``command_limit``.
        """
        try:
            return self.command.pack(command)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return the frame of a torque command [N m at the spool].

        A torque command alone does not enable the motor.
        """
        return (self._command_frame(torque),)

    def _command_frame(self, command: float) -> Frame:
        """Return the frame of a command, which is given in the unit of ``command_limit``."""
        return self._frame_to_motor(self._command_payload(command))

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frame of the disable command."""
        return (self._frame_to_motor(codec.special_command(codec.DISABLE)),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the frame that clears the latched error of the drive.

        After the clear command, the host verifies the registers again.
        """
        fresh_state = state._replace(
            phase=SILENT,
            error=0,
            error_text="",
            protocol_state=MitProgress(errors_to_ignore=IGNORED_FAULT_COUNT),
        )
        return fresh_state, (self._frame_to_motor(codec.special_command(codec.CLEAR_ERROR)),)

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return no release frames, because the watchdog of a disabled motor is not active."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Return the serial number from register 15, or the node number if the serial number is unknown."""
        return f"{serial:#x}" if (serial := get_progress(state).serial) else f"node {self.node_id}"

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return CAUSE_BY_ERROR.get(error_code, DriveFaultCause.UNKNOWN)

    def _frame_to_motor(self, data: bytes) -> Frame:
        """Return a frame to the motor with the given payload."""
        return Frame(self.node_id, data, self.flags, self.bus)

    def _register_frame(self, data: bytes) -> Frame:
        """Return the frame of a register request with the given payload."""
        return Frame(codec.BROADCAST_ID, data, self.flags, self.bus)

    def _refresh_frame(self) -> Frame:
        """Return the frame to request feedback from the motor."""
        return self._register_frame(codec.register_request(self.node_id, codec.REFRESH))
