"""Reaction to the loss of the client that commands a hand: first the digits come to rest, later the hand relaxes.

A client sends no more goals if its program hangs or has been killed. Without a reaction, the last
goal of a lost client would apply without a time limit. A client can have a lease, which limits the
time for which the client may be silent. The client renews the lease by regular signs of life, which
are short requests. Commands, signs of life and targets reach the tick as requests. A log contains
all requests, so the leases are the same when a log is executed again.
"""

from dataclasses import replace

from handctl.controller.controller_state import ClientLease, ControllerState
from handctl.controller.target_streams import bring_to_rest, close_stream
from handctl.core import state_block as s
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickEvent
from handctl.programs.requests import CommandRequestBase, GiveUpCommandRequest

RELAX_TIMEOUT_IN_LEASES = 2
"""Silence of a client after which the hand relaxes, as a multiple of the duration of its lease."""


def begin_lease(state: ControllerState, request: CommandRequestBase) -> None:
    """Start the lease of the client that has sent a command.

    If the command contains no lease, end the present lease.
    """
    lease = None
    if request.lease_s is not None and not isinstance(request, GiveUpCommandRequest):
        lease = ClientLease(
            request.client, round(1e9 * request.lease_s), state.run_integers[s.TICK_TIME_NS]
        )
    state.decide(lease=lease)


def renew_lease(state: ControllerState, client_name: str) -> tuple[TickEvent, ...]:
    """Renew the lease of a client that has sent a sign of life.

    Returns:
        An event if the client had been silent for longer than its lease allows.
    """
    lease = state.decisions.lease
    if lease is None or lease.client != client_name:
        return ()
    state.decide(
        lease=lease._replace(renewed_ns=state.run_integers[s.TICK_TIME_NS], is_at_rest=False)
    )
    return (
        (TickEvent("info", "lease", "", f"{client_name} answers again"),)
        if lease.is_at_rest
        else ()
    )


def enforce_lease(model: HandModel, state: ControllerState) -> tuple[TickEvent, ...]:
    """Bring the digits to rest, or end the run, if the commanding client has been silent for too long.

    A running task continues until the run ends. Digits that hold a tension continue to hold the
    tension until the run ends. If the client streams targets, each target counts as a sign of life
    of the client.

    Args:
        model: model of the hand.
        state: state of the tick, modified in place.

    Returns:
        One event when the digits come to rest, and another event when the run ends.
    """
    lease = state.decisions.lease
    if lease is None:
        return ()
    if state.mode != HandMode.ACTIVE:
        state.decide(lease=None)
        return ()
    last_heard_ns = lease.renewed_ns
    stream = state.decisions.stream
    if stream is not None and stream.client == lease.client:
        last_heard_ns = max(last_heard_ns, state.run_integers[s.STREAM_SENT_NS])
    silence_ns = state.run_integers[s.TICK_TIME_NS] - last_heard_ns
    text = f"client {lease.client or 'without a name'} has been silent for {silence_ns / 1e9:.2f} s"
    if silence_ns > RELAX_TIMEOUT_IN_LEASES * lease.duration_ns:
        state.decide(lease=None, progress=replace(state.progress, finished=True, failure=text))
        return (TickEvent("error", "lease", "", f"{text}: the hand relaxes"),)
    if silence_ns > lease.duration_ns and not lease.is_at_rest:
        if state.progress.task is None:
            close_stream(model, state)
            state.decide(progress=bring_to_rest(model, state))
        state.decide(lease=lease._replace(is_at_rest=True))
        return (TickEvent("warn", "lease", "", f"{text}: moving digits come to rest"),)
    return ()
