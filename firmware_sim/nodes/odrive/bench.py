"""ODrives out of the box; a free shaft, and the numbers of endpoints, are assumptions."""

from typing import Any

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.kind import NOTHING, ODRIVE, Kind, Shaft
from firmware_sim.nodes.odrive.node import OdriveNode, OdriveNodeRow

ENDPOINTS = {"endpoint_enable_watchdog": 201, "endpoint_watchdog_timeout": 202, "endpoint_torque_max": 203,
             "endpoint_torque_min": 204}  # fmt: skip
"""Of an ODrive's settings, made up here: real ones differ from firmware to firmware."""
FIRMWARES: dict[str, dict[str, Any]] = {"0.6": dict(ENDPOINTS), "0.5": {"firmware": "0.5"}}


def shaft(firmware: str) -> Shaft:
    """Return the motor of an ODrive with firmware 0.6 or 0.5."""
    return Shaft(2.0, 1e-4, 0.05, options=FIRMWARES[firmware])


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return node_id << 5 | 0x18, b""


def _mishear(frame: Frame) -> Frame:
    command = frame.can_id & 0x1F
    order = command == 0x02 or (command == 0x07 and frame.data[:1] == b"\1")
    return NOTHING if order else frame


def _spoil(frame: Frame) -> Frame:
    told = frame.can_id & 0x1F == 0x05 and len(frame.data) == 8
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if told else frame


KIND = Kind(OdriveNode, range(0x3F), shaft("0.6"), _host_frame, _mishear, _spoil, OdriveNodeRow, ODRIVE)
