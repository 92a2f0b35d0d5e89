"""Fault campaign for one hand and one or more drive protocols.

The campaign runs all scenarios of the fault matrix. The campaign also simulates runs without
faults.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from handctl.campaign.fault_matrix import FaultScenario, fault_pairs, scenarios_of_hand
from handctl.campaign.run_stages import hand_with_protocol, homed_run, run_experiments
from handctl.campaign.scenario_run import ScenarioResult, run_scenario
from handctl.core.tick_types import HandMode, TickEvent
from handctl.hand.description import Hand
from handctl.safety.safety_action import SafetyAction
from handctl.session.lockstep_simulation import SimulatedRun

QUICK_SCENARIO_STEP = 7
"""Distance between two scenarios that a quick campaign runs, in the list of all scenarios.

A quick campaign runs only every seventh scenario of the fault matrix.
"""
POSITION_NOISE_FACTOR = 3.0
"""Factor by which the specified sensor noise is increased in the runs without faults."""
FRAME_LOSS_PROBABILITY = 0.001
"""Probability with which each CAN frame is lost in the runs without faults."""
MAX_RUN_NS = 8_000_000_000
"""Longest duration of one run without faults [ns]."""
LAST_PHASE = "hold"
"""Phase at the end of a successful run without faults."""


@dataclass
class CampaignReport:
    """Results of a campaign.

    Attributes:
        hand: name of the hand.
        control_rates_hz: control rate by protocol [Hz].
        results: results of the scenarios, by protocol.
        false_alarms: false alarms of each protocol, by the name of the protocol. A false alarm is a
            fault that the controller reports in a run without injected faults, with reaction HOLD
            or a more severe reaction.
        simulated_s: simulated time of the runs without faults, for all protocols together [s].
    """

    hand: str
    control_rates_hz: dict[str, float] = field(default_factory=dict)
    results: dict[str, list[ScenarioResult]] = field(default_factory=dict)
    false_alarms: dict[str, list[str]] = field(default_factory=dict)
    simulated_s: float = 0.0

    @property
    def all_results(self) -> list[ScenarioResult]:
        """Return the results of the scenarios of all protocols in one list."""
        return [result for results in self.results.values() for result in results]

    def as_json(self) -> dict[str, Any]:
        """Return the report as plain values for JSON. The values that summarise the whole campaign come first."""
        results = self.all_results
        return {
            "hand": self.hand,
            "rates_hz": self.control_rates_hz,
            "scenarios": len(results),
            "late": sum(not result.ok for result in results),
            "worst_ticks": max((result.ticks for result in results), default=0),
            "worst_share_of_bound": max(
                (result.ticks / max(result.bound, 1) for result in results), default=0.0
            ),
            "worst_tension_N": max((result.tension for result in results), default=0.0),
            "not_felt": sum(not result.effect_count for result in results),
            "false_alarms": sum(map(len, self.false_alarms.values())),
            "false_alarm_run_s": self.simulated_s,
            "alarms": self.false_alarms,
            "results": {
                protocol: [r.as_json() for r in results]
                for protocol, results in self.results.items()
            },
        }


ProgressCallback = Callable[[str, int, int], None]
"""Function called with the protocol, the number of finished scenarios, and the number of all scenarios."""


def campaign_scenarios(
    hand: Hand,
    protocol: str,
    rate_hz: float,
    is_quick: bool,
    row_ids: Sequence[str] = (),
    seed: int = 0,
) -> list[FaultScenario]:
    """Return the scenarios that a campaign runs.

    A full campaign runs all scenarios. If `row_ids` is not empty, the campaign runs only the
    scenarios of the named rows of the fault matrix. A quick campaign runs every seventh scenario.
    The seed determines the first scenario of a quick campaign, so that each seed gives a different
    sample.
    """
    period_ms = 1e3 / rate_hz
    selected_scenarios = scenarios_of_hand(hand, protocol, period_ms)
    if row_ids:
        return [scenario for scenario in selected_scenarios if scenario.row.id in row_ids]
    selected_scenarios += fault_pairs(hand, protocol, period_ms)
    return (
        selected_scenarios[seed % QUICK_SCENARIO_STEP :: QUICK_SCENARIO_STEP]
        if is_quick
        else selected_scenarios
    )


def run_campaign(
    name: str,
    protocols: Iterable[str],
    control_rate_of_hand: Callable[[Hand], float],
    *,
    jobs: int,
    is_quick: bool,
    fault_free_s: float,
    on_progress: ProgressCallback,
    on_failure: Callable[[SimulatedRun, ScenarioResult], None],
    row_ids: Sequence[str] = (),
    fault_free_only: bool = False,
    seed: int = 1,
) -> CampaignReport:
    """Run a campaign, and return the report.

    Args:
        name: name of the hand.
        protocols: drive protocols to test, one after the other.
        control_rate_of_hand: function that returns the control rate of a hand [Hz].
        jobs: number of processes that run at the same time.
        is_quick: True to run only a sample of the scenarios.
        fault_free_s: simulated time of the runs without faults, for each protocol [s].
        on_progress: function called after each scenario.
        on_failure: function called with the simulation of a failed scenario, and with the result.
        row_ids: ids of the rows of the fault matrix to run. If no ids are given, all rows are run.
        fault_free_only: True to run only the runs without faults, and no scenarios.
        seed: seed of the scenarios and of the first run without faults. For each later run without
            faults, the seed is increased by 1.
    """
    report = CampaignReport(name)
    for protocol in protocols:
        hand = hand_with_protocol(name, protocol)
        rate = report.control_rates_hz[protocol] = control_rate_of_hand(hand)
        scenarios_to_run = (
            []
            if fault_free_only
            else campaign_scenarios(hand, protocol, rate, is_quick, row_ids, seed)
        )
        results = report.results[protocol] = []

        # The default arguments bind the values of the present protocol. Without the default
        # arguments, the function would use the values of the last protocol of the loop.
        def add_result(
            result: ScenarioResult,
            results: list[ScenarioResult] = results,
            protocol: str = protocol,
            total: int = len(scenarios_to_run),
        ) -> None:
            results.append(result)
            on_progress(protocol, len(results), total)

        if scenarios_to_run:
            run_protocol_scenario = partial(run_scenario, protocol=protocol)
            run_experiments(
                hand,
                rate,
                scenarios_to_run,
                jobs,
                run_protocol_scenario,
                add_result,
                on_failure,
                seed,
            )
        # A quick campaign also contains the runs without faults, because false alarms are as bad as
        # missed faults.
        report.false_alarms[protocol] = simulate_without_faults(hand, rate, fault_free_s, seed)
        report.simulated_s += fault_free_s
    return report


def simulate_without_faults(
    hand: Hand, rate_hz: float, duration_s: float, seed: int = 1
) -> list[str]:
    """Simulate a hand without faults, and return the false alarms.

    In the simulation, the sensor noise is larger than normal, and a fraction of the frames is lost.
    During the run, the hand moves and grasps repeatedly. A run that does not reach a grasp also
    adds a text to the result, because without a grasp the run tests too little.
    """
    alarms: list[str] = []
    remaining_s = duration_s
    while remaining_s > 0.0:
        with homed_run(hand, rate_hz, seed, {"noise": POSITION_NOISE_FACTOR}) as simulation:
            for bus in hand.bus_names:
                # The fault command `drop` loses frames that the drives send to the host. The fault
                # command `deaf` loses frames that the host sends to the drives.
                simulation.simulated_hand.inject(
                    f"drop bus={bus} p={FRAME_LOSS_PROBABILITY} seed={seed}"
                )
                simulation.simulated_hand.inject(
                    f"deaf bus={bus} p={FRAME_LOSS_PROBABILITY} seed={seed}"
                )
            alarms_before = len(alarms)
            has_ended = False
            while remaining_s > 0.0 and not has_ended:
                tick_output = simulation.run_tick()
                remaining_s -= simulation.period_ns * 1e-9
                alarms += [
                    event.text
                    for event in tick_output.events
                    if event.name == "fault" and _demands_hold_or_stop(event)
                ]
                has_ended = (
                    tick_output.mode == HandMode.DONE
                    or simulation.k * simulation.period_ns >= MAX_RUN_NS
                )
            if (
                has_ended
                and len(alarms) == alarms_before
                and simulation.last_output
                and simulation.last_output.phase != LAST_PHASE
            ):
                alarms.append(
                    f"seed {seed} did not reach a grasp: {simulation.state.failure or simulation.last_output.phase}"
                )
        seed += 1
    return alarms


def _demands_hold_or_stop(event: TickEvent) -> bool:
    """Return True if the reaction to a fault is HOLD or a more severe reaction.

    The text of the fault event ends with the name of the reaction.
    """
    return SafetyAction[event.text.rpartition(" ")[2]] >= SafetyAction.HOLD
