"""Drives with deliberate faults, for tests of the programs that must find faulty drives."""

from collections.abc import Callable

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes import PROTOCOLS
from firmware_sim.nodes.protocol_spec import DriveNode, Node

FAULTS = {
    "deaf": "ignores commands to disable",
    "mute": "never answers",
    "readback": "reads back wrong settings",
    "sign": "makes torque of the wrong sign",
    "watchdog": "its watchdog never fires",
}
"""Effect of each kind of fault."""


class FaultyDrive:
    """A drive node with a fault. See ``nodes.Node``."""

    def __init__(
        self,
        node: DriveNode,
        fault: str,
        corrupt_command: Callable[[Frame], Frame],
        corrupt_reply: Callable[[Frame], Frame],
    ) -> None:
        """Wrap a node.

        Args:
            node: the node.
            fault: key of ``FAULTS``.
            corrupt_command: replaces a command to disable.
            corrupt_reply: replaces the reply of a read-back.
        """
        self._node = node
        self._fault = fault
        self._corrupt_command = corrupt_command
        self._corrupt_reply = corrupt_reply

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
        answers = self._node.receive(self._corrupt_command(frame) if self._fault == "deaf" else frame, t_ns)
        if self._fault == "mute":
            return [] if answers is not None else None
        return [self._corrupt_reply(answer) for answer in answers] if self._fault == "readback" and answers else answers

    def wake(self, t_ns: int) -> list[Frame] | None:
        """See ``nodes.Node``."""
        self._feed(t_ns)
        unsolicited = self._node.wake(t_ns)
        return None if self._fault == "mute" else unsolicited

    def _feed(self, t_ns: int) -> None:
        if self._fault == "watchdog" and self._node.watchdog_fed_ns >= 0:
            # Every event feeds the watchdog, so that it never fires.
            self._node.watchdog_fed_ns = t_ns


def with_fault(node: DriveNode, protocol: str, fault: str) -> Node:
    """Return a node with a fault, or the node itself without a fault.

    Args:
        node: the node.
        protocol: key of ``PROTOCOLS``.
        fault: key of ``FAULTS``, empty for none. ``sign`` is a fault of the motor, which the caller
            sets.
    """
    if fault in ("", "sign"):
        return node
    return FaultyDrive(node, fault, PROTOCOLS[protocol].corrupt_command, PROTOCOLS[protocol].corrupt_reply)
