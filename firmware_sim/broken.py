"""Drives that are broken on purpose: what tells a good one from a bad one must be tried on a bad one."""

from collections.abc import Callable

from firmware_sim.frame import EXTENDED, Frame
from firmware_sim.nodes import DriveNode, Node

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
    return BrokenNode(node, fault, _MISHEARERS[protocol], _SPOILERS[protocol])


def _mit_mishears(frame: Frame) -> Frame:
    """A question for feedback in place of disable: a motor that did not even answer would be no riddle."""
    question = Frame(0x7FF, frame.can_id.to_bytes(2, "little") + b"\xcc" + bytes(5), frame.flags, frame.bus)
    return question if frame.data == b"\xff" * 7 + b"\xfd" else frame


def _odrive_mishears(frame: Frame) -> Frame:
    command = frame.can_id & 0x1F
    order = command == 0x02 or (command == 0x07 and frame.data[:1] == b"\1")
    return _NOTHING if order else frame


def _cia402_mishears(frame: Frame) -> Frame:
    let_go = 0x200 < frame.can_id < 0x280 and len(frame.data) >= 2 and not frame.data[0] & 0x02
    order = let_go or (frame.can_id == 0 and frame.data[:1] in (b"\2", b"\x80", b"\x81", b"\x82"))
    return _NOTHING if order else frame


_NOTHING = Frame(EXTENDED, b"")
"""A frame for nobody."""


def _mit_spoiler(frame: Frame) -> Frame:
    told = frame.data[2] == 0x33 and frame.data[3] == 23 and frame.data[1] == 0
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if told else frame  # TMAX reads 1


def _odrive_spoiler(frame: Frame) -> Frame:
    told = frame.can_id & 0x1F == 0x05 and len(frame.data) == 8
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if told else frame


def _cia402_spoiler(frame: Frame) -> Frame:
    told = 0x580 < frame.can_id < 0x600 and frame.data[:4] == b"\x4b\x72\x60\x00"
    return frame._replace(data=frame.data[:4] + b"\xff\xff\0\0") if told else frame  # 0x6072 reads 65535


_MISHEARERS = {"mit": _mit_mishears, "odrive": _odrive_mishears, "cia402": _cia402_mishears}
_SPOILERS = {"mit": _mit_spoiler, "odrive": _odrive_spoiler, "cia402": _cia402_spoiler}
