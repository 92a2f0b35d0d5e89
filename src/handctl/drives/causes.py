"""Causes of drive faults: eight classes that replace the error list of each protocol."""

import enum


class Cause(enum.IntEnum):
    """Cause of a drive fault."""

    OTHER = 0
    """Error with a name in the protocol, and none of the causes below."""
    DROPPED_OUT = 1
    """The drive disabled itself or restarted."""
    WATCHDOG = 2
    """The drive's watchdog fired: commands of the host were missing."""
    VOLTAGE = 3
    """Supply voltage too low or too high."""
    HOT = 4
    """Motor or power stage too hot."""
    MISMATCH = 5
    """A setting reads back wrong, or another host enabled the drive."""
    LOST = 6
    """No sign of life."""
    UNKNOWN = 7
    """Code without a documented meaning. The controller assumes the worst."""
