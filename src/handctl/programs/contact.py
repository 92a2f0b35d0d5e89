"""How much force at the tip of a closing digit counts as contact; what is felt is in ``core.estimation.contact``."""

from handctl.core.law.goal import DigitGoal

USUAL_JOINTS = 2
"""Of a digit for which the threshold is said: every joint more adds its own friction to what is felt at the tip, 0.33 N
on fingers of three joints that touch nothing; they find a contact long before 1 N."""
ARRIVED_S, ARRIVED_FACTOR = 0.15, 2.0
"""So long after the end of its way a digit counts as arrived, and needs so much more force: it meets nothing new by
itself, and friction that creeps could be taken for a touch."""


def needed(goal: DigitGoal, joints: int, threshold: float, t: float) -> float:
    """Return the force at the tip that counts as contact [N].

    Args:
        goal: of the digit. joints: it has. threshold: of one with two joints, on its way [N]. t: time [s].
    """
    threshold *= joints / USUAL_JOINTS
    on_way = goal.trajectory is not None and t - goal.since < goal.trajectory.duration + ARRIVED_S
    return threshold if on_way else ARRIVED_FACTOR * threshold
