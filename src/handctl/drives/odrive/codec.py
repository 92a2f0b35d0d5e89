"""Conversion of the CANSimple frames of ODrive firmware 0.6.x between bytes and values, and errors in words.

An identifier has 11 bits. Bits 10..5 contain the node number, and bits 4..0 contain the command
number. Payloads are little-endian. A hyphen in a column means that the message does not contain the
bytes of the column.

    command   name                     to     bytes 0..3                   bytes 4..7
    0x00      Get_Version              host   protocol 8, hardware 3 x 8   firmware 3 x 8, unreleased 8
    0x01      Heartbeat                host   errors 32 (ERROR_TEXTS)      state 8, result 8, done 8, 0
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

All values refer to the motor's shaft. A remote frame with the identifier of a Get message requests
the Get message. Source: ODrive documentation, "CAN Protocol", and the vendor's DBC
``odrive-cansimple`` 0.6.10.
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.frame import REMOTE_FLAG
from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity

# Command numbers, the low five bits of an identifier.
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
HOST_COMMANDS = frozenset(
    (
        ESTOP,
        RX_SDO,
        SET_AXIS_STATE,
        SET_MODE,
        SET_POSITION,
        SET_VELOCITY,
        SET_TORQUE,
        SET_LIMITS,
        0x16,
        CLEAR_ERRORS,
    )
)
"""Numbers of commands that only a host sends. Command 0x16 reboots the drive."""
REQUESTABLE_MESSAGES = frozenset((GET_VERSION, ADDRESS, ENCODER_ESTIMATES, TEMPERATURE, TORQUES))
"""Numbers of messages that the host requests with a remote frame."""
DRIVE_MESSAGES = REQUESTABLE_MESSAGES | {HEARTBEAT, TX_SDO}
"""Numbers of messages sent by the drive."""
LAST_NODE_ID = 0x3E
"""Largest node number of a drive. The number 0x3F addresses all nodes."""
ENCODER_PERIOD_MS = 10
"""Period with which a drive with factory settings sends its position [ms]."""
PROTOCOL_VERSION = 2
"""Version of CANSimple supported by handctl."""
# Numbers of the axis states of an ODrive.
IDLE = 1
CLOSED_LOOP = 8
# Control modes and the input mode in Set_Controller_Mode.
TORQUE_MODE = 1
VELOCITY_MODE = 2
POSITION_MODE = 3
PASSTHROUGH_INPUT_MODE = 1
# Results of the drive's last procedure (such as a calibration), in a heartbeat.
PROCEDURE_SUCCESS = 0
PROCEDURE_BUSY = 1
# Opcodes of RxSdo.
SDO_READ = 0
SDO_WRITE = 1
MAX_FLOAT32 = 3.4028234663852886e38
"""Largest finite value of a float32."""

ERROR_TEXTS = {
    0: "initializing", 1: "system level", 2: "timing", 3: "missing estimate", 4: "bad configuration",
    5: "gate driver fault", 6: "missing input", 8: "DC bus over-voltage", 9: "DC bus under-voltage",
    10: "DC bus over-current", 11: "DC bus over-regeneration", 12: "current limit violation",
    13: "motor over-temperature", 14: "inverter over-temperature", 15: "velocity limit violation",
    16: "position limit violation", 24: "watchdog expired", 25: "emergency stop requested", 26: "spin-out",
    27: "brake resistor disarmed", 28: "thermistor disconnected", 30: "calibration error",
}  # fmt: skip
"""Text of each error, by the bit number in the error field of a heartbeat."""
PROCEDURE_RESULT_TEXTS = {
    2: "cancelled", 3: "disarmed", 4: "no response", 5: "pole pairs or counts per turn do not match",
    6: "phase resistance out of range", 7: "phase inductance out of range", 8: "unbalanced phases",
    9: "invalid motor type", 10: "illegal hall state", 11: "timeout", 12: "homing without end stop",
    13: "invalid state", 14: "not calibrated", 15: "not converging",
}  # fmt: skip
"""Text of each result of a failed procedure of the drive."""


class Heartbeat(NamedTuple):
    """Content of a heartbeat: error bits, axis state, and result of the last procedure."""

    errors: int
    state: int
    result: int


def message_id(node_id: int, command: int) -> int:
    """Return the identifier of a message, from node number and command number."""
    return node_id << 5 | command


def error_text(error_flags: int) -> str:
    """Return the texts of all error bits that are set.

    The text of an undocumented error bit is the number of the bit.
    """
    return ", ".join(
        ERROR_TEXTS.get(bit, f"unknown error bit {bit}")
        for bit in range(32)
        if error_flags >> bit & 1
    )


def result_text(result_code: int) -> str:
    """Return the text that describes the result of a procedure of the drive."""
    return PROCEDURE_RESULT_TEXTS.get(result_code, f"unknown result {result_code}")


def _float_signal(
    name: str,
    quantity: SignalQuantity,
    byte_offset: int,
    scale: float,
    offset: float = 0.0,
    unit: str = "",
) -> Signal:
    """Return the description of a float32 signal that begins at byte ``byte_offset``."""
    return Signal(
        name, quantity, 8 * byte_offset, 32, False, SignalCoding.FLOAT, scale, offset, unit
    )


def encoder_message(node_id: int, ratio: float, zero: float, is_requested: bool) -> CyclicMessage:
    """Return the signal table of Get_Encoder_Estimates: position [turn] and velocity [turn/s] of the shaft.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        zero: angle of the shaft when the spool angle is zero [rad].
        is_requested: True if every tick requests the message. The drive also sends the message
            without a request, by default every 10 ms.
    """
    # One turn of the shaft turns the spool by the angle tau / ratio. A negative ratio reverses the
    # sign.
    turn = math.tau / ratio
    return CyclicMessage("encoder_estimates", message_id(node_id, ENCODER_ESTIMATES), 8, (
        _float_signal("position", SignalQuantity.POSITION, 0, turn, -zero / ratio, "rad"),
        _float_signal("velocity", SignalQuantity.VELOCITY, 4, turn, 0.0, "rad/s"),
    ), keeps_nearest_frame=is_requested)  # fmt: skip


def torques_message(node_id: int, ratio: float) -> CyclicMessage:
    """Return the signal table of Get_Torques: commanded and estimated torque of the shaft [N m].

    The controller uses only the estimated torque.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
    """
    return CyclicMessage("torques", message_id(node_id, TORQUES), 8, (
        _float_signal("target", SignalQuantity.UNUSED, 0, ratio, 0.0, "N m"),
        _float_signal("torque", SignalQuantity.TORQUE, 4, ratio, 0.0, "N m"),
    ), is_reply=False)  # fmt: skip


def torque_message(node_id: int, ratio: float, limit: float) -> CyclicMessage:
    """Return the signal table of Set_Input_Torque: torque of the shaft [N m].

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        limit: largest torque command [N m at the spool].
    """
    # The torque at the spool is ratio * torque at the shaft.
    signal = _float_signal("torque", SignalQuantity.TORQUE, 0, ratio, 0.0, "N m")
    return CyclicMessage("input_torque", message_id(node_id, SET_TORQUE), 4, (signal,), limit=limit)


def position_message(node_id: int, ratio: float, zero: float, limit: float) -> CyclicMessage:
    """Return the signal table of Set_Input_Pos, without feedforward of velocity and torque.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        zero: angle of the shaft when the spool angle is zero [rad].
        limit: largest position command [rad at the spool].
    """
    signals = (
        _float_signal(
            "position", SignalQuantity.POSITION, 0, math.tau / ratio, -zero / ratio, "rad"
        ),
        Signal(
            "velocity",
            SignalQuantity.UNUSED,
            32,
            16,
            False,
            SignalCoding.SIGNED,
            1e-3 * math.tau / ratio,
            0.0,
            "rad/s",
        ),
        Signal(
            "torque",
            SignalQuantity.UNUSED,
            48,
            16,
            False,
            SignalCoding.SIGNED,
            1e-3 * ratio,
            0.0,
            "N m",
        ),
    )
    return CyclicMessage(
        "input_position", message_id(node_id, SET_POSITION), 8, signals, limit=limit
    )


def velocity_message(node_id: int, ratio: float, limit: float) -> CyclicMessage:
    """Return the signal table of Set_Input_Vel, without feedforward of the torque.

    Args:
        node_id: node number of the drive.
        ratio: turns of the shaft per turn of the spool, negative if positive torque unwinds the
            tendon.
        limit: largest velocity command [rad/s at the spool].
    """
    signals = (
        _float_signal("velocity", SignalQuantity.VELOCITY, 0, math.tau / ratio, 0.0, "rad/s"),
        _float_signal("torque", SignalQuantity.UNUSED, 4, ratio, 0.0, "N m"),
    )
    return CyclicMessage(
        "input_velocity", message_id(node_id, SET_VELOCITY), 8, signals, limit=limit
    )


def request_message(node_id: int, command: int) -> CyclicMessage:
    """Return the signal table of the remote frame that requests a message."""
    return CyclicMessage(
        f"ask_{command:#04x}", message_id(node_id, command) | REMOTE_FLAG, 0, is_reply=False
    )


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Decode the 8 bytes of a heartbeat."""
    return Heartbeat(*struct.unpack_from("<IBB", data))


def decode_float_pair(data: bytes) -> tuple[float, float] | None:
    """Decode the two float32 values in a payload. Return None if one of the values is not finite."""
    first_value, second_value = struct.unpack("<ff", data)
    return (
        (first_value, second_value)
        if math.isfinite(first_value) and math.isfinite(second_value)
        else None
    )


def decode_highest_temperature(data: bytes) -> float | None:
    """Return the larger of two float32 temperatures [degC], or None if both are NaN.

    A drive reports NaN for a sensor that is not connected.
    """
    return max(
        (value for value in struct.unpack("<ff", data) if math.isfinite(value)), default=None
    )


def encode_floats(*values: float) -> bytes:
    """Return a payload that contains the given values as float32.

    Raises:
        ValueError: a value is not finite, or too large for a float32.
    """
    for value in values:
        # The comparison is negated, so that the check refuses NaN.
        if not abs(value) <= MAX_FLOAT32:
            raise ValueError(f"{value} cannot be sent, expected a finite number")
    return struct.pack(f"<{len(values)}f", *values)


def encode_integers(*values: int) -> bytes:
    """Return a payload that contains the given values as uint32."""
    return struct.pack(f"<{len(values)}I", *values)


def sdo_request(operation: int, endpoint: int, value: bytes = b"") -> bytes:
    """Return the payload of a message RxSdo, which reads or writes an endpoint (a parameter of the drive)."""
    return struct.pack("<BHB", operation, endpoint, 0) + value


def sdo_reply(endpoint: int, value: bytes) -> bytes:
    """Return the payload of a message TxSdo, which contains the value of an endpoint."""
    return struct.pack("<BHB", 0, endpoint, 0) + value


def decode_sdo_reply(data: bytes) -> tuple[int, bytes]:
    """Decode the payload of TxSdo. Return the endpoint number and the bytes of the endpoint's value."""
    return int.from_bytes(data[1:3], "little"), data[4:]
