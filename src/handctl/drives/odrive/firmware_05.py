"""Differences between ODrive firmware 0.5.x (boards 3.x) and firmware 0.6.x.

Firmware 0.5.x has other error codes, and a heartbeat of 8 bytes, little-endian, with the following
layout:

    byte    0..3                       4             5, bit 0      6, bit 0        7, bit 0           7, bit 7
    field   errors 32 (ERROR_TEXTS)    axis state 8  motor error   encoder error   controller error   done

Over CAN, firmware 0.5.x reports no version, no temperature and no torque, and has no SDO. The
operator sets watchdog and torque limit over USB. The host cannot read watchdog and torque limit
over CAN. Source: ODrive firmware 0.5.6 (``communication/can``) and the vendor's DBC 0.5.6.
"""

from handctl.drives.odrive.codec import PROCEDURE_SUCCESS, Heartbeat

FIRMWARE_VERSIONS = ("0.6", "0.5")
"""Accepted values of the option ``firmware`` in the hand file, the default value first."""
# Error bits that stand for the error flags in bytes 5 to 7 of a heartbeat.
MOTOR_ERROR = 1 << 6
ENCODER_ERROR = 1 << 8
CONTROLLER_ERROR = 1 << 9
ERROR_TEXTS = {
    0: "invalid state", 6: "motor failed", 7: "sensorless estimator failed", 8: "encoder failed",
    9: "controller failed", 11: "watchdog expired", 12: "lower end stop pressed", 13: "upper end stop pressed",
    14: "emergency stop requested", 17: "homing without end stop", 18: "over-temperature", 19: "unknown position",
}  # fmt: skip
"""Text of each error, by the bit number in the error field of a heartbeat."""


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Decode the 8 bytes of a heartbeat.

    Each error flag of motor, encoder, and controller is converted to an error bit of the axis.
    """
    flags = (
        (MOTOR_ERROR * (data[5] & 1))
        | (ENCODER_ERROR * (data[6] & 1))
        | (CONTROLLER_ERROR * (data[7] & 1))
    )
    return Heartbeat(int.from_bytes(data[:4], "little") | flags, data[4], PROCEDURE_SUCCESS)


def error_text(error_flags: int) -> str:
    """Return the texts of all error bits that are set. The text of an undocumented bit is the number of the bit."""
    return ", ".join(
        ERROR_TEXTS.get(bit, f"unknown error bit {bit}")
        for bit in range(32)
        if error_flags >> bit & 1
    )
