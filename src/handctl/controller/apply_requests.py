"""Requests of operators and programs, applied to the controller's state."""

from dataclasses import replace

import numpy as np

from handctl.controller import retune
from handctl.controller.modes import OperatorRequests
from handctl.controller.state import State
from handctl.core.model import HandModel
from handctl.core.types import LETTING_GO, Event, Mode
from handctl.programs.commission import CommissionProgram
from handctl.programs.live import LiveProgram, apply_goal
from handctl.programs.program import Program
from handctl.programs.requests import (
    Arm,
    Clear,
    Cut,
    HoldTension,
    MoveDigits,
    SetGains,
    Stop,
    describe_request,
    parse_request,
)
from handctl.safety.faults.table import BY_ID, DEBOUNCE

BEFORE_READY = (Mode.SILENT, Mode.INVENTORY)
"""Modes in which a request to clear also clears the drives."""


def apply_requests(
    model: HandModel, program: Program, state: State, requests: tuple[str, ...]
) -> tuple[OperatorRequests, tuple[Event, ...]]:
    """Apply the requests of one tick, in order. Other text becomes a warning event.

    Args:
        model: the hand.
        program: source of the goals.
        state: of the tick, modified in place.
        requests: JSON texts.

    Returns:
        Stop and cut requests, and events for each request.
    """
    operator = OperatorRequests()
    events = list[Event]()
    for text in requests:
        request = parse_request(text)
        if isinstance(request, str):
            events.append(Event("warn", "request", "", request))
            continue
        events.append(Event("info", "request", "", describe_request(request)))
        if isinstance(request, Stop):
            operator = replace(operator, stop=True)
        elif isinstance(request, Cut):
            operator = replace(operator, cut=True)
        elif isinstance(request, Arm):
            state.armed = True
        elif isinstance(request, Clear):
            clear(state)
            state.clearing = state.mode in BEFORE_READY
        elif isinstance(request, SetGains) and isinstance(program, CommissionProgram):
            events.append(Event("warn", "request", "", "refused: the hand is being commissioned"))
        elif isinstance(request, SetGains):
            pending = state.decisions.pending
            designed, refused = retune.begin_design(pending.gains if pending else model.gains, request.set)
            state.decide(pending=designed or pending)
            events += refused
        elif isinstance(request, MoveDigits | HoldTension):
            events += _set_goal(model, program, state, request)
    return operator, tuple(events)


def _set_goal(model: HandModel, program: Program, state: State, request: MoveDigits | HoldTension) -> tuple[Event, ...]:
    """Set a live goal if the run accepts live goals. A relaxing or commissioning hand must not pull."""
    if state.mode in LETTING_GO:
        return (Event("info", "request", "", "refused: the hand is letting go"),)
    if not isinstance(program, LiveProgram):
        return (Event("warn", "request", "", "refused: this run has goals of its own"),)
    if state.mode != Mode.ACTIVE:
        return (Event("warn", "request", "", "refused: the hand is not ready yet"),)
    progress, events = apply_goal(model, state.progress, request, state.estimate, state.goal_time)
    state.decide(progress=progress)
    return events


def clear(state: State) -> None:
    """Drop all latches by request of the operator.

    A fault still present counts anew in the tick, and latches again.
    """
    ticks = state.view("fault_ticks")[: len(DEBOUNCE)]
    # One tick below the debounce: a present fault counts again in this tick, an absent one is reset.
    np.minimum(ticks, DEBOUNCE[:, None] - 1, out=ticks)
    counting = [one._replace(ticks=min(one.ticks, BY_ID[one.id].debounce - 1)) for one in state.decisions.counting]
    state.decide(latched=(), counting=tuple(counting))
