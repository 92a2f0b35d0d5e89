"""Drives as they come out of the box: identifiers, ranges and timing of the maker, and a shaft with nothing on it.

Ranges of MIT motors: facts, mit_damiao. Inertia and friction of a free shaft are assumptions: makers seldom tell.
"""

from typing import Any

from firmware_sim.description import MotorSpec, SimulatorError

MIT_TYPES = {
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
NODES = {"mit": range(1, 0x7F0), "odrive": range(0x3F), "cia402": range(1, 0x7F)}
"""Node numbers of each protocol; the last of CANopen's is handctl's own."""
_SHAFTS = {"odrive": (2.0, 1e-4, 0.05), "cia402": (1.0, 5e-5, 0.08)}
"""Peak torque [N m], inertia [kg m2] and torque constant [N m/A] of the other protocols' motors."""
ENDPOINTS = {"endpoint_enable_watchdog": 201, "endpoint_watchdog_timeout": 202, "endpoint_torque_max": 203,
             "endpoint_torque_min": 204}  # fmt: skip
"""Of an ODrive's settings, made up here: real ones differ from firmware to firmware."""
ODRIVES: dict[str, dict[str, Any]] = {"0.6": dict(ENDPOINTS), "0.5": {"firmware": "0.5"}}
INERTIA_PER_TORQUE = 2e-4
"""Of a geared MIT motor at its output, for each N m of TMAX [kg m2/N m]: 2e-3 for the 10 N m of a DM-J4310."""
FRICTION_PART, SLOWING_S = 2e-3, 4.0
"""Coulomb friction over peak torque, and the time constant by which viscous friction slows a shaft [s]."""


def drive_spec(
    protocol: str,
    node_id: int,
    motor_type: str = "dm4310",
    fd: bool = False,
    inertia: float | None = None,
    firmware: str = "0.6",
) -> MotorSpec:
    """Return the description of a drive with a free shaft.

    Args:
        protocol: mit, odrive or cia402.
        node_id: its number on the bus.
        motor_type: of MIT_TYPES; counts for MIT only.
        fd: whether an MIT motor is set to CAN FD.
        inertia: of the shaft [kg m2]; None for the type's own.
        firmware: 0.6 or 0.5; counts for ODrives only.

    Raises:
        SimulatorError: no such number or type.
    """
    if node_id not in NODES[protocol]:
        raise SimulatorError(f"--ids {node_id}: expected {NODES[protocol].start} to {NODES[protocol].stop - 1}")
    if motor_type not in MIT_TYPES:
        raise SimulatorError(f"--motor-type {motor_type}: expected one of {', '.join(MIT_TYPES)}")
    position, velocity, peak = MIT_TYPES[motor_type]
    own, torque_constant = INERTIA_PER_TORQUE * peak, 1.0
    if protocol != "mit":
        peak, own, torque_constant = _SHAFTS[protocol]
    options: dict[str, Any] = ODRIVES[firmware] if protocol == "odrive" else {"fd": True} if fd else {}
    mass = own if inertia is None else inertia
    return MotorSpec(
        name=f"{protocol}{node_id}", protocol=protocol, bus="bench", node_id=node_id, spool_radius=1.0,
        inertia=mass, viscous=mass / SLOWING_S, coulomb=FRICTION_PART * peak, torque_constant=torque_constant,
        torque_max=peak, torque_peak=peak, position_range=position, velocity_range=velocity, direction=1, zero=0.0,
        options=options,
    )  # fmt: skip
