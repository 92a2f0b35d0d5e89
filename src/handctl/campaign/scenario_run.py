"""Run of one scenario on a simulated hand.

The run injects the fault of the scenario, and measures when the fault is detected and when the
controller reacts.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from handctl.campaign.fault_matrix import GRASP_STAGE, HOST_PREFIX, FaultScenario, MatrixRow
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, IoEvent, TickOut
from handctl.errors import REMOVE_POWER
from handctl.runtime.mailbox import CUT_REQUEST
from handctl.safety.action import SafetyAction
from handctl.session.simulate import SimulatedRun

OBSERVATION_TIME_S = 1.3
"""Time for which a run is observed after the largest allowed reaction time, to see the torque disappear [s]."""
RUNAWAY_FAULT = "runaway"
"""Name of the fault of a drive that ignores all commands and pulls with the largest torque."""
SHUT_DOWN_MODES = (HandMode.DISARM, HandMode.DONE)
"""Modes in which the hand shuts down."""
PAIR_DELAY_TICKS = 5
"""Number of ticks from the first fault of a pair to the second one."""
PAIR_EXTRA_TICKS = 2
"""Further reaction time allowed for a pair of faults, because of a missed tick and the next tick [ticks]."""


@dataclass
class ScenarioResult:
    """Result of the run of a scenario.

    Attributes:
        scenario: description of the scenario.
        id: id of the scenario's row in the fault matrix.
        stage: stage of the run at which the fault was injected.
        effects: number of times that the injected fault took effect. If it is 0, the scenario tests
            nothing.
        ticks: number of ticks from the physical event to the CAN frames that contain the reaction.
            The number is -1 if there was no reaction.
        bound: largest allowed number of ticks until the reaction.
        detected_by: id of the fault that the controller reported, and the name of the affected
            part. The text is empty if the controller reported nothing.
        safe_ticks: number of ticks from the physical event until all motor torques are zero. The
            number is -1 if a torque remains.
        tension: largest true tension of a tendon during the scenario [N].
        tension_bound: largest tension that is possible in the scenario [N], see the function
            `tension_bound`.
        ok: True if the scenario passed: the fault took effect and was detected as one of the
            allowed faults, the reaction came in time, no torque remained, and the tension did not
            exceed the bound.
        problem: reasons why the scenario did not pass.
    """

    scenario: str
    id: str
    stage: str
    effects: int = 0
    ticks: int = -1
    bound: int = 0
    detected_by: str = ""
    safe_ticks: int = -1
    tension: float = 0.0
    tension_bound: float = 0.0
    ok: bool = False
    problem: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain values that JSON can contain."""
        # The keys must stay equal to those of the report file, because other programs read that
        # file.
        keys = {
            "effects": "felt",
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
        simulation: simulation at the stage of the scenario. This simulation cannot be used again
            after the scenario.
        scenario: scenario to run.
        protocol: protocol that the drives of the hand use.
    """
    row = scenario.row
    bound = row.bound_ticks(protocol, simulation.period_ns / 1e6) + scenario.sensing_ticks
    bound += PAIR_EXTRA_TICKS if scenario.second_fault else 0
    result = ScenarioResult(scenario.name, row.id, scenario.stage, bound=bound)
    start_ns = simulation.k * simulation.period_ns
    start_tension = simulation.simulated_hand.truth()["tension"]
    speed = _tendon_speeds(simulation)
    host = (
        HostFault(scenario.fault.removeprefix(HOST_PREFIX))
        if scenario.fault.startswith(HOST_PREFIX)
        else None
    )
    if host is None:
        simulation.simulated_hand.inject(scenario.fault)
    second_host = (
        HostFault(scenario.second_fault.removeprefix(HOST_PREFIX))
        if scenario.second_fault.startswith(HOST_PREFIX)
        else None
    )
    for i in range(
        bound + PAIR_DELAY_TICKS + round(OBSERVATION_TIME_S * 1e9 / simulation.period_ns)
    ):
        inputs: dict[str, Any] = {"requests": (CUT_REQUEST,)} if i == 1 and row.id == "N16" else {}
        inputs |= host.tick_arguments(i, simulation) if host else {}
        if i == PAIR_DELAY_TICKS and second_host:
            inputs |= second_host.tick_arguments(0, simulation)
        elif i == PAIR_DELAY_TICKS and scenario.second_fault:
            simulation.simulated_hand.inject(scenario.second_fault)
        t_ns = (simulation.k + int(inputs.get("skip", 0))) * simulation.period_ns
        # If the fault stops the host for some ticks, the reaction time begins with the tick in
        # which the host continues.
        start_ns = t_ns if host and i == 0 else start_ns
        out = simulation.run_tick(**inputs)
        _observe_tick(
            result, simulation, scenario, out, _first_effect_ns(simulation, host, start_ns), t_ns
        )
        if out.mode == HandMode.DONE:
            break
    result.effects = 1 if host else int(simulation.simulated_hand.fault_states()[0]["felt"])
    result.tension_bound = tension_bound(
        simulation,
        scenario,
        start_tension,
        speed,
        max(result.safe_ticks, bound) * simulation.period_ns * 1e-9,
    )
    return _judge_result(result, row)


def _tendon_speeds(simulation: SimulatedRun) -> list[float]:
    """Return the absolute value of the measured speed of each tendon [m/s].

    Before the first tick, the speeds are zero.
    """
    if simulation.last_output is None:
        return [0.0] * simulation.controller.model.tendon_count
    spool = simulation.controller.model.space.spool
    return [
        float(v)
        for v in np.nan_to_num(np.abs(simulation.last_output.telemetry.motor_velocity * spool))
    ]


def tension_bound(
    simulation: SimulatedRun,
    scenario: FaultScenario,
    start_tension: list[float],
    speed: list[float],
    seconds: float,
) -> float:
    """Return the largest tension that the drives and the momentum of the rotors can cause in a scenario [N].

    Only the fault `runaway` makes a drive pull harder than commanded. With all other faults, the
    tension must not exceed the trip tension. A single reading above the trip tension makes the hand
    relax.

    Args:
        simulation: simulation of the run.
        scenario: scenario that the simulation has run.
        start_tension: tension of each tendon when the fault was injected [N].
        speed: speed of each tendon when the fault was injected [m/s].
        seconds: time from the start of the fault until all torques are zero [s].
    """
    if RUNAWAY_FAULT not in (scenario.fault.split()[0], *scenario.second_fault.split()[:1]):
        return max(*simulation.controller.derived.limits.tension_trip, *start_tension)
    return runaway_tension(
        simulation.controller.model,
        start_tension,
        speed,
        0.0 if scenario.stage == GRASP_STAGE else seconds,
    )


def runaway_tension(
    model: HandModel, start_tension: Sequence[float], speed: Sequence[float], seconds: float
) -> float:
    """Return the largest tension that a runaway drive can cause [N].

    A runaway drive accelerates a rotor, whose mass at the tendon is m, with the largest force F of
    the drive. The tendon, with stiffness k, resists. If the tension is T at the start, the tension
    rises up to F + sqrt((F - T)^2 + k m v^2). Here v is the speed of the rotor at the start, plus
    the speed that F adds while the finger moves freely.

    Args:
        model: model of the hand.
        start_tension: tension of each tendon when the fault begins [N].
        speed: speed of each tendon when the fault begins [m/s].
        seconds: time for which the finger moves without resistance [s].
    """
    space = model.space
    bounds = []
    for tendon, k, m, tension, v in zip(
        model.hand.tendon, space.stiffness, space.motor_mass, start_tension, speed, strict=True
    ):
        limit = tendon.drive_limit_N
        bounds.append(
            limit + math.sqrt((limit - tension) ** 2 + k * m * (v + limit / m * seconds) ** 2)
        )
    return float(max(bounds))


def _first_effect_ns(simulation: SimulatedRun, host: "HostFault | None", start_ns: int) -> int:
    """Return the time at which the injected fault first took effect [ns].

    The time is -1 if the fault has had no effect yet.
    """
    if host is not None:
        return start_ns
    return int(simulation.simulated_hand.fault_states()[0]["first_ns"])


def _observe_tick(
    result: ScenarioResult,
    simulation: SimulatedRun,
    scenario: FaultScenario,
    out: TickOut,
    first_effect_ns: int,
    t_ns: int,
) -> None:
    """Add to the result of a scenario the information in the output of a tick."""
    row = scenario.row
    truth = simulation.simulated_hand.truth()
    result.tension = max(result.tension, *truth["tension"])
    if first_effect_ns < 0:
        return
    since = math.ceil((t_ns - first_effect_ns) / simulation.period_ns)
    for event in out.events:
        is_report = event.name == "fault" or REMOVE_POWER in event.text
        is_expected = (
            event.text.startswith(tuple(filter(None, row.accepted_faults)))
            or not any(row.accepted_faults)
            or scenario.second_fault
        )
        if not result.detected_by and is_report and is_expected:
            result.detected_by = " ".join(event.text.split(":")[0].split()[:1]) + f" {event.where}"
    # If the required reaction is RELAX or a more severe one, any mode in which the hand relaxes or
    # shuts down counts as a reaction. But if CUT is required, the mode RELAX is not enough.
    reacted = out.action >= row.action or (
        row.action >= SafetyAction.RELAX
        and out.mode in (*SHUT_DOWN_MODES, HandMode.RELAX, HandMode.CUT)
    )
    reacted = reacted and not (row.action == SafetyAction.CUT and out.mode == HandMode.RELAX)
    # The controller only reports the fault H01 and does not react otherwise. So the report counts
    # as the reaction.
    if row.id == "H01":
        reacted = bool(result.detected_by)
    if (
        result.ticks < 0
        and reacted
        and (result.detected_by or not any(row.accepted_faults) or out.mode in SHUT_DOWN_MODES)
    ):
        result.ticks = max(0, since)
    if result.ticks >= 0 and result.safe_ticks < 0 and not any(truth["torque"]):
        result.safe_ticks = max(0, since)


def _judge_result(result: ScenarioResult, row: MatrixRow) -> ScenarioResult:
    """Add the verdict and the list of problems to a result, and return the result."""
    problems = []
    if not result.effects:
        problems.append("the disturbance had no effect")
    elif result.ticks < 0:
        problems.append("no reaction")
    elif result.ticks > result.bound:
        problems.append(f"late: {result.ticks} ticks, at most {result.bound}")
    elif not result.detected_by and any(row.accepted_faults):
        problems.append(f"none of {', '.join(filter(None, row.accepted_faults))} was reported")
    if row.action >= SafetyAction.RELAX and result.effects and result.safe_ticks < 0:
        problems.append("torque remains")
    if result.tension > result.tension_bound:
        problems.append(
            f"{result.tension:.0f} N in a tendon, at most {result.tension_bound:.0f} N expected"
        )
    result.ok = not problems
    result.problem = "; ".join(problems)
    return result


class HostFault:
    """Fault of the host computer, or request of an operator to the controller.

    The text of a fault has one of the forms `io KIND [WHERE] [lasting]`, `skip N`, `late FRACTION`
    and `ask REQUEST [TIMES]`.
    """

    def __init__(self, text: str) -> None:
        """Parse the text of a host fault."""
        self.kind, *self.words = text.split()

    def tick_arguments(self, i: int, simulation: SimulatedRun) -> dict[str, Any]:
        """Return the arguments with which the simulation executes the i-th tick of the fault."""
        first = i == 0
        if self.kind == "io":
            if not first and "lasting" not in self.words:
                return {}
            where = self.words[1] if len(self.words) > 1 and self.words[1] != "lasting" else "bus"
            return {"io": (IoEvent(self.words[0], where),)}
        if not first:
            return {}
        if self.kind == "skip":
            return {"skip": int(self.words[0])}
        if self.kind == "late":
            return {"late_ns": round(float(self.words[0]) * simulation.period_ns)}
        times = int(self.words[1]) if len(self.words) > 1 else 1
        return {"requests": (f'{{"do": "{self.words[0]}"}}',) * times}
