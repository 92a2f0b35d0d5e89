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


class Release(enum.Enum):
    """How RELAX takes the torque away. Whatever it is, the torque commanded to a motor never rises (``relaxing``)."""

    LOOP = "RELAX"
    """The tension loop, which may only go below the envelope of 500 N/s."""
    FAST = "RELAX fast"
    """The same with 2,000 N/s, for a tendon that bears too much."""
    OPEN = "RELAX open loop"
    """The envelope itself. No measurement has a part in it, for a fault that makes the loop doubtful."""
