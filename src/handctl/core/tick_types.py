"""Inputs and outputs of a tick.

``TickIn`` contains all data for the decisions of a tick. ``TickOut`` contains all decisions.
"""

import enum
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.drives.frame import Frame
from handctl.safety.safety_action import SafetyAction

Vector = NDArray[np.float64]


class HandMode(enum.IntEnum):
    """Mode of the whole hand during a run."""

    SILENT = 0
    """The host sends no frames."""
    INVENTORY = 1
    """Drives are queried and configured, and their settings are read back, without torque."""
    READY = 2
    """All nodes have replied. The hand waits for the request to arm."""
    ARMING = 3
    """Drives are being enabled."""
    ACTIVE = 4
    """The program moves the hand."""
    RELAX = 5
    """All tensions fall to the tension floor. The next mode is DISARM."""
    DISARM = 6
    """Drives are disabled, and are queried until each confirms that it is disabled."""
    CUT = 7
    """The torque of all motors is removed at once, without a ramp."""
    DONE = 8
    """Each drive has confirmed that it is disarmed, or cannot send the confirmation.

    In the mode DONE, the control loop is allowed to end.
    """


SILENT_MODE = int(HandMode.SILENT)
ARMING_MODE = int(HandMode.ARMING)
ACTIVE_MODE = int(HandMode.ACTIVE)
RELAX_MODE = int(HandMode.RELAX)
DISARM_MODE = int(HandMode.DISARM)
CUT_MODE = int(HandMode.CUT)
DONE_MODE = int(HandMode.DONE)
"""Values of ``HandMode``, for compiled code. Motor torque is possible in the modes from ARMING to RELAX."""

MODES_BEFORE_ARMING = (HandMode.SILENT, HandMode.INVENTORY, HandMode.READY)
"""Modes in which no drive was enabled yet."""
TORQUE_MODES = (HandMode.ARMING, HandMode.ACTIVE, HandMode.RELAX)
"""Modes in which motor torque is possible."""
SHUTDOWN_MODES = (HandMode.RELAX, HandMode.CUT, HandMode.DISARM, HandMode.DONE)
"""Modes after which the hand cannot become active again."""


class IoEvent(NamedTuple):
    """An event of a bus, the host or the recorder, which is an input of a tick.

    Attributes:
        kind: type of the event, for example enobufs, bus_off, dropped, recorder or suspended.
        where: bus or part of the host in which the event occurred.
        number: count that belongs to the event, for example the number of dropped records.
    """

    kind: str
    where: str = ""
    number: int = 1


class StreamTarget(NamedTuple):
    """Target in a stream of targets from a client.

    Attributes:
        stream: name of the stream.
        number: sequence number of the target, which rises from one target to the next.
        sent_ns: time at which the client sent the target [ns of the run].
        values: one value for each name of the stream, in the unit of the stream. The values are not
            checked.
    """

    stream: str
    number: int
    sent_ns: int
    values: tuple[float, ...]


TickRequest = str | StreamTarget
"""A request to the controller: a JSON text, or a stream target that is already decoded."""


class TickIn(NamedTuple):
    """Inputs of a tick.

    Attributes:
        k: tick number. If the tick number increases by more than 1, ticks were missed.
        t_ns: scheduled time of the tick on the clock of the run [ns], which is k times the period.
        late_ns: delay of the real start of the tick after the scheduled time [ns].
        frames: frames received since the last tick, in the order of reception.
        io_events: events of buses, host and recorder since the last tick.
        requests: requests of operators and programs since the last tick, in the order of arrival.
            In the log, all requests are JSON texts.
    """

    k: int
    t_ns: int
    late_ns: int = 0
    frames: Sequence[Frame] = ()
    io_events: tuple[IoEvent, ...] = ()
    requests: tuple[TickRequest, ...] = ()


GAIN_EVENT = "gain"
"""Name of the event for a changed gain.

In the event, ``where`` is the key of the gain, and ``text`` is the new value of the gain.
"""


class TickEvent(NamedTuple):
    """An event of a tick, for the log and the operator.

    Attributes:
        level: "info", "warn" or "error".
        name: short identifier, for example "mode", "phase", "contact", "fault".
        where: digit, motor, tendon or bus to which the event belongs.
        text: description of the event in one line.
    """

    level: str
    name: str
    where: str
    text: str


class Telemetry(NamedTuple):
    """Numbers of a tick for the log and the viewers, as float64.

    An unknown number is NaN, and is never replaced by the number of an older tick.

    Shapes: J joints, N tendons, M motors and D digits, in the order of the hand file.
    """

    q: Vector
    """(J,) estimated joint angle [rad]."""
    dq: Vector
    """(J,) estimated joint rate [rad/s]."""
    q_goal: Vector
    """(J,) commanded joint angle [rad]."""
    dq_goal: Vector
    """(J,) commanded joint rate [rad/s]."""
    joint_torque: Vector
    """(J,) commanded joint torque [N m]."""
    joint_encoder: Vector
    """(J,) joint encoder reading of the tick [rad]."""
    excursion: Vector
    """(N,) estimated tendon excursion [m]."""
    excursion_rate: Vector
    """(N,) estimated rate of the excursion [m/s]."""
    tension: Vector
    """(N,) estimated tension at the load cell [N]."""
    tension_sigma: Vector
    """(N,) standard deviation of the estimated tension [N]."""
    tension_raw: Vector
    """(N,) load-cell reading of the tick, minus the tare [N]."""
    tension_goal: Vector
    """(N,) commanded tension at the load cell [N]."""
    stretch_offset: Vector
    """(N,) estimated stretch offset [m]."""
    innovation: Vector
    """(N,) innovation: load-cell reading of the tick minus its prediction [N]."""
    nis: Vector
    """(N,) normalised innovation squared [1]."""
    external_tension: Vector
    """(N,) tension that the model does not explain, for example by contact [N]."""
    motor_position: Vector
    """(M,) measured motor position at the spool [rad]."""
    motor_velocity: Vector
    """(M,) measured motor velocity at the spool [rad/s]."""
    motor_torque: Vector
    """(M,) motor torque that the drive reports [N m]."""
    motor_torque_goal: Vector
    """(M,) commanded motor torque [N m]."""
    motor_temperature: Vector
    """(M,) temperature of the drive's hottest sensor [degC]."""
    motor_age: Vector
    """(M,) age of the drive's latest feedback [s]."""
    drive_phase: Vector
    """(M,) phase of the drive, ``drives.contract.DrivePhase`` as a number."""
    tip_force: Vector
    """(D,) tip-equivalent contact force, normal to the last link [N]."""
    contact: Vector
    """(D,) 1 if the digit is in contact, else 0."""
    q_sigma: Vector
    """(J,) standard deviation of the estimated joint angle [rad]."""
    tip_force_sigma: Vector
    """(D,) standard deviation of the tip-equivalent force [N]."""

    @property
    def axis_lengths(self) -> tuple[int, ...]:
        """Return the numbers of joints, tendons, motors and digits."""
        return tuple(len(getattr(self, name)) for name in FIELD_BY_AXIS)

    def to_bytes(self) -> bytes:
        """Return all telemetry fields in order, as little-endian float64."""
        return b"".join([array.tobytes() for array in self])

    @property
    def buffer(self) -> memoryview:
        """Return the numbers of ``to_bytes``, as a memoryview."""
        return memoryview(self.to_bytes())


FIELD_BY_AXIS = "q", "tension", "motor_torque", "contact"
"""One telemetry field for each axis, in the order joint, tendon, motor, digit."""


class TelemetrySlices(dict[str, slice]):
    """Slice of each telemetry field in the array of all fields.

    The keys are the names of the fields.
    """

    @cached_property
    def axis_lengths(self) -> tuple[int, ...]:
        """Return the numbers of joints, tendons, motors and digits."""
        return tuple(self[name].stop - self[name].start for name in FIELD_BY_AXIS)


class PackedTelemetry:
    """Telemetry of a tick in one array, with the same layout as in the log.

    An attribute with the name of each telemetry field returns the slice of the array with this
    field.

    Attributes:
        numbers: array of all fields in order.
        slices: slice of each field in the array.
    """

    __slots__ = ("numbers", "slices")

    def __init__(self, packed_numbers: Vector, field_slices: TelemetrySlices) -> None:
        """Store the array, without a copy.

        Args:
            packed_numbers: array of all fields in order.
            field_slices: slice of each field in the array.
        """
        self.numbers = packed_numbers
        self.slices = field_slices

    def __getattr__(self, name: str) -> Vector:
        """Return a telemetry field by its name."""
        try:
            return self.numbers[self.slices[name]]
        except KeyError:
            raise AttributeError(name) from None

    def __iter__(self) -> Iterator[Vector]:
        """Iterate over the telemetry fields in order."""
        return iter([self.numbers[field_slice] for field_slice in self.slices.values()])

    @property
    def axis_lengths(self) -> tuple[int, ...]:
        """Return the numbers of joints, tendons, motors and digits."""
        return self.slices.axis_lengths

    def to_bytes(self) -> bytes:
        """Return all telemetry fields in order, as little-endian float64."""
        return self.numbers.tobytes()

    @property
    def buffer(self) -> memoryview:
        """Return the numbers of ``to_bytes``, as a memoryview. The numbers are not copied."""
        return self.numbers.data


TELEMETRY_FIELDS = Telemetry._fields
"""Names of the telemetry fields, in the order of ``Telemetry.to_bytes``."""

ORIGINAL_TELEMETRY_FIELD_COUNT = 25
"""Number of telemetry fields in logs of version 0.1 and before.

Later versions of handctl added telemetry fields at the end.
"""

TELEMETRY_AXES = {
    **dict.fromkeys(TELEMETRY_FIELDS[:6], "joint"),
    **dict.fromkeys(TELEMETRY_FIELDS[6:16], "tendon"),
    **dict.fromkeys(TELEMETRY_FIELDS[16:23], "motor"),
    **dict.fromkeys(TELEMETRY_FIELDS[23:25], "digit"),
    "q_sigma": "joint",
    "tip_force_sigma": "digit",
}
"""Axis of each telemetry field: joint, tendon, motor or digit."""


class TickOut(NamedTuple):
    """Results of a tick: frames to send, events, and numbers for log and viewers.

    Attributes:
        frames: frames to send, in order.
        mode: mode of the hand after the tick.
        phase: phase of the program, for example "home", "close" or "hold" in a grasp.
        action: most severe reaction that the safety monitor demands.
        telemetry: numbers of the tick for log and viewers.
        events: events of the tick.
        state_hash: hash of the whole state of the controller after the tick, 8 bytes.
    """

    frames: Sequence[Frame]
    mode: HandMode
    phase: str
    action: SafetyAction
    telemetry: Telemetry | PackedTelemetry
    events: tuple[TickEvent, ...]
    state_hash: bytes
