"""Objects of a CiA 402 drive with the values that handctl requires before arming.

The host writes the objects of the drive by SDO, and reads the objects back.

RPDO1 has transmission type 255, so that the drive applies the target torque when the RPDO arrives.
The target torque thus takes effect in the tick that has computed the torque, as in the other drive
protocols. TPDO1 has transmission type 1, so that the drive measures and sends the values of TPDO1
at each SYNC. If the heartbeat of the host is missing, the drive goes into fault (objects 0x1016,
0x6007).
"""

from handctl.drives.canopen.codec import RPDO, TPDO
from handctl.drives.canopen.setup import (
    HOST_NODE,
    PDO_DISABLED_BIT,
    SERIAL_NUMBER,
    ObjectCheck,
    SetupStep,
    pdo_steps,
)
from handctl.drives.cia402.codec import DISABLE_VOLTAGE

POSITION_MODE = 8
"""Mode of operation for cyclic synchronous position."""
VELOCITY_MODE = 9
"""Mode of operation for cyclic synchronous velocity."""
TORQUE_MODE = 10
"""Mode of operation for cyclic synchronous torque."""
TARGET_OBJECTS = {POSITION_MODE: (0x607A, 4), VELOCITY_MODE: (0x60FF, 4), TORQUE_MODE: (0x6071, 2)}
"""For each mode of operation, the object with the target value, and the size of the target value in bytes."""
HEARTBEAT_SUPERVISION_OFF = 0x1016, 1, (HOST_NODE << 16).to_bytes(4, "little")
"""Object for the supervision of the host's heartbeat: index, sub-index, and the value 0 that ends the supervision."""

PROTECTION_OBJECTS = ((0x1016, 1), (0x6072, 0), (0x6080, 0))
"""Objects of the protections in the drive: supervision of the host's heartbeat, maximum torque, maximum speed.

The maximum speed is required only in the position and velocity modes.
"""


def required_steps(
    node_id: int,
    rated_torque: int,
    max_torque: int,
    watchdog_ms: int,
    heartbeat_ms: int,
    mode: int = TORQUE_MODE,
) -> tuple[SetupStep, ...]:
    """Return the objects that the host writes and reads back before arming, in the order of the SDO requests.

    Args:
        node_id: node number of the drive.
        rated_torque: rated torque of the drive, in the unit of object 0x6076.
        max_torque: maximum torque [1/1000 of rated].
        watchdog_ms: time without a heartbeat of this host after which the drive goes into fault
            [ms].
        heartbeat_ms: period of the drive's heartbeat [ms].
        mode: mode of operation of the drive, a key of ``TARGET_OBJECTS``.
    """
    target, size = TARGET_OBJECTS[mode]
    equal, bits_set, write, write_optional, read, *_ = ObjectCheck
    pdo_bases = ((0x1400, RPDO), (0x1800, TPDO))
    # PDOs 2 to 4 are switched off. The parameter records of PDOs 2 to 4 have consecutive indices.
    # The default identifiers of PDOs 2 to 4 differ by 0x100.
    disabling_steps = [
        SetupStep(write_optional, base + i, 1, PDO_DISABLED_BIT | cob + 0x100 * i + node_id, 4)
        for base, cob in pdo_bases
        for i in (1, 2, 3)
    ]
    return (
        # 0x0192 is 402, the profile number in the low word of the device type.
        SetupStep(bits_set, 0x1000, 0, 0x0192, 4),
        SetupStep(read, *SERIAL_NUMBER, 0, 4),
        SetupStep(write, 0x6040, 0, DISABLE_VOLTAGE, 2),
        # Object 0x6502 contains one bit for each mode of operation that a drive can support. Bit 9
        # stands for mode 10, cyclic synchronous torque.
        SetupStep(bits_set, 0x6502, 0, 1 << mode - 1, 4),
        SetupStep(equal, 0x6076, 0, rated_torque, 4),
        SetupStep(write, 0x6072, 0, max_torque, 2),
        SetupStep(write, 0x6071, 0, 0, 2),
        # With the value 1 of the abort connection option, the drive goes into fault when the
        # heartbeat of the host is missing.
        SetupStep(write, 0x6007, 0, 1, 2),
        SetupStep(write, 0x1016, 1, HOST_NODE << 16 | watchdog_ms, 4),
        SetupStep(write, 0x1017, 0, heartbeat_ms, 2),
        SetupStep(write, 0x6060, 0, mode, 1),
        SetupStep(equal, 0x6061, 0, mode, 1),
        *disabling_steps,
        *pdo_steps(0x1400, 0x1600, RPDO + node_id, 255, (0x6040_00_10, target << 16 | 8 * size)),
        *pdo_steps(0x1800, 0x1A00, TPDO + node_id, 1, (0x6041_00_10, 0x6064_00_20, 0x6077_00_10)),
    )
