"""When a rope goes slack and when it is taut again, by what its load cell says tick after tick."""

from handctl.core.estimation.filter_stack import D, E, O, Regime, S, W, X
from handctl.core.types import Vector

SLACK = int(Regime.SLACK)
SLACK_BELOW_N, SLACK_TICKS = 1.0, 3
"""Estimated and measured tension below this (two standard deviations of the load cell) for so many ticks is slack."""
TAUT_ABOVE_N = 2.5
"""A load-cell sample above this ends slack at once (five standard deviations)."""
EVIDENCE = ((TAUT_ABOVE_N, 6), (1.5, 2), (1.0, 1))
"""Points that a sample above a tension [N] counts for a taut rope; one below all of them takes ``AGAINST`` away."""
AGAINST, TAUT_POINTS = 2, 6
"""Noise of 0.5 N alone hardly ever comes to so many points, nor does a cell that has drifted by less than 1 N."""
NEAR_M, NEAR_FACTOR = 5e-5, 3
"""A rope that by its encoder hangs no looser than this is about to become taut, and every point counts threefold: a
sample of three standard deviations ends slack at once. Stops and friction leave its length open by about as much."""


def turning(regime: int, points: int, tension: float, cell: float, error: float, near: bool = False) -> int:
    """What speaks for becoming taut (if slack: points) or slack (if taut: consecutive ticks).

    A missing sample ends a count of ticks and leaves points as they are.

    Args:
        regime: of the tendon. points: so far. tension: estimated [N]. cell: load cell [N].
        error: of the load cell, as far as it is known [N].
        near: whether the spool has wound in what hung loose.
    """
    if regime != SLACK:
        return points + 1 if tension < SLACK_BELOW_N and cell < SLACK_BELOW_N else 0
    if cell != cell:
        return points
    for above, worth in EVIDENCE:
        if cell - error > above:
            return points + worth * (NEAR_FACTOR if near else 1)
    return max(points - AGAINST, 0)


def near(x: Vector) -> bool:
    """Whether a rope of known length, slack and in the state (7,), is about to become taut by its encoder."""
    return bool(x[X] - x[S] - x[O] > -NEAR_M)


def has_turned(regime: int, points: int) -> bool:
    """Whether that is enough to end a regime."""
    return points >= (TAUT_POINTS if regime == SLACK else SLACK_TICKS)


def take_up(x: Vector, stiffness: float, cell: float, stopped: bool) -> None:
    """The rope has become taut: the offset is what makes stretch and load cell agree.

    Args:
        x: (7,) state of the tendon, changed in place. stiffness: [N/m]. cell: load cell [N].
        stopped: whether the digit is on its open stop.
    """
    if stopped:
        x[S] = 0.0
    x[O] = x[X] - x[S] - (cell - x[E]) / stiffness
    x[W] = x[D] = 0.0
