"""Causes of drive faults. The eight causes replace the error lists of all protocols."""

import enum


class Cause(enum.IntEnum):
    """Cause of a drive fault."""

    OTHER = 0
    """Error that the protocol names, and that has none of the other causes."""
    DROPPED_OUT = 1
    """The drive disabled itself or restarted."""
    WATCHDOG = 2
    """The drive's watchdog fired: commands of the host were missing."""
    VOLTAGE = 3
    """The supply voltage is too low or too high."""
    HOT = 4
    """The motor or the power stage is too hot."""
    MISMATCH = 5
    """A setting reads back wrong, or another host enabled the drive."""
    LOST = 6
    """The drive has sent no frame for too long."""
    UNKNOWN = 7
    """The error code has no documented meaning. The controller assumes the worst."""
