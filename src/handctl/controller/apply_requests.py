"""Application of requests to the state of the controller.

Requests come from operators and from programs.
"""

from dataclasses import replace

import numpy as np

from handctl.controller import gain_change
from handctl.controller.client_lease import begin_lease, renew_lease
from handctl.controller.controller_state import ControllerState
from handctl.controller.hand_modes import OperatorRequests
from handctl.controller.target_streams import (
    bring_to_rest,
    close_stream,
    open_stream,
    present_references,
)
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import (
    SHUTDOWN_MODES,
    HandMode,
    TickEvent,
)
from handctl.programs.commission import CommissionProgram
from handctl.programs.live_session import (
    LiveProgram,
    apply_goal,
    begin_task,
    end_task,
    release_task,
)
from handctl.programs.program import Program
from handctl.programs.requests import (
    ArmRequest,
    ClearFaultsRequest,
    CloseStreamRequest,
    CommandRequestBase,
    CutTorqueRequest,
    GiveUpCommandRequest,
    GraspRequest,
    HoldTensionRequest,
    KeepAliveRequest,
    MoveDigitsRequest,
    OpenStreamRequest,
    ReleaseGraspRequest,
    Request,
    SetGainsRequest,
    StopRequest,
    describe_request,
    is_routine_request,
    parse_request,
)
from handctl.programs.stream_plans import streamed_digits
from handctl.safety.faults.table import DEBOUNCE_TICKS, FAULT_BY_ID

MODES_BEFORE_READY = (HandMode.SILENT, HandMode.INVENTORY)
"""Modes in which a request to clear faults also clears the errors of the drives."""


def apply_requests(
    model: HandModel, program: Program, state: ControllerState, request_texts: tuple[str, ...]
) -> tuple[OperatorRequests, tuple[TickEvent, ...]]:
    """Apply the requests of one tick in the order of their arrival.

    The function does not apply the targets of streams. A text that is not a request causes a
    warning event.

    Args:
        model: model of the hand.
        program: program that determines the goals of the digits.
        state: state of the tick, modified in place.
        request_texts: requests as JSON texts.

    Returns:
        The requests to stop the run or to cut the torque, and the events that the given requests
        cause.
    """
    operator_requests = OperatorRequests()
    events = list[TickEvent]()
    for text in request_texts:
        request = parse_request(text)
        if isinstance(request, str):
            events.append(TickEvent("warn", "request", "", request))
            continue
        if not is_routine_request(text):
            events.append(TickEvent("info", "request", "", describe_request(request)))
        if isinstance(request, StopRequest):
            operator_requests = replace(operator_requests, is_stop_requested=True)
        elif isinstance(request, CutTorqueRequest):
            operator_requests = replace(operator_requests, is_cut_requested=True)
        elif isinstance(request, ArmRequest):
            state.is_arming_requested = True
        elif isinstance(request, ClearFaultsRequest):
            clear_latched_faults(state)
            state.is_clearing_errors = state.mode in MODES_BEFORE_READY
        else:
            events += _apply_other_request(model, program, state, request)
    return operator_requests, tuple(events)


def _apply_other_request(
    model: HandModel, program: Program, state: ControllerState, request: Request
) -> tuple[TickEvent, ...]:
    """Apply one request.

    The request is a change of gains, a sign of life from a client, or a motion command.
    """
    if isinstance(request, SetGainsRequest):
        return _set_gains(model, program, state, request)
    if isinstance(request, KeepAliveRequest):
        return renew_lease(state, request.client)
    return (
        _apply_command(model, program, state, request)
        if isinstance(request, CommandRequestBase)
        else ()
    )


def _set_gains(
    model: HandModel, program: Program, state: ControllerState, request: SetGainsRequest
) -> tuple[TickEvent, ...]:
    """Begin to design the controller for the gains that a request demands."""
    if isinstance(program, CommissionProgram):
        return (TickEvent("warn", "request", "", "refused: the hand is being commissioned"),)
    pending_gains = state.decisions.pending_gains
    progress_of_design, refusal_text = gain_change.begin_gain_design(
        pending_gains.gains if pending_gains else model.gains, request.set
    )
    state.decide(pending_gains=progress_of_design or pending_gains)
    return refusal_text


def _apply_command(
    model: HandModel, program: Program, state: ControllerState, request: CommandRequestBase
) -> tuple[TickEvent, ...]:
    """Execute a motion command of a client, if the run accepts commands from the client."""
    if refusal := _refusal_reason(program, state, request):
        return (refusal,)
    if state.decisions.commanding_client not in (None, request.client):
        close_stream(model, state)
    state.decide(commanding_client=request.client)
    begin_lease(state, request)
    if isinstance(request, GraspRequest | ReleaseGraspRequest):
        return _apply_grasp(model, state, request)
    if state.progress.task is not None and not isinstance(request, CloseStreamRequest):
        state.decide(progress=end_task(state.progress))
    if isinstance(request, MoveDigitsRequest | HoldTensionRequest):
        return _set_goal(model, state, request)
    if isinstance(request, OpenStreamRequest):
        return (open_stream(model, state, request),)
    stream = state.decisions.stream
    if not isinstance(request, CloseStreamRequest):
        close_stream(model, state)
        state.decide(progress=bring_to_rest(model, state))
    elif stream is not None and stream.name == request.stream:
        close_stream(model, state)
    if isinstance(request, GiveUpCommandRequest):
        state.decide(commanding_client=None)
    return ()


def _apply_grasp(
    model: HandModel, state: ControllerState, request: GraspRequest | ReleaseGraspRequest
) -> tuple[TickEvent, ...]:
    """Begin a grasp task, or let the running grasp task release the object."""
    if isinstance(request, ReleaseGraspRequest):
        progress, events = release_task(state.progress)
    else:
        close_stream(model, state)
        progress, events = begin_task(
            model, state.progress, request.task, state.estimate, state.goal_time
        )
    state.decide(progress=progress)
    return events


def _refusal_reason(
    program: Program, state: ControllerState, request: CommandRequestBase
) -> TickEvent | None:
    """Return an event that contains the reason why a command is refused.

    Return None if the command is accepted.

    A hand must not pull while it relaxes or while it is being commissioned. Only one client is
    allowed to send commands to a hand.
    """
    if state.mode in SHUTDOWN_MODES:
        return TickEvent("info", "request", "", "refused: the hand is letting go")
    if not isinstance(program, LiveProgram):
        return TickEvent("warn", "request", "", "refused: this run has goals of its own")
    if state.mode != HandMode.ACTIVE or state.progress.phase in ("start", "tighten"):
        return TickEvent("warn", "request", "", "refused: the hand is not ready yet")
    commanding_client = state.decisions.commanding_client
    if commanding_client in (None, request.client) or request.take_over:
        return None
    text = f"refused: {commanding_client or 'a client without a name'} commands this hand, expected take_over"
    return TickEvent("info", "request", "", text)


def _set_goal(
    model: HandModel, state: ControllerState, request: MoveDigitsRequest | HoldTensionRequest
) -> tuple[TickEvent, ...]:
    """Give a new goal to the digits that a request names.

    If a stream moves one of the named digits, end the stream.
    """
    reference = present_references(model, state)
    progress, events = apply_goal(
        model, state.progress, request, state.estimate, state.goal_time, reference
    )
    if progress is state.progress:
        return events
    stream, goals = state.decisions.stream, state.progress.goals
    if stream is not None and any(
        progress.goals[d] is not goals[d] for d in streamed_digits(model, stream)
    ):
        close_stream(model, state)
        progress, _ = apply_goal(
            model, state.progress, request, state.estimate, state.goal_time, reference
        )
    state.decide(progress=progress)
    return events


def clear_latched_faults(state: ControllerState) -> None:
    """Clear all latched faults at the request of the operator.

    A fault that is still present is detected and latched again in the present tick.
    """
    ticks = state.view("fault_ticks")[: len(DEBOUNCE_TICKS)]
    # The function sets the tick count of each fault to one below the debounce, so a fault that is
    # still present becomes active again in the present tick. The tick count of any other fault
    # returns to zero.
    np.minimum(ticks, DEBOUNCE_TICKS[:, None] - 1, out=ticks)
    reported_faults = [
        reported_fault._replace(
            ticks=min(reported_fault.ticks, FAULT_BY_ID[reported_fault.id].debounce_ticks - 1)
        )
        for reported_fault in state.decisions.reported_faults
    ]
    state.decide(latched_faults=(), reported_faults=tuple(reported_faults))
