"""Damiao motors as delivered. Source of the ranges: facts, mit_damiao. The free shaft is an assumption."""

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.mit.codec import WORD, apply_command
from firmware_sim.nodes.mit.node import REGISTER_ID, MitNode, MitNodeRow
from firmware_sim.nodes.protocol_spec import MIT, ProtocolSpec, Shaft

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
"""PMAX [rad], VMAX [rad/s] and TMAX [N m] of each motor type."""
DEFAULT_TYPE = "dm4310"
"""Default motor type."""
INERTIA_PER_TORQUE = 2e-4
"""Output inertia of a geared MIT motor for each N m of TMAX [kg m2/N m]: 2e-3 for the 10 N m of a DM-J4310."""


def shaft(ranges: tuple[float, float, float], **options: object) -> Shaft:
    """Build the shaft of a motor.

    Args:
        ranges: position [rad], velocity [rad/s] and torque [N m].
        options: options of the hand file.
    """
    position, velocity, peak = ranges
    return Shaft(peak, INERTIA_PER_TORQUE * peak, 1.0, position, velocity, dict(options))


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return node_id, bytes(8)


def _corrupt_command(frame: Frame) -> Frame:
    """Replace disable by a request for feedback, so that the faulty motor still answers."""
    refresh = Frame(REGISTER_ID, frame.can_id.to_bytes(2, "little") + b"\xcc" + bytes(5), frame.flags, frame.bus)
    return refresh if frame.data == b"\xff" * 7 + b"\xfd" else frame


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the value of TMAX by 1 in a read-back."""
    # Read (0x33) of register 23 (TMAX) by an identifier below 0x100.
    matches = frame.data[2] == 0x33 and frame.data[3] == 23 and frame.data[1] == 0
    return frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if matches else frame  # TMAX reads 1


def _force_command(node: MitNode, frame: Frame) -> None:
    """Apply an MIT command in any state."""
    if frame.can_id == node.node_id and len(frame.data) == 8 and frame.data[:7] != b"\xff" * 7:
        apply_command(node, node.motor.servo, WORD.unpack(frame.data)[0])


SPEC = ProtocolSpec(
    MitNode, range(1, 0x7F0), shaft(TYPES[DEFAULT_TYPE]), _host_frame, _corrupt_command, _corrupt_reply, MitNodeRow,
    MIT, _force_command,
)  # fmt: skip
"""The MIT protocol with Damiao motors."""
