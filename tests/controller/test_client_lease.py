"""Test the lease of a client that commands a hand in lockstep.

If the client stops sending, the digits that the client commands come to rest. After a longer
silence of the client, the whole hand relaxes.
"""

import json
from typing import Any

import numpy as np
import pytest

from handctl.controller.state_snapshot import snapshot_bytes
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.programs.requests import (
    KeepAliveRequest,
    is_routine_request,
    keep_alive_text,
    parse_request,
)
from tests.controller.test_target_streams import StreamClient, check_reexecuted_ticks, live_client

LEASE_S = 0.5


def lease_events(client: StreamClient) -> list[str]:
    """Return the texts of all events so far that report on the lease of a client."""
    return [
        event.text for out in client.tick_outputs for event in out.events if event.name == "lease"
    ]


def run_with_client_heartbeats(
    client: StreamClient, duration_s: float, heartbeat_period_s: float = 0.1
) -> None:
    """Run ticks for ``duration_s``. The client sends a sign of life every ``heartbeat_period_s``."""
    for _ in range(round(duration_s / heartbeat_period_s)):
        client.tick(keep_alive_text(client.name))
        client.wait(heartbeat_period_s - client.model.period)


def test_a_hand_relaxes_if_its_client_is_silent_after_a_hold(jamia: HandModel) -> None:
    """Reproduce a defect: if a client became silent after a hold command, the hand pulled without a time limit."""
    with live_client(jamia) as client:
        client.send_command("hold", tension_N={"index": 30.0}, rate_N_per_s=500.0, lease_s=LEASE_S)
        run_with_client_heartbeats(client, 3.0 * LEASE_S)
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE
        assert lease_events(client) == []
        client.tick_outputs.clear()
        client.wait(1.5 * LEASE_S)
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE
        assert len(lease_events(client)) == 1
        assert client.tick_outputs[-1].telemetry.tension[0] == pytest.approx(30.0, abs=2.0), (
            "a hold is held"
        )
        client.wait(0.6 * LEASE_S)
        assert [out.mode for out in client.tick_outputs].index(HandMode.RELAX) == pytest.approx(
            2 * LEASE_S / jamia.period, abs=0.1 / jamia.period
        )
        text = "client one has been silent for"
        assert client.run.state.failure.startswith(text)
        assert [event.startswith(text) for event in lease_events(client)] == [True, True]
        assert client.run.run_until(lambda out: out.mode == HandMode.DONE, 5.0)
        assert client.run.state.unconfirmed_motors == ()
        assert client.reported_faults == set()


def test_a_moving_digit_comes_to_rest_and_goes_on_with_the_next_command(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": 90.0}, duration_s=2.0, lease_s=LEASE_S)
        client.wait(1.5 * LEASE_S)
        at = np.degrees(client.goal_history("q_goal")[-1])
        assert at < 60.0, "on the way"
        client.wait(0.2 * LEASE_S)
        assert np.degrees(client.goal_history("q_goal")[-1]) == pytest.approx(at, abs=1e-9)
        client.tick(keep_alive_text("one"))
        assert lease_events(client)[-1] == "one answers again"
        assert (
            client.send_command("move", angle_deg={"index": 70.0}, lease_s=LEASE_S)
            == "move index 70"
        )
        run_with_client_heartbeats(client, 1.2)
        assert np.degrees(client.goal_history("q_goal")[-1]) == pytest.approx(70.0)
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE


def test_targets_of_a_stream_are_signs_of_life(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.open_stream(lease_s=0.2)
        client.stream_motion(lambda t: 20.0 * t, 1.0)
        assert lease_events(client) == []
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE


@pytest.mark.parametrize("event_after_lease", ["no lease", "leave", "another"])
def test_a_lease_ends(jamia: HandModel, event_after_lease: str) -> None:
    """The lease of a client ends when this client sends a command that requests no lease.

    A client's lease also ends when the client gives up the right to command the hand, or when
    another client takes over this right.
    """
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": 20.0}, duration_s=0.3, lease_s=LEASE_S)
        if event_after_lease == "leave":
            client.send_command("leave")
        else:
            client.name = "two" if event_after_lease == "another" else "one"
            client.send_command("stay", take_over=True)
        client.tick(keep_alive_text("one"))
        client.wait(3.0 * LEASE_S)
        assert lease_events(client) == []
        assert client.tick_outputs[-1].mode == HandMode.ACTIVE


def test_other_clients_do_not_renew_a_lease(jamia: HandModel) -> None:
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": 20.0}, duration_s=0.3, lease_s=LEASE_S)
        client.name = "two"
        run_with_client_heartbeats(client, 2.2 * LEASE_S)
        assert client.tick_outputs[-1].mode >= HandMode.RELAX


def test_a_task_goes_on_to_its_hold_before_the_hand_relaxes(jamia: HandModel) -> None:
    phases: list[dict[str, Any]] = [
        {"kind": "move", "name": "bend", "angle_deg": {"index": 20.0}, "duration_s": 0.7},
        {"kind": "move", "name": "stay", "angle_deg": {"index": 20.0}, "duration_s": 9.0},
    ]
    with live_client(jamia) as client:
        client.send_command(
            "grasp", task={"schema": 1, "name": "bend", "phase": phases}, lease_s=LEASE_S
        )
        client.wait(1.8 * LEASE_S)
        assert client.tick_outputs[-1].phase == "stay"
        assert np.degrees(client.goal_history("q_goal")[-1]) == pytest.approx(20.0, abs=1.0)
        client.wait(0.4 * LEASE_S)
        assert client.tick_outputs[-1].mode >= HandMode.RELAX


def test_the_ticks_of_a_lost_client_repeat_to_the_last_bit(jamia: HandModel) -> None:
    """Recorded ticks give equal results when they are executed again.

    The re-execution begins at the start of the run, or at a snapshot in the middle of the run.
    """
    with live_client(jamia) as client:
        client.send_command("move", angle_deg={"index": 50.0}, duration_s=1.0, lease_s=LEASE_S)
        run_with_client_heartbeats(client, LEASE_S)
        middle_snapshot, at = snapshot_bytes(client.run.state), len(client.run.recorded_ticks)
        client.wait(2.2 * LEASE_S)
        assert client.tick_outputs[-1].mode >= HandMode.RELAX
        check_reexecuted_ticks(client.run, middle_snapshot, at)


def test_alive_messages_are_requests() -> None:
    assert parse_request(keep_alive_text("client-1-2")) == KeepAliveRequest(
        do="alive", client="client-1-2"
    )
    assert is_routine_request(keep_alive_text("client-1-2"))
    assert not is_routine_request(json.dumps({"do": "stop"}))
    assert isinstance(parse_request('{"do": "alive"}'), str)
    assert isinstance(parse_request('{"do": "stay", "lease_s": 0.1}'), str)
