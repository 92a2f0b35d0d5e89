"""Moteus controllers as delivered.

The data of the motor and of the free shaft are assumptions for a motor such as the mj5208.
"""

from firmware_sim.bus.frame import EXTENDED_FLAG, FDF, Frame
from firmware_sim.nodes.moteus.node import MoteusNode
from firmware_sim.nodes.protocol_spec import ProtocolSpec, ShaftSpec

TORQUE_LIMIT_HEAD = b"\x2d\x25"
"""First bytes of the reply with the torque limit: one float from register 0x25."""
STOP_PAYLOAD = b"\x01\x00\x00"
"""Subframe that writes the mode 0 (stopped)."""


def _host_frame(node_id: int) -> tuple[int, bytes]:
    """Return a request that reads the mode of a moteus controller.

    The request states that the sender has number 0. The controller sends its reply to the number 0.
    """
    return EXTENDED_FLAG | 0x8000 | node_id, b"\x11\x00"


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace the command of mode 0 by the command of mode 13 (*stay within*) without bounds.

    In mode 13 without bounds, the drive makes no torque, but keeps the power stage on.
    """
    return (
        frame._replace(data=b"\x01\x00\x0d" + frame.data[3:])
        if frame.data[:3] == STOP_PAYLOAD
        else frame
    )


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the torque limit by 1 N m in the reply to a read request."""
    return (
        frame._replace(data=TORQUE_LIMIT_HEAD + b"\0\0\x80\x3f" + frame.data[6:])
        if _is_torque_limit_frame(frame)
        else frame
    )


def _is_torque_limit_frame(frame: Frame) -> bool:
    return bool(frame.flags & FDF) and frame.data[:2] == TORQUE_LIMIT_HEAD


MOTEUS_SPEC = ProtocolSpec(
    MoteusNode,
    range(1, 0x7F),
    ShaftSpec(1.7, 5e-5, 0.045),
    _host_frame,
    _make_ineffective_disable,
    _corrupt_reply,
)
"""Specification of the moteus protocol for simulated drives."""
