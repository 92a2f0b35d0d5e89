"""Conversion of the frames of RobStride's private protocol between bytes and values at the output shaft.

Identifiers of the private protocol always have 29 bits. In a frame to a motor, the lowest byte of
the identifier is the number of the motor:

    bits    28..24   23..16                     15..8            7..0
    type 1  1        torque, 16 bits: 23..8                      motor          control command
    type 2  2        mode 23..22, fault 21..16  motor            host           feedback
    other   type     see below                  host             motor          request
    other   type     see below                  motor            host           reply

Control command of 8 bytes, big-endian. The 16 bits of every field cover the range of the field:

    byte    0, 1           2, 3              4, 5      6, 7
    field   position       velocity          kp        kd
    range   +-4 pi rad     by model          from 0    from 0

Feedback of 8 bytes, big-endian:

    byte    0, 1           2, 3              4, 5            6, 7
    field   position       velocity          torque          winding
    range   +-4 pi rad     by model          by model        0.1 degC/count

Requests that read (type 0x11) or write (type 0x12) a parameter are little-endian. Bytes 0 and 1
contain the parameter number, and bytes 4 to 7 contain the value. If the read of a parameter has
failed, bits 23..16 in the identifier of the reply have the value 1. The motor answers the write of
a parameter with feedback.

Source: docs/facts/robstride.md.
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.frame import EXTENDED_FLAG
from handctl.drives.signals import (
    IDENTIFIER_BIT,
    CyclicMessage,
    Signal,
    SignalCoding,
    SignalQuantity,
)

# Types of frames, in bits 28..24 of an identifier.
GET_ID = 0x00
MOTION_CONTROL = 0x01
FEEDBACK = 0x02
ENABLE = 0x03
STOP = 0x04
SET_ZERO = 0x06
SET_NODE_NUMBER = 0x07
READ = 0x11
WRITE = 0x12
FAULT_REPORT = 0x15
SAVE = 0x16
SET_BIT_RATE = 0x17
REPORTING = 0x18
SET_PROTOCOL = 0x19
REQUEST_TYPES = (
    GET_ID,
    ENABLE,
    STOP,
    SET_ZERO,
    SET_NODE_NUMBER,
    READ,
    WRITE,
    SAVE,
    SET_BIT_RATE,
    REPORTING,
    SET_PROTOCOL,
)
"""Types of frames that have the number of the host in bits 15..8 of the identifier."""
BROADCAST = 0xFE
"""Host number to which a motor sends the reply with its identity."""
LAST_NODE_ID = 0x7F
"""Largest motor number."""
HOST_ID = 0xFD
"""Default host number of handctl."""

# Modes of a motor, in the identifier of feedback.
RESET_MODE = 0
CALIBRATION_MODE = 1
RUNNING_MODE = 2
FAULT_TEXTS = {
    0: "under-voltage",
    1: "over-current",
    2: "over-temperature",
    3: "encoder fault",
    4: "overload: the shaft is blocked",
    5: "not calibrated",
    # Faults in the fault report. In the error code, the bits of the fault report are above the bits
    # of the faults in feedback.
    8: "over-temperature",
    9: "driver chip fault",
    10: "under-voltage",
    11: "over-voltage",
    12: "over-current in phase B",
    13: "over-current in phase C",
    15: "encoder not calibrated",
    16: "hardware identification fault",
    17: "position initialization fault",
    22: "overload: the shaft is blocked",
    24: "over-current in phase A",
}
"""Text of each fault, by the bit number in the error code.

Bits 0 to 5 of the error code come from the identifier of feedback. Bits from 8 on come from the
fault report.
"""
FAULT_REPORT_SHIFT = 8
"""Bit number of the error code that stands for bit 0 of the fault report."""

# Numbers of the parameters for mode of operation, torque limit, and watchdog.
RUN_MODE = 0x7005
LIMIT_TORQUE = 0x700B
CAN_TIMEOUT = 0x7028
OPERATION_RUN_MODE = 0
"""Value of the parameter RUN_MODE with which the motor follows control commands."""
TIMEOUT_UNITS_PER_MS = 20
"""Number of counts per millisecond in the parameter CAN_TIMEOUT, the watchdog timeout. 20000 counts are one second."""
POSITION_RANGE_RAD = 4.0 * math.pi
"""Full scale of the position in frames [rad]."""
MAX_COUNT = 0xFFFF
"""Largest count of a 16-bit field."""
_MIDSCALE_COUNT = MAX_COUNT // 2
ZERO_MOTION_PAYLOAD = struct.pack(">HHHH", _MIDSCALE_COUNT, _MIDSCALE_COUNT, 0, 0)
"""Payload of a torque command.

The gains in a torque command are 0, so that position and velocity have no effect.
"""
CLEAR_FAULT_DATA = bytes((1,)) + bytes(7)
"""Payload of a stop command that also clears faults."""
EMPTY_DATA = bytes(8)
"""Payload of requests without data."""
_PARAMETER_STRUCT = struct.Struct("<HH4s")


class ModelRanges(NamedTuple):
    """Full scale of a motor model: velocity [rad/s], torque [N m], kp [N m/rad], kd [N m s/rad]."""

    velocity: float
    torque: float
    kp: float
    kd: float


MOTOR_MODEL_RANGES = {
    "rs00": ModelRanges(33.0, 14.0, 500.0, 5.0),
    "rs01": ModelRanges(44.0, 17.0, 500.0, 5.0),
    "rs02": ModelRanges(44.0, 17.0, 500.0, 5.0),
    "rs03": ModelRanges(20.0, 60.0, 5000.0, 100.0),
    "rs04": ModelRanges(15.0, 120.0, 5000.0, 100.0),
    "rs05": ModelRanges(50.0, 5.5, 500.0, 5.0),
}
"""Full scale of the values in frames, for each motor model. A motor does not report its model."""


def request_id(frame_type: int, node_id: int, host: int, data_field: int = 0) -> int:
    """Return the identifier of a request of type ``frame_type`` from a host to a motor."""
    return EXTENDED_FLAG | frame_type << 24 | data_field << 16 | host << 8 | node_id


def reply_id(frame_type: int, node_id: int, host: int, data_field: int = 0) -> int:
    """Return the identifier of a frame of type ``frame_type`` from a motor to a host."""
    return EXTENDED_FLAG | frame_type << 24 | data_field << 16 | node_id << 8 | host


def motor_ids(node_id: int, host: int) -> frozenset[int]:
    """Return the identifiers of all frames from a motor to a host.

    A motor sends four kinds of frames: its identity, feedback with any mode and fault, replies to
    read requests, and fault reports.
    """
    feedback = {reply_id(FEEDBACK, node_id, host, data) for data in range(0x100)}
    read_reply_ids = {reply_id(READ, node_id, host, failed) for failed in (0, 1)}
    identity = reply_id(GET_ID, node_id, BROADCAST)
    return frozenset(feedback | read_reply_ids | {identity, reply_id(FAULT_REPORT, node_id, host)})


def join_mode_and_fault(mode: int, fault: int) -> int:
    """Return the status that joins a mode and faults, as in bits 23..16 of the identifier of feedback."""
    return mode << 6 | fault


def command_message(
    node_id: int, ranges: ModelRanges, limit: float, direction: int = 1
) -> CyclicMessage:
    """Return the signal table of the torque command. The identifier of a torque command contains the torque.

    The torque field cannot represent exactly 0 N m. For 0 N m, the host sends the nearest count,
    whose torque differs from 0 N m by half a count.

    Args:
        node_id: number of the motor.
        ranges: full scale of the motor model.
        limit: largest torque command [N m].
        direction: 1 if positive torque of the motor winds the tendon, else -1.
    """
    scale = direction * 2 * ranges.torque / MAX_COUNT
    offset = -direction * ranges.torque
    torque = Signal(
        "torque",
        SignalQuantity.TORQUE,
        IDENTIFIER_BIT + 8,
        16,
        scale=scale,
        offset=offset,
        unit="N m",
    )
    return CyclicMessage(
        "command",
        EXTENDED_FLAG | MOTION_CONTROL << 24 | node_id,
        8,
        (torque,),
        0,
        ZERO_MOTION_PAYLOAD,
        False,
        limit,
    )


def impedance_message(
    node_id: int, ranges: ModelRanges, limit: float, direction: int = 1, zero: float = 0.0
) -> CyclicMessage:
    """Return the signal table of the position command, see ``signals.POSITION_COMMAND``.

    The position command contains position, velocity, kp, kd and torque.

    Args:
        node_id: number of the motor.
        ranges: full scale of the motor model.
        limit: largest torque command [N m].
        direction: 1 if positive torque of the motor winds the tendon, else -1. The position and the
            velocity have the same sign as the torque.
        zero: angle of the motor when the spool angle is zero [rad].
    """
    torque = command_message(node_id, ranges, limit, direction)
    position = _signal_over_range(
        "position", SignalQuantity.POSITION, 7, POSITION_RANGE_RAD, "rad", direction
    )
    signals = (
        position._replace(offset=position.offset - direction * zero),
        _signal_over_range(
            "velocity", SignalQuantity.VELOCITY, 23, ranges.velocity, "rad/s", direction
        ),
        Signal(
            "kp",
            SignalQuantity.STIFFNESS,
            39,
            16,
            True,
            scale=ranges.kp / MAX_COUNT,
            unit="N m/rad",
        ),
        Signal(
            "kd",
            SignalQuantity.DAMPING,
            55,
            16,
            True,
            scale=ranges.kd / MAX_COUNT,
            unit="N m s/rad",
        ),
        *torque.signals,
    )
    return torque._replace(name="position_command", signals=signals, base_payload=EMPTY_DATA)


def feedback_message(
    node_id: int, host: int, ranges: ModelRanges, direction: int = 1, zero: float = 0.0
) -> CyclicMessage:
    """Return the signal table of the feedback from a running motor without a fault.

    Args:
        node_id: number of the motor.
        host: number of the host.
        ranges: full scale of the motor model.
        direction: 1 if positive torque of the motor winds the tendon, else -1. The position and the
            velocity have the same sign as the torque.
        zero: angle of the motor when the spool angle is zero [rad].
    """
    position = _signal_over_range(
        "position", SignalQuantity.POSITION, 7, POSITION_RANGE_RAD, "rad", direction
    )
    return CyclicMessage("feedback", reply_id(FEEDBACK, node_id, host, join_mode_and_fault(RUNNING_MODE, 0)), 8, (
        # The spool angle is sign * (motor angle - zero).
        position._replace(offset=position.offset - direction * zero),
        _signal_over_range("velocity", SignalQuantity.VELOCITY, 23, ranges.velocity, "rad/s", direction),
        _signal_over_range("torque", SignalQuantity.TORQUE, 39, ranges.torque, "N m", direction),
        Signal("winding", SignalQuantity.TEMPERATURE, 55, 16, True, SignalCoding.SIGNED, 0.1, unit="degC"),
    ))  # fmt: skip


def _signal_over_range(
    name: str, quantity: SignalQuantity, start: int, largest: float, unit: str, direction: int
) -> Signal:
    """Return the description of a 16-bit signal with values from -largest to largest."""
    scale = direction * 2 * largest / MAX_COUNT
    return Signal(
        name, quantity, start, 16, True, SignalCoding.UNSIGNED, scale, -direction * largest, unit
    )


def parameter_request(parameter_index: int, value_bytes: bytes = EMPTY_DATA[:4]) -> bytes:
    """Return the payload of a request that reads a parameter, or writes the four bytes of a parameter."""
    return _PARAMETER_STRUCT.pack(parameter_index, 0, value_bytes)


def decode_parameter_reply(data: bytes) -> tuple[int, bytes]:
    """Decode the 8 bytes of a parameter reply.

    Return the parameter number and the four bytes of the parameter value.
    """
    number, _, raw_bytes = _PARAMETER_STRUCT.unpack(data)
    return number, raw_bytes
