"""Test random sequences of faults.

The same seed gives the same sequence of faults. No sequence of faults violates a safety rule. The
test can detect a violation of each safety rule.
"""

import os
from dataclasses import replace
from types import SimpleNamespace

import pytest

from firmware_sim.description.hand_description import load_hand
from firmware_sim.faults.fault_text import parse_fault
from handctl.campaign import fault_sequences
from handctl.campaign.fault_matrix import ALL_PROTOCOLS, ARMING_STAGE, HOST_FAULT_PREFIX
from handctl.campaign.fault_sequences import (
    SEQUENCE_TICKS,
    FaultSequence,
    FaultStep,
    draw_sequence,
    run_sequence,
    run_sequences,
    violations_at_end,
    violations_in_tick,
    violations_on_replay,
)
from handctl.campaign.run_stages import (
    RUN_STAGES,
    advance_to_stage,
    hand_with_protocol,
    homed_run,
    run_in_forked_processes,
)
from handctl.core.tick_types import HandMode
from handctl.safety.tick_verdict import LatchedFault
from handctl.session.run_plan import default_control_rate

EMPTY_CALLBACKS = {
    "on_progress": lambda done: None,
    "on_failure": lambda arming_simulation, result: None,
}


@pytest.fixture(scope="module")
def arming_simulation():
    """Yield the simulation of a hand at a control rate of 200 Hz.

    The simulation has stopped at a tick in which the controller arms the hand. Each test uses a
    copy of the yielded simulation.
    """
    with homed_run(hand_with_protocol("jamia", "mit"), 200.0, 0) as arming_simulation:
        advance_to_stage(arming_simulation, ARMING_STAGE)
        yield arming_simulation


@pytest.fixture
def copy_of_arming_simulation(arming_simulation):
    return replace(arming_simulation, recorded_ticks=list(arming_simulation.recorded_ticks))


@pytest.mark.parametrize("protocol", ALL_PROTOCOLS)
def test_a_seed_is_a_sequence_that_the_simulator_understands(protocol, tmp_path):
    hand = hand_with_protocol("jamia11", protocol)
    path = tmp_path / "jamia11.toml"
    path.write_text(hand.to_toml())
    simulated_hand = load_hand(str(path))
    drawn_sequences = [draw_sequence(hand, protocol, 5.0, seed) for seed in range(300)]
    assert drawn_sequences == [draw_sequence(hand, protocol, 5.0, seed) for seed in range(300)]
    assert {sequence.stage for sequence in drawn_sequences} == set(RUN_STAGES)
    assert len({sequence.steps for sequence in drawn_sequences}) == len(drawn_sequences)
    for step in [step for sequence in drawn_sequences for step in sequence.steps]:
        assert 0 <= step.tick < SEQUENCE_TICKS
        if not step.fault.startswith(HOST_FAULT_PREFIX):
            parse_fault(step.fault, simulated_hand)


def test_sequence_violates_no_rule():
    results = run_sequences(
        hand_with_protocol("jamia", "mit"), "mit", 200.0, range(9), jobs=2, **EMPTY_CALLBACKS
    )
    assert [(result.scenario, result.problem) for result in results if not result.ok] == []
    assert sum(result.effect_count for result in results) >= 5


def test_a_sequence_that_breaks_a_rule_names_it(copy_of_arming_simulation, monkeypatch):
    """In the fault sequence of this test, a drive runs away.

    The safety rule about high tensions makes an exception for a tension that a runaway drive has
    caused. The test removes this exception for runaway drives from the safety rule. Without the
    exception for runaway drives, the fault sequence must violate the safety rule.
    """
    results = []
    sequence = FaultSequence(0, ARMING_STAGE, (FaultStep(20, "runaway node=index_motor"),))
    for allowed_fault in (fault_sequences.RUNAWAY_FAULT, "nobody"):
        monkeypatch.setattr(fault_sequences, "RUNAWAY_FAULT", allowed_fault)
        run_in_forked_processes(
            copy_of_arming_simulation,
            [sequence],
            1,
            run_sequence,
            results.append,
            lambda simulation, result: None,
        )
    assert (results[0].ok, results[1].ok) == (True, False)
    assert results[1].problem.endswith("N in a tendon, at most 140 N expected")
    assert results[0].tension == results[1].tension


def test_violated_rule_of_a_tick_is_found(copy_of_arming_simulation):
    state_before = copy_of_arming_simulation.state.copy()
    state_before.mode = HandMode.RELAX
    state_before.decide(latched_faults=(LatchedFault("T03", "index_tendon"),))
    state_after = state_before.copy()
    state_after.view("setpoint")[...] += 1.0
    assert violations_in_tick(state_before, state_after, is_cleared=False) == [
        "a setpoint rises while the hand relaxes"
    ]
    state_without_fault = state_before.copy()
    state_without_fault.decide(latched_faults=())
    assert violations_in_tick(state_before, state_without_fault, is_cleared=False) == [
        "no longer latched: T03"
    ]
    assert violations_in_tick(state_before, state_without_fault, is_cleared=True) == []
    active_state = state_before.copy()
    active_state.mode = HandMode.ACTIVE
    assert violations_in_tick(state_before, active_state, is_cleared=False) == [
        "the mode goes back: RELAX to ACTIVE"
    ]


def test_violated_rule_at_the_end_is_found(copy_of_arming_simulation):
    assert violations_at_end(copy_of_arming_simulation) == ["the run does not end: ARMING"]
    copy_of_arming_simulation.simulated_hand = SimpleNamespace(
        truth=lambda: {"torque": [0.0, 0.1, 0.0, 0.0]}
    )
    copy_of_arming_simulation.state = copy_of_arming_simulation.state.copy()
    copy_of_arming_simulation.state.mode = HandMode.DONE
    assert violations_at_end(copy_of_arming_simulation) == ["torque remains: middle_tendon"]
    copy_of_arming_simulation.state.decide(
        failure="REMOVE POWER: not confirmed disabled: middle_motor"
    )
    assert violations_at_end(copy_of_arming_simulation) == []


def test_a_tick_with_another_result_is_found(copy_of_arming_simulation):
    start = copy_of_arming_simulation.state
    first_tick_index = len(copy_of_arming_simulation.recorded_ticks)
    for _ in range(5):
        copy_of_arming_simulation.run_tick()
    assert violations_on_replay(copy_of_arming_simulation, start, first_tick_index) == []
    other_start = start.copy()
    other_start.goal_time += 1e-9
    assert violations_on_replay(copy_of_arming_simulation, other_start, first_tick_index) == [
        f"tick {copy_of_arming_simulation.recorded_ticks[first_tick_index][0].k} does not repeat with the same inputs"
    ]


@pytest.mark.nightly
@pytest.mark.skipif(
    "HANDCTL_NIGHTLY" not in os.environ, reason="runs with HANDCTL_NIGHTLY=1 (make nightly)"
)
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
@pytest.mark.parametrize("protocol", ALL_PROTOCOLS)
def test_random_sequences_violate_no_rule(hand, protocol):
    """For each hand and each drive protocol, none of 334 random fault sequences violates a safety rule."""
    hand_description = hand_with_protocol(hand, protocol)
    results = run_sequences(
        hand_description,
        protocol,
        default_control_rate(hand_description),
        range(334),
        jobs=2,
        **EMPTY_CALLBACKS,
    )
    assert [(result.scenario, result.problem) for result in results if not result.ok] == []
