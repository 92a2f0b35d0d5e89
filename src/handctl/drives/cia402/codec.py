"""CANopen frames of a CiA 402 drive: identifiers, SDO transfers of up to four bytes, PDOs, states, and errors.

All fields are little-endian. Most identifiers are the base of the service plus the node number n.
An empty field (-) means that the frame has no payload.

    frame      identifier  to     bytes and fields
    NMT        0x000       drive  0 command | 1 node number
    SYNC       0x080       all    -
    EMCY       0x080 + n   host   0..1 error code | 2 error register | 3..7 of the maker
    RPDO1      0x200 + n   drive  0..1 control word | 2..3 target torque int16 [1/1000 of rated]
               in mode 8           0..1 control word | 2..5 target position int32 [count]
               in mode 9           0..1 control word | 2..5 target velocity int32 [1/min or count/s]
    TPDO1      0x180 + n   host   0..1 status word | 2..5 position int32 [count] | 6..7 torque int16
                                  [1/1000 of rated]
    SDO        0x600 + n   drive  0 specifier | 1..2 index | 3 sub-index | 4..7 value
    SDO reply  0x580 + n   host   0 specifier | 1..2 index | 3 sub-index | 4..7 value or abort code
    heartbeat  0x700 + n   all    0 NMT state

Torque and position refer to the motor's shaft. RPDO1 carries a torque in mode 10. Source: CiA 301
4.2 (identifiers, SDO, NMT), CiA 402-2 (control word, status word, objects).
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity

# Identifiers. NMT and SYNC are complete identifiers. The node number is added to all other
# identifiers.
NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO = 0x180
RPDO = 0x200
SDO_REPLY = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700
# NMT commands.
START_NODE = 0x01
PRE_OPERATIONAL = 0x80
# NMT states in a heartbeat.
BOOT_UP = 0x00
STOPPED = 0x04
OPERATIONAL = 0x05
# Values of the control word.
SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE_OPERATION = 0x0F
DISABLE_VOLTAGE = 0x00
FAULT_RESET = 0x80
MAX_TORQUE_COUNT = 0x7FFF
"""Largest target torque in RPDO1 [1/1000 of rated]."""
MAX_TARGET_COUNT = 0x7FFFFFFF
"""Largest target position or velocity in RPDO1 [count]."""
OBJECT_MISSING = 0x06020000
"""SDO abort code for an object missing in the drive."""

# Power states of a drive in words.
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

In other power states the host sends DISABLE_VOLTAGE.
"""

ERROR_TEXTS = {
    0x2310: "over-current", 0x3210: "DC bus over-voltage", 0x3220: "DC bus under-voltage",
    0x4210: "drive over-temperature", 0x4310: "motor over-temperature", 0x5441: "external stop 1",
    0x5442: "external stop 2", 0x6100: "firmware error", 0x7320: "position sensor error",
    0x8120: "CAN error passive", 0x8130: "heartbeat of the master lost: the drive's watchdog fired",
    0x8140: "recovered from bus-off", 0x8210: "PDO too short", 0x8250: "RPDO time-out",
    0x8611: "following error",
}  # fmt: skip
"""Error codes of an emergency in words. Source: CiA 301 and CiA 402-2, error code tables."""
ABORT_TEXTS = {
    0x05030000: "toggle bit", 0x05040000: "time-out", 0x06010001: "write-only", 0x06010002: "read-only",
    OBJECT_MISSING: "no such object", 0x06040041: "cannot be mapped", 0x06040042: "mapping too long",
    0x06070010: "wrong length", 0x06090011: "no such sub-index", 0x06090030: "out of range",
    0x08000022: "not in this state",
}  # fmt: skip
"""SDO abort codes in words. Source: CiA 301."""


ENABLED_STATUS = 0x07 << 2 | 0x01
"""Status of the power state operation enabled: the signals state and stop of ``feedback_message``, joined."""


def power_state(status: int) -> str:
    """Return the power state in a status word, or an empty string if its code is undefined."""
    return next((state for mask, value, state in _POWER_STATES if status & mask == value), "")


def feedback_message(
    node_id: int, counts: int, ratio: float, rated: float, zero: float
) -> CyclicMessage:
    """Return the signal table of TPDO1: status word, position [count], torque [1/1000 of rated].

    Position and torque refer to the motor's shaft.

    Args:
        node_id: node number of the drive.
        counts: position counts per turn of the shaft.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        rated: rated torque of the drive at the shaft [N m].
        zero: angle of the shaft at spool angle zero [rad].
    """
    count = math.tau / counts / ratio
    torque = rated / 1000 * ratio
    return CyclicMessage("tpdo1", TPDO + node_id, 8, (
        # Bits 0..3 and 5..6 define the power state. Bit 4 (voltage) and the upper bits do not
        # belong to the power state.
        Signal("state", SignalQuantity.STATUS, 0, 4),
        Signal("voltage", SignalQuantity.UNUSED, 4, 1),
        Signal("stop", SignalQuantity.STATUS, 5, 2),
        Signal("status", SignalQuantity.UNUSED, 7, 9),
        Signal("position", SignalQuantity.POSITION, 16, 32, False, SignalCoding.SIGNED, count, -zero / ratio, "rad"),
        Signal("torque", SignalQuantity.TORQUE, 48, 16, False, SignalCoding.SIGNED, torque, 0.0, "N m"),
    ))  # fmt: skip


def command_message(node_id: int, ratio: float, rated: float, limit: float) -> CyclicMessage:
    """Return the signal table of RPDO1 to an enabled drive: control word, target torque [1/1000 of rated].

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        rated: rated torque of the drive at the shaft [N m].
        limit: largest torque command [N m at the spool].
    """
    torque = Signal(
        "torque",
        SignalQuantity.TORQUE,
        16,
        16,
        False,
        SignalCoding.SIGNED,
        rated / 1000 * ratio,
        0.0,
        "N m",
    )
    control = Signal("control", SignalQuantity.UNUSED, 0, 16)
    base = struct.pack("<Hh", ENABLE_OPERATION, 0)
    return CyclicMessage("rpdo1", RPDO + node_id, 4, (control, torque), 0, base, False, limit)


def position_message(
    node_id: int, counts: int, ratio: float, zero: float, limit: float
) -> CyclicMessage:
    """Return the signal table of RPDO1 to an enabled drive: control word, target position [count].

    Args:
        node_id: node number of the drive.
        counts: position counts per turn of the shaft.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        zero: angle of the shaft at spool angle zero [rad].
        limit: largest position command [rad at the spool].

    Raises:
        ValueError: the largest position does not fit into the object of the drive.
    """
    count = math.tau / counts / ratio
    signal = Signal(
        "position",
        SignalQuantity.POSITION,
        16,
        32,
        False,
        SignalCoding.SIGNED,
        count,
        -zero / ratio,
        "rad",
    )
    return _motion_message(node_id, signal, limit, limit + abs(zero / ratio))


def velocity_message(node_id: int, unit: float, limit: float) -> CyclicMessage:
    """Return the signal table of RPDO1 to an enabled drive: control word, target velocity.

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


def _motion_message(node_id: int, signal: Signal, limit: float, largest: float) -> CyclicMessage:
    """Return the signal table of RPDO1 with a target of four bytes, from ``-largest`` to ``largest``."""
    if not largest / abs(signal.scale) < MAX_TARGET_COUNT:
        raise ValueError(
            f"{signal.name} {limit:g} {signal.unit} does not fit into the object of the drive"
        )
    control = Signal("control", SignalQuantity.UNUSED, 0, 16)
    base = struct.pack("<Hi", ENABLE_OPERATION, 0)
    return CyclicMessage("rpdo1", RPDO + node_id, 6, (control, signal), 0, base, False, limit)


def error_text(code: int) -> str:
    """Return the text for the error code of an emergency."""
    return ERROR_TEXTS.get(code, f"error {code:#06x}")


def abort_text(code: int) -> str:
    """Return the text for an SDO abort code."""
    return ABORT_TEXTS.get(code, f"abort {code:#010x}")


def upload_request(index: int, subindex: int) -> bytes:
    """Return the SDO payload to request the value of an object."""
    # 0x40 starts an upload from the drive to the host.
    return struct.pack("<BHB4x", 0x40, index, subindex)


def download_request(index: int, subindex: int, value_bytes: bytes) -> bytes:
    """Return the SDO payload that writes one to four bytes to an object."""
    # 0x23 starts an expedited download. Bits 2..3 contain the number of unused bytes.
    return struct.pack("<BHB4s", 0x23 | (4 - len(value_bytes)) << 2, index, subindex, value_bytes)


class SdoReply(NamedTuple):
    """Content of an SDO reply: object, value (empty after a write), and abort code (0 without an abort)."""

    number: int
    sub: int
    raw: bytes
    abort: int


def decode_sdo_reply(data: bytes) -> SdoReply | None:
    """Decode the 8 bytes of an SDO reply.

    Return None if they are not the reply to a read or a write.
    """
    specifier, index, sub = struct.unpack_from("<BHB", data)
    # 0x80 is an abort, 0x60 confirms a write. 0x43 is a value, with the number of unused bytes in
    # bits 2..3.
    if specifier == 0x80:
        return SdoReply(index, sub, b"", int.from_bytes(data[4:], "little"))
    if specifier == 0x60:
        return SdoReply(index, sub, b"", 0)
    if specifier & 0xF3 == 0x43:
        return SdoReply(index, sub, data[4 : 8 - (specifier >> 2 & 3)], 0)
    return None
