"""What every motor drive protocol must offer: bytes <-> values, and its state machine with time passed in.

A protocol is one class; the object is the immutable description of one motor on one bus, and all that changes lives in
an immutable ``DriveState``. The tick calls, for each motor and in this order: ``receive`` for every frame that arrived,
then ``advance`` once with what it wants of the drive. While a drive is enabled and nothing changes, compiled code does
both from the tables of ``cyclic`` (``core.wire``); ``steady_status`` and ``due_ns`` say for how long. Nothing here
reads a clock or a socket.
"""

import enum
import math
from typing import Any, NamedTuple, Protocol

from handctl.drives.causes import Cause
from handctl.drives.frame import Frame
from handctl.drives.signals import Cyclic

UNSTEADY = -1
"""Status of a drive whose state machine must look at every frame."""
NEVER_NS = (1 << 63) - 1
"""Time that does not come [ns]."""


class Want(enum.IntEnum):
    """What the controller wants of a drive; the drive walks there by itself, one step a tick."""

    LISTEN = 0
    """Send nothing."""
    POLL = 1
    """Discover, configure and read back limits and watchdog, then keep polling feedback; never any torque."""
    ENABLE = 2
    """As POLL, then enable; torque commands are sent once the drive says that it is enabled."""
    DISABLE = 3
    """Disable and ask until the drive says that it is disabled."""


class Phase(enum.IntEnum):
    """Where a drive stands."""

    SILENT = 0
    """Nothing heard of it yet (or nothing for so long that it counts as gone)."""
    CONFIGURING = 1
    READY = 2
    """Configured and read back, disabled: no torque."""
    ENABLED = 3
    """Confirmed by the drive's own feedback; torque commands act."""
    FAULT = 4
    """The drive reports an error, or a read-back did not agree; ``DriveState.error`` says which."""


class DriveState(NamedTuple):
    """What is known of one drive; values are at the spool, with the hand's sign (positive winds).

    Attributes:
        phase: where the drive stands.
        position: [rad]; NaN before the first feedback.
        velocity: [rad/s].
        torque: measured or estimated by the drive [N m].
        temperature: hottest of the drive's sensors [degC]; NaN where there is none.
        feedback_t_ns: reception of the latest feedback [ns]; -1 before the first.
        feedback_count: number of feedback frames so far.
        error: the drive's error code; 0 none.
        error_text: the error in words; empty if none.
        misread: frames on the drive's own identifiers that could not be decoded.
        private: the protocol's own progress (which register was asked, deadlines, ranges read); opaque to others.
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
        """Return the state with these values of its feedback; by default as before the first one."""
        return self._replace(
            position=position,
            velocity=velocity,
            torque=torque,
            temperature=temperature,
            feedback_t_ns=feedback_t_ns,
            feedback_count=feedback_count,
        )


class Drive(Protocol):
    """One motor as its protocol speaks; immutable.

    Attributes:
        name: the motor's name in the hand file.
        bus: index of its bus.
        torque_limit: largest torque that can be commanded [N m at the spool].
        exchange: worst-case frames of one control tick, both ways, as (payload bytes, CAN FD?) for the bus load.
        background: frames that come by time, whatever the tick, as (payload bytes, CAN FD?, how many a second).
        host_ids: identifiers that only the host sends for this drive; from elsewhere they mean a second controller.
        node_ids: identifiers that the drive answers on.
        caveats: guards that cannot be verified with this configuration, for a person to read before arming.
        answers_once: whether every command has exactly one feedback: then one more is a duplicate, or a second node.
        position_step: smallest difference of two positions that it can tell [rad at the spool]; 0: not known.
        cyclic: frames of a tick while the drive is enabled.
        feedback_period_s: how often feedback comes by itself [s]; 0 if every tick asks for it.
    """

    @property
    def name(self) -> str: ...
    @property
    def bus(self) -> int: ...
    @property
    def torque_limit(self) -> float: ...
    @property
    def exchange(self) -> tuple[tuple[int, bool], ...]: ...
    @property
    def background(self) -> tuple[tuple[int, bool, float], ...]: ...
    @property
    def host_ids(self) -> frozenset[int]: ...
    @property
    def node_ids(self) -> frozenset[int]: ...
    @property
    def caveats(self) -> tuple[str, ...]: ...
    @property
    def answers_once(self) -> bool: ...
    @property
    def position_step(self) -> float: ...
    @property
    def feedback_period_s(self) -> float: ...
    @property
    def cyclic(self) -> Cyclic: ...

    def steady_status(self, state: DriveState) -> int:
        """Return the status with which feedback changes nothing but values, and commands may go on; else UNSTEADY."""
        ...

    def due_ns(self, state: DriveState) -> int:
        """Return the time at which ``advance`` must be called next although the drive is steady [ns]."""
        ...

    def initial(self) -> DriveState:
        """State before anything was heard."""
        ...

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """Take in one frame; a frame of somebody else leaves the state as it is. Never raises on wire data."""
        ...

    def advance(self, state: DriveState, t_ns: int, want: Want, torque: float) -> tuple[DriveState, tuple[Frame, ...]]:
        """Next frames for this drive at time t_ns [ns]; torque [N m at the spool] counts only when ENABLED.

        Raises:
            ValueError: torque is not finite or beyond ``torque_limit``.
        """
        ...

    def cut(self) -> tuple[Frame, ...]:
        """Frames that take the torque away at once, whatever the state; constant, so that they can be built early."""
        ...

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Clear the drive's latched error on a person's order; the drive stays disabled."""
        ...

    def leave(self, state: DriveState) -> tuple[Frame, ...]:
        """Frames at the good end of a run, after which the drive may miss this host; none if it may still pull."""
        ...

    def identity(self, state: DriveState) -> str:
        """Return what tells this drive from another one: its serial number as ``scan`` prints it.

        A drive that has told none is known by its number on the bus alone, ``node N``: one of the same number in
        another hand cannot be told from it.
        """
        ...

    def cause(self, error: int) -> Cause:
        """What is behind an error, ``DriveState.error``, that is not 0."""
        ...
