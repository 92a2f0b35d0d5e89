"""Random sequences of faults, and rules that the controller must obey in every sequence.

The fault matrix tests whether the controller detects each single fault in time. A random sequence
contains several temporary or permanent faults, one after the other. The faults affect any part of
the hand, in any stage of the run. Requests of a client can come between the faults.

The controller must obey the following rules in every sequence:

- No tick raises an exception.
- The mode of the hand never changes back to an earlier mode.
- A latched fault stays latched until a request clears the fault.
- No setpoint rises while the hand relaxes.
- No tendon exceeds the trip tension. If a sequence has a runaway drive, the limit is the tension
  that the drive and the momentum of the rotor can cause.
- A stop request ends the run without torque, or the controller asks the operator to switch off the
  power.
- If the inputs of a run are executed again, the controller goes through the same states.
"""

import random
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from handctl.campaign.fault_matrix import FAULT_MATRIX, HOST_FAULT_PREFIX, fault_texts_for_hand
from handctl.campaign.run_stages import RUN_STAGES, run_experiments
from handctl.campaign.scenario_run import RUNAWAY_FAULT, HostFault, ScenarioResult, runaway_tension
from handctl.controller.controller_state import ControllerState
from handctl.core.tick_types import HandMode
from handctl.errors import REMOVE_POWER
from handctl.hand.description import Hand
from handctl.runtime.mailbox import CLEAR_REQUEST, STOP_REQUEST
from handctl.session.lockstep_simulation import SimulatedRun

SEQUENCE_TICKS = 200
"""Length of a sequence [ticks]. After the sequence, a request stops the hand."""
MIN_FAULTS = 2
MAX_FAULTS = 6
"""Largest number of faults in a sequence."""
BRIEF_DURATION_RANGE_MS = (5, 200)
"""Shortest and longest duration of a fault that ends by itself [ms]."""
PERMANENT_FAULTS = ("snap", "slack")
"""Names of the faults that never end by themselves."""
HOST_FAULT_FRACTION = 0.2
"""Fraction of a sequence's steps that are requests or faults of the host."""
BRIEF_FAULT_FRACTION = 0.6
"""Fraction of the faults of the simulator in a sequence that end by themselves."""
HOST_FAULT_TEXTS = (
    f"{HOST_FAULT_PREFIX}ask stop",
    f"{HOST_FAULT_PREFIX}ask clear",
    f"{HOST_FAULT_PREFIX}ask nonsense 1",
    f"{HOST_FAULT_PREFIX}skip 3",
    f"{HOST_FAULT_PREFIX}late 0.3",
)
"""Requests and faults of the host that a sequence can contain."""
SHUTDOWN_TIMEOUT_S = 2.5
"""Time for which a run is observed after the stop request [s].

The observation time is long enough for relaxing and disarming with their timeouts, and for the
heartbeat of an ODrive.
"""
WATCHDOG_S = 0.05
"""Time without a command after which a drive disables itself [s]."""
MAX_RUNAWAY_REACTION_TICKS = 10
"""Largest number of ticks after which the controller stops commanding a runaway drive."""
SHUTDOWN_MODE_ORDER = (
    HandMode.ARMING,
    HandMode.ACTIVE,
    HandMode.RELAX,
    HandMode.CUT,
    HandMode.DISARM,
    HandMode.DONE,
)
"""Modes of the hand, in the order of a run."""


class FaultStep(NamedTuple):
    """Fault or request in a sequence.

    Attributes:
        tick: number of the tick of the fault or request, counted from the start of the sequence.
        fault: text of the fault for the simulator, or text of a request or host fault for
            `HostFault`.
    """

    tick: int
    fault: str


class FaultSequence(NamedTuple):
    """Faults and requests of a random sequence.

    Attributes:
        seed: seed from which the sequence was drawn.
        stage: stage of the run at which the sequence begins.
        steps: faults and requests in the order of their ticks.
    """

    seed: int
    stage: str
    steps: tuple[FaultStep, ...]

    @property
    def id(self) -> str:
        """Return the id that reports show for the sequence.

        All sequences have the same id, because no sequence belongs to a row of the fault matrix.
        """
        return "sequence"

    @property
    def name(self) -> str:
        """Return the text that describes the sequence in reports."""
        return f"seed {self.seed}, {self.stage}: " + "; ".join(
            f"{step.tick}: {step.fault}" for step in self.steps
        )


def draw_sequence(hand: Hand, protocol: str, period_ms: float, seed: int) -> FaultSequence:
    """Draw the random sequence that belongs to a seed.

    The result depends only on the seed, the hand, the protocol and the control period [ms].
    """
    chance = random.Random(f"sequence {seed}")
    # Every row of the fault matrix has the same probability. The number of parts that the fault can
    # affect does not matter.
    rows = [row for row in FAULT_MATRIX if protocol in row.protocols]
    count = chance.randint(MIN_FAULTS, MAX_FAULTS)
    steps = []
    for tick in sorted(chance.sample(range(SEQUENCE_TICKS), count)):
        if chance.random() < HOST_FAULT_FRACTION:
            steps.append(FaultStep(tick, chance.choice(HOST_FAULT_TEXTS)))
            continue
        fault = chance.choice(
            fault_texts_for_hand(hand, chance.choice(rows).fault, period_ms)
            or list(HOST_FAULT_TEXTS)
        )
        ends_by_itself = (
            not fault.startswith((HOST_FAULT_PREFIX, *PERMANENT_FAULTS))
            and " for=" not in fault
            and chance.random() < BRIEF_FAULT_FRACTION
        )
        steps.append(
            FaultStep(
                tick,
                f"{fault} for={chance.randint(*BRIEF_DURATION_RANGE_MS)}ms"
                if ends_by_itself
                else fault,
            )
        )
    return FaultSequence(seed, RUN_STAGES[seed % len(RUN_STAGES)], tuple(steps))


def run_sequences(
    hand: Hand,
    protocol: str,
    rate_hz: float,
    seeds: Iterable[int],
    *,
    jobs: int,
    on_progress: Callable[[int], None],
    on_failure: Callable[[SimulatedRun, ScenarioResult], None],
) -> list[ScenarioResult]:
    """Run random sequences of faults, and return their results.

    Each sequence runs in a forked copy of a simulation that has reached the stage of the sequence.

    Args:
        hand: hand whose drives use the protocol `protocol`.
        protocol: drive protocol.
        rate_hz: control rate [Hz].
        seeds: seeds of the sequences.
        jobs: number of processes that run at the same time.
        on_progress: function called with the number of finished sequences.
        on_failure: function called after a violated rule, with the simulation and the result.
    """
    sequences = [draw_sequence(hand, protocol, 1e3 / rate_hz, seed) for seed in seeds]
    results = list[ScenarioResult]()

    def add_result(result: ScenarioResult) -> None:
        results.append(result)
        on_progress(len(results))

    run_experiments(hand, rate_hz, sequences, jobs, run_sequence, add_result, on_failure)
    return results


def run_sequence(simulation: SimulatedRun, sequence: FaultSequence) -> ScenarioResult:
    """Run a sequence of faults, stop the hand, and return the result with the violated rules.

    Args:
        simulation: simulation at the stage of the sequence. The simulation cannot be used after the
            run.
        sequence: sequence of faults to inject.
    """
    start = (simulation.state, len(simulation.recorded_ticks))
    start_tension = simulation.simulated_hand.truth()["tension"]
    violations: list[str] = []
    tension = 0.0
    for inputs in _sequence_ticks(simulation, sequence):
        state_before = simulation.state
        simulation.run_tick(**inputs)
        tension = max(tension, *simulation.simulated_hand.truth()["tension"])
        violations += violations_in_tick(
            state_before, simulation.state, is_cleared=CLEAR_REQUEST in inputs["requests"]
        )
        if simulation.state.mode == HandMode.DONE:
            break
    active_faults = sum(
        int(fault["felt"]) > 0 for fault in simulation.simulated_hand.fault_states()
    )
    bound = _tension_bound(simulation, sequence, start_tension)
    if tension > bound:
        violations.append(f"{tension:.0f} N in a tendon, at most {bound:.0f} N expected")
    violations += [*violations_at_end(simulation), *violations_on_replay(simulation, *start)]
    problem = "; ".join(dict.fromkeys(violations))
    return ScenarioResult(
        sequence.name,
        sequence.id,
        sequence.stage,
        effect_count=active_faults,
        tension=tension,
        tension_bound=bound,
        ok=not violations,
        problem=problem,
    )


def _sequence_ticks(simulation: SimulatedRun, sequence: FaultSequence) -> Iterator[dict[str, Any]]:
    """Yield the inputs of each tick of a sequence.

    Faults of the host are part of the inputs of a tick. The function injects all other faults into
    the simulated hand before the planned tick. After the last tick of the sequence, the inputs
    contain a stop request.
    """
    host_faults: list[tuple[int, HostFault]] = []
    for i in range(SEQUENCE_TICKS + round(SHUTDOWN_TIMEOUT_S * 1e9 / simulation.period_ns)):
        for fault in [step.fault for step in sequence.steps if step.tick == i]:
            if fault.startswith(HOST_FAULT_PREFIX):
                host_faults.append((i, HostFault(fault.removeprefix(HOST_FAULT_PREFIX))))
            else:
                simulation.simulated_hand.inject(fault)
        inputs: dict[str, Any] = {
            "io_events": (),
            "requests": (STOP_REQUEST,) if i == SEQUENCE_TICKS else (),
        }
        for start_tick, host in host_faults:
            for key, value in host.tick_arguments(i - start_tick, simulation).items():
                inputs[key] = inputs[key] + value if key in ("io_events", "requests") else value
        yield inputs


def violations_in_tick(
    state_before: ControllerState, state_after: ControllerState, is_cleared: bool
) -> list[str]:
    """Return a text for each rule that the controller violates in a tick."""
    violations = []
    if SHUTDOWN_MODE_ORDER.index(state_after.mode) < SHUTDOWN_MODE_ORDER.index(state_before.mode):
        violations.append(
            f"the mode goes back: {state_before.mode.name} to {state_after.mode.name}"
        )
    unlatched_faults = set(state_before.latched_faults) - set(state_after.latched_faults)
    if unlatched_faults and not is_cleared:
        violations.append(
            f"no longer latched: {', '.join(sorted(latched_fault.id for latched_fault in unlatched_faults))}"
        )
    if state_before.mode == state_after.mode == HandMode.RELAX and np.any(
        state_after.view("setpoint") > state_before.view("setpoint") + 1e-9
    ):
        violations.append("a setpoint rises while the hand relaxes")
    # The relative tolerance covers the rounding of torques in CAN frames.
    if state_after.mode == HandMode.RELAX and np.any(
        state_after.view("asked") > np.maximum(state_before.view("asked"), 0.0) * (1.0 + 1e-9)
    ):
        violations.append("a motor is commanded to pull harder while the hand relaxes")
    return violations


def _tension_bound(
    simulation: SimulatedRun, sequence: FaultSequence, start_tension: list[float]
) -> float:
    """Return the largest tension that the safety rules allow in a fault sequence [N].

    For a runaway drive, the function assumes that the tendon is slack at the start, and that the
    drive pulls until its watchdog has fired.
    """
    # Without a runaway drive, the bound is the larger of two tensions: the largest trip tension,
    # and the largest tension at the start of the sequence.
    limits = simulation.controller.derived_constants.limits
    model = simulation.controller.model
    if not any(step.fault.startswith(RUNAWAY_FAULT) for step in sequence.steps):
        return max(*limits.tension_trip, *start_tension)
    zero_speeds = [0.0] * model.tendon_count
    return runaway_tension(
        model,
        zero_speeds,
        zero_speeds,
        WATCHDOG_S + MAX_RUNAWAY_REACTION_TICKS * simulation.period_ns * 1e-9,
    )


def violations_at_end(simulation: SimulatedRun) -> list[str]:
    """Return a text for each rule that the controller violates at the end of a run."""
    state = simulation.state
    names = simulation.controller.model.hand.tendon_names
    if state.mode != HandMode.DONE:
        return [f"the run does not end: {state.mode.name}"]
    motors_with_torque = [
        name
        for name, torque in zip(names, simulation.simulated_hand.truth()["torque"], strict=True)
        if torque
    ]
    return (
        [f"torque remains: {', '.join(motors_with_torque)}"]
        if motors_with_torque and REMOVE_POWER not in state.failure
        else []
    )


def violations_on_replay(
    simulation: SimulatedRun, state: ControllerState, first_tick: int
) -> list[str]:
    """Execute the ticks of a simulated run again, with the same inputs.

    The state, the frames and the events of each tick are compared with the first execution. If they
    differ, return a list with one text, which names the first tick with a difference. Otherwise,
    return an empty list.
    """
    for tick_input, tick_output in simulation.recorded_ticks[first_tick:]:
        state, replayed = simulation.controller.tick(state, tick_input)
        if (replayed.state_hash, replayed.frames, replayed.events) != (
            tick_output.state_hash,
            tick_output.frames,
            tick_output.events,
        ):
            return [f"tick {tick_input.k} does not repeat with the same inputs"]
    return []
