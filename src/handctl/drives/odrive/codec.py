"""Frames of ODrive CANSimple, firmware 0.6.x: identifiers, bytes <-> values, errors in words.

Identifier, 11 bits: node number in bits 10..5, command in bits 4..0. Payloads are little-endian.

    command   name                     to     bytes 0..3                   bytes 4..7
    0x00      Get_Version              host   protocol 8, hardware 3 x 8   firmware 3 x 8, unreleased 8
    0x01      Heartbeat                host   errors 32 (bits, ERRORS)     state 8, result 8, done 8, 0
    0x02      Estop                    drive  -                            -
    0x04      RxSdo                    drive  opcode 8, endpoint 16, 0     value
    0x05      TxSdo                    host   0, endpoint 16, 0            value
    0x06      Address                  host   node 8, serial number 48 in bytes 1..6, connection 8
    0x07      Set_Axis_State           drive  state 32                     -
    0x09      Get_Encoder_Estimates    host   position float32 [turn]      velocity float32 [turn/s]
    0x0B      Set_Controller_Mode      drive  control mode 32              input mode 32
    0x0C      Set_Input_Pos            drive  position float32 [turn]      velocity int16, torque int16 [1/1000]
    0x0D      Set_Input_Vel            drive  velocity float32 [turn/s]    torque float32 [N m]
    0x0E      Set_Input_Torque         drive  torque float32 [N m]         -
    0x0F      Set_Limits               drive  velocity float32 [turn/s]    current float32 [A]
    0x15      Get_Temperature          host   power stage float32 [degC]   motor float32 [degC]
    0x18      Clear_Errors             drive  -                            -
    0x1C      Get_Torques              host   target float32 [N m]         estimate float32 [N m]

All values are at the motor's shaft. A remote frame with the identifier of a Get message requests
the message. Source: ODrive documentation, "CAN Protocol", and the vendor's DBC
``odrive-cansimple`` 0.6.10.
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.frame import REMOTE
from handctl.drives.signals import Coding, Message, Quantity, Signal

# Commands, the low five bits of an identifier.
GET_VERSION = 0x00
HEARTBEAT = 0x01
ESTOP = 0x02
RX_SDO = 0x04
TX_SDO = 0x05
ADDRESS = 0x06
SET_AXIS_STATE = 0x07
ENCODER_ESTIMATES = 0x09
SET_MODE = 0x0B
SET_POSITION = 0x0C
SET_VELOCITY = 0x0D
SET_TORQUE = 0x0E
SET_LIMITS = 0x0F
TEMPERATURE = 0x15
CLEAR_ERRORS = 0x18
TORQUES = 0x1C
COMMANDS = frozenset(
    (ESTOP, RX_SDO, SET_AXIS_STATE, SET_MODE, SET_POSITION, SET_VELOCITY, SET_TORQUE, SET_LIMITS, 0x16, CLEAR_ERRORS)
)
"""Numbers of commands sent only by hosts. 0x0C and 0x0D set position and velocity, 0x16 reboots."""
REQUESTABLE = frozenset((GET_VERSION, ADDRESS, ENCODER_ESTIMATES, TEMPERATURE, TORQUES))
"""Messages requested by a remote frame."""
ANSWERS = REQUESTABLE | {HEARTBEAT, TX_SDO}
"""Messages of the drive."""
LAST_NODE = 0x3E
"""Largest node number. 0x3F is the broadcast."""
ENCODER_MS = 10
"""Factory setting of the period of the cyclic position [ms]."""
PROTOCOL = 2
"""Supported version of CANSimple."""
# Axis states.
IDLE = 1
CLOSED_LOOP = 8
# Control mode and input mode of Set_Controller_Mode.
TORQUE_MODE = 1
VELOCITY_MODE = 2
POSITION_MODE = 3
PASSTHROUGH = 1
# Results of the last procedure.
SUCCESS = 0
BUSY = 1
# Opcodes of RxSdo.
SDO_READ = 0
SDO_WRITE = 1
MAX_FLOAT32 = 3.4028234663852886e38
"""Largest float32."""

ERRORS = {
    0: "initializing", 1: "system level", 2: "timing", 3: "missing estimate", 4: "bad configuration",
    5: "gate driver fault", 6: "missing input", 8: "DC bus over-voltage", 9: "DC bus under-voltage",
    10: "DC bus over-current", 11: "DC bus over-regeneration", 12: "current limit violation",
    13: "motor over-temperature", 14: "inverter over-temperature", 15: "velocity limit violation",
    16: "position limit violation", 24: "watchdog expired", 25: "emergency stop requested", 26: "spin-out",
    27: "brake resistor disarmed", 28: "thermistor disconnected", 30: "calibration error",
}  # fmt: skip
"""Errors by bit of Axis_Error."""
RESULTS = {
    2: "cancelled", 3: "disarmed", 4: "no response", 5: "pole pairs or counts per turn do not match",
    6: "phase resistance out of range", 7: "phase inductance out of range", 8: "unbalanced phases",
    9: "invalid motor type", 10: "illegal hall state", 11: "timeout", 12: "homing without end stop",
    13: "invalid state", 14: "not calibrated", 15: "not converging",
}  # fmt: skip
"""Results of a failed procedure."""


class Heartbeat(NamedTuple):
    """Heartbeat: errors as bits, axis state, result of the last procedure."""

    errors: int
    state: int
    result: int


def message_id(node_id: int, command: int) -> int:
    """Return the identifier of a message."""
    return node_id << 5 | command


def error_text(errors: int) -> str:
    """Return the text for all set error bits. An undocumented bit appears with its number."""
    return ", ".join(ERRORS.get(bit, f"unknown error bit {bit}") for bit in range(32) if errors >> bit & 1)


def result_text(result: int) -> str:
    """Return the text for the result of a procedure."""
    return RESULTS.get(result, f"unknown result {result}")


def _float_signal(
    name: str, quantity: Quantity, first: int, scale: float, offset: float = 0.0, unit: str = ""
) -> Signal:
    """Return a float32 signal that begins at a byte."""
    return Signal(name, quantity, 8 * first, 32, False, Coding.FLOAT, scale, offset, unit)


def encoder_message(node_id: int, ratio: float, zero: float, requested: bool) -> Message:
    """Return the signal table of Get_Encoder_Estimates: position [turn] and velocity [turn/s] of the shaft.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, with the sign of the hand.
        zero: angle at the shaft of the spool's zero [rad].
        requested: True if every tick requests the message. The drive also sends it by itself, every 10 ms by default.
    """
    # A shaft turn is tau / ratio at the spool. A negative ratio reverses the sign.
    turn = math.tau / ratio
    return Message("encoder_estimates", message_id(node_id, ENCODER_ESTIMATES), 8, (
        _float_signal("position", Quantity.POSITION, 0, turn, -zero / ratio, "rad"),
        _float_signal("velocity", Quantity.VELOCITY, 4, turn, 0.0, "rad/s"),
    ), nearest=requested)  # fmt: skip


def torques_message(node_id: int, ratio: float) -> Message:
    """Return the signal table of Get_Torques: target and estimate [N m] at the shaft.

    The controller uses the estimate.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, with the sign of the hand.
    """
    return Message("torques", message_id(node_id, TORQUES), 8, (
        _float_signal("target", Quantity.UNUSED, 0, ratio, 0.0, "N m"),
        _float_signal("torque", Quantity.TORQUE, 4, ratio, 0.0, "N m"),
    ), answers=False)  # fmt: skip


def torque_message(node_id: int, ratio: float, limit: float) -> Message:
    """Return the signal table of Set_Input_Torque [N m] at the shaft.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, with the sign of the hand.
        limit: largest torque [N m at the spool].
    """
    # Torque at the spool = ratio * torque at the shaft.
    signal = _float_signal("torque", Quantity.TORQUE, 0, ratio, 0.0, "N m")
    return Message("input_torque", message_id(node_id, SET_TORQUE), 4, (signal,), limit=limit)


def position_message(node_id: int, ratio: float, zero: float, limit: float) -> Message:
    """Return Set_Input_Pos without feedforward.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, with the sign of the hand.
        zero: angle at the shaft of the spool's zero [rad].
        limit: largest position [rad at the spool].
    """
    signals = (
        _float_signal("position", Quantity.POSITION, 0, math.tau / ratio, -zero / ratio, "rad"),
        Signal("velocity", Quantity.UNUSED, 32, 16, False, Coding.SIGNED, 1e-3 * math.tau / ratio, 0.0, "rad/s"),
        Signal("torque", Quantity.UNUSED, 48, 16, False, Coding.SIGNED, 1e-3 * ratio, 0.0, "N m"),
    )
    return Message("input_position", message_id(node_id, SET_POSITION), 8, signals, limit=limit)


def velocity_message(node_id: int, ratio: float, limit: float) -> Message:
    """Return Set_Input_Vel without feedforward.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, with the sign of the hand.
        limit: largest speed [rad/s at the spool].
    """
    signals = (
        _float_signal("velocity", Quantity.VELOCITY, 0, math.tau / ratio, 0.0, "rad/s"),
        _float_signal("torque", Quantity.UNUSED, 4, ratio, 0.0, "N m"),
    )
    return Message("input_velocity", message_id(node_id, SET_VELOCITY), 8, signals, limit=limit)


def request_message(node_id: int, command: int) -> Message:
    """Return the signal table of the remote frame that requests a message."""
    return Message(f"ask_{command:#04x}", message_id(node_id, command) | REMOTE, 0, answers=False)


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Decode 8 bytes of a heartbeat."""
    return Heartbeat(*struct.unpack_from("<IBB", data))


def decode_float_pair(data: bytes) -> tuple[float, float] | None:
    """Decode two float32, or return None unless both are finite."""
    first, second = struct.unpack("<ff", data)
    return (first, second) if math.isfinite(first) and math.isfinite(second) else None


def decode_hottest(data: bytes) -> float | None:
    """Return the larger of two float32 temperatures [degC], or None if both are NaN.

    A drive reports NaN for a sensor that is not connected.
    """
    return max((value for value in struct.unpack("<ff", data) if math.isfinite(value)), default=None)


def encode_floats(*values: float) -> bytes:
    """Return a payload with float32 values.

    Raises:
        ValueError: a value is not finite, or too large for a float32.
    """
    for value in values:
        # Negated, so that NaN is refused.
        if not abs(value) <= MAX_FLOAT32:
            raise ValueError(f"{value} cannot be sent, expected a finite number")
    return struct.pack(f"<{len(values)}f", *values)


def encode_integers(*values: int) -> bytes:
    """Return a payload with uint32 values."""
    return struct.pack(f"<{len(values)}I", *values)


def sdo_request(operation: int, endpoint: int, value: bytes = b"") -> bytes:
    """Return the payload of RxSdo, which reads or writes an endpoint."""
    return struct.pack("<BHB", operation, endpoint, 0) + value


def decode_sdo_reply(data: bytes) -> tuple[int, bytes]:
    """Decode a TxSdo: endpoint and value."""
    return int.from_bytes(data[1:3], "little"), data[4:]
