"""Drives as the manufacturer delivers them.

Identifiers, ranges and timing are as the manufacturer delivers them. The shaft of each drive is
free.
"""

from firmware_sim.description.hand_description import MotorSpec, SimulatorError
from firmware_sim.nodes import PROTOCOL_SPECS, cubemars
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.nodes.odrive import bench as odrive_bench
from firmware_sim.nodes.protocol_spec import ShaftSpec
from firmware_sim.nodes.robstride import bench as robstride_bench
from firmware_sim.nodes.robstride.node import FULL_SCALE_BY_MOTOR_TYPE

MIT_PROTOCOL_BY_MOTOR_TYPE = {
    **dict.fromkeys(mit_bench.MOTOR_TYPE_RANGES, "mit"),
    **dict.fromkeys(cubemars.FULL_SCALE_BY_MOTOR_TYPE, "cubemars"),
}
"""Name of the handctl protocol for each motor type that has an MIT mode."""
ROBSTRIDE_PROTOCOLS = ("robstride", "robstride_mit")
"""Protocols of RobStride motors."""
ROBSTRIDE_MOTOR_TYPES = tuple(FULL_SCALE_BY_MOTOR_TYPE)
"""Names of the RobStride motor models."""
FRICTION_FRACTION = 2e-3
"""Coulomb friction of a shaft, as a fraction of the motor's peak torque."""
COASTING_TIME_CONSTANT_S = 4.0
"""Time constant with which viscous friction slows a free shaft [s]."""


def drive_spec(
    protocol: str,
    node_id: int,
    motor_type: str = "",
    fd: bool = False,
    inertia: float | None = None,
    firmware: str = "0.6",
) -> MotorSpec:
    """Build the description of a drive with a free shaft.

    Args:
        protocol: key of ``nodes.PROTOCOL_SPECS``. If the protocol is ``mit`` and the motor type is
            a type of CubeMars, the drive uses the protocol ``cubemars``.
        node_id: node number of the drive.
        motor_type: motor type of the protocol, such as a key of ``MIT_PROTOCOL_BY_MOTOR_TYPE``, empty for the
            default of the protocol.
        fd: True for an MIT motor whose settings select CAN FD.
        inertia: inertia of the shaft [kg m2], or None for the default inertia of the motor type.
        firmware: firmware version of an ODrive, 0.6 or 0.5. Drives with other protocols ignore the
            firmware version.

    Raises:
        SimulatorError: the node number or the motor type is not valid for the protocol.
    """
    _check_type(protocol, motor_type)
    protocol = MIT_PROTOCOL_BY_MOTOR_TYPE.get(motor_type, protocol)
    protocol_spec = PROTOCOL_SPECS[protocol]
    if node_id not in protocol_spec.numbers:
        raise SimulatorError(
            f"--ids {node_id}: expected {protocol_spec.numbers.start} to {protocol_spec.numbers.stop - 1}"
        )
    shaft = _shaft_of_type(protocol, motor_type, fd, firmware)
    rotor_inertia = shaft.inertia if inertia is None else inertia
    return MotorSpec(
        name=f"{protocol}{node_id}", protocol=protocol, bus="bench", node_id=node_id, spool_radius=1.0,
        inertia=rotor_inertia, viscous=rotor_inertia / COASTING_TIME_CONSTANT_S, coulomb=FRICTION_FRACTION * shaft.peak,
        torque_constant=shaft.torque_constant,
        torque_max=shaft.peak, torque_peak=min(shaft.peak, shaft.limit),
        position_range=shaft.position, velocity_range=shaft.velocity, direction=1, zero_angle=0.0,
        options=shaft.options, top_speed=shaft.top_speed, stall_torque=shaft.stall_torque,
    )  # fmt: skip


def _check_type(protocol: str, motor_type: str) -> None:
    """Check that a motor type fits a drive protocol. The protocol ``mit`` fits all motor types with an MIT mode.

    Raises:
        SimulatorError: the motor type does not exist, or uses another protocol.
    """
    types = (
        ROBSTRIDE_MOTOR_TYPES
        if protocol in ROBSTRIDE_PROTOCOLS
        else tuple(MIT_PROTOCOL_BY_MOTOR_TYPE)
    )
    if motor_type and MIT_PROTOCOL_BY_MOTOR_TYPE.get(motor_type, protocol) != protocol != "mit":
        raise SimulatorError(f"--motor-type {motor_type}: {protocol} has no such motor")
    if motor_type and motor_type not in types:
        raise SimulatorError(f"--motor-type {motor_type}: expected one of {', '.join(types)}")


def _shaft_of_type(protocol: str, motor_type: str, fd: bool, firmware: str) -> ShaftSpec:
    """Build the description of the shaft of a motor type."""
    if protocol == "odrive":
        return odrive_bench.shaft_of_odrive(firmware)
    if protocol in ROBSTRIDE_PROTOCOLS and motor_type:
        shaft = robstride_bench.shaft_of_robstride_motor(motor_type)
        return shaft._replace(options=PROTOCOL_SPECS[protocol].shaft.options | shaft.options)
    if protocol == "cubemars":
        return cubemars.shaft_of_cubemars_motor(motor_type or cubemars.DEFAULT_MOTOR_TYPE)
    if protocol == "mit":
        kind = motor_type or mit_bench.DEFAULT_MOTOR_TYPE
        return (
            mit_bench.shaft_of_mit_motor(kind, fd=True)
            if fd
            else mit_bench.shaft_of_mit_motor(kind)
        )
    return PROTOCOL_SPECS[protocol].shaft
