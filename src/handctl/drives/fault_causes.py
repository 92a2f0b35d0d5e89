"""Causes of drive faults. Each protocol maps its own error codes to these eight causes."""

import enum


class DriveFaultCause(enum.IntEnum):
    """Cause of a drive fault."""

    OTHER = 0
    """The protocol documents the error, but none of the other causes fits."""
    DROPPED_OUT = 1
    """The drive disabled itself or restarted."""
    WATCHDOG = 2
    """The drive's watchdog fired, because commands of the host were missing."""
    VOLTAGE = 3
    """The supply voltage is too low or too high."""
    HOT = 4
    """The motor or the power stage is too hot."""
    MISMATCH = 5
    """A setting of the drive reads back wrong, or another host has enabled the drive."""
    LOST = 6
    """The drive has sent no frame for longer than its timeout."""
    UNKNOWN = 7
    """The error code of the drive has no documented meaning.

    The controller assumes the worst cause.
    """
