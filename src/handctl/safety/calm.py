"""Whether a tick shows nothing at all: nearly all do, and then no row of the table has to be asked."""

from handctl.safety.faults.bus import UNKNOWN_MOST
from handctl.safety.faults.host import LATE_SHARE
from handctl.safety.signals import FIRST_RARE, Limits, Signals

RARE = Signals(armed=True)[FIRST_RARE:]
"""What is seldom told, when there is nothing to tell."""


def calm(limits: Limits, s: Signals) -> bool:
    """Whether certainly no row of the fault table finds anything; a False says nothing.

    Args:
        limits: thresholds of the hand.
        s: facts of this tick.
    """
    return (
        s[FIRST_RARE:] == RARE
        and not s.missed
        and s.late <= LATE_SHARE
        and s.frames <= limits.frames_most
        and s.unknown <= UNKNOWN_MOST
        and (not s.armed or _answered(limits, s))
        and (not s.tension or max(s.tension) <= limits.trip_least)
        and True not in [warm > limits.warm_least for warm in s.temperature]
    )


def _answered(limits: Limits, s: Signals) -> bool:
    """Whether every node has answered of late, and no load cell is at an end of its range."""
    return (
        not any(s.motor_age)
        and (not s.sensor_age or max(s.sensor_age) < limits.silent_ticks)
        and (not s.tension or (max(s.tension) < limits.tension_rail and min(s.tension) > limits.tension_low))
    )
