"""Detection of a tendon that becomes slack or taut, by the load-cell readings of several ticks."""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.filter_types import SLACK_REGIME
from handctl.core.state_block import StateTables

MAX_SLACK_TENSION_N = 1.0
"""Upper limit of the estimated tension and of the load-cell reading of a tendon that could be slack [N].

The limit of 1 N is two standard deviations of the load cell's noise.
"""
SLACK_TICKS = 3
"""Number of ticks in a row below ``MAX_SLACK_TENSION_N`` after which a tendon counts as slack."""
MIN_TAUT_TENSION_N = 2.5
CERTAINLY_TAUT_POINTS = 6
LIKELY_TAUT_ABOVE_N = 1.5
LIKELY_TAUT_POINTS = 2
POSSIBLY_TAUT_ABOVE_N = 1.0
POSSIBLY_TAUT_POINTS = 1
"""Tensions [N], and the points that a load-cell sample above each tension adds. Points are evidence of a taut tendon.

A sample below all three tensions subtracts ``POINTS_AGAINST``. A sample above the first tension
(five standard deviations) makes a slack tendon count as taut at once.
"""
POINTS_AGAINST, TAUT_POINTS = 2, 6
"""Points that a low load-cell sample subtracts, and number of points from which a tendon counts as taut.

Load-cell noise of 0.5 N alone almost never reaches the points of a taut tendon. A drift of the load
cell by less than 1 N does not reach the points of a taut tendon either.
"""
NEARLY_TAUT_M, NEARLY_TAUT_FACTOR = 5e-5, 3
"""Slack length below which the encoder shows a nearly taut tendon [m], and the factor on the points of this tendon.

With the factor, a load-cell sample of three standard deviations makes a nearly taut tendon count as
taut at once. The slack length is uncertain by about 50 um, because of stops and friction.
"""

EXCURSION_MARGIN_M = 1e-3
"""Margin beyond the joints' range within which the excursion of a newly taut tendon is accepted [m]."""


@kernel_helper
def regime_evidence(
    regime: int,
    evidence_count: int,
    tension: float,
    cell_tension: float,
    cell_error: float,
    is_nearly_taut: bool,
) -> int:
    """Return the evidence that the regime of a tendon has ended.

    For a slack tendon, the evidence is a number of points. The points increase while the load cell
    indicates that the tendon is taut. For a taut tendon, the evidence is the number of ticks in a
    row in which the tendon seemed to be slack. If the load-cell reading of a taut tendon is
    missing, the number of ticks is set to 0. If the load-cell reading of a slack tendon is missing,
    the points do not change.

    Args:
        regime: present regime of the tendon.
        evidence_count: result of the function in the last tick.
        tension: estimated tension [N].
        cell_tension: load-cell reading [N].
        cell_error: estimated error of the load-cell reading [N].
        is_nearly_taut: True if the spool has wound up the slack length of the tendon.
    """
    if regime != SLACK_REGIME:
        return (
            evidence_count + 1
            if tension < MAX_SLACK_TENSION_N and cell_tension < MAX_SLACK_TENSION_N
            else 0
        )
    if math.isnan(cell_tension):
        return evidence_count
    evidence = -POINTS_AGAINST
    if cell_tension - cell_error > MIN_TAUT_TENSION_N:
        evidence = CERTAINLY_TAUT_POINTS
    elif cell_tension - cell_error > LIKELY_TAUT_ABOVE_N:
        evidence = LIKELY_TAUT_POINTS
    elif cell_tension - cell_error > POSSIBLY_TAUT_ABOVE_N:
        evidence = POSSIBLY_TAUT_POINTS
    if evidence > 0 and is_nearly_taut:
        evidence *= NEARLY_TAUT_FACTOR
    return max(evidence_count + evidence, 0)


TAUT_WITHOUT_CELL_N = 2.5
"""Threshold [N] for the force that is missing at the motor of a slack tendon without load cell.

A larger missing force counts as tension.
"""
SLACK_TICKS_WITHOUT_CELL = 12
"""Number of ticks in a row with low estimated tension after which a tendon without load cell counts as slack."""


@kernel_helper
def regime_evidence_without_cell(
    regime: int, evidence_count: int, tension: float, missing: float
) -> int:
    """Return the evidence for the end of a regime, for a tendon without a load cell.

    ``regime_evidence`` explains the evidence. The motor of a slack tendon turns without load, so
    its whole force accelerates the rotor. When the tendon has become taut, its tension reduces the
    force that accelerates the rotor. The missing force is the part of the motor force that no
    longer accelerates the rotor.

    Args:
        regime: present regime of the tendon.
        evidence_count: result of the function in the last tick.
        tension: estimated tension [N].
        missing: motor force that is missing, compared with the model of a slack tendon [N].
    """
    if regime != SLACK_REGIME:
        return evidence_count + 1 if tension < MAX_SLACK_TENSION_N else 0
    return max(
        evidence_count + (LIKELY_TAUT_POINTS if missing > TAUT_WITHOUT_CELL_N else -POINTS_AGAINST),
        0,
    )


@kernel_helper
def is_nearly_taut(x: StateTables, n: int) -> bool:
    """Return True if a slack tendon is nearly taut, according to the motor encoder and the known tendon length."""
    return (
        x.tendon[s.SPOOL_TRAVEL, n] - x.tendon[s.EXCURSION, n] - x.tendon[s.STRETCH_OFFSET, n]
        > -NEARLY_TAUT_M
    )


@kernel_helper
def is_regime_over(regime: int, evidence_count: int, has_no_cell: bool) -> bool:
    """Return True if the evidence (points or ticks) is sufficient to end a regime.

    A taut tendon without load cell (``has_no_cell``) counts as slack only after more ticks than a
    tendon with load cell.
    """
    slack_ticks = SLACK_TICKS_WITHOUT_CELL if has_no_cell else SLACK_TICKS
    return evidence_count >= (TAUT_POINTS if regime == SLACK_REGIME else slack_ticks)


@kernel_helper
def set_offset_of_newly_taut_tendon(
    x: StateTables, c: ConstantTables, n: int, cell_tension: float
) -> None:
    """Set the stretch offset or the excursion of a tendon that has become taut.

    With the new value, the modelled tension equals the load-cell reading. In a digit with return
    springs or joint encoders, the springs or encoders determine the excursion, so the function sets
    the stretch offset. In a digit with neither return springs nor joint encoders, the length of the
    tendon is known from commissioning, so the function sets the excursion. If the new excursion is
    outside the range of the joints, the stretch offset is set instead of the excursion.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        cell_tension: load-cell reading [N].
    """
    if x.tendon_int[s.DIGIT_ON_OPEN_STOP, n]:
        x.tendon[s.EXCURSION, n] = c.tendon[h.OPEN_EXCURSION, n]
    stretch = (cell_tension - x.tendon[s.CELL_ERROR, n]) / c.tendon[h.TENDON_STIFFNESS, n]
    excursion = x.tendon[s.SPOOL_TRAVEL, n] - x.tendon[s.STRETCH_OFFSET, n] - stretch
    low = c.tendon[h.MIN_EXCURSION, n] - EXCURSION_MARGIN_M
    high = c.tendon[h.MAX_EXCURSION, n] + EXCURSION_MARGIN_M
    if c.tendon_int[h.HAS_CONSTANT_LENGTH, n] and low <= excursion <= high:
        x.tendon[s.EXCURSION, n] = excursion
    else:
        x.tendon[s.STRETCH_OFFSET, n] = (
            x.tendon[s.SPOOL_TRAVEL, n] - x.tendon[s.EXCURSION, n] - stretch
        )
    x.tendon[s.EXCURSION_RATE, n] = x.tendon[s.MOTOR_DISTURBANCE, n] = 0.0
