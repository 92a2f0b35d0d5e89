"""RobStride motors as delivered.

The data of the free shaft are assumptions. Source of the ranges: docs/facts/robstride.md.
"""

from firmware_sim.bus.frame import EXTENDED_FLAG, Frame
from firmware_sim.nodes.protocol_spec import ProtocolSpec, ShaftSpec
from firmware_sim.nodes.robstride.node import (
    DEFAULT_MOTOR_TYPE,
    FULL_SCALE_BY_MOTOR_TYPE,
    POSITION_RANGE,
    RobstrideNode,
)

INERTIA_PER_TORQUE = 2e-4
"""Output inertia divided by the torque at full scale [kg m2/N m]. Other geared motors have the same ratio."""


def shaft_of_robstride_motor(motor_type: str) -> ShaftSpec:
    """Build the description of the shaft of a motor type."""
    velocity, peak, _, _ = FULL_SCALE_BY_MOTOR_TYPE[motor_type]
    return ShaftSpec(
        peak, INERTIA_PER_TORQUE * peak, 1.0, POSITION_RANGE, velocity, {"motor_type": motor_type}
    )


def _host_frame(node_id: int) -> tuple[int, bytes]:
    """Return a request that reads parameter 0x7019, the position."""
    return EXTENDED_FLAG | 0x11 << 24 | 0xFD00 | node_id, b"\x19\x70" + bytes(6)


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace a stop command by a control command with zero torque, so that the motor stays enabled."""
    number = frame.can_id & ~EXTENDED_FLAG
    if number >> 24 != 4 or frame.data[:1] != b"\0":
        return frame
    zero_torque_id = EXTENDED_FLAG | 1 << 24 | 0x7FFF00 | number & 0xFF
    return frame._replace(can_id=zero_torque_id, data=b"\x7f\xff\x7f\xff\0\0\0\0")


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the torque limit by 1 N m in the reply to a read request."""
    is_corrupted = (frame.can_id & ~EXTENDED_FLAG) >> 24 == 0x11 and frame.data[:2] == b"\x0b\x70"
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if is_corrupted else frame


def _force_command(node: RobstrideNode, frame: Frame) -> None:
    """Follow a control command in any mode of the motor."""
    number = frame.can_id & ~EXTENDED_FLAG
    if number >> 24 == 1 and number & 0xFF == node.node_id and len(frame.data) == 8:
        node.follow(number >> 8 & 0xFFFF, frame.data)


ROBSTRIDE_SPEC = ProtocolSpec(
    RobstrideNode, range(1, 0x80), shaft_of_robstride_motor(DEFAULT_MOTOR_TYPE), _host_frame, _make_ineffective_disable,
    _corrupt_reply,
    force_command=_force_command,
)  # fmt: skip
"""Specification of RobStride's private protocol for simulated drives."""
