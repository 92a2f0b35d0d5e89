"""Transitions of a tendon between slack and taut, by the load cell over consecutive ticks."""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables

SLACK = 2
SLACK_BELOW_N = 1.0
"""Limit of estimated and measured tension in slack: two standard deviations of the load cell [N]."""
SLACK_TICKS = 3
"""Consecutive ticks below ``SLACK_BELOW_N`` before a tendon counts as slack."""
TAUT_ABOVE_N = 2.5
POINTS_AT_ONCE = 6
LIKELY_ABOVE_N = 1.5
POINTS_LIKELY = 2
POSSIBLE_ABOVE_N = 1.0
POINTS_POSSIBLE = 1
"""Points towards a taut tendon for a load-cell sample above each tension.

A sample below all of them subtracts ``POINTS_AGAINST``.
A sample above the first (five standard deviations) ends slack at once.
"""
POINTS_AGAINST, POINTS_OF_TAUT = 2, 6
"""Points subtracted per sample, and points of a taut tendon.

Noise of 0.5 N alone hardly ever reaches the points, nor does a cell with a drift below 1 N.
"""
NEAR_M, NEAR_FACTOR = 5e-5, 3
"""Slack length of a nearly taut tendon, by the encoder [m], and factor on the points then.

A sample of three standard deviations ends slack at once then. Stops and friction leave the length
uncertain by about as much.
"""

RANGE_MARGIN_M = 1e-3
"""Margin of a newly taut tendon's excursion by its length [m]. Beyond the joints' range the length is not known."""


@inner
def regime_evidence(regime: int, points: int, tension: float, cell: float, error: float, near: bool) -> int:
    """Return the evidence that a slack tendon becomes taut (in points), or a taut one slack (in consecutive ticks).

    A missing sample resets the ticks, and keeps the points.

    Args:
        regime: of the tendon.
        points: so far.
        tension: estimated [N].
        cell: load cell [N].
        error: known error of the load cell [N].
        near: True if the spool has wound up the slack length.
    """
    if regime != SLACK:
        return points + 1 if tension < SLACK_BELOW_N and cell < SLACK_BELOW_N else 0
    if math.isnan(cell):
        return points
    evidence = -POINTS_AGAINST
    if cell - error > TAUT_ABOVE_N:
        evidence = POINTS_AT_ONCE
    elif cell - error > LIKELY_ABOVE_N:
        evidence = POINTS_LIKELY
    elif cell - error > POSSIBLE_ABOVE_N:
        evidence = POINTS_POSSIBLE
    if evidence > 0 and near:
        evidence *= NEAR_FACTOR
    return max(points + evidence, 0)


TAUT_WITHOUT_CELL_N = 2.5
"""Force missing at the motor of a slack tendon without load cell that counts as tension [N]."""
SLACK_TICKS_WITHOUT_CELL = 12
"""Ticks in a row of slack by the estimate alone."""


@inner
def regime_evidence_without_cell(regime: int, points: int, tension: float, missing: float) -> int:
    """Return the evidence of a tendon without load cell, see ``regime_evidence``.

    The motor of a slack tendon runs alone. Once the tendon is taut the motor lacks its tension.

    Args:
        regime: of the tendon.
        points: so far.
        tension: estimated [N].
        missing: force that the motor lacks [N].
    """
    if regime != SLACK:
        return points + 1 if tension < SLACK_BELOW_N else 0
    return max(points + (POINTS_LIKELY if missing > TAUT_WITHOUT_CELL_N else -POINTS_AGAINST), 0)


@inner
def is_nearly_taut(x: Tables, n: int) -> bool:
    """Return True if a slack tendon of known length is nearly taut by the encoder."""
    return x.tendon[s.TRAVEL, n] - x.tendon[s.EXCURSION, n] - x.tendon[s.STRETCH_OFFSET, n] > -NEAR_M


@inner
def is_regime_over(regime: int, points: int, blind: bool) -> bool:
    """Return True if the evidence ends a regime. A tendon without load cell (``blind``) becomes slack later."""
    slack_ticks = SLACK_TICKS_WITHOUT_CELL if blind else SLACK_TICKS
    return points >= (POINTS_OF_TAUT if regime == SLACK else slack_ticks)


@inner
def set_offset_of_newly_taut(x: Tables, c: ConstantTables, n: int, cell: float) -> None:
    """Set offset or excursion of a newly taut tendon to make stretch and load cell agree.

    The excursion of a digit on its open stop, or with joint encoders, is known. Otherwise the
    length of the tendon is known by commissioning.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        cell: load cell [N].
    """
    if x.tendon_int[s.STOPPED, n]:
        x.tendon[s.EXCURSION, n] = c.tendon[h.OPEN_EXCURSION, n]
    stretch = (cell - x.tendon[s.CELL_ERROR, n]) / c.tendon[h.STIFFNESS, n]
    excursion = x.tendon[s.TRAVEL, n] - x.tendon[s.STRETCH_OFFSET, n] - stretch
    low = c.tendon[h.EXCURSION_LOW, n] - RANGE_MARGIN_M
    high = c.tendon[h.EXCURSION_HIGH, n] + RANGE_MARGIN_M
    if c.tendon_int[h.ABSOLUTE, n] and low <= excursion <= high:
        x.tendon[s.EXCURSION, n] = excursion
    else:
        x.tendon[s.STRETCH_OFFSET, n] = x.tendon[s.TRAVEL, n] - x.tendon[s.EXCURSION, n] - stretch
    x.tendon[s.EXCURSION_RATE, n] = x.tendon[s.DISTURBANCE, n] = 0.0
