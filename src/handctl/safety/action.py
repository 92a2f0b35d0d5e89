"""Reactions to faults, in order of severity. The most severe reaction that a fault demands is executed."""

import enum


class Action(enum.IntEnum):
    """Reaction to a fault. Each action includes every restriction of the weaker actions."""

    PASS = 0
    """Continue, without a warning."""
    WARN = 1
    """Continue, and log a warning."""
    HOLD = 2
    """Keep the goals constant and limit the tension to the present value, until the fault has ended."""
    RELAX = 3
    """Lower every tension to the floor, disable the drives, and stay silent until an operator clears the fault."""
    CUT = 4
    """Remove the torque at once, for faults in which commands may not reach the drives."""


class RelaxMethod(enum.Enum):
    """Method of removing the torque in RELAX. No method raises a commanded torque (``controller.relaxing``)."""

    LOOP = "RELAX"
    """Use the tension loop, limited by an envelope that falls by 500 N/s."""
    FAST_LOOP = "RELAX fast"
    """Use the tension loop, limited by an envelope that falls by 2,000 N/s, for an overloaded tendon."""
    OPEN_LOOP = "RELAX open loop"
    """Command the envelope directly, without feedback, for faults that make the tension loop unreliable."""
