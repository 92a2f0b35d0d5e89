"""Relax the hand: every tension falls to a small one, and no motor is commanded to pull harder on the way.

The loop that would lower the tension may be what is broken: crossed feedback, a motor that answers late, an encoder
that lies. Therefore an envelope bounds the motor force of each tendon, and no measurement can raise it:

    e[k] = max(min(u[k-1], floor), u[k-1] - rate T)      0 <= u[k] <= e[k]

with the motor force u at the cable that was commanded [N]. It begins at the last command, or at the tension that is
there if this is less. The tension loop may only go below the envelope. After a fault that
makes the loop doubtful (``Release.OPEN``) u[k] = e[k]. A motor that brakes when relaxing begins goes to zero.
"""

from dataclasses import replace

import numpy as np

from handctl.controller.state import State
from handctl.core.law.computed_torque import Envelope
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.model import HandModel
from handctl.core.types import Mode, Vector
from handctl.safety.action import Release
from handctl.safety.faults.table import BY_ID

RELAX_FLOOR_N = 5.0
RELAX_RATE_N_PER_S, OVER_TENSION_RATE_N_PER_S = 500.0, 2000.0
ROUNDING = 1.0 - 1e-12
"""Keeps an envelope that has come to rest from creeping upwards by the last bit of a division."""
RELAX_FROM_MORE_N = 15.0
"""More than the last command that relaxing may begin at: what a rope bears besides, in motion and by friction."""

OF_LOAD_CELLS = ("T04b", "T05", "T05b", "T06")
"""Faults in which the measured tension is not to be trusted."""
RELAXED_WITHIN_N = 3.0
"""A tendon within this of the floor is relaxed."""
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
    return state._replace(
        progress=replace(state.progress, goals=goals),
        law=law._replace(setpoint=begin),
        watch=state.watch._replace(asked=_begin(model, state, present)),
    )


def _begin(model: HandModel, state: State, present: Vector) -> Vector:
    """Return (N,) motor force at which the envelope begins [N]: what was commanded, or less.

    A loop that a fault has made unstable may have commanded 100 N for a tendon that bears 10. Such a command ends at
    once: the motor begins at the tension that is there, with what friction adds. A doubted load cell has no say.

    Args:
        model: the hand. state: of the tick in which relaxing begins.
        present: (N,) tension with a margin [N].
    """
    asked = np.nan_to_num(state.watch.asked, nan=0.0)
    if any(mark.id in OF_LOAD_CELLS for mark in state.safety.latched):
        return np.asarray(asked)
    return np.minimum(asked, present + model.space.coulomb)


def envelope(model: HandModel, state: State, ticks: int) -> Envelope | None:
    """Bound the motor force of this tick while the hand relaxes.

    Args:
        model: the hand.
        state: with the mode of this tick. ``watch.asked`` is what the last tick commanded.
        ticks: periods since the last tick, 1 unless ticks were missed.

    Returns:
        The envelope; None in every other mode.
    """
    if state.mode != Mode.RELAX:
        return None
    last = np.maximum(np.nan_to_num(state.watch.asked, nan=0.0), 0.0)
    falling = np.maximum(last - _rate(state) * model.period * ticks, 0.0)
    ceiling = np.maximum(np.minimum(last, RELAX_FLOOR_N), falling) * ROUNDING
    return Envelope(ceiling, Release.OPEN in _releases(state))


def let_go(state: State) -> bool:
    """Return True if no motor is commanded more than what a relaxed tendon bears."""
    return not np.any(state.watch.asked > RELAX_FLOOR_N + RELAXED_WITHIN_N)


def hurried(state: State) -> State:
    """The state of a hand that is relaxing already, faster from the tick on in which a rope bears too much."""
    rate = _rate(state)
    if state.progress.goals[0].rate == rate:
        return state
    goals = tuple([replace(goal, rate=rate) for goal in state.progress.goals])
    return state._replace(progress=replace(state.progress, goals=goals))


def _rate(state: State) -> float:
    """Return how fast tensions fall [N/s]."""
    return OVER_TENSION_RATE_N_PER_S if Release.FAST in _releases(state) else RELAX_RATE_N_PER_S


def _releases(state: State) -> set[Release]:
    """Return how the latched faults want the torque taken away."""
    return {BY_ID[mark.id].release for mark in state.safety.latched}
