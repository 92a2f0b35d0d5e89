"""The interface of a protocol to the simulator: its node, and its motors as delivered."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from firmware_sim.bus.frame import EXTENDED, Frame
from firmware_sim.description import MotorSpec
from firmware_sim.plant.motor import Motor

SENSORS, MIT, ODRIVE, CIA402 = range(4)
"""Kinds of nodes in compiled kernels: sensor node, MIT drive, ODrive, CiA 402 drive."""


class Node(Protocol):
    """A simulated node. Time is an argument of its methods.

    Attributes:
        wake_ns: time of the next call of ``wake`` [ns].
        malformed: frames on the node's identifiers that the node could not decode.
        ids: identifiers that the node may answer, a new object after each change. None if the node
            must see every frame.
    """

    @property
    def wake_ns(self) -> int:
        """Return the time of the next call of ``wake`` [ns]."""
        ...

    @property
    def ids(self) -> frozenset[int] | None:
        """Return the identifiers that the node may answer, None if the node must see every frame."""
        ...

    @property
    def malformed(self) -> int:
        """Return the number of frames on the node's identifiers that the node could not decode."""
        ...

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Answer a frame.

        Returns:
            The answers, None if the frame is not for this node.
        """
        ...

    def wake(self, t_ns: int) -> list[Frame] | None:
        """Update watchdog and temperatures.

        Returns:
            Unsolicited frames, None if the node never sends any.
        """
        ...


class DriveNode(Node, Protocol):
    """A node with a motor.

    Attributes:
        watchdog_fed_ns: time of the last frame that fed the watchdog [ns], negative without
            watchdog.
    """

    watchdog_fed_ns: int


class Shaft(NamedTuple):
    """A motor as delivered, at its output shaft.

    Attributes:
        peak: full scale of the torque [N m].
        inertia: inertia of the free shaft [kg m2].
        torque_constant: torque constant [N m/A].
        position: position range [rad].
        velocity: velocity range [rad/s].
        options: options of the hand file.
        limit: largest torque that the motor can make [N m].
        top_speed: no-load speed [rad/s].
        stall_torque: torque at standstill if only the supply voltage limited it [N m].
    """

    peak: float
    inertia: float
    torque_constant: float
    position: float = 12.5
    velocity: float = 30.0
    options: dict[str, Any] = {}  # noqa: RUF012 - read only
    limit: float = math.inf
    top_speed: float = 0.0
    stall_torque: float = 0.0


def identity(frame: Frame) -> Frame:
    """Return the frame unchanged."""
    return frame


UNADDRESSED = Frame(EXTENDED, b"")
"""A frame for no node."""


class ProtocolSpec(NamedTuple):
    """A protocol.

    Attributes:
        node: factory of a node from motor, rotor and encoder angle at theta = 0 [rad].
        numbers: valid node numbers.
        shaft: shaft of the default motor on a bench.
        host_frame: identifier and payload, by node number, of a frame that only a host sends and
            that has no effect.
        corrupt_command: replaces a command to disable in a faulty drive.
        corrupt_reply: replaces the reply of a read-back in a faulty drive.
        force_command: makes a drive follow a torque command in any state, for a faulty drive. None without.
        row: class of a node whose numbers are a row of an array for compiled kernels, None without.
        node_kind: kind of node in compiled kernels, see ``cyclic.Receiver``.
    """

    node: Callable[[MotorSpec, Motor, float], DriveNode]
    numbers: range
    shaft: Shaft
    host_frame: Callable[[int], tuple[int, bytes]]
    corrupt_command: Callable[[Frame], Frame]
    corrupt_reply: Callable[[Frame], Frame] = identity
    row: Any = None
    node_kind: int = -1
    force_command: Callable[[Any, Frame], None] | None = None
