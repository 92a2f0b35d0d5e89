"""Contact of closing digits by a growing force at the tip, and opening of a grip.

Closing: unexplained tension is converted into a force at the tip. Each digit's tendons are weighted
by their load under a unit force at the tip, so a proximal tendon, with most effect of the tip and
least friction, counts most. The force is smoothed over a few milliseconds: the force of a contact
stays, a chattering tendon's force alternates. A model with too much expected tension hides a
contact behind a negative force. A negative force lasts longer than a contact takes to grow, and is
subtracted. A positive force during all of a digit's closing is a load cell's drift, and is
subtracted as well.

Holding: the length wound at the spool minus the tendon's stretch is known to a few micrometres. A
fast and a slow average of this length diverge when a digit is pushed open.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.estimation.kalman import write_free_angles
from handctl.core.estimation.statics import link_poses_of_hand, write_tip_levers

Vector = NDArray[np.float64]

SMOOTH_S = 5e-3
"""Time constant of the tip force: a quarter of the time for finding a contact [s]."""
MEAN_S = 0.15
"""Time constant of the tip force before contact: several times the growth of a contact [s]."""
DRIFT_S = 2.0
"""Time constant of the drift of the tip force before contact: a whole closing [s]."""
FAST_GRIP_S = 0.02
"""Time constant of the fast average of a grip [s]."""
SLOW_GRIP_S = 0.2
"""Time constant of the slow average of a grip [s]."""


@inner
def update_tip_forces(x: Tables, c: ConstantTables) -> None:
    """Update the tip forces of closing digits. The values of all other digits are reset, except for the drift."""
    closing = False
    for d in range(x.digit.shape[1]):
        if x.digit_int[s.CLOSING, d]:
            closing = True
        else:
            x.digit[s.SMOOTHED_TIP_FORCE, d] = x.digit[s.CONTACT_FORCE, d] = 0.0
            x.digit[s.TIP_FORCE_MEAN, d] = math.nan
    if not closing:
        return
    lever = np.zeros(x.joint.shape[1])
    _write_tip_levers(x, c, lever)
    for d in range(x.digit.shape[1]):
        if not x.digit_int[s.CLOSING, d]:
            continue
        force = x.digit[s.SMOOTHED_TIP_FORCE, d]
        force += c.run[h.TIP_FORCE_FRACTION] * (_fit_tip_force(x, c, d, lever) - force)
        mean = force if math.isnan(x.digit[s.TIP_FORCE_MEAN, d]) else x.digit[s.TIP_FORCE_MEAN, d]
        drift = 0.0 if math.isnan(x.digit[s.DRIFT, d]) else x.digit[s.DRIFT, d]
        x.digit[s.SMOOTHED_TIP_FORCE, d] = force
        # The mean counts only if negative (too much expected tension), the drift only if positive (load cell).
        x.digit[s.CONTACT_FORCE, d] = force - min(mean, 0.0) - max(drift, 0.0)
        x.digit[s.TIP_FORCE_MEAN, d] = mean + c.run[h.TIP_FORCE_MEAN_FRACTION] * (force - mean)
        x.digit[s.DRIFT, d] = drift + c.run[h.DRIFT_FRACTION] * (force - drift)


@inner
def _write_tip_levers(x: Tables, c: ConstantTables, lever: Vector) -> None:
    """Write the levers (J,) [m] of forces at the tips about the joints, at the free angles.

    A closing digit is free until contact is found.
    """
    q = np.zeros(x.joint.shape[1])
    write_free_angles(x, c, s.EXCURSION, q)
    pose = link_poses_of_hand(c, q)
    for d in range(x.digit.shape[1]):
        write_tip_levers(c, d, pose, lever)


@inner
def _fit_tip_force(x: Tables, c: ConstantTables, d: int, lever: Vector) -> float:
    """Return the force at a tip [N] with the best fit to the digit's unexplained tensions, in least squares."""
    work = 0.0
    size = 0.0
    for n in range(c.digit_int[h.TENDONS_FIRST, d], c.digit_int[h.TENDONS_END, d]):
        response = 0.0
        for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
            response += c.tendon_joint[h.TORQUE_TO_TENSION, n, j] * lever[j]
        work += response * x.tendon[s.EXTERNAL, n]
        size += response * response
    return work / size


@inner
def average_grip_travel(x: Tables, c: ConstantTables) -> None:
    """Average the length wound minus stretch. Before slip is judged the slow average equals the fast."""
    judged = x.run[s.GOAL_TIME] + c.run[h.PERIOD] >= x.run[s.GRIP_READY]
    for n in range(x.tendon.shape[1]):
        # Length wound minus elastic stretch: the tendon length that moves the joints.
        here = x.tendon[s.TRAVEL, n] - x.tendon[s.TENSION, n] / c.tendon[h.STIFFNESS, n]
        fast = x.tendon[s.GRIP_FAST, n]
        slow = x.tendon[s.GRIP_SLOW, n]
        fast = fast + (here - fast) * c.run[h.FAST_FRACTION] if x.run_int[s.GRIPPING] else here
        slow = slow + (here - slow) * c.run[h.SLOW_FRACTION]
        x.tendon[s.GRIP_FAST, n] = fast
        x.tendon[s.GRIP_SLOW, n] = slow if judged and x.run_int[s.GRIPPING] else fast
