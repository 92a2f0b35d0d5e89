"""The goals of all digits as arrays over the tendons: goals change far more rarely than ticks, so they are kept."""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import MinimumJerk, Trajectory
from handctl.core.model import HandModel
from handctl.core.types import Vector
from handctl.hand.dynamics import DigitModel

Mask = NDArray[np.bool_]


class Move(NamedTuple):
    """A digit on its way, or expected on it.

    Attributes:
        digit: it.
        coordinates: its place among the coordinates of all digits.
        trajectory: the way.
        since: when it began [s].
    """

    digit: DigitModel
    coordinates: slice
    trajectory: Trajectory
    since: float


@dataclass(frozen=True, slots=True, eq=False)
class GoalTable:
    """Goals of N tendons and J joints.

    Attributes:
        moves: digits on their way. together: all digits on one way, if they are.
        expected: digits at a tension that are expected on a way.
        moving: (N,) tendons of these. all_moving: whether that is all of them.
        known: (J,) their joints.
        exact: (N,) tendons of which a joint torque asks one tension and no other.
        alone: whether every digit has one tendon: then the tension that comes nearest is that within the bounds.
        holds: whether any tendon is held.
        held: (N,) tendons at a tension. all_held: whether that is all of them.
        target: (N,) their tensions, within what the hand allows [N].
        step: (N,) most that a set-point moves in a tick [N].
        limit: (N,) most motor force at the cable [N].
        nothing: (J,) NaN.
    """

    moves: tuple[Move, ...]
    together: tuple[MinimumJerk, float] | None
    expected: tuple[Move, ...]
    moving: Mask
    all_moving: bool
    known: Mask
    exact: Mask
    alone: bool
    holds: bool
    held: Mask
    all_held: bool
    target: Vector
    step: Vector
    limit: Vector
    nothing: Vector

    def chosen(self, moved: Vector, held: Vector, other: float) -> Vector:
        """(N,) one value for tendons that move, another for those that are held, a third for the rest."""
        if self.all_moving:
            return moved
        if self.all_held:
            return held
        found = np.full(len(moved), other)
        np.putmask(found, self.held, held)
        np.putmask(found, self.moving, moved)
        return found


@functools.lru_cache(maxsize=16)
def goal_table(model: HandModel, goals: tuple[DigitGoal, ...]) -> GoalTable:
    """Lay the goals out; goals are told apart by identity, so the same tuple gives the same table.

    Args:
        model: the hand.
        goals: per digit.
    """
    n, joints, at = model.tendon_count, len(model.hand.joints), 0
    moves: list[Move] = []
    expected: list[Move] = []
    moving, held, exact, known = (np.zeros(size, dtype=bool) for size in (n, n, n, joints))
    target, step, limit = np.zeros(n), np.zeros(n), np.zeros(n)
    for digit, tendons, goal in zip(model.digits, model.digit_tendons, goals, strict=True):
        coordinates = slice(at, at := at + digit.coupling.shape[1])
        exact[tendons] = digit.reduced_moment_arms.shape[0] == digit.reduced_moment_arms.shape[1]
        if goal.kind == Kind.MOTION and goal.trajectory is not None:
            moves.append(Move(digit, coordinates, goal.trajectory, goal.since))
            moving[tendons] = known[digit.joints] = True
        elif goal.kind == Kind.TENSION and goal.tension is not None:
            held[tendons], target[tendons] = True, goal.tension
            step[tendons], limit[tendons] = goal.rate * model.period, goal.force_limit
            if goal.trajectory is not None:
                expected.append(Move(digit, coordinates, goal.trajectory, goal.since))
    return GoalTable(
        moves=tuple(moves),
        together=_together(moves) if moving.all() else None,
        expected=tuple(expected),
        moving=moving,
        all_moving=bool(moving.all()),
        known=known,
        exact=exact,
        alone=all(digit.reduced_moment_arms.shape == (1, 1) for digit in model.digits),
        holds=bool(held.any()),
        held=held,
        all_held=bool(held.all()),
        target=np.clip(target, 0.0, model.ceiling),
        step=step,
        limit=limit,
        nothing=np.full(joints, np.nan),
    )


def _together(moves: list[Move]) -> tuple[MinimumJerk, float] | None:
    """The way of all digits in one, and when it began [s]; None if they do not move alike."""
    ways = [move.trajectory for move in moves if isinstance(move.trajectory, MinimumJerk)]
    if len(ways) < len(moves) or len({(way.duration, move.since) for way, move in zip(ways, moves, strict=True)}) > 1:
        return None
    start, end = (np.concatenate([getattr(way, name) for way in ways]) for name in ("start", "end"))
    return MinimumJerk(start, end, ways[0].duration), moves[0].since
