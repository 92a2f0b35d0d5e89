"""Contract of every motor drive protocol: codec and state machine, with time as an argument.

Each protocol is one class. Each object of the class is the immutable description of one motor on
one bus. All changing values live in an immutable ``DriveState``. Per tick and motor the controller
calls ``receive`` for every received frame, then ``advance`` once with the requested drive state.
While a drive is enabled and steady, compiled code does both from the tables of ``cyclic``
(``core.wire``). ``steady_status`` and ``due_ns`` end this mode. No function here reads a clock or
a socket.
"""

import enum
import math
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from handctl.drives.causes import Cause
from handctl.drives.frame import Frame

if TYPE_CHECKING:  # imported for types only, because it imports numba, which readers of a log do not need
    from handctl.drives.signals import Cyclic

UNSTEADY = -1
"""Value of ``steady_status`` for a drive whose state machine must process every frame."""
END_OF_TIME_NS = (1 << 63) - 1
"""Largest time [ns], the value of ``due_ns`` if no call is scheduled."""


class DriveTarget(enum.IntEnum):
    """Drive state that the controller requests. In each tick the drive goes one step towards it."""

    LISTEN = 0
    """Send nothing."""
    POLL = 1
    """Discover the drive, configure it, read limits and watchdog back, then poll feedback. No torque."""
    ENABLE = 2
    """Do the steps of POLL, then enable the drive. Send torque commands after the drive reports enabled."""
    DISABLE = 3
    """Disable the drive, and repeat the command until the drive reports disabled."""


class Phase(enum.IntEnum):
    """Progress of a drive from silence to torque."""

    SILENT = 0
    """No frame received yet, or none for longer than the timeout."""
    CONFIGURING = 1
    """The settings of the drive are being written and read back."""
    READY = 2
    """All settings are verified. The drive is disabled and makes no torque."""
    ENABLED = 3
    """The drive has reported enabled. Torque commands act."""
    FAULT = 4
    """The drive reports an error, or a setting reads back wrong. ``DriveState.error`` has the code."""


class DriveState(NamedTuple):
    """State of one drive. Values are at the spool, with the hand's sign (positive winds).

    Attributes:
        phase: progress from silence to torque.
        position: position [rad], NaN before the first feedback.
        velocity: velocity [rad/s].
        torque: measured or estimated by the drive [N m].
        temperature: hottest sensor of the drive [degC], NaN without a sensor.
        feedback_t_ns: reception time of the latest feedback [ns], -1 before the first.
        feedback_count: number of feedback frames since the start.
        error: error code of the drive, 0 without an error.
        error_text: the error in words, empty without an error.
        misread: number of frames with the drive's identifiers but an invalid payload.
        private: internal state of the protocol (open request, deadlines, ranges). Callers do not
            read it.
    """

    phase: Phase = Phase.SILENT
    position: float = math.nan
    velocity: float = math.nan
    torque: float = math.nan
    temperature: float = math.nan
    feedback_t_ns: int = -1
    feedback_count: int = 0
    error: int = 0
    error_text: str = ""
    misread: int = 0
    private: Any = ()

    def with_values(
        self,
        position: float = math.nan,
        velocity: float = math.nan,
        torque: float = math.nan,
        temperature: float = math.nan,
        feedback_t_ns: int = -1,
        feedback_count: int = 0,
    ) -> "DriveState":
        """Return the state with new feedback values. Defaults are the values before the first feedback."""
        # The constructor takes a third of the time of ``_replace``, and a tick with a read-back comes here often.
        return DriveState(
            self.phase, position, velocity, torque, temperature, feedback_t_ns, feedback_count,
            self.error, self.error_text, self.misread, self.private,
        )  # fmt: skip


class Drive(Protocol):
    """One motor with its protocol. Implementations are immutable.

    Attributes:
        name: name of the motor in the hand file.
        bus: index of the bus.
        torque_limit: largest torque command [N m at the spool].
        exchange: worst-case frames of one control tick in both directions, for the bus load, as
            (payload bytes, CAN FD?).
        background: frames that do not follow the control rate, as (payload bytes, CAN FD?, frames
            per second).
        extended: True if the frames have 29-bit identifiers, for the bus load.
        host_ids: identifiers sent only by the host. A received frame with one of these identifiers
            comes from a second controller.
        node_ids: identifiers of the drive's answers.
        unverified_protections: protections of the drive that handctl cannot verify, shown to the
            operator before arming.
        one_reply_per_command: True if the drive sends one feedback frame per command. An additional
            frame is then a duplicate, or comes from a second node.
        position_step: resolution of the position [rad at the spool], 0 if unknown.
        cyclic: frames of a tick while the drive is enabled.
        feedback_period_s: period of unsolicited feedback [s], 0 if every tick requests feedback.
    """

    @property
    def name(self) -> str:
        """Return the name of the motor in the hand file."""
        ...

    @property
    def bus(self) -> int:
        """Return the index of the bus."""
        ...

    @property
    def torque_limit(self) -> float:
        """Return the largest torque command [N m at the spool]."""
        ...

    @property
    def exchange(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of one control tick in the worst case, as (payload bytes, CAN FD?)."""
        ...

    @property
    def background(self) -> tuple[tuple[int, bool, float], ...]:
        """Return the periodic frames as (payload bytes, CAN FD?, frames per second)."""
        ...

    @property
    def extended(self) -> bool:
        """Return True if the frames have 29-bit identifiers."""
        ...

    @property
    def host_ids(self) -> frozenset[int]:
        """Return the identifiers sent only by the host."""
        ...

    @property
    def node_ids(self) -> frozenset[int]:
        """Return the identifiers sent only by the drive."""
        ...

    @property
    def unverified_protections(self) -> tuple[str, ...]:
        """Return one line for each protection of the drive that handctl cannot verify."""
        ...

    @property
    def one_reply_per_command(self) -> bool:
        """Return True if the drive sends exactly one feedback frame per command."""
        ...

    @property
    def position_step(self) -> float:
        """Return the resolution of the position [rad at the spool], 0 if unknown."""
        ...

    @property
    def feedback_period_s(self) -> float:
        """Return the period of unsolicited feedback [s], 0 if every tick requests feedback."""
        ...

    @property
    def cyclic(self) -> "Cyclic":
        """Return the signal tables of the frames exchanged in each tick while the drive is enabled."""
        ...

    def steady_status(self, state: DriveState) -> int:
        """Return the feedback status of a steady drive, or UNSTEADY.

        While feedback has this status, only its values change, and torque commands may continue.
        """
        ...

    def due_ns(self, state: DriveState) -> int:
        """Return the time by which a steady drive needs the next call of ``advance`` [ns]."""
        ...

    def initial(self) -> DriveState:
        """Return the state before the first frame."""
        ...

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Return the state after one received frame. A frame of another node leaves the state unchanged.

        Does not raise for any content of a frame.
        """
        ...

    def advance(
        self, state: DriveState, t_ns: int, target: DriveTarget, torque: float
    ) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the next state and the frames to send at time t_ns [ns].

        Args:
            state: state of the drive.
            t_ns: time of the tick [ns].
            target: requested drive state.
            torque: command [N m at the spool], used only if the target is ENABLE.

        Raises:
            ValueError: torque is not finite or beyond ``torque_limit``.
        """
        ...

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return the frames of a torque command [N m at the spool] without an enable command.

        The frames serve to test that a disabled drive ignores torque commands.

        The result is empty if every torque command of the protocol also enables the drive.
        """
        ...

    def cut(self) -> tuple[Frame, ...]:
        """Return the frames that remove the torque at once, in any state.

        The frames do not depend on the state, so they can be built before a run.
        """
        ...

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Return the state that clears the drive's latched error. The drive stays disabled."""
        ...

    def release_frames(self, state: DriveState) -> tuple[Frame, ...]:
        """Return the frames to send at the regular end of a run.

        After these frames the drive tolerates a silent host.

        The result is empty if the drive may still make torque.
        """
        ...

    def identity(self, state: DriveState) -> str:
        """Return the serial number as ``scan`` prints it, or ``node N`` without a serial number.

        Drives without a serial number cannot be distinguished from drives of another hand with an
        equal node number.
        """
        ...

    def cause(self, error: int) -> Cause:
        """Return the cause of a nonzero ``DriveState.error``."""
        ...
