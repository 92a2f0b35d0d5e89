"""Damiao motors out of the box. Source of the ranges: facts, mit_damiao; a free shaft is an assumption."""

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.kind import MIT, Kind, Shaft
from firmware_sim.nodes.mit.node import REGISTER_ID, MitNode, MitNodeRow

TYPES = {
    "dm3507": (12.566, 50.0, 5.0),
    "dm4310": (12.5, 30.0, 10.0),
    "dm4310-48v": (12.5, 50.0, 10.0),
    "dm4340": (12.5, 10.0, 28.0),
    "dm6006": (12.5, 45.0, 20.0),
    "dm8006": (12.5, 45.0, 40.0),
    "dm8009": (12.5, 45.0, 54.0),
    "dm10010l": (12.5, 25.0, 200.0),
    "dm10010": (12.5, 20.0, 200.0),
    "dmh3510": (12.5, 280.0, 1.0),
    "dmh6215": (12.5, 45.0, 10.0),
}
"""PMAX [rad], VMAX [rad/s], TMAX [N m]."""
USUAL = "dm4310"
INERTIA_PER_TORQUE = 2e-4
"""Of a geared MIT motor at its output, for each N m of TMAX [kg m2/N m]: 2e-3 for the 10 N m of a DM-J4310."""


def shaft(ranges: tuple[float, float, float], **options: object) -> Shaft:
    """Return the shaft of a motor with these ranges [rad], [rad/s], [N m]."""
    position, velocity, peak = ranges
    return Shaft(peak, INERTIA_PER_TORQUE * peak, 1.0, position, velocity, dict(options))


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return node_id, bytes(8)


def _mishear(frame: Frame) -> Frame:
    """A question for feedback in place of disable: a motor that did not even answer would be no riddle."""
    question = Frame(REGISTER_ID, frame.can_id.to_bytes(2, "little") + b"\xcc" + bytes(5), frame.flags, frame.bus)
    return question if frame.data == b"\xff" * 7 + b"\xfd" else frame


def _spoil(frame: Frame) -> Frame:
    told = frame.data[2] == 0x33 and frame.data[3] == 23 and frame.data[1] == 0
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if told else frame  # TMAX reads 1


KIND = Kind(MitNode, range(1, 0x7F0), shaft(TYPES[USUAL]), _host_frame, _mishear, _spoil, MitNodeRow, MIT)
