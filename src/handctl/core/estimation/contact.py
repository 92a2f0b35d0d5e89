"""What is felt of digits that close or hold: a force at the tip that grows, and a grip that is pushed open.

Closing: the tension that nothing known explains is taken as a force at the tip. Each digit's tendons are weighed as a
unit force at the tip would load them, so that a proximal tendon, which feels the tip most and friction least, counts
most. The force is smoothed over a few milliseconds: what the contact of a closing digit adds stays, what a chattering
tendon adds comes and goes. A model that expects too much tension hides a contact behind a force below zero, which is
there for longer than a contact takes to grow: it is taken off. A force above zero that is there in all of a digit's
closing is a load cell's drift, and is taken off, too.

Holding: the length wound at the spool less the tendon's stretch is known to a few micrometres. Two averages of it, one
quick and one slow, come apart when a digit is pushed open.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.estimation.kalman import free_angles

Vector = NDArray[np.float64]

SMOOTH_S = 5e-3
"""Time constant of the force felt: a quarter of the time in which a contact is to be found."""
USUAL_S, DRIFT_S = 0.15, 2.0
"""Time constants of what is felt anyway: several times that in which a contact grows, and one in which it is found."""
FAST_S, SLOW_S = 0.02, 0.2
"""Time constants of the two averages of a grip."""


@inner
def feel(x: Tables, c: ConstantTables) -> None:
    """Take in the force at the tips of digits that close; forget it of the others, their drift aside."""
    closing = False
    for d in range(x.digit.shape[1]):
        if x.digit_int[s.CLOSING, d]:
            closing = True
        else:
            x.digit[s.FELT, d] = x.digit[s.GROWN, d] = 0.0
            x.digit[s.USUAL, d] = math.nan
    if not closing:
        return
    lever = np.zeros(x.joint.shape[1])
    _levers(x, c, lever)
    for d in range(x.digit.shape[1]):
        if not x.digit_int[s.CLOSING, d]:
            continue
        felt = x.digit[s.FELT, d]
        felt += c.run[h.FELT_FRACTION] * (_force(x, c, d, lever) - felt)
        usual = felt if math.isnan(x.digit[s.USUAL, d]) else x.digit[s.USUAL, d]
        drift = 0.0 if math.isnan(x.digit[s.DRIFT, d]) else x.digit[s.DRIFT, d]
        x.digit[s.FELT, d] = felt
        x.digit[s.GROWN, d] = felt - min(usual, 0.0) - max(drift, 0.0)
        x.digit[s.USUAL, d] = usual + c.run[h.USUAL_FRACTION] * (felt - usual)
        x.digit[s.DRIFT, d] = drift + c.run[h.DRIFT_FRACTION] * (felt - drift)


@inner
def _levers(x: Tables, c: ConstantTables, lever: Vector) -> None:
    """Write the levers (J,) [m] of forces at the tips about the joints, at the free angles.

    A closing digit is free until this finds otherwise.
    """
    joints = x.joint.shape[1]
    q = np.zeros(joints)
    free_angles(x, c, s.EXCURSION, q)
    for link in range(joints):
        angle = 0.0
        for j in range(joints):
            angle += c.joint_joint[h.TIP_AHEAD, link, j] * q[j]
        for j in range(joints):
            lever[j] += math.cos(angle) * c.joint_joint[h.TIP_BEYOND, link, j]


@inner
def _force(x: Tables, c: ConstantTables, d: int, lever: Vector) -> float:
    """Return the force at a tip [N] that fits the digit's unexplained tensions best, in least squares of tension."""
    work, size = 0.0, 0.0
    for n in range(c.digit_int[h.TENDONS_FIRST, d], c.digit_int[h.TENDONS_END, d]):
        response = 0.0
        for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
            response += c.tendon_joint[h.TORQUE_TO_TENSION, n, j] * lever[j]
        work += response * x.tendon[s.EXTERNAL, n]
        size += response * response
    return work / size


@inner
def watch_grip(x: Tables, c: ConstantTables) -> None:
    """Average the length wound less stretch; before slip is judged the slow average is the quick one."""
    judged = x.run[s.GOAL_TIME] + c.run[h.PERIOD] >= x.run[s.GRIP_READY]
    for n in range(x.tendon.shape[1]):
        here = x.tendon[s.TRAVEL, n] - x.tendon[s.TENSION, n] / c.tendon[h.STIFFNESS, n]
        fast, slow = x.tendon[s.GRIP_FAST, n], x.tendon[s.GRIP_SLOW, n]
        fast = fast + (here - fast) * c.run[h.FAST_FRACTION] if x.run_int[s.GRIPPING] else here
        slow = slow + (here - slow) * c.run[h.SLOW_FRACTION]
        x.tendon[s.GRIP_FAST, n] = fast
        x.tendon[s.GRIP_SLOW, n] = slow if judged and x.run_int[s.GRIPPING] else fast
