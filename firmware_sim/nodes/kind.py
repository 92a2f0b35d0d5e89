"""What a protocol brings to the simulator, in one record: a node, and what it is out of the box."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from firmware_sim.bus.frame import EXTENDED, Frame
from firmware_sim.description import MotorSpec
from firmware_sim.plant.motor import Motor

SENSORS, MIT, ODRIVE, CIA402 = range(4)
"""Kinds of nodes to which compiled laws deliver frames."""


class Node(Protocol):
    """A simulated node; time is passed in.

    Attributes:
        wake_ns: when it wants ``wake`` to be called next [ns].
        malformed: frames on its own identifiers that it could not read.
        ids: identifiers that it may answer, another object whenever they change; None: it must see every frame.
    """

    @property
    def wake_ns(self) -> int: ...
    @property
    def ids(self) -> frozenset[int] | None: ...
    @property
    def malformed(self) -> int: ...

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return the answers to a frame; None if the frame is not for this node."""
        ...

    def wake(self, t_ns: int) -> list[Frame] | None:
        """Let time pass: watchdog, temperatures; return what it sends of its own accord, if it ever does."""
        ...


class DriveNode(Node, Protocol):
    """A node with a motor.

    Attributes:
        fed_ns: last sign of life of the host that its watchdog counts [ns]; below 0 if it does not watch.
    """

    fed_ns: int


class Shaft(NamedTuple):
    """A motor as its maker sells it, at its own shaft.

    Attributes:
        peak: torque [N m]. inertia: of the free shaft [kg m2]. torque_constant: [N m/A].
        position, velocity: ranges [rad], [rad/s]. options: of the hand file.
    """

    peak: float
    inertia: float
    torque_constant: float
    position: float = 12.5
    velocity: float = 30.0
    options: dict[str, Any] = {}  # noqa: RUF012 - read only


def as_it_is(frame: Frame) -> Frame:
    """Hear, or say, what was said."""
    return frame


NOTHING = Frame(EXTENDED, b"")
"""A frame for nobody."""


class Kind(NamedTuple):
    """A protocol.

    Attributes:
        node: made of the motor, its rotor and the angle its encoder shows at theta = 0 [rad].
        numbers: that a node can have.
        shaft: of the usual motor on a bench.
        host_frame: identifier and payload of a frame that only the host of a node, by its number, may send, and that
            does nothing to it.
        mishear: what a broken node hears of an order to let go.
        spoil: what becomes of its answers if it reads back wrong.
        row: type of a node whose numbers are a row of an array, for compiled laws; None if there is none.
        taker: how these laws call it; see ``cyclic.Taker``.
    """

    node: Callable[[MotorSpec, Motor, float], DriveNode]
    numbers: range
    shaft: Shaft
    host_frame: Callable[[int], tuple[int, bytes]]
    mishear: Callable[[Frame], Frame]
    spoil: Callable[[Frame], Frame] = as_it_is
    row: Any = None
    taker: int = -1
