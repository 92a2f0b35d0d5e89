"""When a tendon goes slack and when it is taut again, by what its load cell says tick after tick."""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core.block import Tables

SLACK = 2
SLACK_BELOW_N, SLACK_TICKS = 1.0, 3
"""Estimated and measured tension below this (two standard deviations of the load cell) for so many ticks is slack."""
TAUT_ABOVE_N, TAUT_AT_ONCE = 2.5, 6
LIKELY_ABOVE_N, LIKELY = 1.5, 2
POSSIBLE_ABOVE_N, POSSIBLE = 1.0, 1
"""Points that a load-cell sample above a tension counts for a taut tendon; below all of them it takes ``AGAINST`` away.
A sample above the first (five standard deviations) ends slack at once."""
AGAINST, TAUT_POINTS = 2, 6
"""Noise of 0.5 N alone hardly ever comes to so many points, nor does a cell that has drifted by less than 1 N."""
NEAR_M, NEAR_FACTOR = 5e-5, 3
"""A tendon that by its encoder hangs no looser than this is about to become taut, and every point counts threefold: a
sample of three standard deviations ends slack at once. Stops and friction leave its length open by about as much."""


@inner
def turning(regime: int, points: int, tension: float, cell: float, error: float, near: bool) -> int:
    """Return the evidence for becoming taut (in slack: points) or slack (taut: consecutive ticks).

    A missing sample ends a count of ticks and leaves points as they are.

    Args:
        regime: of the tendon. points: so far. tension: estimated [N]. cell: load cell [N].
        error: of the load cell, as far as it is known [N].
        near: whether the spool has wound in what hung loose.
    """
    if regime != SLACK:
        return points + 1 if tension < SLACK_BELOW_N and cell < SLACK_BELOW_N else 0
    if math.isnan(cell):
        return points
    worth = -AGAINST
    if cell - error > TAUT_ABOVE_N:
        worth = TAUT_AT_ONCE
    elif cell - error > LIKELY_ABOVE_N:
        worth = LIKELY
    elif cell - error > POSSIBLE_ABOVE_N:
        worth = POSSIBLE
    if worth > 0 and near:
        worth *= NEAR_FACTOR
    return max(points + worth, 0)


@inner
def near_taut(x: Tables, n: int) -> bool:
    """Return whether a slack tendon of known length is about to become taut by its encoder."""
    return x.tendon[s.TRAVEL, n] - x.tendon[s.EXCURSION, n] - x.tendon[s.STRETCH_OFFSET, n] > -NEAR_M


@inner
def has_turned(regime: int, points: int) -> bool:
    """Return whether that is enough to end a regime."""
    return points >= (TAUT_POINTS if regime == SLACK else SLACK_TICKS)


@inner
def take_up(x: Tables, n: int, stiffness: float, cell: float) -> None:
    """Set the offset of a tendon that has become taut, so that stretch and load cell agree.

    Args:
        x: tables. n: index of the tendon. stiffness: [N/m]. cell: load cell [N].
    """
    if x.tendon_int[s.STOPPED, n]:
        x.tendon[s.EXCURSION, n] = 0.0
    stretch = (cell - x.tendon[s.CELL_ERROR, n]) / stiffness
    x.tendon[s.STRETCH_OFFSET, n] = x.tendon[s.TRAVEL, n] - x.tendon[s.EXCURSION, n] - stretch
    x.tendon[s.EXCURSION_RATE, n] = x.tendon[s.DISTURBANCE, n] = 0.0
