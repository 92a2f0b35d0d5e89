"""Drives that are broken on purpose: what tells a good one from a bad one must be tried on a bad one."""

from collections.abc import Callable

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes import PROTOCOLS
from firmware_sim.nodes.kind import DriveNode, Node

FAULTS = {
    "deaf": "takes no order to let go",
    "mute": "answers nothing",
    "readback": "its settings read back wrong",
    "sign": "makes torque the wrong way round",
    "watchdog": "never notices that the host is gone",
}
"""Kinds of fault, and what they do."""


class BrokenNode:
    """A node with a fault; see ``nodes.Node``."""

    def __init__(
        self, node: DriveNode, fault: str, mishear: Callable[[Frame], Frame], spoil: Callable[[Frame], Frame]
    ) -> None:
        """Args: the node; its fault; what it hears of an order to let go; what becomes of its answers."""
        self._node, self._fault, self._mishear, self._spoil = node, fault, mishear, spoil

    @property
    def wake_ns(self) -> int:
        """See ``nodes.Node``."""
        return self._node.wake_ns

    @property
    def ids(self) -> frozenset[int] | None:
        """See ``nodes.Node``."""
        return self._node.ids

    @property
    def malformed(self) -> int:
        """See ``nodes.Node``."""
        return self._node.malformed

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """See ``nodes.Node``."""
        self._feed(t_ns)
        answers = self._node.receive(self._mishear(frame) if self._fault == "deaf" else frame, t_ns)
        if self._fault == "mute":
            return [] if answers is not None else None
        return [self._spoil(answer) for answer in answers] if self._fault == "readback" and answers else answers

    def wake(self, t_ns: int) -> list[Frame] | None:
        """See ``nodes.Node``."""
        self._feed(t_ns)
        spoken = self._node.wake(t_ns)
        return None if self._fault == "mute" else spoken

    def _feed(self, t_ns: int) -> None:
        if self._fault == "watchdog" and self._node.fed_ns >= 0:
            self._node.fed_ns = t_ns


def break_node(node: DriveNode, protocol: str, fault: str) -> Node:
    """Return a node with a fault; without one the node itself."""
    if fault in ("", "sign"):
        return node
    return BrokenNode(node, fault, PROTOCOLS[protocol].mishear, PROTOCOLS[protocol].spoil)
