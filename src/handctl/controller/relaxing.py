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
from handctl.core import block as s
from handctl.core.law.computed_torque import RELAX_FLOOR_N
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.model import HandModel
from handctl.core.types import Vector
from handctl.safety.action import Release
from handctl.safety.faults.table import BY_ID

RELAX_RATE_N_PER_S, OVER_TENSION_RATE_N_PER_S = 500.0, 2000.0
RELAX_FROM_MORE_N = 15.0
"""More than the last command that relaxing may begin at: what a tendon bears besides, in motion and by friction."""

OF_LOAD_CELLS = ("T04b", "T05", "T05b", "T06")
"""Faults in which the measured tension is not to be trusted."""
RELAXED_WITHIN_N = 3.0
"""A tendon within this of the floor is relaxed."""
AHEAD_N = 3.0
"""A setpoint that is more than this above the tension is ahead of it; of a settled hold it is up to 2 N."""


def begin_relaxing(model: HandModel, state: State) -> None:
    """Set the goals of relaxing.

    It begins at the tension that there is: the setpoint of a held digit is ahead of it where tension was to grow, and
    would go on pulling. Nor at one that no motor was asked for: a load cell may be wrong.
    """
    table, whole = state.tendon, state.tendon_int
    held = np.array([state.progress.goals[d].kind == Kind.TENSION for d in model.digit_of])
    present = np.maximum(table[s.TENSION], RELAX_FLOOR_N) + AHEAD_N
    setpoint = np.where(held, np.minimum(table[s.SETPOINT], present), table[s.SETPOINT])
    begin = np.minimum(setpoint, np.maximum(table[s.FORCE], 0.0) + RELAX_FROM_MORE_N)
    goals = tuple(
        DigitGoal(Kind.TENSION, tension=np.minimum(begin[tendons], RELAX_FLOOR_N), rate=relax_rate(state))
        for tendons in model.digit_tendons
    )
    state.decide(progress=replace(state.progress, goals=goals))
    table[s.SETPOINT] = begin
    table[s.ASKED] = _begin(model, state, present)
    whole[s.GOAL_KIND] = int(Kind.TENSION)


def _begin(model: HandModel, state: State, present: Vector) -> Vector:
    """Return (N,) motor force at which the envelope begins [N]: what was commanded, or less.

    A loop that a fault has made unstable may have commanded 100 N for a tendon that bears 10. Such a command ends at
    once: the motor begins at the tension that is there, with what friction adds. A doubted load cell has no say.

    Args:
        model: the hand. state: of the tick in which relaxing begins.
        present: (N,) tension with a margin [N].
    """
    asked = np.nan_to_num(state.tendon[s.ASKED], nan=0.0)
    if any(mark.id in OF_LOAD_CELLS for mark in state.latched):
        return np.asarray(asked)
    return np.minimum(asked, present + model.space.coulomb)


def let_go(state: State) -> bool:
    """Return True if no motor is commanded more than what a relaxed tendon bears."""
    return not np.any(state.tendon[s.ASKED] > RELAX_FLOOR_N + RELAXED_WITHIN_N)


def settled(state: State) -> bool:
    """Return True if every tendon bears little enough."""
    return bool(np.max(state.tendon[s.TENSION]) < RELAX_FLOOR_N + RELAXED_WITHIN_N)


def hurry(state: State) -> None:
    """Let a hand that is relaxing already relax faster from the tick on in which a tendon bears too much."""
    rate = relax_rate(state)
    if state.progress.goals[0].rate != rate:
        goals = tuple([replace(goal, rate=rate) for goal in state.progress.goals])
        state.decide(progress=replace(state.progress, goals=goals))


def relax_rate(state: State) -> float:
    """Return how fast tensions fall [N/s]."""
    return OVER_TENSION_RATE_N_PER_S if Release.FAST in _releases(state) else RELAX_RATE_N_PER_S


def open_loop(state: State) -> bool:
    """Return whether the envelope itself is commanded, whatever is measured."""
    return Release.OPEN in _releases(state)


def _releases(state: State) -> set[Release]:
    """Return how the latched faults want the torque taken away."""
    return {BY_ID[mark.id].release for mark in state.latched}
