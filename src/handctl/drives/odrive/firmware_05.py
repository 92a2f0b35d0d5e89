"""Differences of ODrive firmware 0.5.x (boards 3.x) from 0.6.x.

The heartbeat and the error codes in the heartbeat differ. Heartbeat of 8 bytes, little-endian:

    byte    0..3                       4             5, bit 0      6, bit 0        7, bit 0           7, bit 7
    field   errors 32 (ERROR_TEXTS)    axis state 8  motor error   encoder error   controller error   done

Over CAN, this firmware reports no version, no temperature and no torque. It also has no SDO.
Watchdog and torque limit are set over USB. Watchdog and torque limit cannot be read over CAN.
Source: ODrive firmware 0.5.6 (``communication/can``) and the vendor's DBC 0.5.6.
"""

from handctl.drives.odrive.codec import PROCEDURE_SUCCESS, Heartbeat

FIRMWARE_VERSIONS = ("0.6", "0.5")
"""Values of the option ``firmware`` in the hand file, the default first."""
# Error bits that the error flags in bytes 5 to 7 of a heartbeat set.
MOTOR_ERROR = 1 << 6
ENCODER_ERROR = 1 << 8
CONTROLLER_ERROR = 1 << 9
ERROR_TEXTS = {
    0: "invalid state", 6: "motor failed", 7: "sensorless estimator failed", 8: "encoder failed",
    9: "controller failed", 11: "watchdog expired", 12: "lower end stop pressed", 13: "upper end stop pressed",
    14: "emergency stop requested", 17: "homing without end stop", 18: "over-temperature", 19: "unknown position",
}  # fmt: skip
"""Text of each error, by the bit in the errors of a heartbeat."""


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Decode the 8 bytes of a heartbeat.

    The error flags of motor, encoder, and controller become error bits of the axis.
    """
    flags = (
        (MOTOR_ERROR * (data[5] & 1))
        | (ENCODER_ERROR * (data[6] & 1))
        | (CONTROLLER_ERROR * (data[7] & 1))
    )
    return Heartbeat(int.from_bytes(data[:4], "little") | flags, data[4], PROCEDURE_SUCCESS)


def error_text(error_flags: int) -> str:
    """Return the texts of all set error bits. If a bit is not documented, its number is used as the text."""
    return ", ".join(
        ERROR_TEXTS.get(bit, f"unknown error bit {bit}")
        for bit in range(32)
        if error_flags >> bit & 1
    )
