"""Moteus controllers as delivered. The motor and its free shaft are assumptions (mj5208 class)."""

from firmware_sim.bus.frame import EXTENDED, FDF, Frame
from firmware_sim.nodes.moteus.node import MoteusNode
from firmware_sim.nodes.protocol_spec import ProtocolSpec, Shaft

TORQUE_LIMIT_HEAD = b"\x2d\x25"
"""Head of the reply with the torque limit: one float, register 0x25."""
STOP = b"\x01\x00\x00"
"""Subframe that writes mode 0."""


def _host_frame(node_id: int) -> tuple[int, bytes]:
    """Return a read of the mode, with a reply to source 0."""
    return EXTENDED | 0x8000 | node_id, b"\x11\x00"


def _corrupt_command(frame: Frame) -> Frame:
    """Replace the write of mode 0 by mode 13 without bounds: no torque, but the power stage stays on."""
    return frame._replace(data=b"\x01\x00\x0d" + frame.data[3:]) if frame.data[:3] == STOP else frame


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the torque limit by 1 N m in a read-back."""
    return frame._replace(data=TORQUE_LIMIT_HEAD + b"\0\0\x80\x3f" + frame.data[6:]) if _is_limit(frame) else frame


def _is_limit(frame: Frame) -> bool:
    return bool(frame.flags & FDF) and frame.data[:2] == TORQUE_LIMIT_HEAD


SPEC = ProtocolSpec(MoteusNode, range(1, 0x7F), Shaft(1.7, 5e-5, 0.045), _host_frame, _corrupt_command, _corrupt_reply)
"""The moteus protocol."""
