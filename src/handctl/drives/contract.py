"""Interface of every motor drive protocol.

The interface covers the codec and the state machine of a protocol. Functions of the interface that
need the time get the time as an argument.

Each drive protocol is one class. Each object of the class is the immutable description of one motor
on one bus. All values of a drive that change during a run are in an immutable ``DriveState``. In
each tick the controller calls ``receive`` of each drive for every received frame. After the calls
of ``receive``, the controller calls ``advance`` of each drive once, with the requested drive state.
While a drive is enabled and its state machine has nothing to do, the controller calls neither
``receive`` nor ``advance``. Compiled code in ``core.wire.cyclic_frames`` then decodes the feedback
and encodes the commands of the drive, with the tables of ``cyclic_messages`` and ``rechecks``. The
controller calls ``advance`` again if the status in the feedback differs from ``steady_status``, or
when the time ``due_ns`` is reached. No function of a drive protocol reads a clock or a socket.
"""

import enum
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from handctl.drives.frame import Frame
from handctl.drives.readback import RecheckCursor, SettingRecheck

if TYPE_CHECKING:  # imported for types only: signals imports numba, which programs that only read a log do not need
    from handctl.drives.signals import CyclicMessages

NO_STEADY_STATUS = -1
"""Value of ``steady_status`` for a drive whose state machine must process every received frame."""
MAX_TIME_NS = (1 << 63) - 1
"""Largest time [ns]. ``due_ns`` returns ``MAX_TIME_NS`` if no call of ``advance`` is scheduled."""

INITIAL_RECHECK_CURSOR = RecheckCursor()
"""Value of ``DriveState.recheck`` (position in the repeated read-back) before a drive is enabled."""


class DriveTarget(enum.IntEnum):
    """Drive state that the controller requests from the drive.

    In each tick, the drive goes one step towards the requested state.
    """

    LISTEN = 0
    """Send nothing to the drive."""
    POLL = 1
    """Configure the drive, read back its limits and its watchdog, then request feedback.

    With the target POLL, the drive makes no torque.
    """
    ENABLE = 2
    """Do the same as with POLL, then enable the drive.

    Torque commands follow when the drive reports the state enabled.
    """
    DISABLE = 3
    """Disable the drive, and repeat the command until the drive reports the state disabled."""


class DrivePhase(enum.IntEnum):
    """Progress of a drive from its first received frame until it makes torque."""

    SILENT = 0
    """The drive has sent no frame yet, or has sent no frame for longer than its timeout."""
    CONFIGURING = 1
    """The host is writing and reading back the settings of the drive."""
    READY = 2
    """The host has verified all settings of the drive. The drive is disabled and makes no torque."""
    ENABLED = 3
    """The drive has reported the state enabled, and follows torque commands."""
    FAULT = 4
    """The drive reports an error, or a setting of the drive has a wrong value.

    ``DriveState.error`` contains the error code.
    """


class DriveFaultCause(enum.IntEnum):
    """Cause of a drive fault. Each drive protocol converts its own error codes to one of eight causes."""

    OTHER = 0
    """The manual of the drive describes the error, but no other member of ``DriveFaultCause`` describes its cause."""
    DROPPED_OUT = 1
    """The drive disabled itself or restarted."""
    WATCHDOG = 2
    """The drive's watchdog fired, because commands of the host were missing."""
    VOLTAGE = 3
    """The supply voltage is too low or too high."""
    OVERHEATED = 4
    """The motor or the power stage is too hot."""
    SETTING_MISMATCH = 5
    """A setting of the drive has a wrong value, or another host has enabled the drive."""
    COMMUNICATION_LOST = 6
    """The drive has sent no frame for longer than its timeout."""
    UNKNOWN = 7
    """The error code of the drive has no documented meaning.

    For an unknown error code, the controller assumes the worst cause.
    """


class DriveProperty(enum.Enum):
    """Property of a drive that handctl can check only with some protocols and some options."""

    READBACK = "read-back of settings"
    WATCHDOG = "watchdog"
    CUT = "cut of the torque"


class DriveState(NamedTuple):
    """State of one motor drive. All values refer to the spool, and positive values wind the tendon.

    Attributes:
        phase: progress of the drive from the first frame to torque.
        position: position of the spool [rad], NaN before the first feedback.
        velocity: velocity of the spool [rad/s].
        torque: torque that the drive measures or estimates [N m].
        temperature: temperature of the hottest sensor of the drive [degC], NaN for a drive without
            a sensor.
        feedback_t_ns: reception time of the latest feedback [ns], -1 before the first feedback.
        feedback_count: number of feedback frames since the start.
        recheck: position in the list of settings that are read again while the drive is enabled.
        error: error code of the drive, or 0 without an error.
        error_text: error of the drive in words, or an empty text without an error.
        misread_frame_count: number of frames that had an identifier of the drive but an invalid payload.
        protocol_state: internal values of the protocol, such as an unanswered request or the end of
            a waiting time. Code outside the protocol does not read ``protocol_state``.
    """

    phase: DrivePhase = DrivePhase.SILENT
    position: float = math.nan
    velocity: float = math.nan
    torque: float = math.nan
    temperature: float = math.nan
    feedback_t_ns: int = -1
    feedback_count: int = 0
    recheck: RecheckCursor = INITIAL_RECHECK_CURSOR
    error: int = 0
    error_text: str = ""
    misread_frame_count: int = 0
    protocol_state: Any = ()

    def with_values(
        self,
        position: float = math.nan,
        velocity: float = math.nan,
        torque: float = math.nan,
        temperature: float = math.nan,
        feedback_t_ns: int = -1,
        feedback_count: int = 0,
        recheck: RecheckCursor = INITIAL_RECHECK_CURSOR,
    ) -> "DriveState":
        """Return a copy of the drive state in which feedback and read-back cursor have new values.

        An omitted argument resets its field to the value before the first feedback.
        """
        # The constructor takes a third of the time of ``_replace``. While drives are configured,
        # every tick calls this method for each drive.
        return DriveState(
            self.phase, position, velocity, torque, temperature, feedback_t_ns, feedback_count, recheck,
            self.error, self.error_text, self.misread_frame_count, self.protocol_state,
        )  # fmt: skip

    def with_feedback(
        self, position: float, velocity: float, torque: float, temperature: float, t_ns: int
    ) -> "DriveState":
        """Return a copy of the drive state with the values of a feedback frame.

        Args:
            position: position of the spool [rad].
            velocity: velocity of the spool [rad/s].
            torque: torque [N m].
            temperature: temperature of the hottest sensor [degC].
            t_ns: reception time of the feedback [ns].
        """
        return self.with_values(
            position, velocity, torque, temperature, t_ns, self.feedback_count + 1, self.recheck
        )


def is_confirmed_off(state: DriveState) -> bool:
    """Return True if a drive with target DISABLE has reported that it makes no torque.

    The phases SILENT and CONFIGURING do not confirm that the drive makes no torque, because a drive
    reaches these phases without a report. The phase FAULT is a confirmation only after a call of
    ``advance`` with the target DISABLE. If a drive in the phase FAULT may still make torque, the
    call of ``advance`` changes the phase to ENABLED.
    """
    return state.phase in (DrivePhase.READY, DrivePhase.FAULT)


class Drive(Protocol):
    """One motor with its drive, in the protocol of the drive. Implementations are immutable.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus to which the drive is connected.
        command_limit: largest command at the spool: a torque [N m], or in the modes of
            ``drive_modes`` a position [rad] or velocity [rad/s].
        frames_per_tick: largest number of frames in one tick, in both directions, as (payload
            bytes, CAN FD?). The bus load of the hand is computed from ``frames_per_tick`` and
            ``background_frames``.
        background_frames: frames whose rate is not the control rate, as (payload bytes, CAN FD?,
            frames per second).
        has_extended_ids: True if the frames have 29-bit identifiers. Frames with 29-bit identifiers
            take longer on the bus.
        host_ids: identifiers of frames that a host sends to the drive. If the controller receives a
            frame with one of the identifiers in ``host_ids``, another host has sent the frame.
        node_ids: identifiers of frames that the drive sends.
        unverified_protections: protections of the drive that handctl cannot verify, shown to the
            operator before arming.
        unchecked_properties: reason for each property that handctl cannot check on this drive. The
            reason names the missing option, or what the protocol lacks.
        sends_one_reply_per_command: True if the drive sends exactly one feedback frame per command. An
            additional frame is then a duplicate, or comes from a second drive with the same number.
        position_step: resolution of the measured position [rad at the spool], 0 if unknown.
        cyclic_messages: signal tables of the frames that a tick exchanges with the enabled drive.
        rechecks: settings that compiled code reads again while the drive is enabled, each with one
            request and one reply. The tuple is empty if the state machine of the drive itself reads
            the settings again.
        feedback_period_s: period of the drive's unrequested feedback [s], 0 if every tick requests
            feedback.
    """

    @property
    def name(self) -> str:
        """Return the name of the motor in the hand file."""
        ...

    @property
    def bus(self) -> int:
        """Return the index of the bus of the drive."""
        ...

    @property
    def command_limit(self) -> float:
        """Return the largest command at the spool [N m].

        For drives that control position or velocity (``drive_modes``), the unit is rad or rad/s.
        """
        ...

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return payload bytes and CAN FD flag of each frame, for the tick with the most frames.

        The result contains the frames from the host to the drive and from the drive to the host.
        """
        ...

    @property
    def background_frames(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the frames whose rate is not the control rate.

        Each frame is given as (payload bytes, CAN FD?, frames per second).
        """
        ...

    @property
    def has_extended_ids(self) -> bool:
        """Return True if the frames of the protocol have 29-bit identifiers."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from a host to the drive."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers of frames from the drive."""
        ...

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return one line for each of the drive's protections that handctl cannot verify."""
        ...

    @property
    def unchecked_properties(self) -> Mapping[DriveProperty, str]:
        """Return the properties of the drive that handctl cannot check, each with the reason."""
        ...

    @property
    def sends_one_reply_per_command(self) -> bool:
        """Return True if the drive sends exactly one feedback frame per command."""
        ...

    @property
    def position_step(self) -> float:
        """Return the resolution of the measured position [rad at the spool], 0 if unknown."""
        ...

    @property
    def feedback_period_s(self) -> float:
        """Return the period of feedback that the drive sends without a request [s].

        The period is 0 if every tick requests feedback.
        """
        ...

    @property
    def cyclic_messages(self) -> "CyclicMessages":
        """Return the signal tables of the frames that a tick exchanges with the enabled drive."""
        ...

    @property
    def rechecks(self) -> tuple[SettingRecheck, ...]:
        """Return the settings that compiled code reads again while the drive is enabled."""
        ...

    def steady_status(self, state: DriveState) -> int:
        """Return the status in feedback for which the state machine has nothing to do.

        Return NO_STEADY_STATUS if the state machine of the drive must process every frame. While
        the feedback contains the steady status, only the measured values in the drive state change.
        The host may then continue its torque commands without a call of the state machine.
        """
        ...

    def due_ns(self, state: DriveState) -> int:
        """Return the next time at which ``advance`` must be called, even if the status of the drive is unchanged [ns].

        The requests of ``rechecks`` do not influence the returned time, because compiled code sends
        these requests.
        """
        ...

    def initial_state(self) -> DriveState:
        """Return the state of the drive before the first frame."""
        ...

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state of the drive after a received frame. A frame of another node has no effect.

        This method raises no error, whatever the frame contains.
        """
        ...

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, command: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state of the drive, and the frames to send at time t_ns [ns].

        Args:
            state: state of the drive.
            t_ns: time of the tick [ns].
            target: requested drive state.
            command: command at the spool, in the unit of ``command_limit``, used only if the target
                is ENABLE.

        Raises:
            ValueError: the command is not finite, or larger than ``command_limit``.
        """
        ...

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return the frames that command a torque [N m at the spool] and do not enable the drive.

        The conformance test sends these frames to a disabled drive, and checks that the drive
        ignores the torque command.

        The tuple of frames is empty if every torque command of the protocol also enables the drive.
        """
        ...

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frames that remove the torque at once, in any state of the drive.

        The frames that remove the torque do not depend on the state of the drive, so that they can
        be built before a run.
        """
        ...

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the drive state and the frames that clear the drive's latched error.

        After the frames that clear the error, the drive is still disabled.
        """
        ...

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return the frames to send to the drive at the regular end of a run.

        After the release frames, the drive needs no further frames from the host.

        The tuple of release frames is empty if the drive may still make torque.
        """
        ...

    def identity(self, state: DriveState) -> str:
        """Return the serial number of the drive in the form that ``scan`` prints.

        If the drive has no serial number, return ``node N``. A drive without a serial number cannot
        be distinguished from a drive of another hand with the same node number.
        """
        ...

    def fault_cause(self, error_code: int) -> DriveFaultCause:
        """Return the cause of a nonzero error code in ``DriveState.error``."""
        ...
