"""What a drive's error code means for the hand: eight causes instead of each protocol's list of codes."""

import enum


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
