"""How relaxing begins: every tension falls to a small one from where it is, and none rises on the way."""

from dataclasses import replace

import numpy as np

from handctl.controller.goal import DigitGoal, Kind
from handctl.controller.model import HandModel
from handctl.controller.state import State
from handctl.controller.types import Vector

RELAX_FLOOR_N = 5.0
RELAX_RATE_N_PER_S, OVER_TENSION_RATE_N_PER_S = 500.0, 2000.0
OVER_TENSION = ("T03", "T06")
"""Faults of a rope that bears too much, or so much that its load cell cannot tell: what is let go of faster."""
RELAX_FROM_MORE_N = 15.0
"""More than the last command that relaxing may begin at: what a rope bears besides, in motion and by friction."""

AHEAD_N = 3.0
"""A set-point that is more than this above the tension is ahead of it; of a settled hold it is up to 2 N."""


def tension(model: HandModel, state: State) -> Vector:
    """(N,) tensions as the filter knows them [N]."""
    return np.asarray(model.filter.stacked(state.filter.regimes).tension @ state.filter.x)


def relaxing(model: HandModel, state: State) -> State:
    """The state with the goals of relaxing.

    It begins at the tension that there is: the set-point of a held digit is ahead of it where tension was to grow, and
    would go on pulling. Nor at one that no motor was asked for: a load cell may be wrong.
    """
    law = state.law
    held = np.array([state.progress.goals[d].kind == Kind.TENSION for d in model.digit_of])
    present = np.maximum(tension(model, state), RELAX_FLOOR_N) + AHEAD_N
    setpoint = np.where(held, np.minimum(law.setpoint, present), law.setpoint)
    begin = np.minimum(setpoint, np.maximum(law.force, 0.0) + RELAX_FROM_MORE_N)
    goals = tuple(
        DigitGoal(Kind.TENSION, tension=np.minimum(begin[s], RELAX_FLOOR_N), rate=_rate(state))
        for s in model.digit_tendons
    )
    return state._replace(progress=replace(state.progress, goals=goals), law=law._replace(setpoint=begin))


def hurried(state: State) -> State:
    """The state of a hand that is relaxing already, faster from the tick on in which a rope bears too much."""
    rate = _rate(state)
    if state.progress.goals[0].rate == rate:
        return state
    goals = tuple([replace(goal, rate=rate) for goal in state.progress.goals])
    return state._replace(progress=replace(state.progress, goals=goals))


def _rate(state: State) -> float:
    """How fast tensions fall [N/s]."""
    too_much = any(mark.id in OVER_TENSION for mark in state.safety.latched)
    return OVER_TENSION_RATE_N_PER_S if too_much else RELAX_RATE_N_PER_S
