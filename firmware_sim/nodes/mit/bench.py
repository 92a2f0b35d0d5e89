"""Damiao motors as delivered.

The data of the free shaft are assumptions. Source of the ranges: fact sheet mit_damiao.
"""

import math
from typing import NamedTuple

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.mit.codec import PAYLOAD_WORD_STRUCT, apply_command
from firmware_sim.nodes.mit.node import REGISTER_ID, MitNode, MitNodeRow
from firmware_sim.nodes.protocol_spec import MIT_KIND, ProtocolSpec, ShaftSpec

MOTOR_TYPE_RANGES = {
    "dm3507": (12.566, 50.0, 5.0),
    "dm4310": (12.5, 30.0, 10.0),
    "dm4310-48v": (12.5, 50.0, 10.0),
    "dm4310v": (3.1415926, 30.0, 10.0),
    "dm4340": (12.5, 10.0, 28.0),
    "dm4340-48v": (12.5, 10.0, 28.0),
    "dm6006": (12.5, 45.0, 20.0),
    "dm6248": (12.566, 20.0, 120.0),
    "dm8006": (12.5, 45.0, 40.0),
    "dm8009": (12.5, 45.0, 54.0),
    "dm10010l": (12.5, 25.0, 200.0),
    "dm10010": (12.5, 20.0, 200.0),
    "dmh3510": (12.5, 280.0, 1.0),
    "dmh6215": (12.5, 45.0, 10.0),
    "dmg6220": (12.5, 45.0, 10.0),
}
"""PMAX [rad], VMAX [rad/s] and TMAX [N m] of each motor type.

The fact sheet lacks some types. The ranges of the types that the fact sheet lacks come from public
client software: DM4310V from i2rt, DM6248 from openarm_can.
"""


class MotorRating(NamedTuple):
    """Rated values of a motor type at the output shaft, and the supply voltage.

    Attributes:
        peak: peak torque of the motor [N m].
        no_load_speed: speed of the motor without load [1/min].
        torque_constant: torque of the motor per phase current [N m/A].
        resistance: resistance of a motor phase [ohm].
        supply_voltage: supply voltage of the drive [V].
    """

    peak: float
    no_load_speed: float
    torque_constant: float
    resistance: float
    supply_voltage: float = 24.0

    @property
    def top_speed(self) -> float:
        """Return the speed of the motor without load [rad/s]."""
        return self.no_load_speed * math.tau / 60.0

    @property
    def stall_torque(self) -> float:
        """Return the torque of the motor at standstill, if only the supply voltage limits the torque [N m]."""
        # With space-vector modulation, the largest amplitude of a phase voltage is the supply
        # voltage divided by sqrt(3).
        return self.torque_constant * self.supply_voltage / math.sqrt(3.0) / self.resistance


MOTOR_RATINGS = {
    "dm3507": MotorRating(3.0, 460.0, 0.5439, 0.8),
    "dm4310": MotorRating(7.0, 200.0, 0.945, 0.85),
    "dm4310-48v": MotorRating(7.0, 400.0, 0.945, 0.85, 48.0),
    "dm4310v": MotorRating(7.0, 200.0, 0.945, 0.85),
    "dm4340": MotorRating(27.0, 52.5, 4.074, 0.88),
    "dm4340-48v": MotorRating(27.0, 100.0, 4.074, 0.88, 48.0),
    "dm6006": MotorRating(11.0, 226.0, 0.7308, 0.435),
    "dm8006": MotorRating(20.0, 194.2, 1.0206, 0.4),
    "dm8009": MotorRating(40.0, 168.0, 1.261575, 0.145),
    "dm10010l": MotorRating(120.0, 100.0, 2.00025, 0.11),
    "dm10010": MotorRating(150.0, 75.0, 2.59875, 0.125),
}
"""Published ratings by motor type. Source: wiki of Seeed Studio, table in "Damiao Series"."""
GEAR_RATIOS = {
    "dm3507": 7.0,
    "dm4310": 10.0,
    "dm4310-48v": 10.0,
    "dm4310v": 10.0,
    "dm4340": 40.0,
    "dm4340-48v": 40.0,
    "dm6006": 6.0,
    "dm6248": 48.0,
    "dm8006": 6.0,
    "dm8009": 9.0,
    "dm10010l": 10.0,
    "dm10010": 10.0,
    "dmh3510": 1.0,
    "dmh6215": 1.0,
    "dmg6220": 1.0,
}
"""Value of the register gear ratio of each motor type.

The client i2rt 1.3.6 has a table of gear ratios for DM3507, DM4310, DM4310V, DM4340, DM6248 and
DM8009. The client refuses a motor whose register differs from the table. The gear ratios of all
other types are assumptions: the last two digits of the type, and 1 for motors without a gear.
"""
STALL_TORQUE_RATIO = 2.0
"""Ratio of the stall torque to TMAX, for motor types without a published rating.

The no-load speed of motor types without a published rating is VMAX.

The ratio and the no-load speed are assumptions.
"""
DEFAULT_MOTOR_TYPE = "dm4310"
"""Motor type if none is given."""
INERTIA_PER_TORQUE = 2e-4
"""Inertia of a geared MIT motor at the output, divided by TMAX [kg m2/N m].

A DM-J4310 with TMAX 10 N m has an inertia of 2e-3 kg m2.
"""


def shaft_of_mit_motor(motor_type: str, **options: object) -> ShaftSpec:
    """Build the description of the shaft of a motor type.

    Args:
        motor_type: key of ``MOTOR_TYPE_RANGES``.
        options: options of the motor, as in a hand file.
    """
    position, velocity, peak = MOTOR_TYPE_RANGES[motor_type]
    inertia = INERTIA_PER_TORQUE * peak
    if motor_type not in MOTOR_RATINGS:
        limits = peak, velocity, STALL_TORQUE_RATIO * peak
    else:
        rating = MOTOR_RATINGS[motor_type]
        limits = rating.peak, rating.top_speed, rating.stall_torque
    options = {"gear_ratio": GEAR_RATIOS[motor_type], **options}
    return ShaftSpec(peak, inertia, 1.0, position, velocity, options, *limits)


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return node_id, bytes(8)


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace the command *disable* by a request for feedback.

    The faulty motor answers the request for feedback, but stays enabled.
    """
    # The identifiers of remote and extended frames have flags above the lowest 11 bits of the
    # identifier.
    if frame.data != b"\xff" * 7 + b"\xfd" or frame.can_id > 0x7FF:
        return frame
    data = frame.can_id.to_bytes(2, "little") + b"\xcc" + bytes(5)
    return Frame(REGISTER_ID, data, frame.flags, frame.bus)


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the value of the register TMAX by 1 in the reply to a read request."""
    # The function changes only replies to a read request (0x33) for register 23 (TMAX), from motors
    # with an identifier below 0x100.
    data = frame.data
    is_corrupted = len(data) == 8 and data[2] == 0x33 and data[3] == 23 and data[1] == 0
    return (
        frame._replace(data=frame.data[:4] + b"\0\0\x80\x3f") if is_corrupted else frame
    )  # the value of TMAX becomes 1


def _force_command(node: MitNode, frame: Frame) -> None:
    """Apply an MIT command in any state of the motor."""
    if frame.can_id == node.node_id and len(frame.data) == 8 and frame.data[:7] != b"\xff" * 7:
        apply_command(node, node.motor.servo, PAYLOAD_WORD_STRUCT.unpack(frame.data)[0])


MIT_SPEC = ProtocolSpec(
    MitNode, range(1, 0x7F0), shaft_of_mit_motor(DEFAULT_MOTOR_TYPE), _host_frame,
    _make_ineffective_disable, _corrupt_reply,
    MitNodeRow,
    MIT_KIND, _force_command,
)  # fmt: skip
"""Specification of the MIT protocol with Damiao motors."""
