"""What is different on ODrive firmware 0.5.x (3.x boards): the heartbeat and its errors.

There is no version, no SDO, no temperature and no torque on the bus: the watchdog and the torque limit are what was
set over USB, and nobody on the bus can know them. Source: facts, odrive_cansimple; the vendor's DBC 0.5.6.
"""

from handctl.drives.odrive.codec import SUCCESS, Heartbeat

FIRMWARE = ("0.6", "0.5")
"""Values of the option ``firmware``, the usual one first."""
MOTOR, ENCODER, CONTROLLER = 1 << 6, 1 << 8, 1 << 9
ERRORS = {
    0: "invalid state", 6: "motor failed", 7: "sensorless estimator failed", 8: "encoder failed",
    9: "controller failed", 11: "watchdog expired", 12: "lower end stop pressed", 13: "upper end stop pressed",
    14: "emergency stop requested", 17: "homing without end stop", 18: "over-temperature", 19: "unknown position",
}  # fmt: skip


def heartbeat(data: bytes) -> Heartbeat:
    """Values of 8 bytes of Heartbeat; the flags of motor, encoder and controller count as the axis errors they are."""
    flags = (MOTOR * (data[5] & 1)) | (ENCODER * (data[6] & 1)) | (CONTROLLER * (data[7] & 1))
    return Heartbeat(int.from_bytes(data[:4], "little") | flags, data[4], SUCCESS)


def error_text(errors: int) -> str:
    """All errors in words; a bit that nobody knows keeps its number."""
    return ", ".join(ERRORS.get(bit, f"unknown error bit {bit}") for bit in range(32) if errors >> bit & 1)
