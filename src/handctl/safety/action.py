"""What safety can demand, ordered: the largest wins."""

import enum


class Action(enum.IntEnum):
    """Reaction to a fault. Each larger one includes taking away what the smaller left."""

    PASS = 0
    WARN = 1
    """Go on and say so."""
    HOLD = 2
    """Freeze the goal, limit the tension to the present one; ends by itself."""
    RELAX = 3
    """Ramp every tension to the floor, disable, stay silent until a person clears it."""
    CUT = 4
    """Take the torque away at once, for where commands cannot be trusted to arrive."""
