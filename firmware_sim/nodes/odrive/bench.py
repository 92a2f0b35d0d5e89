"""ODrives as delivered. The motor data of the free shaft, and the endpoint numbers of the settings, are assumed."""

import struct
from typing import Any

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.odrive.node import OdriveNode, OdriveNodeRow
from firmware_sim.nodes.protocol_spec import FRAME_FOR_NO_NODE, ODRIVE_KIND, ProtocolSpec, ShaftSpec

ENDPOINT_NUMBERS = {"endpoint_enable_watchdog": 201, "endpoint_watchdog_timeout": 202, "endpoint_torque_max": 203,
             "endpoint_torque_min": 204}  # fmt: skip
"""Assumed endpoint numbers of an ODrive's settings.

The real endpoint numbers differ between firmware versions.
"""
TORQUE_CONSTANT = 0.05
"""Assumed torque constant of the motor [N m/A]."""
TOP_SPEED = 24.0 / TORQUE_CONSTANT
"""Speed of the motor without load at 24 V [rad/s].

In SI units, the voltage constant and the torque constant of a motor are equal.
"""
FIRMWARE_OPTIONS: dict[str, dict[str, Any]] = {
    "0.6": dict(ENDPOINT_NUMBERS),
    "0.5": {"firmware": "0.5"},
}
"""Options that a hand file needs for each firmware version."""


def shaft_of_odrive(firmware: str) -> ShaftSpec:
    """Build the description of the shaft of a motor on an ODrive, for firmware 0.6 or 0.5."""
    limits = {"top_speed": TOP_SPEED, "stall_torque": 8.0}
    return ShaftSpec(2.0, 1e-4, TORQUE_CONSTANT, options=FIRMWARE_OPTIONS[firmware], **limits)


def _host_frame(node_id: int) -> tuple[int, bytes]:
    """Return the command Clear_Errors, which has no effect on a drive without errors."""
    return node_id << 5 | 0x18, b""


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace a command Estop or Set_Axis_State(IDLE) by a frame that no node receives."""
    command = frame.can_id & 0x1F
    is_release_command = command == 0x02 or (command == 0x07 and frame.data[:1] == b"\1")
    return FRAME_FOR_NO_NODE if is_release_command else frame


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the value of an endpoint by 1 in the reply to a read request."""
    is_corrupted = frame.can_id & 0x1F == 0x05 and len(frame.data) == 8
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if is_corrupted else frame


def _force_command(node: OdriveNode, frame: Frame) -> None:
    """Follow the command Set_Input_Torque in any state of the drive."""
    if frame.can_id == node.node_id << 5 | 0x0E and len(frame.data) >= 4:
        servo = node.motor.servo
        servo.limit = node.peak
        servo.torque = node.direction * node.gear * struct.unpack_from("<f", frame.data)[0]


ODRIVE_SPEC = ProtocolSpec(
    OdriveNode, range(0x3F), shaft_of_odrive("0.6"), _host_frame,
    _make_ineffective_disable, _corrupt_reply, OdriveNodeRow,
    ODRIVE_KIND,
    _force_command,
)  # fmt: skip
"""Specification of the ODrive protocol for simulated drives."""
