"""What sits on the bus: one module per drive protocol, and the sensor node."""

from collections.abc import Callable
from typing import Protocol

from firmware_sim.description import MotorSpec
from firmware_sim.frame import Frame
from firmware_sim.motor import Motor
from firmware_sim.nodes.cia402 import Cia402Node
from firmware_sim.nodes.mit import MitNode
from firmware_sim.nodes.odrive import OdriveNode


class Node(Protocol):
    """A simulated node; time is passed in.

    Attributes:
        wake_ns: when it wants ``wake`` to be called next [ns].
        malformed: frames on its own identifiers that it could not read.
    """

    @property
    def wake_ns(self) -> int: ...
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


PROTOCOLS: dict[str, Callable[[MotorSpec, Motor, float], DriveNode]] = {
    "cia402": Cia402Node,
    "mit": MitNode,
    "odrive": OdriveNode,
}
"""Name in the hand file to a node, made of the motor, its rotor and the angle its encoder shows at theta = 0 [rad]."""
