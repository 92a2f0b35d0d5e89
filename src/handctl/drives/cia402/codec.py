"""CANopen frames of a CiA 402 drive: PDOs, power states, and errors.

All fields of the frames are little-endian. The identifier of a frame is the sum of a base
identifier and the node number n. ``canopen.codec`` has the frames that do not depend on the device
profile.

    frame      identifier  to     bytes and fields
    EMCY       0x080 + n   host   0..1 error code | 2 error register | 3..7 of the maker
    RPDO1      0x200 + n   drive  0..1 control word | 2..3 target torque int16 [1/1000 of rated]
               in mode 8           0..1 control word | 2..5 target position int32 [count]
               in mode 9           0..1 control word | 2..5 target velocity int32 [1/min or count/s]
    TPDO1      0x180 + n   host   0..1 status word | 2..5 position int32 [count] | 6..7 torque int16
                                  [1/1000 of rated]

Torque and position are measured at the shaft of the motor. In mode 10 (cyclic synchronous torque),
the target in RPDO1 is a torque. Source: CiA 402-2 (control word, status word, objects).
"""

import math
import struct

from handctl.drives.canopen.codec import RPDO, TPDO
from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity

# Values of the control word of a drive.
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE_OPERATION = 0x0F
DISABLE_VOLTAGE = 0x00
FAULT_RESET = 0x80
MAX_TORQUE_COUNT = 0x7FFF
"""Largest target torque in RPDO1 [1/1000 of rated]."""
MAX_TARGET_COUNT = 0x7FFFFFFF
"""Largest target position or velocity in RPDO1 [count]."""

# Names of the power states of a drive.
SWITCH_ON_DISABLED = "switch on disabled"
READY_TO_SWITCH_ON = "ready"
SWITCHED_ON = "switched on"
OPERATION_ENABLED = "enabled"
NOT_READY = "not ready"
QUICK_STOP = "quick stop active"
FAULT_REACTION = "fault reaction"
FAULT = "fault"
_POWER_STATES = (
    (0x4F, 0x00, NOT_READY), (0x4F, 0x40, SWITCH_ON_DISABLED),
    (0x6F, 0x21, READY_TO_SWITCH_ON), (0x6F, 0x23, SWITCHED_ON),
    (0x6F, 0x27, OPERATION_ENABLED), (0x6F, 0x07, QUICK_STOP), (0x4F, 0x0F, FAULT_REACTION), (0x4F, 0x08, FAULT),
)  # fmt: skip
"""Mask and value of the status word for each power state: (mask, value, power state).

Source: CiA 402-2, status word coding.
"""
STATES_WITHOUT_TORQUE = frozenset((NOT_READY, SWITCH_ON_DISABLED, READY_TO_SWITCH_ON, FAULT))
"""Power states in which the power stage is off."""
NEXT_CONTROLWORD = {
    SWITCH_ON_DISABLED: SHUTDOWN,
    READY_TO_SWITCH_ON: SWITCH_ON,
    SWITCHED_ON: ENABLE_OPERATION,
    OPERATION_ENABLED: ENABLE_OPERATION,
}
"""For each power state, the control word that leads one step towards the power state operation enabled.

In a power state that is not a key of ``NEXT_CONTROLWORD``, the host sends DISABLE_VOLTAGE.
"""

ERROR_TEXTS = {
    0x2310: "over-current", 0x3210: "DC bus over-voltage", 0x3220: "DC bus under-voltage",
    0x4210: "drive over-temperature", 0x4310: "motor over-temperature", 0x5441: "external stop 1",
    0x5442: "external stop 2", 0x6100: "firmware error", 0x7320: "position sensor error",
    0x8120: "CAN error passive", 0x8130: "heartbeat of the master lost: the drive's watchdog fired",
    0x8140: "recovered from bus-off", 0x8210: "PDO too short", 0x8250: "RPDO time-out",
    0x8611: "following error",
}  # fmt: skip
"""Meaning of each error code of an emergency frame, in words. Source: CiA 301 and CiA 402-2, error code tables."""


ENABLED_STATUS = 0x07 << 2 | 0x01
"""Joined values of the signals state and stop of ``feedback_message`` in the power state operation enabled."""


def power_state(status_word: int) -> str:
    """Return the power state in a status word, or an empty string if the status word has no defined power state."""
    return next((state for mask, value, state in _POWER_STATES if status_word & mask == value), "")


def feedback_message(
    node_id: int, counts_per_turn: int, gear_ratio: float, rated_torque: float, zero_angle: float
) -> CyclicMessage:
    """Return the signal table of TPDO1.

    The signals are the status word, the position [count] and the torque [1/1000 of rated]. Torque
    and position are measured at the shaft of the motor.

    Args:
        node_id: node number of the drive.
        counts_per_turn: position counts per turn of the shaft.
        gear_ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        rated_torque: rated torque of the drive at the shaft [N m].
        zero_angle: angle of the shaft when the spool angle is zero [rad].
    """
    rad_per_count = math.tau / counts_per_turn / gear_ratio
    offset = -zero_angle / gear_ratio
    torque = rated_torque / 1000 * gear_ratio
    return CyclicMessage("tpdo1", TPDO + node_id, 8, (
        # Bits 0..3 and 5..6 of the status word define the power state. Bit 4 (voltage) and the
        # upper bits of the status word do not belong to the power state.
        Signal("state", SignalQuantity.STATUS, 0, 4),
        Signal("voltage", SignalQuantity.UNUSED, 4, 1),
        Signal("stop", SignalQuantity.STATUS, 5, 2),
        Signal("status", SignalQuantity.UNUSED, 7, 9),
        Signal("position", SignalQuantity.POSITION, 16, 32, False, SignalCoding.SIGNED, rad_per_count, offset, "rad"),
        Signal("torque", SignalQuantity.TORQUE, 48, 16, False, SignalCoding.SIGNED, torque, 0.0, "N m"),
    ))  # fmt: skip


def command_message(
    node_id: int, gear_ratio: float, rated_torque: float, limit: float
) -> CyclicMessage:
    """Return the signal table of RPDO1 with the control word and the target torque [1/1000 of rated].

    Args:
        node_id: node number of the drive.
        gear_ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        rated_torque: rated torque of the drive at the shaft [N m].
        limit: largest torque command [N m at the spool].
    """
    torque = Signal(
        "torque",
        SignalQuantity.TORQUE,
        16,
        16,
        False,
        SignalCoding.SIGNED,
        rated_torque / 1000 * gear_ratio,
        0.0,
        "N m",
    )
    control = Signal("control", SignalQuantity.UNUSED, 0, 16)
    base = struct.pack("<Hh", ENABLE_OPERATION, 0)
    return CyclicMessage("rpdo1", RPDO + node_id, 4, (control, torque), 0, base, False, limit)


def position_message(
    node_id: int, counts_per_turn: int, gear_ratio: float, zero_angle: float, limit: float
) -> CyclicMessage:
    """Return the signal table of RPDO1 with the control word and the target position [count].

    Args:
        node_id: node number of the drive.
        counts_per_turn: position counts per turn of the shaft.
        gear_ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        zero_angle: angle of the shaft when the spool angle is zero [rad].
        limit: largest position command [rad at the spool].

    Raises:
        ValueError: the largest position does not fit into the object of the drive.
    """
    rad_per_count = math.tau / counts_per_turn / gear_ratio
    signal = Signal(
        "position",
        SignalQuantity.POSITION,
        16,
        32,
        False,
        SignalCoding.SIGNED,
        rad_per_count,
        -zero_angle / gear_ratio,
        "rad",
    )
    return _motion_message(node_id, signal, limit, limit + abs(zero_angle / gear_ratio))


def velocity_message(node_id: int, unit: float, limit: float) -> CyclicMessage:
    """Return the signal table of RPDO1 with the control word and the target velocity.

    Args:
        node_id: node number of the drive.
        unit: value of one count of object 0x60FF [rad/s at the spool], negative if a positive count
            unwinds the tendon.
        limit: largest velocity command [rad/s at the spool].

    Raises:
        ValueError: the largest velocity does not fit into the object of the drive.
    """
    signal = Signal(
        "velocity", SignalQuantity.VELOCITY, 16, 32, False, SignalCoding.SIGNED, unit, 0.0, "rad/s"
    )
    return _motion_message(node_id, signal, limit, limit)


def _motion_message(node_id: int, signal: Signal, limit: float, max_value: float) -> CyclicMessage:
    """Return the signal table of RPDO1 with the control word and a target (position or velocity) of four bytes.

    The target in the RPDO has values from ``-max_value`` to ``max_value``.
    """
    if not max_value / abs(signal.scale) < MAX_TARGET_COUNT:
        raise ValueError(
            f"{signal.name} {limit:g} {signal.unit} does not fit into the object of the drive"
        )
    control = Signal("control", SignalQuantity.UNUSED, 0, 16)
    base = struct.pack("<Hi", ENABLE_OPERATION, 0)
    return CyclicMessage("rpdo1", RPDO + node_id, 6, (control, signal), 0, base, False, limit)


def error_text(error_code: int) -> str:
    """Return the meaning of the error code in an emergency frame, in words."""
    return ERROR_TEXTS.get(error_code, f"error {error_code:#06x}")
