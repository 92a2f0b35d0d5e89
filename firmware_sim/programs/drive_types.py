"""Drives as they come out of the box: identifiers, ranges and timing of the maker, and a shaft with nothing on it."""

from firmware_sim.description import MotorSpec, SimulatorError
from firmware_sim.nodes import PROTOCOLS, cubemars
from firmware_sim.nodes.kind import Shaft
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.nodes.odrive import bench as odrive_bench

MIT_TYPES = {**dict.fromkeys(mit_bench.TYPES, "mit"), **dict.fromkeys(cubemars.FULL_SCALE, "cubemars")}
"""Motors that speak MIT mode, and the protocol by whose name handctl drives them."""
FRICTION_PART, SLOWING_S = 2e-3, 4.0
"""Coulomb friction over peak torque, and the time constant by which viscous friction slows a shaft [s]."""


def drive_spec(
    protocol: str,
    node_id: int,
    motor_type: str = "",
    fd: bool = False,
    inertia: float | None = None,
    firmware: str = "0.6",
) -> MotorSpec:
    """Return the description of a drive with a free shaft.

    Args:
        protocol: of nodes.PROTOCOLS; mit with a CubeMars type is cubemars.
        node_id: its number on the bus.
        motor_type: of MIT_TYPES; the protocol's usual one if empty.
        fd: whether an MIT motor is set to CAN FD.
        inertia: of the shaft [kg m2]; None for the type's own.
        firmware: 0.6 or 0.5; counts for ODrives only.

    Raises:
        SimulatorError: no such number or type.
    """
    if motor_type and MIT_TYPES.get(motor_type, protocol) != protocol != "mit":
        raise SimulatorError(f"--motor-type {motor_type}: {protocol} has no such motor")
    if motor_type and motor_type not in MIT_TYPES:
        raise SimulatorError(f"--motor-type {motor_type}: expected one of {', '.join(MIT_TYPES)}")
    protocol = MIT_TYPES.get(motor_type, protocol)
    kind = PROTOCOLS[protocol]
    if node_id not in kind.numbers:
        raise SimulatorError(f"--ids {node_id}: expected {kind.numbers.start} to {kind.numbers.stop - 1}")
    shaft = _shaft(protocol, motor_type, fd, firmware)
    mass = shaft.inertia if inertia is None else inertia
    return MotorSpec(
        name=f"{protocol}{node_id}", protocol=protocol, bus="bench", node_id=node_id, spool_radius=1.0,
        inertia=mass, viscous=mass / SLOWING_S, coulomb=FRICTION_PART * shaft.peak,
        torque_constant=shaft.torque_constant, torque_max=shaft.peak, torque_peak=shaft.peak,
        position_range=shaft.position, velocity_range=shaft.velocity, direction=1, zero=0.0, options=shaft.options,
    )  # fmt: skip


def _shaft(protocol: str, motor_type: str, fd: bool, firmware: str) -> Shaft:
    """The motor with what was asked of it."""
    if protocol == "odrive":
        return odrive_bench.shaft(firmware)
    if protocol == "cubemars":
        return cubemars.shaft(motor_type or cubemars.USUAL)
    if protocol == "mit":
        ranges = mit_bench.TYPES[motor_type or mit_bench.USUAL]
        return mit_bench.shaft(ranges, fd=True) if fd else mit_bench.shaft(ranges)
    return PROTOCOLS[protocol].shaft
