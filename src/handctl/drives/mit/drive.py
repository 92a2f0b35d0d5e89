"""Damiao motor in MIT mode: from silence through its registers to torque, and back to disabled.

A motor answers requests and sends no other frame. Therefore one request is sent in each tick, and
one register request is open at a time. Position, velocity, and torque are NaN until the ranges of
the motor are known. Angles beyond PMAX are not unwrapped, because the travel of a hand is far
smaller. Only feedback with state 0 or with an error proves that the motor is disabled.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from handctl.drives import readback
from handctl.drives.causes import Cause
from handctl.drives.contract import UNSTEADY, DriveState, DriveTarget, Phase
from handctl.drives.frame import BRS, FDF, Frame
from handctl.drives.mit import codec
from handctl.drives.mit import settings as registers
from handctl.drives.mit.progress import (
    CAUSES,
    CLEAR_TRIES,
    FIRES_WHILE_DISABLED_TEXT,
    MISMATCH,
    SILENCE_NS,
    MitProgress,
    apply_status,
    progress_of,
    to_fault,
)
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import checked_boolean, refuse_unknown_options
from handctl.drives.readback import Cursor
from handctl.drives.signals import Cyclic, Table
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = DriveTarget
SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase
"""Phases as module-level names for speed.

Reading an attribute of the enumeration is slower than a comparison.
"""


@dataclass(frozen=True, slots=True)
class MitDrive:
    """Damiao motor. Implements ``contract.Drive``.

    Attributes:
        name: name of the motor.
        bus: index of the bus.
        node_id: ESC_ID, identifier of commands.
        reply_id: MST_ID, identifier of answers.
        ranges: PMAX, VMAX, TMAX. TMAX is also the drive's own torque limit.
        direction: 1 if positive torque of the motor winds, else -1.
        zero: motor angle of the spool's zero [rad].
        timeout: time of the watchdog [50 us].
        flags: flags of frames to the motor, 0 for classical CAN.
        command: signal table of the command, from the fields above.
        feedback: signal table of the feedback, from the fields above.
    """

    name: str
    bus: int
    node_id: int
    reply_id: int
    ranges: codec.Ranges
    direction: int
    zero: float
    timeout: int
    flags: int = 0
    command: Table = field(init=False, repr=False, compare=False)
    feedback: Table = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        command = codec.command_message(self.node_id, self.ranges, self.direction, self.flags)
        feedback = codec.feedback_message(self.reply_id, self.ranges, self.direction, self.zero)
        object.__setattr__(self, "command", Table(command))
        object.__setattr__(self, "feedback", Table(feedback))

    @staticmethod
    def of(motor: MotorDescription, bus: int, given: Mapping[str, Any] | None = None) -> "MitDrive":
        """Return the drive of a motor description.

        Args:
            motor: description of the motor.
            bus: index of the bus.
            given: options instead of those of the description.

        Raises:
            ConfigError: an option unknown to MIT mode.
        """
        options = dict(motor.options if given is None else given)
        where = f"motor[{motor.name}].options"
        reply = options.pop("reply_id", motor.node_id + 0x10)
        fd = checked_boolean(options.pop("fd", False), f"{where}.fd")
        refuse_unknown_options(options, where, "reply_id or fd")
        if type(reply) is not int or not 0 < reply < codec.BROADCAST_ID:
            raise ConfigError(repr(reply), f"{where}.reply_id", "an identifier from 1 to 0x7fe")
        return MitDrive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            reply_id=reply,
            ranges=codec.Ranges(motor.position_range_rad, motor.velocity_range_rad_s, motor.torque_max_N_m),
            direction=motor.direction,
            zero=motor.zero_rad,
            timeout=round(motor.watchdog_ms * codec.TIMEOUT_UNITS_PER_MS),
            flags=FDF | BRS if fd else 0,
        )

    @property
    def torque_limit(self) -> float:
        """Return TMAX [N m]."""
        return self.ranges.torque

    @property
    def exchange(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of a tick: command and answer."""
        return ((8, bool(self.flags)), (8, bool(self.flags)))

    @property
    def background(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the register requests of the repeated read-back, and their answers."""
        return ((8, bool(self.flags), readback.RECHECKS_PER_SECOND),) * 2

    @property
    def extended(self) -> bool:
        """Return False, because all identifiers have 11 bits."""
        return False

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the command identifiers in all control modes, and the identifier of register frames."""
        return frozenset(mode + self.node_id for mode in (0x000, 0x100, 0x200, 0x300)) | {codec.BROADCAST_ID}

    @property
    def node_ids(self) -> frozenset[int]:
        """Return MST_ID, the identifier of every answer of the motor."""
        return frozenset((self.reply_id,))

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return an empty tuple, because every setting is read back."""
        return ()

    @property
    def one_reply_per_command(self) -> bool:
        """Return True, because a motor sends one answer per request."""
        return True

    @property
    def position_step(self) -> float:
        """Return the position step of one count: 16 bits cover twice PMAX [rad]."""
        return self.ranges.position_step

    @property
    def feedback_period_s(self) -> float:
        """Return 0, because every command requests feedback."""
        return 0.0

    @property
    def required(self) -> tuple[tuple[int, float], ...]:
        """Return the registers to verify before arming, as (register, value) pairs."""
        ranges = zip((codec.PMAX, codec.VMAX, codec.TMAX), self.ranges, strict=True)
        return (*self._mode_registers, *ranges, (codec.TIMEOUT, self.timeout))

    @property
    def _mode_registers(self) -> tuple[tuple[int, float], ...]:
        """Return the (register, value) pairs of the mode."""
        return ((codec.CTRL_MODE, codec.MIT_MODE),)

    @property
    def guards(self) -> tuple[tuple[int, float], ...]:
        """Return the registers of the drive's own protections, as (register, value) pairs.

        They are read back again while the motor is enabled.
        """
        return ((codec.TIMEOUT, self.timeout), (codec.TMAX, self.ranges.torque))

    @property
    def cyclic(self) -> Cyclic:
        """Return the signal tables of command and answer."""
        position = codec.impedance_message(
            self.node_id, self.ranges, self.direction, self.zero, self.flags
        )
        return Cyclic((self.feedback.message,), (self.command.message,), position=position)

    def steady_status(self, state: DriveState) -> int:
        """Return the first byte of feedback from an enabled motor without error: state and node number."""
        progress = progress_of(state)
        if state.phase != ENABLED or not progress.enable_sent or progress.disabling or progress.check.waiting:
            return UNSTEADY
        return codec.ENABLED << 4 | self.node_id & 0xF

    def due_ns(self, state: DriveState) -> int:
        """Return the time of the next read-back request [ns]."""
        return progress_of(state).check.due_ns

    def initial(self) -> DriveState:
        """Return the state before the first frame."""
        return DriveState(private=MitProgress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state after one received frame, see ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        if can_id != self.reply_id or bus != self.bus:
            return state
        if len(data) != 8:
            return state._replace(misread=state.misread + 1)
        progress = progress_of(state)
        if state.phase == ENABLED and progress.check.waiting:
            reply = codec.decode_register_reply(data, self.node_id)
            if reply is not None and reply[:2] == (codec.READ, self.guards[progress.check.step][0]):
                return self._on_guard(state, progress, reply)
        # While enabled, byte 0 of feedback is 0x10 | node nibble. A node number from 0x10 to 0x1f
        # makes byte 0 of a register reply look alike: the frame then counts as feedback.
        if state.phase != ENABLED or self.node_id >> 4 != codec.ENABLED:
            reply = codec.decode_register_reply(data, self.node_id)
            if reply is not None:
                return self._on_register(state, reply, t_ns)
        # The low nibble of byte 0 is the node number: another value is a frame of another motor.
        if (data[0] ^ self.node_id) & 0xF:
            return state._replace(misread=state.misread + 1)
        return self._on_feedback(state, data, t_ns)

    def _on_register(self, state: DriveState, reply: codec.RegisterReply, t_ns: int) -> DriveState:
        """Return the state after a register reply during configuration."""
        if state.phase != CONFIGURING:
            return state
        progress = progress_of(state)
        if progress.cursor.step >= len(self.required):
            updated = reply[:2] == (codec.READ, codec.SERIAL_NUMBER)
            return _ready_state(state, progress, t_ns, int.from_bytes(reply.raw, "little")) if updated else state
        cursor, problem = registers.on_reply(progress.cursor, self.required, reply)
        if problem:
            return to_fault(state, MISMATCH, problem)
        return state._replace(private=progress._replace(cursor=cursor))

    def _on_guard(self, state: DriveState, progress: MitProgress, reply: codec.RegisterReply) -> DriveState:
        """Compare the value of a register, read again while the motor is enabled, with the required value."""
        register, value = self.guards[progress.check.step]
        same = reply.raw == codec.register_bytes(register, value)
        answer = f"reads {reply.value:g}"
        check, problem = readback.on_recheck_reply(
            progress.check, len(self.guards), same, registers.register_name(register), answer, f"{value:g}"
        )
        updated = state._replace(private=progress._replace(check=check))
        return to_fault(updated, MISMATCH, problem) if problem else updated

    def _on_feedback(self, state: DriveState, data: bytes, t_ns: int) -> DriveState:
        """Update the state with the values and the state nibble of a feedback frame."""
        nibble, position, velocity, torque, hot = codec.decode_feedback(data, self.feedback)
        if not progress_of(state).configured:
            position = velocity = torque = math.nan
        updated = state._replace(
            position=position,
            velocity=velocity,
            torque=torque,
            temperature=hot,
            feedback_t_ns=t_ns,
            feedback_count=state.feedback_count + 1,
        )
        return apply_status(updated, nibble)

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, torque: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state and the frames to send, see ``contract.Drive``."""
        progress: MitProgress = state.private
        if target == ENABLE and state.phase == ENABLED and not progress.disabling:
            command = self._command(torque)
            # The usual path of a running hand: one command, no other state change.
            if t_ns < progress.check.due_ns:
                return state, (command,)
            state, question = self._ask_guard(state, progress, t_ns)
            return state, (command, question)
        if target == LISTEN:
            return state, ()
        if target == DISABLE or state.phase == ENABLED:
            return self._disable(state, progress, t_ns), self.cut()
        if state.phase == FAULT and progress.enabled_by_other:
            return state, self.cut()
        progress = progress._replace(disabling=False)
        if (
            state.phase == READY
            and not progress.enable_sent
            and t_ns - max(state.feedback_t_ns, progress.ready_ns) > SILENCE_NS
        ):
            return state._replace(phase=SILENT, private=MitProgress()), (self._refresh(),)
        # Commands restart the watchdog of this motor, also while it is disabled.
        fed = state.error_text == FIRES_WHILE_DISABLED_TEXT
        clear = (self._frame(codec.special_command(codec.CLEAR)),) if progress.clearing else ()
        if state.phase == CONFIGURING or (state.phase == READY and not progress.configured):
            updated, requests = self._configure(state._replace(phase=CONFIGURING), progress, t_ns)
            return updated, (*(clear or self.cut()), *requests) if fed else requests
        if state.phase == READY and target == ENABLE and not (fed and progress.clearing):
            check = progress.check if progress.enable_sent else readback.first_recheck(self.node_id, t_ns)
            enabling = state._replace(private=progress._replace(enable_sent=True, check=check))
            return enabling, (self._frame(codec.special_command(codec.ENABLE)),)
        if fed and not clear:
            return state._replace(private=progress), self.cut()
        # It is not documented if the clear command has an answer, so feedback is requested as well.
        return state._replace(private=progress), (*clear, self._refresh())

    def _disable(self, state: DriveState, progress: MitProgress, t_ns: int) -> DriveState:
        """Return the state while the motor is being disabled.

        A motor that may be enabled counts as enabled until it reports state 0.
        """
        phase = ENABLED if progress.enable_sent or progress.enabled_by_other else state.phase
        since = progress.disabling_ns if progress.disabling else t_ns
        return state._replace(phase=phase, private=progress._replace(disabling=True, disabling_ns=since))

    def _ask_guard(self, state: DriveState, progress: MitProgress, t_ns: int) -> tuple[DriveState, Frame]:
        """Return the state and the request that reads a protection register of the enabled motor."""
        register, _ = self.guards[progress.check.step]
        check, problem = readback.next_recheck(progress.check, registers.register_name(register), self.node_id, t_ns)
        state = state._replace(private=progress._replace(check=check))
        if problem:
            state = to_fault(state, MISMATCH, problem)
        return state, self._broadcast(codec.register_request(self.node_id, codec.READ, register))

    def _configure(self, state: DriveState, progress: MitProgress, t_ns: int) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state and the next register request. An enabled motor is disabled first."""
        if progress.enabled_by_other:
            updated = state._replace(error_text="enabled, and does not disable", private=progress)
            return updated, self.cut()
        if progress.cursor.step >= len(self.required):
            cursor, data, unanswered = registers.next_serial_request(progress.cursor, self.node_id, t_ns)
            updated = state._replace(private=progress._replace(cursor=cursor))
            return _ready_state(updated, progress, t_ns, 0) if unanswered else updated, (
                self._broadcast(data),
            ) if data else ()
        cursor, data, problem = registers.next_request(progress.cursor, self.required, self.node_id, t_ns)
        if problem:
            return to_fault(state._replace(private=progress), MISMATCH, problem), ()
        text = FIRES_WHILE_DISABLED_TEXT if state.error_text == FIRES_WHILE_DISABLED_TEXT else ""
        updated = state._replace(error_text=text, private=progress._replace(cursor=cursor))
        return updated, (self._broadcast(data),) if data else ()

    def _torque(self, torque: float) -> bytes:
        """Return the payload of a command that contains a torque only.

        Args:
            torque: command [N m at the spool].

        Raises:
            ValueError: torque is not finite, or beyond TMAX.
        """
        try:
            return self.command.pack(torque)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return the frame of a torque command [N m at the spool]. It does not enable the motor."""
        return (self._command(torque),)

    def _command(self, torque: float) -> Frame:
        """Return the torque command [N m at the spool]."""
        return self._frame(self._torque(torque))

    def cut(self) -> tuple[Frame, ...]:
        """Return the frame of the disable command."""
        return (self._frame(codec.special_command(codec.DISABLE)),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state that clears the latched error and repeats the register read-back."""
        fresh = state._replace(phase=SILENT, error=0, error_text="", private=MitProgress(clearing=CLEAR_TRIES))
        return fresh, (self._frame(codec.special_command(codec.CLEAR)),)

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return no frame. A disabled motor has no active watchdog, so its release needs no frame."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Return the serial number from register 15, or the node number if it is unknown."""
        return f"{serial:#x}" if (serial := progress_of(state).serial) else f"node {self.node_id}"

    def cause(self, error: int) -> Cause:
        """Return the cause of an error code, see ``contract.Drive``."""
        return CAUSES.get(error, Cause.UNKNOWN)

    def _frame(self, data: bytes) -> Frame:
        """Return a frame to the motor with this payload."""
        return Frame(self.node_id, data, self.flags, self.bus)

    def _broadcast(self, data: bytes) -> Frame:
        """Return a register frame with this payload."""
        return Frame(codec.BROADCAST_ID, data, self.flags, self.bus)

    def _refresh(self) -> Frame:
        """Return the frame that requests feedback."""
        return self._broadcast(codec.register_request(self.node_id, codec.REFRESH))


def _ready_state(state: DriveState, progress: MitProgress, t_ns: int, serial: int) -> DriveState:
    """Return the state in phase READY, after all registers were verified.

    Serial number 0 means unknown.
    """
    ready = progress._replace(cursor=Cursor(), configured=True, ready_ns=t_ns, serial=serial)
    return state._replace(phase=READY, private=ready)
