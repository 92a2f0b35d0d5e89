"""CiA 402 drive in cyclic synchronous torque mode over CANopen: from silence to torque, and back.

In each tick the host sends one RPDO (control word, target torque), and the drive sends one TPDO
(status word, position, torque). The drive sends the TPDO at SYNC. The SYNC of the sensor node has
the identifier 0x080 too, and also requests the TPDO. On a bus without a sensor node, the option
``sync`` of one drive makes handctl send SYNC. This host's heartbeat is the drive's watchdog. Only a
status word proves that the drive is enabled or disabled.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from handctl.drives import readback
from handctl.drives.causes import Cause
from handctl.drives.cia402 import codec
from handctl.drives.cia402 import settings as setup
from handctl.drives.cia402.progress import (
    CAUSES,
    CLEAR_TRIES,
    MISMATCH,
    REPEAT_NS,
    Cia402Progress,
    apply_power_state,
    on_heartbeat,
    progress_of,
    state_after_timeout,
    to_fault,
)
from handctl.drives.contract import UNSTEADY, DriveState, DriveTarget, Phase
from handctl.drives.frame import Frame
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import checked_boolean, checked_positive, checked_whole_number, refuse_unknown_options
from handctl.drives.signals import Cyclic, Message, Table
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = DriveTarget
SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase

MAX_MISSED_HEARTBEATS = 3.5
"""Heartbeat periods without a sign of life before the drive counts as lost."""
TORQUE_UNITS = {"uN_m": 1e6, "mN_m": 1e3}
"""Counts of object 0x6076 per newton metre. Makers differ: uN m on EPOS4, mN m in the standard."""


@dataclass(frozen=True, slots=True)
class Cia402Drive:
    """Motor on a CiA 402 drive. Implements ``contract.Drive``.

    Attributes:
        name: name of the motor.
        bus: index of the bus.
        node_id: 1 to 0x7e.
        torque_limit: largest torque command [N m at the spool].
        ratio: turns of the motor's shaft per turn of the spool, negative if positive torque of the
            motor unwinds.
        zero: angle at the shaft of the spool's zero [rad].
        rated: rated torque at the shaft [N m].
        counts: position counts per turn of the shaft.
        steps: objects with the values required before arming.
        sync: True if the host sends SYNC after the command of this drive.
        heartbeat_period_ns: period of this host's heartbeat [ns].
        life_sign_timeout_ns: longest time without a sign of life [ns].
        command: signal table of the command, from the fields above.
        feedback: signal table of the feedback, from the fields above.
    """

    name: str
    bus: int
    node_id: int
    torque_limit: float
    ratio: float
    zero: float
    rated: float
    counts: int
    steps: tuple[setup.Step, ...]
    sync: bool
    heartbeat_period_ns: int
    life_sign_timeout_ns: int
    command: Table = field(init=False, repr=False, compare=False)
    feedback: Table = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        sent = codec.command_message(self.node_id, self.ratio, self.rated, self.torque_limit)
        feedback = codec.feedback_message(self.node_id, self.counts, self.ratio, self.rated, self.zero)
        object.__setattr__(self, "command", Table(sent))
        object.__setattr__(self, "feedback", Table(feedback))

    @staticmethod
    def of(
        motor: MotorDescription, bus: int, given: Mapping[str, Any] | None = None, mode: int = setup.TORQUE_MODE
    ) -> "Cia402Drive":
        """Return the drive of a motor description.

        Args:
            motor: description of the motor.
            bus: index of the bus.
            given: options instead of those of the description.
            mode: mode of operation.

        Raises:
            ConfigError: an option unknown to CiA 402, the node number of this host, or too large a
                torque.
        """
        options = dict(motor.options if given is None else given)
        where = f"motor[{motor.name}].options"
        if not 0 < motor.node_id < setup.HOST_NODE:
            raise ConfigError(str(motor.node_id), f"motor[{motor.name}].node_id", f"1 to {setup.HOST_NODE - 1}")
        ratio = checked_positive(options.pop("gear_ratio", 1.0), f"{where}.gear_ratio", 1000)
        rated = checked_positive(options.pop("rated_torque_N_m", None), f"{where}.rated_torque_N_m", 1000)
        counts = checked_whole_number(options.pop("counts_per_turn", None), f"{where}.counts_per_turn", 1 << 24)
        heartbeat = checked_whole_number(options.pop("heartbeat_ms", 50), f"{where}.heartbeat_ms", 1000)
        unit = options.pop("rated_torque_unit", "mN_m")
        sync = checked_boolean(options.pop("sync", False), f"{where}.sync")
        if unit not in TORQUE_UNITS:
            raise ConfigError(repr(unit), f"{where}.rated_torque_unit", " or ".join(TORQUE_UNITS))
        right = "rated_torque_N_m, rated_torque_unit, counts_per_turn, gear_ratio, heartbeat_ms or sync"
        refuse_unknown_options(options, where, right)
        max_torque = math.ceil(motor.torque_max_N_m / ratio / rated * 1000)
        if max_torque > codec.MAX_TORQUE_COUNT:
            raise ConfigError(f"{motor.torque_max_N_m:g}", f"motor[{motor.name}].torque_max_N_m", "32 x rated at most")
        if round(rated * TORQUE_UNITS[unit]) < 1:
            raise ConfigError(f"{rated:g}", f"{where}.rated_torque_N_m", f"at least one {unit}")
        watchdog = round(motor.watchdog_ms)
        return Cia402Drive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            torque_limit=motor.torque_max_N_m,
            ratio=motor.direction * ratio,
            zero=motor.zero_rad,
            rated=rated,
            counts=counts,
            steps=setup.required_steps(
                motor.node_id, round(rated * TORQUE_UNITS[unit]), max_torque, watchdog, heartbeat, mode
            ),
            sync=sync,
            # Three heartbeats are sent per watchdog time, so two may be lost.
            heartbeat_period_ns=watchdog * 1_000_000 // 3,
            life_sign_timeout_ns=round(heartbeat * MAX_MISSED_HEARTBEATS * 1e6),
        )

    @property
    def exchange(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of a tick: RPDO, TPDO, and SYNC with the option ``sync``."""
        return ((4, False), (8, False), *(((0, False),) if self.sync else ()))

    @property
    def background(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the periodic frames: both heartbeats, and the SDO transfers of the repeated read-back."""
        beats = (
            (1, False, MAX_MISSED_HEARTBEATS * 1e9 / self.life_sign_timeout_ns),
            (1, False, 1e9 / self.heartbeat_period_ns),
        )
        return (*beats, *((8, False, readback.RECHECKS_PER_SECOND),) * 2)

    @property
    def extended(self) -> bool:
        """Return False, because all identifiers have 11 bits."""
        return False

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of NMT, RPDO, SDO requests, and the host's heartbeat."""
        return frozenset((codec.NMT, codec.RPDO + self.node_id, codec.SDO_REQUEST + self.node_id, _HOST_HEARTBEAT))

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of TPDO, SDO replies, emergency, and the drive's heartbeat."""
        bases = (codec.TPDO, codec.SDO_REPLY, codec.EMERGENCY, codec.HEARTBEAT)
        return frozenset(base + self.node_id for base in bases)

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return an empty tuple, because every setting is read back."""
        return ()

    @property
    def one_reply_per_command(self) -> bool:
        """Return True, because the drive sends one TPDO per SYNC."""
        return True

    @property
    def position_step(self) -> float:
        """Return one encoder count [rad at the spool]."""
        return math.tau / (self.counts * abs(self.ratio))

    @property
    def feedback_period_s(self) -> float:
        """Return 0, because SYNC requests feedback in every tick."""
        return 0.0

    @property
    def cyclic(self) -> Cyclic:
        """Return the signal tables of RPDO and TPDO, and SYNC with the option ``sync``."""
        sync = (Message("sync", codec.SYNC, 0, answers=False),) if self.sync else ()
        return Cyclic((self.feedback.message,), (self.command.message, *sync), self.life_sign_timeout_ns)

    def steady_status(self, state: DriveState) -> int:
        """Return the feedback status of a drive that this host has enabled, else UNSTEADY."""
        progress = progress_of(state)
        steady = state.phase == ENABLED and progress.enable_sent and progress.disabling_ns < 0
        return codec.ENABLED_STATUS if steady else UNSTEADY

    def due_ns(self, state: DriveState) -> int:
        """Return the time at which this host must send its heartbeat or read an object back [ns]."""
        progress = progress_of(state)
        return min(progress.check.due_ns, progress.heartbeat_sent_ns + self.heartbeat_period_ns)

    @property
    def guards(self) -> tuple[setup.Step, ...]:
        """Return the objects that are read back again while the drive is enabled."""
        return tuple(step for step in self.steps if (step.number, step.sub) in setup.PROTECTION_OBJECTS)

    def initial(self) -> DriveState:
        """Return the state before the first frame."""
        return DriveState(private=Cia402Progress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state after one received frame, see ``contract.Drive``."""
        if frame.bus != self.bus or frame.can_id not in self.node_ids:
            return state
        service = frame.can_id - self.node_id
        if len(frame.data) != (1 if service == codec.HEARTBEAT else 8):
            return state._replace(misread=state.misread + 1)
        if service == codec.TPDO:
            return self._on_feedback(state, frame)
        if service == codec.HEARTBEAT:
            return on_heartbeat(state, frame)
        if service == codec.SDO_REPLY:
            return self._on_object(state, frame.data)
        # The remaining service is the emergency. Code 0 reports the end of all errors.
        code = int.from_bytes(frame.data[:2], "little")
        return state._replace(private=progress_of(state)._replace(code=code)) if code else state

    def _on_object(self, state: DriveState, data: bytes) -> DriveState:
        """Update the state with an SDO reply."""
        progress = progress_of(state)
        reply = codec.decode_sdo_reply(data)
        if reply is not None and state.phase == ENABLED and progress.check.waiting:
            return self._on_recheck_reply(state, progress, reply)
        if reply is None or progress.cursor.step >= len(self.steps) or state.phase not in (SILENT, CONFIGURING):
            return state
        cursor, serial, problem = setup.on_reply(progress.cursor, self.steps, reply)
        progress = progress._replace(cursor=cursor, serial=serial or progress.serial)
        updated = state._replace(phase=CONFIGURING, private=progress)
        return to_fault(updated, MISMATCH, problem) if problem else updated

    def _on_recheck_reply(self, state: DriveState, progress: Cia402Progress, reply: codec.SdoReply) -> DriveState:
        """Compare the value of an object, read again while the drive is enabled, with the required value."""
        step = self.guards[progress.check.step]
        if reply[:2] != (step.number, step.sub) or not (reply.raw or reply.abort):
            return state
        value = int.from_bytes(reply.raw, "little")
        same = reply.raw == step.raw
        answer = f"answers {codec.abort_text(reply.abort)!r}" if reply.abort else f"reads {value:#x}"
        check, problem = readback.on_recheck_reply(
            progress.check, len(self.guards), same, step.name, answer, f"{step.value:#x}"
        )
        updated = state._replace(private=progress._replace(check=check))
        return to_fault(updated, MISMATCH, problem) if problem else updated

    def _on_feedback(self, state: DriveState, frame: Frame) -> DriveState:
        """Update the state with a TPDO: values and power state.

        Before the read-back is complete, the mapping of the TPDO is unknown and its values are not
        used.
        """
        progress = progress_of(state)
        if progress.cursor.step < len(self.steps):
            return state
        _, _, position, torque = self.feedback.unpack(frame.data)
        updated = state._replace(
            position=position,
            torque=torque,
            feedback_t_ns=frame.t_ns,
            feedback_count=state.feedback_count + 1,
        )
        power = codec.power_state(int.from_bytes(frame.data[:2], "little"))
        return apply_power_state(updated, progress._replace(power=power or "unknown", life_sign_ns=frame.t_ns))

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, torque: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state and the frames to send, see ``contract.Drive``."""
        if target == LISTEN:
            return state, ()
        # A status word is a sign of life as well. Compiled code may have received the latest one.
        if 0 <= max(progress_of(state).life_sign_ns, state.feedback_t_ns) < t_ns - self.life_sign_timeout_ns:
            state = state_after_timeout(state)
        state, frames = self._command(state, t_ns, target, torque)
        progress = progress_of(state)
        if t_ns - progress.heartbeat_sent_ns >= self.heartbeat_period_ns:
            frames = (*frames, Frame(_HOST_HEARTBEAT, bytes((codec.OPERATIONAL,)), 0, self.bus))
            state = state._replace(private=progress._replace(heartbeat_sent_ns=t_ns))
        return state, (*frames, Frame(codec.SYNC, b"", 0, self.bus)) if self.sync else frames

    def _command(
        self, state: DriveState, t_ns: int, target: DriveTarget, torque: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state and the frames for the requested drive state, except heartbeat and SYNC."""
        progress = progress_of(state)
        if target == DISABLE or (state.phase == ENABLED and (target != ENABLE or progress.disabling_ns >= 0)):
            return self._disable(state, progress, t_ns)
        if state.phase == ENABLED:
            state, recheck = self._next_recheck(state, progress, t_ns)
            return state, (self._rpdo(codec.ENABLE_OPERATION, torque), *recheck)
        if state.phase == FAULT:
            return state, self.cut() if progress.may_be_enabled else ()
        progress = progress._replace(disabling_ns=-1)
        if progress.cursor.step < len(self.steps):
            return self._configure(state, progress, t_ns)
        if state.phase != READY:
            return self._start(state, progress, t_ns)
        if target == ENABLE:
            control_word = codec.NEXT_COMMAND.get(progress.power, codec.DISABLE_VOLTAGE)
            check = progress.check if progress.enable_sent else readback.first_recheck(self.node_id, t_ns)
            return state._replace(private=progress._replace(enable_sent=True, check=check)), (
                self._rpdo(control_word, self._rest(state)),
            )
        return state._replace(private=progress), ()

    def _next_recheck(
        self, state: DriveState, progress: Cia402Progress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next read-back request for an enabled drive, if its time has come."""
        if t_ns < progress.check.due_ns:
            return state, ()
        step = self.guards[progress.check.step]
        check, problem = readback.next_recheck(progress.check, step.name, self.node_id, t_ns)
        state = state._replace(private=progress._replace(check=check))
        if problem:
            state = to_fault(state, MISMATCH, problem)
        return state, (
            Frame(codec.SDO_REQUEST + self.node_id, codec.upload_request(step.number, step.sub), 0, self.bus),
        )

    def _disable(self, state: DriveState, progress: Cia402Progress, t_ns: int) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state and the frames that disable the drive.

        A drive that may be enabled counts as enabled until a status word reports disabled.

        Status words need the NMT state operational: NMT start is repeated without feedback.
        """
        phase = ENABLED if progress.may_be_enabled else state.phase
        since = progress.disabling_ns if progress.disabling_ns >= 0 else t_ns
        progress = progress._replace(disabling_ns=since)
        start: tuple[Frame, ...] = ()
        if t_ns - max(state.feedback_t_ns, progress.started_ns) > REPEAT_NS:
            progress = progress._replace(started_ns=t_ns)
            start = (self._nmt(codec.START),)
        return state._replace(phase=phase, private=progress), (*start, self._rpdo(codec.DISABLE_VOLTAGE, 0.0))

    def _configure(
        self, state: DriveState, progress: Cia402Progress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state and the next SDO request.

        Before the first request the node is set to pre-operational.
        """
        cursor, data, problem = setup.next_request(progress.cursor, self.steps, t_ns)
        updated = state._replace(private=progress._replace(cursor=cursor))
        if problem:
            return to_fault(updated, MISMATCH, problem), ()
        frames = (Frame(codec.SDO_REQUEST + self.node_id, data, 0, self.bus),) if data else ()
        return updated, (self._nmt(codec.PRE_OPERATIONAL), *frames) if cursor.step == 0 and data else frames

    def _start(self, state: DriveState, progress: Cia402Progress, t_ns: int) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state and the frames that make the node operational, until a status word arrives.

        A fault cleared by the operator is reset by the rising edge of a control bit.
        """
        if progress.clearing and progress.power == codec.FAULT:
            # The control word alternates, because only the rising edge of bit 7 resets a fault.
            control_word = codec.FAULT_RESET if progress.clearing % 2 else codec.DISABLE_VOLTAGE
            return state._replace(private=progress), (self._rpdo(control_word, 0.0),)
        if t_ns - progress.started_ns < REPEAT_NS:
            return state._replace(private=progress), ()
        question = "does a node send SYNC (0x080) on its bus, and does the drive accept SYNC with a counter?"
        text = f"no TPDO yet: {question}" if progress.started_ns >= 0 else ""
        updated = progress._replace(started_ns=t_ns)
        return state._replace(error_text=text, private=updated), (self._nmt(codec.START),)

    def _rpdo(self, control: int, torque: float) -> Frame:
        """Return the RPDO1 frame with a control word and a torque [N m at the spool]."""
        try:
            data = struct.pack("<H", control) + self.command.pack(torque)[2:]
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
        return Frame(codec.RPDO + self.node_id, data, 0, self.bus)

    def _rest(self, state: DriveState) -> float:
        """Return the command of a drive that is being enabled: no torque."""
        return 0.0

    def _nmt(self, order: int) -> Frame:
        """Return the frame of an NMT command to the node."""
        return Frame(codec.NMT, bytes((order, self.node_id)), 0, self.bus)

    def identity(self, state: DriveState) -> str:
        """Return the serial number from object 0x1018:4, or the node number if the drive lacks this object."""
        return f"{serial:#x}" if (serial := progress_of(state).serial) else f"node {self.node_id}"

    def cause(self, error: int) -> Cause:
        """Return the cause of an error code, see ``contract.Drive``."""
        return CAUSES.get(error, Cause.OTHER if error in codec.ERRORS else Cause.UNKNOWN)

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return an RPDO with a target torque [N m at the spool] that leaves the power stage off."""
        return (self._rpdo(codec.DISABLE_VOLTAGE, torque),)

    def cut(self) -> tuple[Frame, ...]:
        """Return the frames that remove the torque: DISABLE_VOLTAGE, then NMT pre-operational.

        Pre-operational makes the drive fault through object 0x6007.

        The order matters. A node outside operational reads no PDO, and CiA 402-2 does not require
        the loss of torque on entry to pre-operational.
        """
        return (self._rpdo(codec.DISABLE_VOLTAGE, 0.0), self._nmt(codec.PRE_OPERATIONAL))

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return the SDO request that ends the supervision of the host's heartbeat.

        Without this request the drive would latch a fault when the host is silent after a run.
        """
        if state.phase != READY:
            return ()
        data = codec.download_request(*setup.END_OF_SUPERVISION)
        return (Frame(codec.SDO_REQUEST + self.node_id, data, 0, self.bus),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state that repeats the read-back of all objects and then resets the fault."""
        power = progress_of(state).power
        fresh = Cia402Progress(power="" if power == codec.FAULT else power, clearing=CLEAR_TRIES)
        updated = state._replace(phase=SILENT, error=0, error_text="", private=fresh)
        return updated, (self._rpdo(codec.DISABLE_VOLTAGE, 0.0), self._rpdo(codec.FAULT_RESET, 0.0))


_HOST_HEARTBEAT = codec.HEARTBEAT + setup.HOST_NODE
"""Identifier of this host's heartbeat."""
