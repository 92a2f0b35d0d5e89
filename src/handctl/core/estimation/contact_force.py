"""Detection of contact and slip.

The force at the tip of a closing digit is a sign of contact. The opening of a digit that holds an
object is a sign of slip. While a digit closes, the part of its tensions that the model does not
explain is converted into a force at the tip. The tip force is a weighted combination of the
unexplained tensions. The weight of a tendon is the tension that a force of 1 N at the tip causes in
this tendon. A proximal tendon has the largest weight, because a proximal tendon bears the largest
tension and has the least friction. The tip force is averaged over a few milliseconds by a low-pass
filter. The force of a contact remains after the low-pass filter. The alternating force of a
chattering tendon cancels out in the low-pass filter.

Two errors of the tip force are corrected. If the model expects too much tension, the tip force is
negative and hides a contact. A contact force changes faster than the tip-force error that a wrong
model causes. To correct this error, an average of the tip force is subtracted while the average is
negative. If the reading of a load cell drifts, the tip force is positive during the whole closing
motion. To correct the drift, a positive average of the tip force over a long time is subtracted.

The excursion of a tendon is the tendon length on the spool minus the stretch of the tendon. While a
digit holds an object, the excursion is known to a few micrometres. If the object pushes the digit
open, a fast and a slow average of the excursion differ.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel, kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import ConstantTables
from handctl.core.estimation.kalman import write_free_angles
from handctl.core.estimation.statics import link_poses_of_hand, write_tip_levers
from handctl.core.state_block import StateTables, state_tables

Vector = NDArray[np.float64]

TIP_FORCE_TIME_CONSTANT_S = 5e-3
"""Time constant of the smoothed tip force [s]. A contact is found within four times the time constant."""
TIP_FORCE_MEAN_TIME_CONSTANT_S = 0.15
"""Time constant of the mean tip force [s]. A contact force grows within a fraction of the time constant."""
TIP_FORCE_DRIFT_TIME_CONSTANT_S = 2.0
"""Time constant of the mean tip force that is subtracted as drift [s], about the time in which a digit closes."""
FAST_GRIP_TIME_CONSTANT_S = 0.02
"""Time constant of the fast average of wound length minus stretch, while the hand holds an object [s]."""
SLOW_GRIP_TIME_CONSTANT_S = 0.2
"""Time constant of the slow average of wound length minus stretch, while the hand holds an object [s]."""


MIN_SQUARED_RESPONSE = 1e-6
"""Sum of the squared tendon tensions under a tip force of 1 N [N^2], below which the tip force is unknown.

If the sum is smaller, the tensions of the tendons do not show a force at the tip.
"""


@kernel_helper
def update_tip_forces(x: StateTables, c: ConstantTables) -> None:
    """Update the tip forces of closing digits.

    For all other digits, the tip force is set to 0, but the estimated drift of the load cells is
    kept.
    """
    is_closing = False
    for d in range(x.digit.shape[1]):
        if x.digit_int[s.CLOSING_UNTIL_CONTACT, d]:
            is_closing = True
        else:
            x.digit[s.SMOOTHED_TIP_FORCE, d] = x.digit[s.CONTACT_FORCE, d] = 0.0
            x.digit[s.TIP_FORCE_MEAN, d] = math.nan
    if not is_closing:
        return
    lever = np.zeros(x.joint.shape[1])
    _write_tip_levers(x, c, lever)
    for d in range(x.digit.shape[1]):
        if not x.digit_int[s.CLOSING_UNTIL_CONTACT, d]:
            continue
        force = x.digit[s.SMOOTHED_TIP_FORCE, d]
        force += c.run[h.TIP_FORCE_UPDATE_FRACTION] * (_fit_tip_force(x, c, d, lever) - force)
        mean = force if math.isnan(x.digit[s.TIP_FORCE_MEAN, d]) else x.digit[s.TIP_FORCE_MEAN, d]
        drift = 0.0 if math.isnan(x.digit[s.TIP_FORCE_DRIFT, d]) else x.digit[s.TIP_FORCE_DRIFT, d]
        x.digit[s.SMOOTHED_TIP_FORCE, d] = force
        # A negative average of the tip force is attributed to an error of the model, and a positive
        # drift to an error of the load cell.
        x.digit[s.CONTACT_FORCE, d] = force - min(mean, 0.0) - max(drift, 0.0)
        x.digit[s.TIP_FORCE_MEAN, d] = mean + c.run[h.MEAN_FORCE_UPDATE_FRACTION] * (force - mean)
        x.digit[s.TIP_FORCE_DRIFT, d] = drift + c.run[h.DRIFT_UPDATE_FRACTION] * (force - drift)


@kernel_helper
def _write_tip_levers(x: StateTables, c: ConstantTables, lever: Vector) -> None:
    """Write the lever about each joint (J,) of a force at the tip of the joint's digit [m].

    The function assumes that the digits have the joint angles of free digits. A digit that closes
    counts as free until its contact is found.
    """
    q = np.zeros(x.joint.shape[1])
    write_free_angles(x, c, s.EXCURSION, q)
    pose = link_poses_of_hand(c, q)
    for d in range(x.digit.shape[1]):
        write_tip_levers(c, d, pose, lever)


@kernel_helper
def _fit_tip_force(x: StateTables, c: ConstantTables, d: int, lever: Vector) -> float:
    """Return the force at the tip that best explains the external tensions (tensions beyond those of the model) [N].

    The force is a least-squares solution. The result is 0 if a force at the tip does not load any
    tendon of the digit.
    """
    virtual_work = 0.0
    squared_response = 0.0
    for n in range(c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d]):
        tension_per_force = 0.0
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            tension_per_force += c.tendon_joint_table[h.TORQUE_TO_TENSION, n, j] * lever[j]
        virtual_work += tension_per_force * x.tendon[s.EXTERNAL_TENSION, n]
        squared_response += tension_per_force * tension_per_force
    return virtual_work / squared_response if squared_response > MIN_SQUARED_RESPONSE else 0.0


@kernel_helper
def update_grip_travel(x: StateTables, c: ConstantTables) -> None:
    """Update the fast and the slow average of each tendon's excursion (length on the spool minus stretch).

    The fast and the slow average are equal until the detection of slip begins.
    """
    is_slip_judged = x.run[s.GOAL_TIME] + c.run[h.CONTROL_PERIOD] >= x.run[s.SLIP_DETECTION_START]
    for n in range(x.tendon.shape[1]):
        # The tendon length on the spool minus the elastic stretch is the excursion at the joints.
        unstretched_travel = (
            x.tendon[s.SPOOL_TRAVEL, n] - x.tendon[s.TENSION, n] / c.tendon[h.TENDON_STIFFNESS, n]
        )
        fast_travel = x.tendon[s.FAST_GRIP_TRAVEL, n]
        slow_travel = x.tendon[s.SLOW_GRIP_TRAVEL, n]
        fast_travel = (
            fast_travel + (unstretched_travel - fast_travel) * c.run[h.FAST_GRIP_UPDATE_FRACTION]
            if x.run_int[s.PROGRAM_HOLDS_OBJECT]
            else unstretched_travel
        )
        slow_travel = (
            slow_travel + (unstretched_travel - slow_travel) * c.run[h.SLOW_GRIP_UPDATE_FRACTION]
        )
        x.tendon[s.FAST_GRIP_TRAVEL, n] = fast_travel
        x.tendon[s.SLOW_GRIP_TRAVEL, n] = (
            slow_travel if is_slip_judged and x.run_int[s.PROGRAM_HOLDS_OBJECT] else fast_travel
        )


@kernel("block", "layout", "vector", "vector")
def largest_grip_opening(
    block: BlockArray, at: TableOffsets, closing_sign: Vector, held_tension: Vector
) -> tuple[int, float]:
    """Find the largest recent opening of a digit that holds an object, and return the tendon and the opening [m].

    The opening is a length along the tendon. If no digit that holds an object has opened, the
    result is (0, 0.0).

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        closing_sign: (N,) direction of each tendon while its digit closes, see
            ``control_law.tendon_redundancy.TendonRedundancy``.
        held_tension: (N,) tension targets of the grip [N], NaN for the tendons of other digits.
    """
    x = state_tables(block, at)
    worst_tendon = 0
    largest_opening = 0.0
    for n in range(x.tendon.shape[1]):
        # A tendon that opens a digit is pulled out while the digit closes.
        opening = closing_sign[n] * (
            x.tendon[s.SLOW_GRIP_TRAVEL, n] - x.tendon[s.FAST_GRIP_TRAVEL, n]
        )
        if not math.isnan(held_tension[n]) and opening > largest_opening:
            worst_tendon, largest_opening = n, opening
    return worst_tendon, largest_opening
