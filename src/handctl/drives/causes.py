"""What a drive's error code means for the hand: eight causes instead of three protocols' lists of codes."""

import enum
from typing import assert_never, cast

from handctl.drives import cia402_codec, cia402_progress, mit_codec, mit_progress, odrive_codec, odrive_progress
from handctl.drives.cia402 import Cia402Drive
from handctl.drives.contract import Drive
from handctl.drives.mit import MitDrive
from handctl.drives.odrive import OdriveDrive


class Cause(enum.IntEnum):
    """Why a drive is in fault."""

    OTHER = 0
    """An error that the protocol names."""
    DROPPED_OUT = 1
    """It has disabled itself, or restarted."""
    WATCHDOG = 2
    """Its watchdog fired: it has missed the host."""
    VOLTAGE = 3
    """Supply too low or too high."""
    HOT = 4
    MISMATCH = 5
    """It does not read back as configured, or somebody else has enabled it."""
    LOST = 6
    """No sign of life."""
    UNKNOWN = 7
    """A code that nobody knows: the worst is assumed."""


MIT = {
    0x8: Cause.VOLTAGE, 0x9: Cause.VOLTAGE, 0xB: Cause.HOT, 0xC: Cause.HOT, 0xD: Cause.WATCHDOG,
    mit_progress.DROPPED_OUT: Cause.DROPPED_OUT, mit_progress.MISMATCH: Cause.MISMATCH,
    mit_progress.ENABLED_BY_OTHERS: Cause.MISMATCH,
} | dict.fromkeys(mit_codec.ERRORS.keys() - {0x8, 0x9, 0xB, 0xC, 0xD}, Cause.OTHER)  # fmt: skip
"""By the state nibble of the feedback."""
CIA402 = {
    0x3210: Cause.VOLTAGE, 0x3220: Cause.VOLTAGE, 0x4210: Cause.HOT, 0x4310: Cause.HOT, 0x8130: Cause.WATCHDOG,
    0x8250: Cause.WATCHDOG, cia402_progress.DROPPED_OUT: Cause.DROPPED_OUT, cia402_progress.LOST: Cause.LOST,
    cia402_progress.MISMATCH: Cause.MISMATCH, cia402_progress.ENABLED_BY_OTHERS: Cause.MISMATCH,
    0x8100: Cause.DROPPED_OUT,
}  # fmt: skip
"""By the code of the emergency."""
ODRIVE_BITS = {
    8: Cause.VOLTAGE, 9: Cause.VOLTAGE, 11: Cause.VOLTAGE, 13: Cause.HOT, 14: Cause.HOT, 24: Cause.WATCHDOG,
}  # fmt: skip
"""By the bit of the heartbeat's error."""
ODRIVE_OWN = {
    odrive_progress.DROPPED_OUT: Cause.DROPPED_OUT, odrive_progress.MISMATCH: Cause.MISMATCH,
    odrive_progress.REFUSED: Cause.OTHER, odrive_progress.ENABLED_BY_OTHERS: Cause.MISMATCH,
    odrive_progress.LOST: Cause.LOST,
}  # fmt: skip


def cause_of(drive: Drive, error: int) -> Cause:
    """The cause behind a drive's ``DriveState.error``.

    Args:
        drive: whose error it is.
        error: not 0.
    """
    known = cast(MitDrive | OdriveDrive | Cia402Drive, drive)
    match known:
        case MitDrive():
            return MIT.get(error, Cause.UNKNOWN)
        case Cia402Drive():
            return CIA402.get(error, Cause.OTHER if error in cia402_codec.ERRORS else Cause.UNKNOWN)
        case OdriveDrive():
            return ODRIVE_OWN.get(error) or _of_bits(error)
    assert_never(known)


def answers_once(drive: Drive) -> bool:
    """Whether every command has exactly one feedback: then one more is a duplicate, or a second node.

    An ODrive's cyclic messages come beside its answers.
    """
    return not isinstance(drive, OdriveDrive)


def feedback_period_s(drive: Drive) -> float:
    """How often feedback comes by itself [s]; 0 if every tick asks for it."""
    return drive.cyclic_s if isinstance(drive, OdriveDrive) else 0.0


def _of_bits(error: int) -> Cause:
    bits = [bit for bit in range(32) if error >> bit & 1]
    if any(bit not in odrive_codec.ERRORS for bit in bits):
        return Cause.UNKNOWN
    causes = [ODRIVE_BITS.get(bit, Cause.OTHER) for bit in bits]
    return next((cause for cause in causes if cause == Cause.WATCHDOG), causes[0])
