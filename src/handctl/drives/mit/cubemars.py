"""CubeMars AK motor in MIT mode.

The motor uses the command frame of Damiao motors, but its feedback contains less data.

The command and the special commands have the identifier and the layout that ``codec`` describes.
Feedback has the identifier of the command and 8 bytes, big-endian. Older firmware omits bytes 6 and
7:

    byte    0        1, 2          3, 4 high     4 low, 5     6                   7
    field   node 8   position 16   velocity 12   torque 12    temperature 8       error 8
    range            +-12.5 rad    by model      by model     1 degC from -40     see ERROR_TEXTS

A CubeMars motor has no registers and no watchdog. The feedback of a CubeMars motor does not show if
the motor is enabled. A motor counts as enabled after several answers to the enable command. The
motor counts as disabled after several answers to the disable command, if these answers report no
torque. The host also uses the disable command to request feedback, because every other command can
cause torque. ``unverified_protections`` lists the protections that handctl cannot verify. Source:
CubeMars AK Series Actuator Driver Manual V1.0.8, section 5.3.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from handctl.drives.contract import (
    MAX_TIME_NS,
    NO_STEADY_STATUS,
    DriveFaultCause,
    DrivePhase,
    DriveProperty,
    DriveState,
    DriveTarget,
)
from handctl.drives.frame import Frame
from handctl.drives.mit import codec
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import (
    MotorOption,
    check_full_scale,
    motor_type_option,
    pop_motor_model,
    refuse_unknown_options,
)
from handctl.drives.readback import SettingRecheck
from handctl.drives.signals import CyclicMessages, Signal, SignalQuantity, SignalTable
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = DriveTarget
SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase
MOTOR_MODEL_RANGES = {
    "ak60-6": codec.MotorRanges(12.5, 50.0, 15.0),
    "ak70-10": codec.MotorRanges(12.5, 50.0, 25.0),
    "ak80-6": codec.MotorRanges(12.5, 76.0, 12.0),
    "ak80-9": codec.MotorRanges(12.5, 50.0, 18.0),
    "ak10-9": codec.MotorRanges(12.5, 50.0, 65.0),
}
"""Full scale of each motor model: position [rad], velocity [rad/s], torque [N m].

Source: CubeMars AK Series Actuator Driver Manual V1.0.8, section 5.3.
"""
ERROR_TEXTS = {
    1: "over-temperature",
    2: "over-current",
    3: "over-voltage",
    4: "under-voltage",
    5: "encoder error",
    6: "phase current imbalance",
}
"""Text of each error, by byte 7 of the feedback. Byte 7 is 0 if the motor has no error."""
CAUSE_BY_ERROR = {
    1: DriveFaultCause.OVERHEATED,
    3: DriveFaultCause.VOLTAGE,
    4: DriveFaultCause.VOLTAGE,
} | dict.fromkeys((2, 5, 6), DriveFaultCause.OTHER)
"""Cause of each error, by byte 7 of the feedback."""
FEEDBACK_LENGTHS_BYTES = (6, 8)
"""Possible payload lengths of feedback [bytes].

Older firmware sends 6 bytes, without temperature and error.
"""
REQUIRED_ANSWER_COUNT = 3
"""Number of answers after which an enable or disable command counts as obeyed.

The motor may have sent the first answer before the motor received the command.
"""
ZERO_COUNT_TEMPERATURE_C = -40.0
"""Temperature at count 0 in byte 6 of the feedback [degC].

Source: CubeMars AK Series Actuator Driver Manual, section 5.3, example of a reply. Programs that
use the count as a temperature in degC (TMotorCANControl) report 40 degC too much.
"""
MAX_RESTING_TORQUE_FRACTION = 0.02
"""Largest reported torque of a motor that counts as making no torque, as a fraction of the full scale.

The sensor noise of a motor at rest is below 2 % of full scale.
"""
SILENCE_TIMEOUT_NS = 250_000_000
"""Time without a frame after which a disabled motor returns to phase SILENT [ns]."""
UNVERIFIED_PROTECTIONS = (
    "watchdog: CubeMars' MIT mode has none; a dead host leaves torque on",
    "has no torque limit below its model's full scale; torque_max_N_m is this host's alone",
    "does not report whether it is enabled; "
    f"counts as disabled if its answer to the disable command reports at most "
    f"{MAX_RESTING_TORQUE_FRACTION:.0%} of full-scale torque",
    "ranges cannot be read back; motor_type must be right",
)
"""Protections of a CubeMars motor that handctl cannot verify, one line each."""
UNCHECKED_PROPERTIES = {
    DriveProperty.READBACK: "the protocol has no settings that can be read back",
    DriveProperty.WATCHDOG: "the protocol has no watchdog",
    DriveProperty.CUT: "the protocol has no report of the drive's state",
}
"""Reason for each property of a CubeMars motor that handctl cannot check."""


class CubemarsProgress(NamedTuple):
    """State of the CubeMars state machine between frames, stored in ``DriveState.protocol_state``.

    Attributes:
        last_special_command: latest special command to the motor, ENABLE or DISABLE.
        command_start_ns: time at which the latest special command was first sent [ns].
        agreeing_answers: number of consecutive answers of the motor that agree with the latest
            special command.
        is_enable_sent: True from the enable command until the motor counts as disabled.
    """

    last_special_command: DriveTarget = DISABLE
    command_start_ns: int = -1
    agreeing_answers: int = 0
    is_enable_sent: bool = False


def get_progress(state: DriveState) -> CubemarsProgress:
    """Return the ``CubemarsProgress`` in the state of a drive."""
    progress: CubemarsProgress = state.protocol_state
    return progress


OPTIONS = {
    "motor_type": motor_type_option(MOTOR_MODEL_RANGES),
    "temperature_offset_C": MotorOption(
        "-40 (default) or 0",
        "Temperature that the code 0 means. Set it to 0 if a cold motor reports a temperature below zero.",
    ),
}
"""Options of a CubeMars motor in the hand file."""


@dataclass(frozen=True, slots=True)
class CubemarsDrive:
    """CubeMars motor, with the interface ``contract.Drive``.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus of the motor.
        node_id: node number, and identifier of commands and feedback.
        ranges: full scale of the motor model.
        command_limit: largest torque command [N m at the spool].
        direction: 1 if positive torque of the motor winds the tendon, else -1.
        zero: angle of the motor when the spool angle is zero [rad].
        temperature_offset: temperature at count 0 in byte 6 of the feedback [degC].
        command: signal table of the torque command, built from the other attributes.
        feedback: signal table of the feedback, built from the other attributes.
    """

    name: str
    bus: int
    node_id: int
    ranges: codec.MotorRanges
    command_limit: float
    direction: int
    zero: float
    temperature_offset: float
    command: SignalTable = field(init=False, repr=False, compare=False)
    feedback: SignalTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        command = codec.command_message(self.node_id, self.ranges, self.direction)
        feedback = codec.feedback_message(self.node_id, self.ranges, self.direction, self.zero)
        state, position, velocity, torque, _, _ = feedback.signals
        signals = (
            # Byte 0 of a CubeMars motor is the whole node number, without a state nibble.
            state._replace(name="node"),
            position,
            velocity,
            torque,
            Signal(
                "temperature",
                SignalQuantity.TEMPERATURE,
                55,
                8,
                True,
                offset=self.temperature_offset,
                unit="degC",
            ),
            Signal("error", SignalQuantity.STATUS, 63, 8, True),
        )
        object.__setattr__(self, "command", SignalTable(command._replace(limit=self.command_limit)))
        object.__setattr__(self, "feedback", SignalTable(feedback._replace(signals=signals)))

    @staticmethod
    def from_motor(motor: MotorDescription, bus: int) -> "CubemarsDrive":
        """Return the drive object for a motor description in the hand file.

        The full scales of position and velocity come from the motor model, not from the
        description.

        Raises:
            ConfigError: the motor model or an option is unknown, or the torque limit exceeds the
                full scale of the model.
        """
        options = dict(motor.options)
        location = f"motor[{motor.name}]"
        ranges = pop_motor_model(options, location, MOTOR_MODEL_RANGES)
        temperature_offset = options.pop("temperature_offset_C", ZERO_COUNT_TEMPERATURE_C)
        if isinstance(temperature_offset, bool) or temperature_offset not in (
            ZERO_COUNT_TEMPERATURE_C,
            0.0,
        ):
            raise ConfigError(
                repr(temperature_offset),
                f"{location}.options.temperature_offset_C",
                f"{ZERO_COUNT_TEMPERATURE_C:g} or 0",
            )
        refuse_unknown_options(options, f"{location}.options", OPTIONS)
        check_full_scale(motor, ranges)
        command_limit = motor.torque_max_N_m
        zero = motor.zero_rad
        return CubemarsDrive(
            motor.name,
            bus,
            motor.node_id,
            ranges,
            command_limit,
            motor.direction,
            zero,
            float(temperature_offset),
        )

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the motor in a tick: command and answer."""
        return ((8, False), (8, False))

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return no background frames, because the motor sends only answers to commands."""
        return ()

    @property
    def has_extended_ids(self) -> bool:
        """Return False, because all identifiers of the MIT protocol have 11 bits."""
        return False

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifier of commands to the motor.

        Feedback and commands have the same identifier, so commands of another host cannot be
        detected.
        """
        return frozenset((self.node_id,))

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifier of feedback, which is also the identifier of commands."""
        return frozenset((self.node_id,))

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return one line for each of the drive's protections that handctl cannot verify."""
        return UNVERIFIED_PROTECTIONS

    @property
    def unchecked_properties(self) -> Mapping[DriveProperty, str]:
        """Return a reason for each of the drive's properties that handctl cannot check."""
        return UNCHECKED_PROPERTIES

    @property
    def sends_one_reply_per_command(self) -> bool:
        """Return True, because the motor sends a single answer per command."""
        return True

    @property
    def position_step(self) -> float:
        """Return the change of the position per count [rad].

        The 16 bits of the position field cover the range from minus to plus the position full scale
        of the motor model.
        """
        return self.ranges.position_step

    @property
    def feedback_period_s(self) -> float:
        """Return 0 (no unrequested feedback), because the motor sends feedback only in answer to a command."""
        return 0.0

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return no settings to read again, because the motor has no settings that can be read."""
        return ()

    @property
    def cyclic_messages(self) -> CyclicMessages:
        """Return the signal tables of the commands and of the feedback."""
        position = codec.impedance_message(self.node_id, self.ranges, self.direction, self.zero)
        position = position._replace(limit=self.command_limit)
        return CyclicMessages((self.feedback.message,), (self.command.message,), position=position)

    def steady_status(self, state: DriveState) -> int:
        """Return the status that the feedback of an enabled motor without an error contains.

        The high byte of the status is the node number. The low byte is the error code 0.
        """
        progress: CubemarsProgress = state.protocol_state
        is_steady = (
            state.phase == ENABLED
            and progress.last_special_command == ENABLE
            and progress.agreeing_answers >= REQUIRED_ANSWER_COUNT
        )
        return (self.node_id & 0xFF) << 8 if is_steady else NO_STEADY_STATUS

    def due_ns(self, state: DriveState) -> int:
        """Return MAX_TIME_NS, because no call is scheduled: the motor has no settings to read back."""
        return MAX_TIME_NS

    def initial_state(self) -> DriveState:
        """Return the state of the motor before the first frame."""
        return DriveState(protocol_state=CubemarsProgress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        if can_id != self.node_id or bus != self.bus:
            return state
        if len(data) not in FEEDBACK_LENGTHS_BYTES or data[0] != self.node_id & 0xFF:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        _, position, velocity, torque, temperature, error_code = self.feedback.unpack(data)
        if len(data) < 8:
            temperature = math.nan
            error_code = 0.0
        error = int(error_code)
        state_with_feedback = state.with_feedback(position, velocity, torque, temperature, t_ns)
        next_state = self._on_answer(state_with_feedback, state.protocol_state)
        if not error:
            return next_state
        is_disabling = (
            next_state.phase == ENABLED and get_progress(next_state).last_special_command == DISABLE
        )
        next_state = next_state._replace(
            error=error, error_text=ERROR_TEXTS.get(error, f"unknown error {error}")
        )
        return next_state if is_disabling else next_state._replace(phase=FAULT)

    def _on_answer(self, state: DriveState, progress: CubemarsProgress) -> DriveState:
        """Return the drive state after an answer to the latest enable or disable command."""
        # An answer that the motor sent before a command does not show the effect of the command.
        if state.feedback_t_ns < progress.command_start_ns:
            return state
        if progress.last_special_command == ENABLE:
            if progress.agreeing_answers >= REQUIRED_ANSWER_COUNT:
                return state  # the enable or disable command counts as obeyed, and further answers change nothing
            is_done = (
                state.phase != FAULT and progress.agreeing_answers + 1 >= REQUIRED_ANSWER_COUNT
            )
            return state._replace(
                phase=ENABLED if is_done else state.phase,
                protocol_state=progress._replace(agreeing_answers=progress.agreeing_answers + 1),
            )
        is_torque_free = abs(state.torque) <= MAX_RESTING_TORQUE_FRACTION * self.ranges.torque
        progress = progress._replace(
            agreeing_answers=progress.agreeing_answers + 1 if is_torque_free else 0
        )
        if progress.agreeing_answers < REQUIRED_ANSWER_COUNT:
            phase_in_setup = CONFIGURING if state.phase == SILENT else state.phase
            return state._replace(phase=phase_in_setup, protocol_state=progress)
        phase = FAULT if state.error else READY
        return state._replace(phase=phase, protocol_state=progress._replace(is_enable_sent=False))

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``."""
        progress: CubemarsProgress = state.protocol_state
        if state.phase == ENABLED and target == ENABLE and progress.last_special_command == ENABLE:
            return state, (self._frame_to_motor(self._torque_payload(command)),)
        if target == LISTEN:
            return state, ()
        if (
            state.phase == READY
            and t_ns - state.feedback_t_ns > SILENCE_TIMEOUT_NS
            and not progress.is_enable_sent
        ):
            state = state._replace(phase=SILENT)
        if target == ENABLE and state.phase == READY:
            return self._state_after_command(state, ENABLE, t_ns), (
                self._frame_to_motor(codec.special_command(codec.ENABLE)),
            )
        phase = (
            ENABLED
            if progress.is_enable_sent and (target == DISABLE or state.phase != FAULT)
            else state.phase
        )
        return self._state_after_command(
            state._replace(phase=phase), DISABLE, t_ns
        ), self.torque_cut_frames()

    def _state_after_command(
        self, state: DriveState, new_command: DriveTarget, t_ns: int
    ) -> DriveState:
        """Return the drive state after an enable or disable command was sent.

        If an enable command follows a disable command, or the reverse, the count of answers that
        agree with the command starts at 0.
        """
        progress: CubemarsProgress = state.protocol_state
        if progress.last_special_command == new_command and progress.command_start_ns >= 0:
            return state
        is_enable_sent = progress.is_enable_sent or new_command == ENABLE
        return state._replace(protocol_state=CubemarsProgress(new_command, t_ns, 0, is_enable_sent))

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
        """Return the frame of a torque command [N m at the spool].

        A torque command alone does not enable the motor.
        """
        return (self._frame_to_motor(self._torque_payload(torque)),)

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frame of the disable command."""
        return (self._frame_to_motor(codec.special_command(codec.DISABLE)),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the drive state without the error, and the frame of the disable command.

        The protocol has no frame that clears an error. If the cause of an error remains, the motor
        reports the error again.
        """
        progress: CubemarsProgress = state.protocol_state
        fresh_state = state._replace(
            phase=SILENT,
            error=0,
            error_text="",
            protocol_state=CubemarsProgress(is_enable_sent=progress.is_enable_sent),
        )
        return fresh_state, self.torque_cut_frames()

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return no release frames, because a CubeMars motor has no watchdog."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Return the node number, because the motor does not report a serial number."""
        return f"node {self.node_id}"

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return CAUSE_BY_ERROR.get(error_code, DriveFaultCause.UNKNOWN)

    def _frame_to_motor(self, data: bytes) -> Frame:
        """Return a frame to the motor with the given payload."""
        return Frame(self.node_id, data, 0, self.bus)
