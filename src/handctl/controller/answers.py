"""What people and programs asked in a tick, turned into the controller's state."""

from dataclasses import replace

from handctl.controller import retune
from handctl.controller.modes import Wishes
from handctl.controller.state import State
from handctl.core.estimation.estimator import Estimate
from handctl.core.model import HandModel
from handctl.core.types import LETTING_GO, Event, Mode
from handctl.programs.commission import CommissionProgram
from handctl.programs.live import LiveProgram, apply_goal
from handctl.programs.program import Program
from handctl.programs.requests import Arm, Clear, Cut, HoldTension, MoveDigits, SetGains, Stop, parse_request, taken
from handctl.safety import judge as safety

BEFORE_READY = (Mode.SILENT, Mode.INVENTORY)
"""Modes in which an order to clear also clears the drives."""


def answer(
    model: HandModel, program: Program, state: State, estimate: Estimate, requests: tuple[str, ...]
) -> tuple[State, Wishes, tuple[Event, ...]]:
    """Take in the requests of one tick, in order; what is no request becomes a line in the log.

    Args:
        model: the hand.
        program: that decides the goals.
        state: of this tick.
        estimate: of this instant.
        requests: JSON text each.
    """
    wishes, events = Wishes(), []
    for text in requests:
        request = parse_request(text)
        if isinstance(request, str):
            events.append(Event("warn", "request", "", request))
            continue
        events.append(Event("info", "request", "", taken(request)))
        if isinstance(request, Stop):
            wishes = replace(wishes, stop=True)
        elif isinstance(request, Cut):
            wishes = replace(wishes, cut=True)
        elif isinstance(request, Arm):
            state = state._replace(armed=True)
        elif isinstance(request, Clear):
            state = state._replace(safety=safety.clear(state.safety), clearing=state.mode in BEFORE_READY)
        elif isinstance(request, SetGains) and isinstance(program, CommissionProgram):
            events.append(Event("warn", "request", "", "refused: the hand is being commissioned"))
        elif isinstance(request, SetGains):
            coming, refused = retune.asked(state.coming.gains if state.coming else model.gains, request.set)
            state = state._replace(coming=coming or state.coming)
            events += refused
        elif isinstance(request, MoveDigits | HoldTension):
            state, told = _set_goal(model, program, state, estimate, request)
            events += told
    return state, wishes, tuple(events)


def _set_goal(
    model: HandModel, program: Program, state: State, estimate: Estimate, request: MoveDigits | HoldTension
) -> tuple[State, tuple[Event, ...]]:
    """A live goal, if the run waits for one: a hand that lets go must not pull again, nor one that is commissioned."""
    if state.mode in LETTING_GO:
        return state, (Event("info", "request", "", "refused: the hand is letting go"),)
    if not isinstance(program, LiveProgram):
        return state, (Event("warn", "request", "", "refused: this run has goals of its own"),)
    if state.mode != Mode.ACTIVE:
        return state, (Event("warn", "request", "", "refused: the hand is not ready yet"),)
    progress, told = apply_goal(model, state.progress, request, estimate, state.goal_time)
    return state._replace(progress=progress), told
