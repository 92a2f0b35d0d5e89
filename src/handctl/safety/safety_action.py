"""Reactions to faults, in order of severity.

If several faults demand reactions, the most severe reaction is executed.
"""

import enum


class SafetyAction(enum.IntEnum):
    """Reaction to a fault.

    Each reaction to a fault includes the restrictions of all less severe reactions.
    """

    PASS = 0
    """Continue, without a warning."""
    WARN = 1
    """Continue, and log a warning."""
    HOLD = 2
    """Keep the goals constant, and limit each tension to its present value, until the fault has ended."""
    RELAX = 3
    """Lower every tension to the floor, disable the drives, and stay silent until an operator clears the fault."""
    CUT = 4
    """Remove the torque of all motors at once.

    The reaction CUT belongs to faults after which commands could fail to reach the drives.
    """


class RelaxMethod(enum.Enum):
    """Method by which the reaction RELAX removes the torque.

    No method of relaxing ever raises the commanded torque of a motor (``controller.relaxation``).
    """

    TENSION_LOOP = "RELAX"
    """Use the tension loop, limited by an envelope (upper bound) of the motor force that falls by 500 N/s."""
    FAST_TENSION_LOOP = "RELAX fast"
    """Use the tension loop, limited by an envelope that falls by 2,000 N/s, for an overloaded tendon."""
    OPEN_LOOP = "RELAX open loop"
    """Command the envelope itself, without feedback, for faults that make the tension loop unreliable."""
