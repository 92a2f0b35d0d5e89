"""State machine that configures, enables and stops a RobStride motor.

A motor answers requests, and sends fault reports without a request. The identifier of feedback
contains mode and faults, so that all feedback of a running motor without a fault has the same
identifier. Feedback with any other identifier reports another mode or a fault, and is processed by
the state machine. A stop command without data stops the motor, but does not clear faults. The host
also sends the stop command without data to request feedback from a disabled motor. A disabled motor
sends feedback only as the answer to a stop command.
"""

import struct
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
from handctl.drives.frame import EXTENDED_FLAG, Frame
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import (
    MotorOption,
    check_full_scale,
    checked_whole_number,
    motor_type_option,
    pop_motor_model,
    refuse_unknown_options,
)
from handctl.drives.readback import SettingRecheck
from handctl.drives.robstride import codec
from handctl.drives.robstride import settings as parameters
from handctl.drives.robstride.progress import (
    IGNORED_FAULT_COUNT,
    SETTING_MISMATCH_ERROR,
    RobstrideProgress,
    apply_fault,
    apply_status,
    cause_of_error,
    get_progress,
)
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
    "motor_type": motor_type_option(codec.MOTOR_MODEL_RANGES),
    "host_id": MotorOption("128 to 253 (default)", "Identifier of the host in the frames."),
}
"""Options of a RobStride motor in the hand file."""


@dataclass(frozen=True, slots=True)
class RobstrideDrive:
    """RobStride motor with the private protocol, and with the interface ``contract.Drive``.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus of the motor.
        node_id: number of the motor, from 1 to 0x7f.
        host: number of this host.
        ranges: full scale of the motor model.
        command_limit: largest torque command, and torque limit in the motor [N m at the spool].
        direction: 1 if positive torque of the motor winds the tendon, else -1.
        zero: angle of the motor when the spool angle is zero [rad].
        watchdog_ms: timeout of the motor's watchdog [ms].
        command: signal table of the torque command, built from the other attributes.
        feedback: signal table of the feedback, built from the other attributes.
        required_settings: parameters with the values required before arming, built from the attributes
            above.
        node_ids: identifiers of the frames from the motor, built from the attributes above.
    """

    name: str
    bus: int
    node_id: int
    host: int
    ranges: codec.ModelRanges
    command_limit: float
    direction: int
    zero: float
    watchdog_ms: float
    command: SignalTable = field(init=False, repr=False, compare=False)
    feedback: SignalTable = field(init=False, repr=False, compare=False)
    required_settings: tuple[parameters.RequiredParameter, ...] = field(
        init=False, repr=False, compare=False
    )
    node_ids: frozenset[int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames, the required parameters, and the identifiers."""
        command = codec.command_message(
            self.node_id, self.ranges, self.command_limit, self.direction
        )
        feedback = codec.feedback_message(
            self.node_id, self.host, self.ranges, self.direction, self.zero
        )
        object.__setattr__(self, "command", SignalTable(command))
        object.__setattr__(self, "feedback", SignalTable(feedback))
        object.__setattr__(
            self,
            "required_settings",
            parameters.required_parameters(self.command_limit, self.watchdog_ms),
        )
        object.__setattr__(self, "node_ids", codec.motor_ids(self.node_id, self.host))

    @staticmethod
    def from_motor(motor: MotorDescription, bus: int) -> "RobstrideDrive":
        """Return the drive object for a motor description in the hand file.

        The full scales of position and velocity come from the motor model, not from the
        description.

        Raises:
            ConfigError: the model or an option is unknown or wrong, or the torque limit exceeds the
                full scale of the model.
        """
        options = dict(motor.options)
        location = f"motor[{motor.name}]"
        ranges = pop_motor_model(options, location, codec.MOTOR_MODEL_RANGES)
        host = checked_whole_number(
            options.pop("host_id", codec.HOST_ID), f"{location}.options.host_id", codec.HOST_ID
        )
        refuse_unknown_options(options, f"{location}.options", OPTIONS)
        if host <= codec.LAST_NODE_ID:
            raise ConfigError(
                str(host), f"{location}.options.host_id", "128 to 253, no number of a motor"
            )
        check_full_scale(motor, ranges)
        return RobstrideDrive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            host=host,
            ranges=ranges,
            command_limit=motor.torque_max_N_m,
            direction=motor.direction,
            zero=motor.zero_rad,
            watchdog_ms=motor.watchdog_ms,
        )

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the motor in a tick: command and feedback."""
        return ((8, False), (8, False))

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the requests and replies of the repeated read-back of the enabled motor."""
        return ((8, False, readback.RECHECKS_PER_SECOND),) * 2

    @property
    def has_extended_ids(self) -> bool:
        """Return True, because all identifiers of the private protocol have 29 bits."""
        return True

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of requests from this host, and of commands with zero torque.

        Torque commands have a different identifier for each torque, 65536 identifiers in all. Of
        the torque commands, the set contains only the identifier of zero torque. The requests of
        another host are sufficient to detect the other host.
        """
        requests = {codec.request_id(kind, self.node_id, self.host) for kind in codec.REQUEST_TYPES}
        return frozenset(requests | {self.command.message.can_id, self.command.pack_frame(0.0)[0]})

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return no unverified protections, because the host reads back torque limit and watchdog."""
        return ()

    @property
    def unchecked_properties(self) -> Mapping[DriveProperty, str]:
        """Return no unchecked properties, because handctl can check every property of the drive."""
        return {}

    @property
    def sends_one_reply_per_command(self) -> bool:
        """Return True, because the motor sends a single feedback frame per command."""
        return True

    @property
    def position_step(self) -> float:
        """Return the change of the position per count [rad].

        The 16 bits of the position field cover a range of 8 pi rad.
        """
        return 2 * codec.POSITION_RANGE_RAD / codec.MAX_COUNT

    @property
    def feedback_period_s(self) -> float:
        """Return 0 (no unrequested feedback), because the motor sends feedback only in answer to a command."""
        return 0.0

    @property
    def cyclic_messages(self) -> CyclicMessages:
        """Return the signal tables of the commands and of the feedback."""
        position = codec.impedance_message(
            self.node_id, self.ranges, self.command_limit, self.direction, self.zero
        )
        return CyclicMessages((self.feedback.message,), (self.command.message,), position=position)

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return request and reply for each parameter that the host reads again, see ``contract.Drive``."""
        return tuple(
            SettingRecheck(
                parameter.name,
                self._request_frame(codec.READ, codec.parameter_request(parameter.number)),
                Frame(
                    codec.reply_id(codec.READ, self.node_id, self.host),
                    codec.parameter_request(parameter.number, parameter.raw),
                    0,
                    self.bus,
                ),
                key_byte_range=(0, 2),
                compared_byte_range=(0, 4 + struct.calcsize(parameter.coding)),
            )
            for parameter in self.required_settings
        )

    def steady_status(self, state: DriveState) -> int:
        """Return the status 0 for an enabled motor.

        The status of the motor is in the identifier of feedback, not in the payload.
        """
        if not is_steady(state):
            return NO_STEADY_STATUS
        return 0

    def due_ns(self, state: DriveState) -> int:
        """Return MAX_TIME_NS, because no call of the state machine of an enabled motor is scheduled."""
        return MAX_TIME_NS

    def initial_state(self) -> DriveState:
        """Return the state of the motor before the first frame."""
        return DriveState(protocol_state=RobstrideProgress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        number = can_id & ~EXTENDED_FLAG
        if bus != self.bus or can_id not in self.node_ids:
            return state
        if len(data) != 8:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        kind = number >> 24
        status = number >> 16 & 0xFF
        if kind == codec.FEEDBACK:
            return self._on_feedback(state, data, t_ns, status)
        if kind == codec.READ:
            return self._on_parameter_reply(state, data, bool(status))
        if kind == codec.FAULT_REPORT:
            return self._on_fault_report(state, data)
        serial = int.from_bytes(data, "big")
        progress = get_progress(state)._replace(serial=serial)
        phase = (
            CONFIGURING if state.phase == SILENT and not progress.errors_to_ignore else state.phase
        )
        return state._replace(phase=phase, protocol_state=progress)

    def _on_feedback(self, state: DriveState, data: bytes, t_ns: int, status: int) -> DriveState:
        """Return the drive state after feedback.

        The returned state contains the values of the feedback, and the effect of the status in the
        identifier.
        """
        position, velocity, torque, winding_temperature = self.feedback.unpack(data)
        next_state = state.with_feedback(position, velocity, torque, winding_temperature, t_ns)
        return apply_status(next_state, status >> 6, status & 0x3F)

    def _on_fault_report(self, state: DriveState, data: bytes) -> DriveState:
        """Return the drive state after a fault report.

        Bytes 0 to 3 of a fault report contain faults, and bytes 4 to 7 contain warnings. A motor
        with a fault makes no torque.
        """
        faults = int.from_bytes(data[:4], "little")
        if not faults:
            return state
        return apply_fault(state, codec.RESET_MODE, faults << codec.FAULT_REPORT_SHIFT & 0xFFFFFFFF)

    def _on_parameter_reply(self, state: DriveState, data: bytes, has_failed: bool) -> DriveState:
        """Return the drive state after a parameter reply.

        The method compares the value in the reply with the required value of the parameter.
        """
        progress = get_progress(state)
        number, raw_bytes = codec.decode_parameter_reply(data)
        if state.phase == ENABLED and state.recheck.is_waiting:
            required_parameter = self.required_settings[state.recheck.step]
            if number != required_parameter.number:
                return state
            is_equal = required_parameter.is_required_value(raw_bytes) and not has_failed
            answer = (
                "cannot be read"
                if has_failed
                else f"reads {required_parameter.value_text(raw_bytes)}"
            )
            return state_after_recheck_reply(
                state,
                SETTING_MISMATCH_ERROR,
                len(self.required_settings),
                is_equal,
                required_parameter.name,
                answer,
                f"{required_parameter.value:g}",
            )
        cursor = progress.cursor
        if (
            state.phase != CONFIGURING
            or not cursor.is_waiting
            or cursor.step >= len(self.required_settings)
        ):
            return state
        required_parameter = self.required_settings[cursor.step]
        if number != required_parameter.number:
            return state
        if has_failed:
            return enter_fault(
                state, SETTING_MISMATCH_ERROR, f"{required_parameter.name} cannot be read"
            )
        if required_parameter.is_required_value(raw_bytes):
            return state._replace(protocol_state=progress._replace(cursor=cursor.next_setting()))
        cursor, problem = readback.cursor_after_wrong_value(
            cursor,
            required_parameter.name,
            required_parameter.value_text(raw_bytes),
            f"{required_parameter.value:g}",
            parameters.WRITE_TRIES,
        )
        next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
        return enter_fault(next_state, SETTING_MISMATCH_ERROR, problem) if problem else next_state

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``."""
        progress: RobstrideProgress = state.protocol_state
        if target == ENABLE and state.phase == ENABLED and not progress.is_disabling:
            sent_torque_frame = self._torque_frame(command)
            state, recheck = request_recheck(state, self, SETTING_MISMATCH_ERROR, t_ns)
            return state, (sent_torque_frame, *recheck)
        if target == LISTEN:
            return state, ()
        if target == DISABLE or state.phase == ENABLED:
            return start_disabling(state, t_ns), self.torque_cut_frames()
        if state.phase == FAULT:
            return state, self.torque_cut_frames()
        if progress.is_disabling:
            progress = progress._replace(is_disabling=False)
            state = state._replace(protocol_state=progress)
        if may_have_lost_power(state, t_ns):
            return state._replace(phase=SILENT, protocol_state=RobstrideProgress()), (
                self._request_frame(codec.GET_ID),
            )
        if state.phase == CONFIGURING or (state.phase == READY and not progress.is_configured):
            return self._configure(state._replace(phase=CONFIGURING), progress, t_ns)
        if state.phase == READY and target == ENABLE:
            enabling_state = start_enabling(state, self.node_id, t_ns)
            return enabling_state, (self._request_frame(codec.ENABLE),)
        return state, (self._standby_request(state, progress),)

    def _standby_request(self, state: DriveState, progress: RobstrideProgress) -> Frame:
        """Return the frame that the host sends while the motor makes no torque.

        The frame requests feedback, requests the identity, or clears faults.
        """
        if state.phase == READY:
            return self._request_frame(codec.STOP)
        if progress.errors_to_ignore:
            return self._request_frame(codec.STOP, codec.CLEAR_FAULT_DATA)
        return self._request_frame(codec.GET_ID)

    def _configure(
        self, state: DriveState, progress: RobstrideProgress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the request to read or write the next parameter.

        If the motor is enabled, the host first stops the motor.
        """
        if progress.enabled_by_other_host:
            next_state = state._replace(error_text="enabled, and does not stop")
            return next_state, self.torque_cut_frames()
        cursor = progress.cursor
        if cursor.step >= len(self.required_settings):
            ready_state = state_after_configuration(state, t_ns, progress.serial)
            return ready_state, self.torque_cut_frames()
        required_parameter = self.required_settings[cursor.step]
        if cursor.must_write:
            next_state = state._replace(
                protocol_state=progress._replace(cursor=cursor.cursor_after_write())
            )
            return next_state, (
                self._request_frame(
                    codec.WRITE,
                    codec.parameter_request(required_parameter.number, required_parameter.raw),
                ),
            )
        cursor, must_send, problem = readback.request_setting(cursor, required_parameter.name, t_ns)
        if problem:
            return enter_fault(state, SETTING_MISMATCH_ERROR, problem), ()
        next_state = state._replace(error_text="", protocol_state=progress._replace(cursor=cursor))
        return next_state, (
            self._request_frame(codec.READ, codec.parameter_request(required_parameter.number)),
        ) if must_send else ()

    def _torque_frame(self, torque: float) -> Frame:
        """Return the frame of a torque command.

        Args:
            torque: torque to command [N m at the spool].

        Raises:
            ValueError: the torque is not finite, or exceeds the torque limit.
        """
        try:
            can_id, data = self.command.pack_frame(torque)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
        return Frame(can_id, data, 0, self.bus)

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return the frame of a torque command.

        A torque command alone does not enable the motor.
        """
        return (self._torque_frame(torque),)

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frame of the stop command."""
        return (self._request_frame(codec.STOP),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the stop command that clears the latched faults.

        After the stop command, the host reads back the parameters again.
        """
        fresh_state = state._replace(
            phase=SILENT,
            error=0,
            error_text="",
            protocol_state=RobstrideProgress(errors_to_ignore=IGNORED_FAULT_COUNT),
        )
        return fresh_state, (self._request_frame(codec.STOP, codec.CLEAR_FAULT_DATA),)

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return no release frames, because the watchdog of a stopped motor is not active."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Return the 64-bit identifier of the motor's processor, or the node number if the identifier is unknown."""
        return (
            f"{serial:016x}" if (serial := get_progress(state).serial) else f"node {self.node_id}"
        )

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return cause_of_error(error_code)

    def _request_frame(self, message_type: int, data: bytes = codec.EMPTY_DATA) -> Frame:
        """Return a request of type ``message_type`` to the motor."""
        return Frame(codec.request_id(message_type, self.node_id, self.host), data, 0, self.bus)
