"""Touch that nobody has planned: a digit that is on a stop, or has met something on its way.

A closing digit is judged by ``contact``, finely; here it takes a force at the tip that no error of the model makes.
The filter must know: it takes a free digit to follow its rope, and a loop on that belief rings against a blocked one.
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from handctl.core.estimation.estimator import Estimate
from handctl.core.model import HandModel
from handctl.core.types import Event, Vector

SMOOTH_S = 20e-3
"""Time constant of the tension that is judged."""
BLOCKED_N, FREED_N = 6.0, 3.0
"""Tension, the mean of a digit's tendons, that nothing explains, from which on it is blocked, and below which it is
free again: fast free motion with friction wrong by a half comes to 3.6 N. It is not taken as a force at the tip, since
a digit that is curled up on its stops has no lever there."""
PRESS_N = 30.0
"""A digit that is blocked on its way pulls at most so much more than the way asks: the loop that holds it there is
stiff enough to wind the rope up to where safety must act."""


class Touch(NamedTuple):
    """What is felt of each digit.

    Attributes:
        tension: (D,) that nothing explains, the mean of its tendons, smoothed [N].
        blocked: per digit.
    """

    tension: Vector
    blocked: tuple[bool, ...]

    @staticmethod
    @functools.lru_cache(maxsize=16)
    def none(digits: int) -> "Touch":
        """Nothing felt."""
        return Touch(np.zeros(digits), (False,) * digits)


def feel(model: HandModel, before: Touch, estimate: Estimate) -> Touch:
    """Take in what one more tick tells.

    Args:
        model: the hand.
        before: from the last tick.
        estimate: of this instant.
    """
    starts, weight, kept = _constants(model)
    tension = kept * before.tension + weight * np.add.reduceat(estimate.external, starts)
    felt = tension.tolist()
    if max(felt) < FREED_N and True not in before.blocked:
        return Touch(tension, before.blocked)
    pairs = zip(felt, before.blocked, strict=True)
    return Touch(tension, tuple([one > (FREED_N if was else BLOCKED_N) for one, was in pairs]))


@functools.lru_cache(maxsize=16)
def _constants(model: HandModel) -> tuple[list[int], Vector, float]:
    """First tendon of each digit, (D,) what each of its tendons counts in a tick, and what is kept of the last."""
    kept = math.exp(-model.period / SMOOTH_S)
    counts = np.array([tendons.stop - tendons.start for tendons in model.digit_tendons])
    return [tendons.start for tendons in model.digit_tendons], (1.0 - kept) / counts, kept


def gentle(model: HandModel, felt: Touch, planned: Vector, most: Vector | None) -> Vector | None:
    """(N,) tension that must not be exceeded [N], with what is allowed of digits that are blocked on their way.

    Args:
        model: the hand. felt: of each digit.
        planned: (N,) tensions that their ways ask [N]; 0 of digits that have none.
        most: (N,) that holds anyway [N]; None for nothing.
    """
    if True not in felt.blocked:
        return most
    limit = np.full(len(planned), np.inf) if most is None else most.copy()
    for tendons, blocked in zip(model.digit_tendons, felt.blocked, strict=True):
        if blocked:
            own = planned[tendons]
            limit[tendons] = np.minimum(limit[tendons], np.where(own > 0.0, own + PRESS_N, np.inf))
    return limit


def told(names: tuple[str, ...], before: Touch, after: Touch, known: tuple[bool, ...]) -> tuple[Event, ...]:
    """Lines for the log where a digit is found blocked, or free again, that was not known to touch.

    Args:
        names: of the digits. before, after: of the last tick and of this one. known: digits known to touch anyway.
    """
    if before.blocked == after.blocked:
        return ()
    events = []
    for name, was, now, tension, anyway in zip(
        names, before.blocked, after.blocked, after.tension.tolist(), known, strict=True
    ):
        if was != now and not anyway:
            text = (
                f"{name} is blocked: {tension:.1f} N of tension that nothing explains"
                if now
                else f"{name} is free again"
            )
            events.append(Event("info", "blocked", name, text))
    return tuple(events)
