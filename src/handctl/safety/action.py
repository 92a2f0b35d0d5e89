"""Reactions of safety, in order of severity: the largest wins."""

import enum


class Action(enum.IntEnum):
    """Reaction to a fault. Each action includes every restriction of the weaker actions."""

    PASS = 0
    WARN = 1
    """Continue, and log a warning."""
    HOLD = 2
    """Freeze the goals and limit the tension to the present value. Ends as soon as the fault is gone."""
    RELAX = 3
    """Ramp every tension to the floor, disable the drives, stay silent until an operator clears the fault."""
    CUT = 4
    """Remove the torque at once, where commands cannot be trusted to arrive."""


class Release(enum.Enum):
    """Method of removing the torque in RELAX. No method raises a commanded torque (``relaxing``)."""

    LOOP = "RELAX"
    """The tension loop, limited by an envelope falling by 500 N/s."""
    FAST = "RELAX fast"
    """The tension loop, limited by an envelope falling by 2,000 N/s, for an overloaded tendon."""
    OPEN = "RELAX open loop"
    """The envelope itself as the command, without feedback, for faults of the loop."""
