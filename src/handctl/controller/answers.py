"""What people and programs asked in a tick, turned into the controller's state."""

from dataclasses import replace

from handctl.controller import retune
from handctl.controller.estimator import Estimate
from handctl.controller.live import apply_goal
from handctl.controller.model import HandModel
from handctl.controller.modes import Wishes
from handctl.controller.requests import Arm, Clear, Cut, HoldTension, MoveDigits, SetGains, Stop, parse_request
from handctl.controller.state import State
from handctl.controller.types import Event, Mode
from handctl.safety import judge as safety

BEFORE_READY = (Mode.SILENT, Mode.INVENTORY)
"""Modes in which an order to clear also clears the drives."""


def answer(
    model: HandModel, state: State, estimate: Estimate, requests: tuple[str, ...]
) -> tuple[State, Wishes, tuple[Event, ...]]:
    """Take in the requests of one tick, in order; what is no request becomes a line in the log.

    Args:
        model: the hand.
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
        events.append(Event("info", "request", "", f"asked: {request.do}"))
        if isinstance(request, Stop):
            wishes = replace(wishes, stop=True)
        elif isinstance(request, Cut):
            wishes = replace(wishes, cut=True)
        elif isinstance(request, Arm):
            state = state._replace(armed=True)
        elif isinstance(request, Clear):
            state = state._replace(safety=safety.clear(state.safety), clearing=state.mode in BEFORE_READY)
        elif isinstance(request, SetGains):
            coming, refused = retune.asked(state.coming.gains if state.coming else model.gains, request.set)
            state = state._replace(coming=coming or state.coming)
            events += refused
        elif isinstance(request, MoveDigits | HoldTension):
            progress, told = apply_goal(model, state.progress, request, estimate, state.goal_time)
            state = state._replace(progress=progress)
            events += told
    return state, wishes, tuple(events)
