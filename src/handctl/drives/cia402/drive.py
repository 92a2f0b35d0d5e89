"""State machine of a CiA 402 drive in cyclic synchronous torque mode.

The state machine configures, enables and disables a CiA 402 drive. In each tick the host sends one
RPDO (control word, target torque), and the drive sends one TPDO (status word, position, torque).
The drive sends the TPDO at SYNC, a frame with the identifier 0x080. If a sensor node on the bus
also measures at SYNC 0x080, one SYNC requests the frames of the sensor node and the TPDO of the
drive. On any other bus, the host sends SYNC after the command to the drive with the option
``sync``. If no drive on such a bus has the option ``sync``, handctl sets the option for the last
CiA 402 drive on the bus (``controller.run_setup``). The watchdog of the drive supervises the
heartbeat of this host. Only a status word proves that the drive is enabled or disabled.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from handctl.drives import readback
from handctl.drives.canopen import codec as canopen
from handctl.drives.canopen import setup
from handctl.drives.canopen.setup import REPEAT_PERIOD_NS
from handctl.drives.cia402 import codec, settings
from handctl.drives.cia402.progress import (
    CAUSE_BY_ERROR,
    IGNORED_FAULT_COUNT,
    SETTING_MISMATCH_ERROR,
    Cia402Progress,
    apply_power_state,
    get_progress,
    on_heartbeat,
    state_after_timeout,
)
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
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import (
    MotorOption,
    checked_boolean,
    checked_positive,
    checked_whole_number,
    refuse_unknown_options,
)
from handctl.drives.readback import SettingRecheck
from handctl.drives.signals import CyclicMessage, CyclicMessages, SignalTable
from handctl.drives.state_machine import (
    enter_fault,
    request_recheck,
    start_enabling,
    state_after_recheck_reply,
)
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = DriveTarget
SILENT, CONFIGURING, READY, ENABLED, FAULT = DrivePhase

MAX_MISSED_HEARTBEATS = 3.5
"""Number of heartbeat periods after which a drive without a sign of life counts as lost."""
TORQUE_UNITS = {"uN_m": 1e6, "mN_m": 1e3}
"""Number of counts of object 0x6076 per newton metre. An EPOS4 drive uses uN m. The standard CiA 402 uses mN m."""
OPTIONS = {
    "rated_torque_N_m": MotorOption(
        "a number above 0, at most 1000",
        "Rated torque of the motor, object 0x6076 [N m].",
        is_required=True,
    ),
    "rated_torque_unit": MotorOption(
        '"mN_m" (default) or "uN_m"', "Unit of object 0x6076. EPOS4 uses uN m."
    ),
    "counts_per_turn": MotorOption(
        f"a whole number from 1 to {1 << 24}",
        "Counts of the encoder per turn, object 0x608F.",
        is_required=True,
    ),
    "gear_ratio": MotorOption(
        "above 0, at most 1000 (default: 1)", "Turns of the motor per turn of the spool."
    ),
    "heartbeat_ms": MotorOption(
        "a whole number from 1 to 1000 (default: 50)", "Period of the heartbeat of the drive."
    ),
    "sync": MotorOption(
        "true or false (default)",
        "True if handctl sends the SYNC frame of the bus after the command to this drive.",
    ),
}
"""Options of a CiA 402 drive in the hand file."""


@dataclass(frozen=True, slots=True)
class Cia402Drive:
    """Motor on a CiA 402 drive, with the interface ``contract.Drive``.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus of the drive.
        node_id: node number, from 1 to 0x7e.
        command_limit: largest torque command [N m at the spool].
        ratio: turns of the motor's shaft per turn of the spool, negative if positive torque of the
            motor unwinds the tendon.
        zero: angle of the shaft when the spool angle is zero [rad].
        rated_torque: rated torque of the drive at the shaft [N m].
        counts: position counts per turn of the shaft.
        setup_steps: objects of the drive, with the values that the objects must have before arming.
        sync: True if the host sends SYNC after the command of this drive.
        sends_heartbeat: True if the host sends its heartbeat after the command of this drive. All
            drives on a bus receive the same heartbeat, so the host sends it with one drive only.
        heartbeat_period_ns: period of this host's heartbeat [ns].
        life_sign_timeout_ns: time without a sign of life after which the drive counts as lost [ns].
        command: signal table of RPDO1, built from the other attributes.
        feedback: signal table of TPDO1, built from the other attributes.
    """

    name: str
    bus: int
    node_id: int
    command_limit: float
    ratio: float
    zero: float
    rated_torque: float
    counts: int
    setup_steps: tuple[setup.SetupStep, ...]
    sync: bool
    sends_heartbeat: bool
    heartbeat_period_ns: int
    life_sign_timeout_ns: int
    command: SignalTable = field(init=False, repr=False, compare=False)
    feedback: SignalTable = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the signal tables of the drive's cyclic frames."""
        sent_message = codec.command_message(
            self.node_id, self.ratio, self.rated_torque, self.command_limit
        )
        feedback = codec.feedback_message(
            self.node_id, self.counts, self.ratio, self.rated_torque, self.zero
        )
        object.__setattr__(self, "command", SignalTable(sent_message))
        object.__setattr__(self, "feedback", SignalTable(feedback))

    @staticmethod
    def from_motor(
        motor: MotorDescription,
        bus: int,
        options_override: Mapping[str, Any] | None = None,
        mode: int = settings.TORQUE_MODE,
    ) -> "Cia402Drive":
        """Return the drive for a motor description.

        Args:
            motor: description of the motor.
            bus: index of the bus of the drive.
            options_override: options to use instead of the options in the description.
            mode: mode of operation of the drive, see ``settings``.

        Raises:
            ConfigError: an option is unknown or wrong, the node number is out of range, or the
                torque limit is too large.
        """
        options = dict(motor.options if options_override is None else options_override)
        location = f"motor[{motor.name}].options"
        if not 0 < motor.node_id < setup.HOST_NODE:
            raise ConfigError(
                str(motor.node_id), f"motor[{motor.name}].node_id", f"1 to {setup.HOST_NODE - 1}"
            )
        ratio = checked_positive(options.pop("gear_ratio", 1.0), f"{location}.gear_ratio", 1000)
        rated = checked_positive(
            options.pop("rated_torque_N_m", None), f"{location}.rated_torque_N_m", 1000
        )
        counts = checked_whole_number(
            options.pop("counts_per_turn", None), f"{location}.counts_per_turn", 1 << 24
        )
        heartbeat = checked_whole_number(
            options.pop("heartbeat_ms", 50), f"{location}.heartbeat_ms", 1000
        )
        unit = options.pop("rated_torque_unit", "mN_m")
        sync = checked_boolean(options.pop("sync", False), f"{location}.sync")
        if unit not in TORQUE_UNITS:
            raise ConfigError(
                repr(unit), f"{location}.rated_torque_unit", " or ".join(TORQUE_UNITS)
            )
        refuse_unknown_options(options, location, OPTIONS)
        max_torque = math.ceil(motor.torque_max_N_m / ratio / rated * 1000)
        if max_torque > codec.MAX_TORQUE_COUNT:
            raise ConfigError(
                f"{motor.torque_max_N_m:g}",
                f"motor[{motor.name}].torque_max_N_m",
                "32 x rated at most",
            )
        if round(rated * TORQUE_UNITS[unit]) < 1:
            raise ConfigError(f"{rated:g}", f"{location}.rated_torque_N_m", f"at least one {unit}")
        watchdog = round(motor.watchdog_ms)
        return Cia402Drive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            command_limit=motor.torque_max_N_m,
            ratio=motor.direction * ratio,
            zero=motor.zero_rad,
            rated_torque=rated,
            counts=counts,
            setup_steps=settings.required_steps(
                motor.node_id,
                round(rated * TORQUE_UNITS[unit]),
                max_torque,
                watchdog,
                heartbeat,
                mode,
            ),
            sync=sync,
            sends_heartbeat=True,
            # The host sends three heartbeats per timeout of the drive's watchdog. The bus can thus
            # lose two of the three heartbeats.
            heartbeat_period_ns=watchdog * 1_000_000 // 3,
            life_sign_timeout_ns=round(heartbeat * MAX_MISSED_HEARTBEATS * 1e6),
        )

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the drive in a tick: RPDO, TPDO, and SYNC if the option ``sync`` is set."""
        return ((4, False), (8, False), *(((0, False),) if self.sync else ()))

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the drive's frames whose rate is not the control rate: heartbeats, SDO requests and SDO replies."""
        heartbeats = [(1, False, MAX_MISSED_HEARTBEATS * 1e9 / self.life_sign_timeout_ns)]
        if self.sends_heartbeat:
            heartbeats.append((1, False, 1e9 / self.heartbeat_period_ns))
        return (*heartbeats, *((8, False, readback.RECHECKS_PER_SECOND),) * 2)

    @property
    def has_extended_ids(self) -> bool:
        """Return False, because all identifiers of the protocol have 11 bits."""
        return False

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of the frames that the host sends: NMT, RPDO, SDO requests, and heartbeat."""
        return frozenset(
            (
                canopen.NMT,
                canopen.RPDO + self.node_id,
                canopen.SDO_REQUEST + self.node_id,
                _HOST_HEARTBEAT,
            )
        )

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of the frames that the drive sends: TPDO, SDO replies, emergency, and heartbeat."""
        base_ids = (canopen.TPDO, canopen.SDO_REPLY, canopen.EMERGENCY, canopen.HEARTBEAT)
        return frozenset(base + self.node_id for base in base_ids)

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
        """Return True, because the drive sends one TPDO for each SYNC."""
        return True

    @property
    def position_step(self) -> float:
        """Return the angle of the spool per encoder count [rad]."""
        return math.tau / (self.counts * abs(self.ratio))

    @property
    def feedback_period_s(self) -> float:
        """Return 0 (no unrequested feedback), because SYNC requests feedback in every tick."""
        return 0.0

    @property
    def cyclic_messages(self) -> CyclicMessages:
        """Return the signal tables of RPDO and TPDO, and of SYNC if the option ``sync`` is set."""
        sync = (CyclicMessage("sync", canopen.SYNC, 0, is_reply=False),) if self.sync else ()
        return CyclicMessages(
            (self.feedback.message,), (self.command.message, *sync), self.life_sign_timeout_ns
        )

    def steady_status(self, state: DriveState) -> int:
        """Return the status word of an enabled drive, or NO_STEADY_STATUS if this host has not enabled the drive."""
        progress = get_progress(state)
        is_steady = (
            state.phase == ENABLED and progress.is_enable_sent and progress.disable_command_ns < 0
        )
        return codec.ENABLED_STATUS if is_steady else NO_STEADY_STATUS

    def due_ns(self, state: DriveState) -> int:
        """Return the time at which this host must send its next heartbeat [ns]."""
        if not self.sends_heartbeat:
            return MAX_TIME_NS
        return get_progress(state).heartbeat_sent_ns + self.heartbeat_period_ns

    @property
    def rechecked_settings(self) -> tuple[setup.SetupStep, ...]:
        """Return the objects that the host reads again while the drive is enabled."""
        return tuple(
            step
            for step in self.setup_steps
            if (step.number, step.sub_index) in settings.PROTECTION_OBJECTS
        )

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return request and reply for each object that the host reads again, see ``contract.Drive``."""
        return tuple(
            SettingRecheck(
                step.name,
                self._sdo_frame(canopen.upload_request(step.number, step.sub_index)),
                Frame(
                    canopen.SDO_REPLY + self.node_id,
                    canopen.upload_reply(step.number, step.sub_index, step.raw),
                    0,
                    self.bus,
                ),
                key_byte_range=(1, 4),
                compared_byte_range=(0, 4 + len(step.raw)),
            )
            for step in self.rechecked_settings
        )

    def initial_state(self) -> DriveState:
        """Return the state of the drive before the first frame."""
        return DriveState(protocol_state=Cia402Progress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        if frame.bus != self.bus or frame.can_id not in self.node_ids:
            return state
        function_code = frame.can_id - self.node_id
        if len(frame.data) != (1 if function_code == canopen.HEARTBEAT else 8):
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        if function_code == canopen.TPDO:
            return self._on_feedback(state, frame)
        if function_code == canopen.HEARTBEAT:
            return on_heartbeat(state, frame)
        if function_code == canopen.SDO_REPLY:
            return self._on_sdo_reply(state, frame.data)
        # All other frames of the drive have been handled above, so the frame is an emergency. Error
        # code 0 of an emergency reports that all errors have ended.
        code = int.from_bytes(frame.data[:2], "little")
        return (
            state._replace(protocol_state=get_progress(state)._replace(error_code=code))
            if code
            else state
        )

    def _on_sdo_reply(self, state: DriveState, payload: bytes) -> DriveState:
        """Return the drive state after an SDO reply of the drive."""
        progress = get_progress(state)
        reply = canopen.decode_sdo_reply(payload)
        if reply is not None and state.phase == ENABLED and state.recheck.is_waiting:
            return self._on_recheck_reply(state, reply)
        if (
            reply is None
            or progress.cursor.step >= len(self.setup_steps)
            or state.phase not in (SILENT, CONFIGURING)
        ):
            return state
        cursor, serial, problem = setup.on_reply(progress.cursor, self.setup_steps, reply)
        progress = progress._replace(cursor=cursor, serial=serial or progress.serial)
        next_state = state._replace(phase=CONFIGURING, protocol_state=progress)
        return enter_fault(next_state, SETTING_MISMATCH_ERROR, problem) if problem else next_state

    def _on_recheck_reply(self, state: DriveState, reply: canopen.SdoReply) -> DriveState:
        """Check an object of the enabled drive after the host has read the object again."""
        step = self.rechecked_settings[state.recheck.step]
        if reply[:2] != (step.number, step.sub_index) or not (reply.raw or reply.abort):
            return state
        value = int.from_bytes(reply.raw, "little")
        is_equal = reply.raw == step.raw
        answer = (
            f"answers {canopen.abort_text(reply.abort)!r}" if reply.abort else f"reads {value:#x}"
        )
        return state_after_recheck_reply(
            state,
            SETTING_MISMATCH_ERROR,
            len(self.rechecked_settings),
            is_equal,
            step.name,
            answer,
            f"{step.value:#x}",
        )

    def _on_feedback(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a TPDO.

        The returned state contains the received values and the effect of the received power state.
        Until the read-back of all objects is complete, the mapping of the TPDO is unknown, and the
        values of the TPDO are not used.
        """
        progress = get_progress(state)
        if progress.cursor.step < len(self.setup_steps):
            return state
        _, _, position, torque = self.feedback.unpack(frame.data)
        next_state = state.with_feedback(
            position, state.velocity, torque, state.temperature, frame.t_ns
        )
        power_state = codec.power_state(int.from_bytes(frame.data[:2], "little"))
        return apply_power_state(
            next_state,
            progress._replace(power_state=power_state or "unknown", life_sign_ns=frame.t_ns),
        )

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``."""
        if target == LISTEN:
            return state, ()
        # A status word also shows that the drive is alive. Compiled code, and not ``receive``, may
        # have processed the latest status word.
        if (
            0
            <= max(get_progress(state).life_sign_ns, state.feedback_t_ns)
            < t_ns - self.life_sign_timeout_ns
        ):
            state = state_after_timeout(state)
        state, frames = self._advance_to_target(state, t_ns, target, command)
        progress = get_progress(state)
        if self.sends_heartbeat and t_ns - progress.heartbeat_sent_ns >= self.heartbeat_period_ns:
            frames = (*frames, Frame(_HOST_HEARTBEAT, bytes((canopen.OPERATIONAL,)), 0, self.bus))
            state = state._replace(protocol_state=progress._replace(heartbeat_sent_ns=t_ns))
        return state, (*frames, Frame(canopen.SYNC, b"", 0, self.bus)) if self.sync else frames

    def _advance_to_target(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the frames for the requested drive state.

        The caller adds the frames heartbeat and SYNC.
        """
        progress = get_progress(state)
        if target == DISABLE or (
            state.phase == ENABLED and (target != ENABLE or progress.disable_command_ns >= 0)
        ):
            return self._disable(state, progress, t_ns)
        if state.phase == ENABLED:
            state, recheck = request_recheck(state, self, SETTING_MISMATCH_ERROR, t_ns)
            return state, (self._rpdo_frame(codec.ENABLE_OPERATION, command), *recheck)
        if state.phase == FAULT:
            return state, self.torque_cut_frames() if progress.may_be_enabled else ()
        if progress.disable_command_ns >= 0:
            progress = progress._replace(disable_command_ns=-1)
            state = state._replace(protocol_state=progress)
        if progress.cursor.step < len(self.setup_steps):
            return self._configure(state, progress, t_ns)
        if state.phase != READY:
            return self._start_node(state, progress, t_ns)
        if target == ENABLE:
            control_word = codec.NEXT_CONTROLWORD.get(progress.power_state, codec.DISABLE_VOLTAGE)
            enabling_state = start_enabling(state, self.node_id, t_ns)
            return enabling_state, (self._rpdo_frame(control_word, self._command_at_rest(state)),)
        return state, ()

    def _disable(
        self, state: DriveState, progress: Cia402Progress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the frames that disable the drive.

        If the drive may be enabled (``Cia402Progress.may_be_enabled``), the drive counts as enabled
        until a status word reports that the drive is disabled.

        The drive sends status words only in the NMT state operational. The host repeats the NMT
        start while no feedback arrives.
        """
        phase = ENABLED if progress.may_be_enabled else state.phase
        disabling_start_ns = (
            progress.disable_command_ns if progress.disable_command_ns >= 0 else t_ns
        )
        progress = progress._replace(disable_command_ns=disabling_start_ns)
        start_frames: tuple[Frame, ...] = ()
        if t_ns - max(state.feedback_t_ns, progress.started_ns) > REPEAT_PERIOD_NS:
            progress = progress._replace(started_ns=t_ns)
            start_frames = (self._nmt_frame(canopen.START_NODE),)
        return state._replace(phase=phase, protocol_state=progress), (
            *start_frames,
            self._rpdo_frame(codec.DISABLE_VOLTAGE, 0.0),
        )

    def _configure(
        self, state: DriveState, progress: Cia402Progress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the next SDO request.

        Before the first SDO request, the host sets the node to the NMT state pre-operational.
        """
        cursor, data, problem = setup.next_request(progress.cursor, self.setup_steps, t_ns)
        next_state = state._replace(protocol_state=progress._replace(cursor=cursor))
        if problem:
            return enter_fault(next_state, SETTING_MISMATCH_ERROR, problem), ()
        frames = (self._sdo_frame(data),) if data else ()
        return next_state, (
            self._nmt_frame(canopen.PRE_OPERATIONAL),
            *frames,
        ) if cursor.step == 0 and data else frames

    def _start_node(
        self, state: DriveState, progress: Cia402Progress, t_ns: int
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state, and the frames that set the node to the NMT state operational.

        The host repeats the NMT frames until a status word arrives. If the operator has cleared a
        fault, the returned frame is an RPDO that resets the fault.
        """
        if progress.errors_to_ignore and progress.power_state == codec.FAULT:
            # The control word alternates between two values, because the drive resets a fault only
            # when bit 7 of the control word changes from 0 to 1.
            control_word = (
                codec.FAULT_RESET if progress.errors_to_ignore % 2 else codec.DISABLE_VOLTAGE
            )
            return state._replace(protocol_state=progress), (self._rpdo_frame(control_word, 0.0),)
        if t_ns - progress.started_ns < REPEAT_PERIOD_NS:
            return state._replace(protocol_state=progress), ()
        question_text = "does a node send SYNC (0x080) on its bus, and does the drive accept SYNC with a counter?"
        text = f"no TPDO yet: {question_text}" if progress.started_ns >= 0 else ""
        next_progress = progress._replace(started_ns=t_ns)
        return state._replace(error_text=text, protocol_state=next_progress), (
            self._nmt_frame(canopen.START_NODE),
        )

    def _rpdo_frame(self, control_word: int, command: float) -> Frame:
        """Return RPDO1 with a control word and a command, which has the unit of ``command_limit``."""
        try:
            data = struct.pack("<H", control_word) + self.command.pack(command)[2:]
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
        return Frame(canopen.RPDO + self.node_id, data, 0, self.bus)

    def _command_at_rest(self, state: DriveState) -> float:
        """Return the command that the host sends while it enables the drive: a torque of 0 N m."""
        return 0.0

    def _sdo_frame(self, payload: bytes) -> Frame:
        """Return the frame of an SDO request with the given payload."""
        return Frame(canopen.SDO_REQUEST + self.node_id, payload, 0, self.bus)

    def _nmt_frame(self, nmt_command: int) -> Frame:
        """Return the frame of an NMT command to the drive."""
        return Frame(canopen.NMT, bytes((nmt_command, self.node_id)), 0, self.bus)

    def identity(self, state: DriveState) -> str:
        """Return the serial number in object 0x1018:4, or the node number if the drive has no object 0x1018:4."""
        return f"{serial:#x}" if (serial := get_progress(state).serial) else f"node {self.node_id}"

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return CAUSE_BY_ERROR.get(
            error_code,
            DriveFaultCause.OTHER if error_code in codec.ERROR_TEXTS else DriveFaultCause.UNKNOWN,
        )

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return an RPDO with a target torque [N m at the spool]. The RPDO does not enable the drive.

        The control word in the RPDO keeps the power stage off.
        """
        return (self._rpdo_frame(codec.DISABLE_VOLTAGE, torque),)

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frames that remove the torque: DISABLE_VOLTAGE, then NMT pre-operational.

        When the node enters the NMT state pre-operational, object 0x6007 makes the drive go into
        fault.

        CiA 402-2 does not require that a drive loses its torque in the NMT state pre-operational.
        The control word DISABLE_VOLTAGE removes the torque of every drive. DISABLE_VOLTAGE must
        precede the NMT command, because a node reads PDOs only in the NMT state operational.
        """
        return (
            self._rpdo_frame(codec.DISABLE_VOLTAGE, 0.0),
            self._nmt_frame(canopen.PRE_OPERATIONAL),
        )

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return the SDO request after which the drive no longer supervises the host's heartbeat.

        After a run, the host sends no heartbeat. Without the SDO request, a drive that supervises
        the heartbeat would latch a fault.
        """
        if state.phase != READY:
            return ()
        data = canopen.download_request(*settings.HEARTBEAT_SUPERVISION_OFF)
        return (self._sdo_frame(data),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next drive state and the frames that reset the fault of the drive.

        After the reset of the fault, the host reads back all objects again.
        """
        power = get_progress(state).power_state
        initial_progress = Cia402Progress(
            power_state="" if power == codec.FAULT else power, errors_to_ignore=IGNORED_FAULT_COUNT
        )
        next_state = state._replace(
            phase=SILENT, error=0, error_text="", protocol_state=initial_progress
        )
        return next_state, (
            self._rpdo_frame(codec.DISABLE_VOLTAGE, 0.0),
            self._rpdo_frame(codec.FAULT_RESET, 0.0),
        )


_HOST_HEARTBEAT = canopen.HEARTBEAT + setup.HOST_NODE
"""Identifier of this host's heartbeat."""
