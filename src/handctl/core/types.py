"""One tick as data: everything that can change a decision comes in by TickIn, everything decided leaves by TickOut."""

import enum
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.drives.frame import Frame
from handctl.safety.action import Action

Vector = NDArray[np.float64]


class Mode(enum.IntEnum):
    """State of the whole hand."""

    SILENT = 0
    """Nothing is sent."""
    INVENTORY = 1
    """Drives are asked, configured and read back; no torque."""
    READY = 2
    """Everything answered; waiting to be armed."""
    ARMING = 3
    """Drives are being enabled."""
    ACTIVE = 4
    RELAX = 5
    """Tensions ramp to the floor, then DISARM."""
    DISARM = 6
    """Drives are disabled and asked until each confirms."""
    CUT = 7
    """Torque is taken away at once, without a ramp."""
    DONE = 8
    """Disarmed and confirmed (or found impossible to confirm); the loop may end."""


BEFORE_ARMING = (Mode.SILENT, Mode.INVENTORY, Mode.READY)
"""Modes in which no drive has been enabled."""
ACTING = (Mode.ARMING, Mode.ACTIVE, Mode.RELAX)
"""Modes in which torque may act."""
LETTING_GO = (Mode.RELAX, Mode.CUT, Mode.DISARM, Mode.DONE)
"""Modes from which nothing leads back to action."""


class IoEvent(NamedTuple):
    """Something the bus or the host did, as data: ``kind`` e.g. enobufs, bus_off, dropped, recorder, suspended."""

    kind: str
    where: str = ""
    number: int = 1


class TickIn(NamedTuple):
    """All that one tick may know.

    Attributes:
        k: tick number; a jump means missed ticks.
        t_ns: scheduled time of the tick on the run's clock [ns], k times the period; starts at 0.
        late_ns: how late the tick really began [ns].
        frames: frames received since the last tick, in order.
        io_events: what buses and host reported since the last tick.
        requests: what people and programs asked, JSON text each, in order.
    """

    k: int
    t_ns: int
    late_ns: int = 0
    frames: Sequence[Frame] = ()
    io_events: tuple[IoEvent, ...] = ()
    requests: tuple[str, ...] = ()


GAIN_EVENT = "gain"
"""Name of the event of a changed gain; ``where`` is its key, ``text`` its new value."""


class Event(NamedTuple):
    """Something worth a line in the log.

    Attributes:
        level: "info", "warn" or "error".
        name: short identifier, e.g. "mode", "phase", "contact", "fault".
        where: digit, motor, tendon or bus it concerns.
        text: one line for a person.
    """

    level: str
    name: str
    where: str
    text: str


class Telemetry(NamedTuple):
    """The numbers of one tick, float64 each; NaN where nothing is known, never an old value with a fresh stamp.

    Shapes: J joints, N tendons, M motors, D digits, in the order of the hand file.
    """

    q: Vector
    """(J,) estimated joint angle [rad]."""
    dq: Vector
    """(J,) [rad/s]."""
    q_goal: Vector
    """(J,) [rad]."""
    dq_goal: Vector
    """(J,) [rad/s]."""
    joint_torque: Vector
    """(J,) commanded joint torque [N m]."""
    joint_encoder: Vector
    """(J,) joint encoder reading of this tick [rad]."""
    excursion: Vector
    """(N,) estimated tendon excursion [m]."""
    excursion_rate: Vector
    """(N,) [m/s]."""
    tension: Vector
    """(N,) estimated tension at the load cell [N]."""
    tension_sigma: Vector
    """(N,) standard deviation of that estimate [N]."""
    tension_raw: Vector
    """(N,) load cell reading of this tick, tared [N]."""
    tension_goal: Vector
    """(N,) commanded tension at the load cell [N]."""
    stretch_offset: Vector
    """(N,) estimated stretch offset [m]."""
    innovation: Vector
    """(N,) load cell innovation [N]."""
    nis: Vector
    """(N,) normalised innovation squared [1]."""
    external_tension: Vector
    """(N,) tension that the model does not explain: contact [N]."""
    motor_position: Vector
    """(M,) [rad at the spool]."""
    motor_velocity: Vector
    """(M,) [rad/s]."""
    motor_torque: Vector
    """(M,) measured [N m]."""
    motor_torque_goal: Vector
    """(M,) commanded [N m]."""
    motor_temperature: Vector
    """(M,) [degC]."""
    motor_age: Vector
    """(M,) age of the latest feedback [s]."""
    drive_phase: Vector
    """(M,) drives.contract.Phase as a number."""
    tip_force: Vector
    """(D,) tip-equivalent contact force, normal to the last link [N]."""
    contact: Vector
    """(D,) 1 in contact, 0 not."""
    q_sigma: Vector
    """(J,) standard deviation of the estimated joint angle [rad]."""
    tip_force_sigma: Vector
    """(D,) standard deviation of the tip-equivalent force [N]."""

    def packed(self) -> bytes:
        """All fields in order as little-endian float64."""
        return b"".join([array.tobytes() for array in self])


class PackedTelemetry:
    """The numbers of one tick as they go into the log; a field is taken out when it is looked at.

    Attributes:
        numbers: all fields in order. places: of each field in it.
    """

    __slots__ = ("numbers", "places")

    def __init__(self, numbers: Vector, places: dict[str, slice]) -> None:
        self.numbers, self.places = numbers, places

    def __getattr__(self, name: str) -> Vector:
        try:
            return self.numbers[self.places[name]]
        except KeyError:
            raise AttributeError(name) from None

    def __iter__(self) -> Iterator[Vector]:
        return iter([self.numbers[place] for place in self.places.values()])

    def packed(self) -> bytes:
        """Return all fields in order as little-endian float64."""
        return self.numbers.tobytes()


TELEMETRY_FIELDS = Telemetry._fields
"""Field names in the order of ``Telemetry.packed``."""

TELEMETRY_FIRST = 25
"""Number of fields in logs of version 0.1 and before; later fields follow them."""

TELEMETRY_AXES = {
    **dict.fromkeys(TELEMETRY_FIELDS[:6], "joint"),
    **dict.fromkeys(TELEMETRY_FIELDS[6:16], "tendon"),
    **dict.fromkeys(TELEMETRY_FIELDS[16:23], "motor"),
    **dict.fromkeys(TELEMETRY_FIELDS[23:25], "digit"),
    "q_sigma": "joint",
    "tip_force_sigma": "digit",
}
"""Which of joint, tendon, motor, digit each field runs over."""


class TickOut(NamedTuple):
    """All that one tick decided.

    Attributes:
        frames: frames to send, in order.
        mode: state of the hand after this tick.
        phase: grasp phase (or the goal source's name), e.g. "home", "close", "hold".
        action: what safety demands, the largest wins.
        telemetry: the numbers.
        events: lines for the log.
        state_hash: 8 bytes, hash of the controller's whole state after this tick.
    """

    frames: Sequence[Frame]
    mode: Mode
    phase: str
    action: Action
    telemetry: Telemetry | PackedTelemetry
    events: tuple[Event, ...]
    state_hash: bytes
