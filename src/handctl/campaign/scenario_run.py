"""Run of one scenario on a simulated hand.

The run injects the fault of the scenario, and measures when the fault is detected and when the
controller reacts.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from handctl.campaign.fault_matrix import (
    GRASP_STAGE,
    HOST_FAULT_PREFIX,
    FaultMatrixRow,
    FaultScenario,
    parse_fault_text,
)
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, IoEvent, TickOut
from handctl.errors import REMOVE_POWER
from handctl.runtime.mailbox import CUT_REQUEST
from handctl.safety.safety_action import SafetyAction
from handctl.session.lockstep_simulation import SimulatedRun

OBSERVATION_TIME_S = 1.3
"""Time for which a run is observed after the largest allowed reaction time, to see the torque disappear [s]."""
FORCE_CHANGE_OBSERVATION_S = 8.0
"""Further time for which a run is observed if the detection needs a change of the motor force [s]."""
FORCE_TIME_CONSTANT_S = 0.02
"""Time constant of the low-pass filter for the motor force whose change a detection needs [s]."""
RUNAWAY_FAULT = "runaway"
"""Name of the fault of a drive that ignores all commands and pulls with the largest torque."""
SHUT_DOWN_MODES = (HandMode.DISARM, HandMode.DONE)
"""Modes in which the hand shuts down."""
SECOND_FAULT_DELAY_TICKS = 5
"""Number of ticks from the first fault of a pair to the second fault."""
FAULT_PAIR_EXTRA_TICKS = 2
"""Further reaction time allowed for a pair of faults, because of a missed tick and the next tick [ticks]."""


@dataclass
class ScenarioResult:
    """Result of the run of a scenario.

    Attributes:
        scenario: description of the scenario.
        id: id of the scenario's row in the fault matrix.
        stage: stage of the run at which the fault was injected.
        effect_count: number of times that the injected fault took effect. If the fault had no
            effect, the scenario is not a valid test.
        ticks: number of ticks from the physical event to the frames with the reaction. If the
            detection needs a change of the motor force, the ticks count from this change. The
            number is -1 without a reaction.
        bound: largest allowed number of ticks until the reaction.
        detected_by: id of the fault that the controller reported, and the name of the affected
            part. If the controller reported no fault, the text is empty.
        safe_ticks: number of ticks from the physical event until all motor torques are zero. The
            number is -1 if a torque remains.
        tension: largest true tension of a tendon during the scenario [N].
        tension_bound: largest tension to expect [N], see the function `tension_bound`.
        ok: True if the scenario passed: the fault took effect and was detected as one of the
            allowed faults, the reaction came in time, no torque remained, and the tension did not
            exceed the bound.
        problem: reasons why the scenario did not pass.
    """

    scenario: str
    id: str
    stage: str
    effect_count: int = 0
    ticks: int = -1
    bound: int = 0
    detected_by: str = ""
    safe_ticks: int = -1
    tension: float = 0.0
    tension_bound: float = 0.0
    ok: bool = False
    problem: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        # The keys must stay equal to the keys in the report file, because other programs read the
        # report file.
        keys = {
            "effect_count": "felt",
            "detected_by": "found",
            "tension_bound": "most",
            "problem": "why",
        }
        return {keys.get(name, name): value for name, value in asdict(self).items()}


def run_scenario(
    simulation: SimulatedRun, scenario: FaultScenario, protocol: str
) -> ScenarioResult:
    """Run a scenario to the end, and return the result of the scenario.

    Args:
        simulation: simulation at the stage of the scenario. The simulation cannot be used after the
            run.
        scenario: scenario to run.
        protocol: protocol that the drives of the hand use.
    """
    row = scenario.row
    bound = (
        row.reaction_limit_ticks(protocol, simulation.period_ns / 1e6)
        + scenario.missing_sensor_ticks
    )
    bound += FAULT_PAIR_EXTRA_TICKS if scenario.second_fault else 0
    result = ScenarioResult(scenario.name, row.id, scenario.stage, bound=bound)
    start_ns = simulation.k * simulation.period_ns
    start_tension = simulation.simulated_hand.truth()["tension"]
    speed = _tendon_speeds(simulation)
    reaction_start = ReactionStart(simulation, scenario)
    host_fault = (
        HostFault(scenario.fault.removeprefix(HOST_FAULT_PREFIX))
        if scenario.fault.startswith(HOST_FAULT_PREFIX)
        else None
    )
    if host_fault is None:
        simulation.simulated_hand.inject(scenario.fault)
    second_host_fault = (
        HostFault(scenario.second_fault.removeprefix(HOST_FAULT_PREFIX))
        if scenario.second_fault.startswith(HOST_FAULT_PREFIX)
        else None
    )
    observation_s = OBSERVATION_TIME_S + (FORCE_CHANGE_OBSERVATION_S if row.force_change_N else 0.0)
    for i in range(
        bound + SECOND_FAULT_DELAY_TICKS + round(observation_s * 1e9 / simulation.period_ns)
    ):
        inputs: dict[str, Any] = {"requests": (CUT_REQUEST,)} if i == 1 and row.id == "N16" else {}
        inputs |= host_fault.tick_arguments(i, simulation) if host_fault else {}
        if i == SECOND_FAULT_DELAY_TICKS and second_host_fault:
            inputs |= second_host_fault.tick_arguments(0, simulation)
        elif i == SECOND_FAULT_DELAY_TICKS and scenario.second_fault:
            simulation.simulated_hand.inject(scenario.second_fault)
        t_ns = (simulation.k + int(inputs.get("skipped_ticks", 0))) * simulation.period_ns
        # If the fault stops the host for some ticks, the reaction time counts from the tick in
        # which the host continues.
        start_ns = t_ns if host_fault and i == 0 else start_ns
        tick_output = simulation.run_tick(**inputs)
        first_effect_ns = _first_effect_ns(simulation, host_fault, start_ns)
        _observe_tick(
            result,
            simulation,
            scenario,
            tick_output,
            reaction_start.update(simulation, first_effect_ns, t_ns),
            t_ns,
        )
        if tick_output.mode == HandMode.DONE:
            break
    result.effect_count = (
        1 if host_fault else int(simulation.simulated_hand.fault_states()[0]["felt"])
    )
    result.tension_bound = tension_bound(
        simulation,
        scenario,
        start_tension,
        speed,
        max(result.safe_ticks, bound) * simulation.period_ns * 1e-9,
    )
    return _judge_result(result, row, reaction_start.has_begun)


def _tendon_speeds(simulation: SimulatedRun) -> list[float]:
    """Return the absolute value of the measured speed of each tendon [m/s].

    Before the first tick, the speeds are zero.
    """
    if simulation.last_output is None:
        return [0.0] * simulation.controller.model.tendon_count
    spool = simulation.controller.model.tendon_constants.spool_radius
    return [
        float(v)
        for v in np.nan_to_num(np.abs(simulation.last_output.telemetry.motor_velocity * spool))
    ]


def tension_bound(
    simulation: SimulatedRun,
    scenario: FaultScenario,
    start_tension: list[float],
    spool_speeds: list[float],
    duration_s: float,
) -> float:
    """Return the largest tension that the drives and the momentum of the rotors can cause in a scenario [N].

    Only the fault `runaway` makes a drive pull harder than commanded. For a fault other than
    `runaway`, the result is the largest of all start tensions and trip tensions. A single reading
    above the trip tension of a tendon makes the hand relax.

    Args:
        simulation: simulation of the run.
        scenario: scenario that the simulation has run.
        start_tension: tension of each tendon when the fault was injected [N].
        spool_speeds: speed of each tendon when the fault was injected [m/s].
        duration_s: time from the start of the fault until all torques are zero [s].
    """
    if RUNAWAY_FAULT not in (scenario.fault.split()[0], *scenario.second_fault.split()[:1]):
        return max(*simulation.controller.derived_constants.limits.tension_trip, *start_tension)
    return runaway_tension(
        simulation.controller.model,
        start_tension,
        spool_speeds,
        0.0 if scenario.stage == GRASP_STAGE else duration_s,
    )


def runaway_tension(
    model: HandModel,
    start_tension: Sequence[float],
    spool_speeds: Sequence[float],
    duration_s: float,
) -> float:
    """Return the largest tension that a runaway drive can cause [N].

    A runaway drive pulls the tendon, and accelerates its rotor. The tension of the tendon rises up
    to F + sqrt((F - T)^2 + k m v^2), with these values of the tendon and its drive:

    - F: largest force of the drive [N]
    - T: tension at the start of the fault [N]
    - k: stiffness of the tendon [N/m]
    - m: inertia of the rotor, converted to a mass at the tendon [kg]
    - v: initial speed of the rotor, plus the speed that the rotor gains from F while the finger
      moves freely [m/s]

    Args:
        model: model of the hand.
        start_tension: tension of each tendon when the fault begins [N].
        spool_speeds: speed of each tendon when the fault begins [m/s].
        duration_s: time for which the finger moves freely [s].
    """
    tendons = model.tendon_constants
    bounds = []
    for tendon, k, m, tension, v in zip(
        model.hand.tendon,
        tendons.stiffness,
        tendons.motor_mass,
        start_tension,
        spool_speeds,
        strict=True,
    ):
        limit = tendon.drive_limit_N
        bounds.append(
            limit + math.sqrt((limit - tension) ** 2 + k * m * (v + limit / m * duration_s) ** 2)
        )
    return float(max(bounds))


def _first_effect_ns(
    simulation: SimulatedRun, host_fault: "HostFault | None", start_ns: int
) -> int:
    """Return the time at which the injected fault first took effect [ns].

    If the fault has had no effect yet, the returned time is -1.
    """
    if host_fault is not None:
        return start_ns
    return int(simulation.simulated_hand.fault_states()[0]["first_ns"])


class ReactionStart:
    """Instant from which the reaction time of a scenario counts.

    For most faults, the reaction time counts from the first effect of the fault. A stuck load cell
    is not visible until the motor force has varied, see ``FaultMatrixRow.force_change_N``. For a
    stuck load cell, the reaction time therefore counts from the instant at which the low-passed
    motor force has varied enough.
    """

    def __init__(self, simulation: SimulatedRun, scenario: FaultScenario) -> None:
        """Store the motor force before the fault."""
        self._force_change_N = scenario.row.force_change_N
        self._varied_ns = -1
        self._tendon = 0
        if self._force_change_N:
            names = [tendon.name for tendon in simulation.controller.model.hand.tendon]
            self._tendon = names.index(parse_fault_text(scenario.fault)["cell"])
        self._fraction = 1.0 - math.exp(-simulation.period_ns * 1e-9 / FORCE_TIME_CONSTANT_S)
        self._force = self._motor_force(simulation)
        self._smallest = self._largest = self._force

    @property
    def has_begun(self) -> bool:
        """Return True if the motor force has varied enough for a detection, or does not need to vary."""
        return not self._force_change_N or self._varied_ns >= 0

    def update(self, simulation: SimulatedRun, first_effect_ns: int, t_ns: int) -> int:
        """Return the instant from which the reaction time counts [ns].

        Before the first effect of the fault, the method returns -1. If the fault can be detected at
        a constant motor force, the reaction time counts from the first effect. Otherwise, the
        reaction time counts from the tick in which the motor force has varied enough. Before this
        tick, the method returns the time of the present tick.

        Args:
            simulation: simulation after the present tick.
            first_effect_ns: time of the first effect of the fault [ns], or -1 before the first
                effect.
            t_ns: time of the present tick [ns].
        """
        if first_effect_ns < 0 or not self._force_change_N:
            return first_effect_ns
        self._force += self._fraction * (self._motor_force(simulation) - self._force)
        self._smallest = min(self._smallest, self._force)
        self._largest = max(self._largest, self._force)
        if self._varied_ns < 0 and self._largest - self._smallest >= self._force_change_N:
            self._varied_ns = t_ns
        return self._varied_ns if self._varied_ns >= 0 else t_ns

    def _motor_force(self, simulation: SimulatedRun) -> float:
        """Return the force with which the faulty motor pulls its tendon [N]."""
        torque = simulation.simulated_hand.truth()["torque"][self._tendon]
        return float(
            torque / simulation.controller.model.tendon_constants.spool_radius[self._tendon]
        )


def _observe_tick(
    result: ScenarioResult,
    simulation: SimulatedRun,
    scenario: FaultScenario,
    tick_output: TickOut,
    reaction_start_ns: int,
    t_ns: int,
) -> None:
    """Add the output of a tick to the result of a scenario."""
    row = scenario.row
    truth = simulation.simulated_hand.truth()
    result.tension = max(result.tension, *truth["tension"])
    if reaction_start_ns < 0:
        return
    ticks_since_start = math.ceil((t_ns - reaction_start_ns) / simulation.period_ns)
    for event in tick_output.events:
        reports_fault = event.name == "fault" or REMOVE_POWER in event.text
        is_expected = (
            event.text.startswith(tuple(filter(None, row.accepted_faults)))
            or not any(row.accepted_faults)
            or scenario.second_fault
        )
        if not result.detected_by and reports_fault and is_expected:
            result.detected_by = " ".join(event.text.split(":")[0].split()[:1]) + f" {event.where}"
    # If the required reaction is RELAX or a more severe reaction, any mode in which the hand
    # relaxes or shuts down counts as a reaction. But if the required reaction is CUT, the mode
    # RELAX does not count as a reaction.
    has_reacted = tick_output.action >= row.action or (
        row.action >= SafetyAction.RELAX
        and tick_output.mode in (*SHUT_DOWN_MODES, HandMode.RELAX, HandMode.CUT)
    )
    has_reacted = has_reacted and not (
        row.action == SafetyAction.CUT and tick_output.mode == HandMode.RELAX
    )
    # The only reaction of the controller to the fault H01 is a report. So the report of H01 counts
    # as the reaction.
    if row.id == "H01":
        has_reacted = bool(result.detected_by)
    if (
        result.ticks < 0
        and has_reacted
        and (
            result.detected_by
            or not any(row.accepted_faults)
            or tick_output.mode in SHUT_DOWN_MODES
        )
    ):
        result.ticks = max(0, ticks_since_start)
    if result.ticks >= 0 and result.safe_ticks < 0 and not any(truth["torque"]):
        result.safe_ticks = max(0, ticks_since_start)


def _judge_result(result: ScenarioResult, row: FaultMatrixRow, is_visible: bool) -> ScenarioResult:
    """Add the verdict on a scenario (passed or not) and the list of problems to the result, and return the result.

    Args:
        result: result of the run.
        row: row of the fault matrix.
        is_visible: False if no reaction is required, because the motor force has not varied.
    """
    problems = []
    if not result.effect_count:
        problems.append("the disturbance had no effect")
    elif not is_visible and result.ticks < 0:
        pass
    elif result.ticks < 0:
        problems.append("no reaction")
    elif result.ticks > result.bound:
        problems.append(f"late: {result.ticks} ticks, at most {result.bound}")
    elif not result.detected_by and any(row.accepted_faults):
        problems.append(f"none of {', '.join(filter(None, row.accepted_faults))} was reported")
    is_relax_required = row.action >= SafetyAction.RELAX and (is_visible or result.ticks >= 0)
    if is_relax_required and result.effect_count and result.safe_ticks < 0:
        problems.append("torque remains")
    if result.tension > result.tension_bound:
        problems.append(
            f"{result.tension:.0f} N in a tendon, at most {result.tension_bound:.0f} N expected"
        )
    result.ok = not problems
    result.problem = "; ".join(problems)
    return result


class HostFault:
    """Fault of the host computer, or request from an operator to the controller.

    The text of a fault has one of the forms `io KIND [WHERE] [lasting]`, `skip N`, `late FRACTION`
    and `ask REQUEST [TIMES]`.
    """

    def __init__(self, fault_text: str) -> None:
        """Parse the text of a host fault."""
        self.kind, *self.words = fault_text.split()

    def tick_arguments(self, i: int, simulation: SimulatedRun) -> dict[str, Any]:
        """Return the arguments with which the simulation has to execute the i-th tick after the start of the fault."""
        is_first_tick = i == 0
        if self.kind == "io":
            if not is_first_tick and "lasting" not in self.words:
                return {}
            location = (
                self.words[1] if len(self.words) > 1 and self.words[1] != "lasting" else "bus"
            )
            return {"io_events": (IoEvent(self.words[0], location),)}
        if not is_first_tick:
            return {}
        if self.kind == "skip":
            return {"skipped_ticks": int(self.words[0])}
        if self.kind == "late":
            return {"late_ns": round(float(self.words[0]) * simulation.period_ns)}
        request_count = int(self.words[1]) if len(self.words) > 1 else 1
        return {"requests": (f'{{"do": "{self.words[0]}"}}',) * request_count}
