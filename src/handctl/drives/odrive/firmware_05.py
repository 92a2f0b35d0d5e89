"""Differences of ODrive firmware 0.5.x (3.x boards): the heartbeat and its errors.

Heartbeat, 8 bytes, little-endian:

    byte    0..3                       4             5, bit 0      6, bit 0        7, bit 0           7, bit 7
    field   errors 32 (bits, ERRORS)   axis state 8  motor error   encoder error   controller error   done

Over CAN this firmware offers no version, SDO, temperature, or torque. Watchdog and torque limit are
set over USB, and cannot be read over CAN. Source: ODrive firmware 0.5.6 (``communication/can``) and
the vendor's DBC 0.5.6.
"""

from handctl.drives.odrive.codec import SUCCESS, Heartbeat

FIRMWARE = ("0.6", "0.5")
"""Values of the option ``firmware``, the default first."""
# Axis errors that the flags of bytes 5 to 7 stand for.
MOTOR_ERROR = 1 << 6
ENCODER_ERROR = 1 << 8
CONTROLLER_ERROR = 1 << 9
ERRORS = {
    0: "invalid state", 6: "motor failed", 7: "sensorless estimator failed", 8: "encoder failed",
    9: "controller failed", 11: "watchdog expired", 12: "lower end stop pressed", 13: "upper end stop pressed",
    14: "emergency stop requested", 17: "homing without end stop", 18: "over-temperature", 19: "unknown position",
}  # fmt: skip
"""Errors by bit."""


def decode_heartbeat(data: bytes) -> Heartbeat:
    """Decode 8 bytes of a heartbeat.

    The flags of motor, encoder, and controller become bits of the axis errors.
    """
    flags = (MOTOR_ERROR * (data[5] & 1)) | (ENCODER_ERROR * (data[6] & 1)) | (CONTROLLER_ERROR * (data[7] & 1))
    return Heartbeat(int.from_bytes(data[:4], "little") | flags, data[4], SUCCESS)


def error_text(errors: int) -> str:
    """Return the text for all set error bits. An undocumented bit appears with its number."""
    return ", ".join(ERRORS.get(bit, f"unknown error bit {bit}") for bit in range(32) if errors >> bit & 1)
