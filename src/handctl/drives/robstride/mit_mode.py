"""RobStride motor in MIT mode.

In MIT mode, the motor has 11-bit identifiers, the command frame of MIT motors, and no registers.
The identifier of a command or a special command is the number of the motor. The module
``mit.codec`` describes the bytes of both. Byte 6 of a special command contains FF in all special
commands that handctl uses, except in the request to read the faults:

    bytes 0..5          byte 6   byte 7   effect
    FF FF FF FF FF FF   FF       FC       enable
    FF FF FF FF FF FF   FF       FD       stop, also the request for feedback here
    FF FF FF FF FF FF   FF       FB       clear the faults
    FF FF FF FF FF FF   00       FB       read the faults

Feedback has 8 bytes, big-endian. The identifier of feedback is the host's number. The answer to the
request to read the faults has the same identifier, and the layout in the last row of the table:

    byte    0         1, 2            3, 4 high     4 low, 5      6, 7
    field   motor 8   position 16     velocity 12   torque 12     winding 16
    range             +-12.57 rad     by model      by model      0.1 degC/count
    faults  motor 8   bits 0..7, 8..15, 16..23 in bytes 1..3      0 in bytes 4..7

As with CubeMars motors, the feedback does not show if the motor is enabled. Watchdog and torque
limit can be set and read only in the private protocol. An MIT motor of another maker would take the
request for the faults as a motion command. The host therefore sends this request only to disabled
motors, and a scan never sends it.

Source: docs/facts/robstride.md, section MIT mode.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from handctl.drives.contract import (
    DriveFaultCause,
    DrivePhase,
    DriveProperty,
    DriveState,
    DriveTarget,
)
from handctl.drives.frame import Frame
from handctl.drives.mit import codec as mit
from handctl.drives.mit import cubemars
from handctl.drives.mit.cubemars import (
    MAX_RESTING_TORQUE_FRACTION,
    REQUIRED_ANSWER_COUNT,
    CubemarsDrive,
    CubemarsProgress,
)
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import (
    MotorOption,
    check_full_scale,
    checked_whole_number,
    motor_type_option,
    pop_motor_model,
    refuse_unknown_options,
)
from handctl.drives.robstride import codec
from handctl.drives.robstride.progress import cause_of_error, fault_text
from handctl.drives.signals import Signal, SignalCoding, SignalQuantity, SignalTable
from handctl.errors import ConfigError

POSITION_RANGE_RAD = 12.57
"""Full scale of the position in MIT mode [rad]."""
MOTOR_MODEL_RANGES = {
    name: mit.MotorRanges(
        POSITION_RANGE_RAD,
        codec.MOTOR_MODEL_RANGES[name].velocity,
        codec.MOTOR_MODEL_RANGES[name].torque,
    )
    for name in ("rs00", "rs01", "rs05")
}
"""Full scale of each motor model whose ranges in MIT mode are the same in all sources."""
HOST_ID_OFFSET = 0x10
"""Difference between the default host number and the motor number, on a bus with several motors."""
FACTORY_HOST_ID = 0
"""Factory setting of the host number in a motor."""
READ_FAULTS = b"\xff" * 6 + b"\x00\xfb"
"""Payload of the special command to read the faults."""
FAULT_READ_INTERVAL_FRAMES = 8
"""Number of answers from a disabled motor between two reads of its faults."""
CONTROL_MODES = range(3)
"""Values of bits 10..8 in the identifier of a command, for MIT, position, and velocity mode."""
UNVERIFIED_PROTECTIONS = (
    "watchdog: canTimeout cannot be read in MIT mode; set and save it in the private protocol, its default is off",
    "torque limit: limit_torque cannot be read in MIT mode; torque_max_N_m is this host's alone",
    "does not report whether it is enabled; "
    f"counts as disabled if its answer to the stop command reports at most "
    f"{MAX_RESTING_TORQUE_FRACTION:.0%} of full-scale torque",
    "ranges cannot be read back; motor_type must be right",
)
"""Protections of a RobStride motor in MIT mode that handctl cannot verify, one line each."""
UNCHECKED_PROPERTIES = {
    **cubemars.UNCHECKED_PROPERTIES,
    DriveProperty.WATCHDOG: "the protocol has no command that switches the watchdog on",
}
"""Reason for each property of a RobStride motor in MIT mode that handctl cannot check."""
OPTIONS = {
    "motor_type": motor_type_option(MOTOR_MODEL_RANGES),
    "host_id": MotorOption(
        "0 to 127 (default: `node_id` + 0x10)",
        "CAN identifier of the replies, another one for each motor on a bus. A new motor has 0.",
    ),
}
"""Options of a RobStride motor in MIT mode in the hand file."""


@dataclass(frozen=True, slots=True)
class RobstrideMitDrive(CubemarsDrive):
    """RobStride motor in MIT mode, with the interface ``contract.Drive``.

    Attributes:
        host_id: number of the host, also the identifier of feedback.
    """

    host_id: int

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        command = mit.command_message(self.node_id, self.ranges, self.direction)
        feedback = mit.feedback_message(self.host_id, self.ranges, self.direction, self.zero)
        state, position, velocity, torque, _, _ = feedback.signals
        temperature_signal = Signal(
            "winding",
            SignalQuantity.TEMPERATURE,
            55,
            16,
            True,
            SignalCoding.SIGNED,
            0.1,
            unit="degC",
        )
        # Byte 0 of feedback is the whole number of the motor, without a state nibble.
        signals = (state._replace(name="node"), position, velocity, torque, temperature_signal)
        object.__setattr__(self, "command", SignalTable(command._replace(limit=self.command_limit)))
        object.__setattr__(self, "feedback", SignalTable(feedback._replace(signals=signals)))

    @staticmethod
    def from_motor(motor: MotorDescription, bus: int) -> "RobstrideMitDrive":
        """Return the drive object for a motor description in the hand file.

        Raises:
            ConfigError: the motor model or an option is unknown, the number of the motor or host is
                wrong, or the torque limit is too large.
        """
        options = dict(motor.options)
        location = f"motor[{motor.name}]"
        ranges = pop_motor_model(options, location, MOTOR_MODEL_RANGES)
        if not 0 < motor.node_id <= codec.LAST_NODE_ID:
            raise ConfigError(
                str(motor.node_id), f"{location}.node_id", f"1 to {codec.LAST_NODE_ID}"
            )
        host = options.pop("host_id", motor.node_id + HOST_ID_OFFSET)
        if host != FACTORY_HOST_ID:
            host = checked_whole_number(host, f"{location}.options.host_id", codec.LAST_NODE_ID)
        refuse_unknown_options(options, f"{location}.options", OPTIONS)
        if host == motor.node_id:
            raise ConfigError(
                str(host), f"{location}.options.host_id", "another number than node_id"
            )
        check_full_scale(motor, ranges)
        return RobstrideMitDrive(
            name=motor.name,
            bus=bus,
            node_id=motor.node_id,
            ranges=ranges,
            command_limit=motor.torque_max_N_m,
            direction=motor.direction,
            zero=motor.zero_rad,
            temperature_offset=0.0,
            host_id=host,
        )

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of commands to the motor in its three control modes."""
        return frozenset(mode << 8 | self.node_id for mode in CONTROL_MODES)

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifier of feedback."""
        return frozenset((self.host_id,))

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return one line for each of the drive's protections that handctl cannot verify."""
        return UNVERIFIED_PROTECTIONS

    @property
    def unchecked_properties(self) -> Mapping[DriveProperty, str]:
        """Return a reason for each of the drive's properties that handctl cannot check."""
        return UNCHECKED_PROPERTIES

    def steady_status(self, state: DriveState) -> int:
        """Return the status that the feedback of an enabled motor contains.

        The status in feedback consists only of the motor's number.
        """
        status = CubemarsDrive.steady_status(self, state)
        return status if status < 0 else self.node_id

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame, see ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        if can_id != self.host_id or bus != self.bus:
            return state
        if len(data) != 8 or data[0] != self.node_id:
            return state._replace(misread_frame_count=state.misread_frame_count + 1)
        next_state = state._replace(feedback_t_ns=t_ns, feedback_count=state.feedback_count + 1)
        # Bytes 4 to 7 are 0 only in the answer to a request to read the faults. In feedback, zeros
        # in bytes 4 and 5 would mean a torque near the negative full scale.
        if not any(data[4:]) and state.phase != DrivePhase.ENABLED:
            return self._on_faults(next_state, int.from_bytes(data[1:4], "little"))
        _, position, velocity, torque, winding_temperature = self.feedback.unpack(data)
        next_state = next_state._replace(
            position=position, velocity=velocity, torque=torque, temperature=winding_temperature
        )
        return self._on_answer(next_state, state.protocol_state)

    def _on_faults(self, state: DriveState, fault_bits: int) -> DriveState:
        """Return the drive state after an answer to the request that reads the faults.

        The argument ``fault_bits`` contains one bit for each fault.
        """
        if not fault_bits:
            return state
        error = fault_bits << codec.FAULT_REPORT_SHIFT
        return state._replace(phase=DrivePhase.FAULT, error=error, error_text=fault_text(error))

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive and the frames to send, see ``contract.Drive``.

        If the motor is disabled, every eighth stop command is replaced by a request that reads the
        faults.
        """
        next_state, frames = CubemarsDrive.advance(self, state, t_ns, target, command)
        progress: CubemarsProgress = next_state.protocol_state
        is_disabled = (
            next_state.phase in (DrivePhase.READY, DrivePhase.FAULT) and not progress.is_enable_sent
        )
        if (
            target == DriveTarget.POLL
            and is_disabled
            and next_state.feedback_count % FAULT_READ_INTERVAL_FRAMES == REQUIRED_ANSWER_COUNT
        ):
            return next_state, (self._frame_to_motor(READ_FAULTS),)
        return next_state, frames

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the drive state and the frames that clear the faults.

        After the faults are cleared, the host sends stop commands to the motor again.
        """
        cleared_state, stop = CubemarsDrive.clear(self, state)
        return cleared_state, (self._frame_to_motor(mit.special_command(mit.CLEAR_ERROR)), *stop)

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of an error code of the drive, see ``contract.Drive``."""
        return cause_of_error(error_code)
