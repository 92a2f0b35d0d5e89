"""The whole matrix for one hand and some protocols, and what the undisturbed hand raises."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from handctl.campaign.scenarios import Scenario, pairs, scenarios
from handctl.campaign.stage import hand_in, started, try_all
from handctl.campaign.trial import Result, try_out
from handctl.core.types import Event, Mode
from handctl.hand.description import Hand
from handctl.safety.action import Action
from handctl.session.simulate import Simulation

QUICK_EVERY = 7
"""A sample takes every so-manieth scenario."""
NOISE, LOSS = 3.0, 0.001
"""What the undisturbed hand must bear: times the specified noise, and the share of frames that are lost."""
RUN_NS, GRASPED = 8_000_000_000, "hold"
"""How long a run of the undisturbed hand takes; and the phase in which it must be then."""


@dataclass
class Report:
    """What a campaign came to.

    Attributes:
        hand: its name. rates: control rate by protocol [Hz].
        results: by protocol. alarms: faults of the undisturbed hand with HOLD or more, by protocol.
        simulated_s: how long it was simulated undisturbed, in all [s].
    """

    hand: str
    rates: dict[str, float] = field(default_factory=dict)
    results: dict[str, list[Result]] = field(default_factory=dict)
    alarms: dict[str, list[str]] = field(default_factory=dict)
    simulated_s: float = 0.0

    @property
    def all_results(self) -> list[Result]:
        """Of all protocols."""
        return [result for results in self.results.values() for result in results]

    def plain(self) -> dict[str, Any]:
        """As plain values: the figures first."""
        results = self.all_results
        return {
            "hand": self.hand,
            "rates_hz": self.rates,
            "scenarios": len(results),
            "late": sum(not result.ok for result in results),
            "worst_ticks": max((result.ticks for result in results), default=0),
            "worst_share_of_bound": max((result.ticks / max(result.bound, 1) for result in results), default=0.0),
            "worst_tension_N": max((result.tension for result in results), default=0.0),
            "not_felt": sum(not result.felt for result in results),
            "false_alarms": sum(map(len, self.alarms.values())),
            "false_alarm_run_s": self.simulated_s,
            "alarms": self.alarms,
            "results": {protocol: [r.plain() for r in results] for protocol, results in self.results.items()},
        }


Told = Callable[[str, int, int], None]
"""Protocol, scenarios done, scenarios in all."""


def plan(
    hand: Hand, protocol: str, rate_hz: float, quick: bool, only: Sequence[str] = (), seed: int = 0
) -> list[Scenario]:
    """List what is tried: everything, a sample, which is another one for the next seed, or some rows."""
    period_ms = 1e3 / rate_hz
    found = scenarios(hand, protocol, period_ms)
    if only:
        return [one for one in found if one.row.id in only]
    found += pairs(hand, protocol, period_ms)
    return found[seed % QUICK_EVERY :: QUICK_EVERY] if quick else found


def run(
    name: str,
    protocols: Iterable[str],
    rate_of: Callable[[Hand], float],
    *,
    jobs: int,
    quick: bool,
    calm_s: float,
    told: Told,
    keep: Callable[[Simulation, Result], None],
    only: Sequence[str] = (),
    calm_only: bool = False,
    seed: int = 1,
) -> Report:
    """Try everything out.

    Args:
        name: of the hand. protocols: of its drives, one after the other.
        rate_of: control rate of a hand [Hz].
        jobs: processes at a time. quick: a sample.
        calm_s: how long the undisturbed hand is watched, for each protocol [s].
        told: progress. keep: called where a scenario failed, with its course.
        only: rows to try; all if empty.
        calm_only: nothing but the undisturbed hand.
        seed: of the run that is disturbed, and of the undisturbed hand's first one; its next ones count on.
    """
    report = Report(name)
    for protocol in protocols:
        hand = hand_in(name, protocol)
        rate = report.rates[protocol] = rate_of(hand)
        todo = [] if calm_only else plan(hand, protocol, rate, quick, only, seed)
        results = report.results[protocol] = []

        def done(
            result: Result, results: list[Result] = results, protocol: str = protocol, most: int = len(todo)
        ) -> None:
            results.append(result)
            told(protocol, len(results), most)

        if todo:
            attempt = partial(try_out, protocol=protocol)
            try_all(hand, rate, todo, jobs, attempt, done, keep, seed)
        report.alarms[protocol] = calm(hand, rate, calm_s, seed)
        report.simulated_s += calm_s
    return report


def calm(hand: Hand, rate_hz: float, seconds: float, seed: int = 1) -> list[str]:
    """Faults with HOLD or more that an undisturbed hand raises while it moves and grasps, with noise and frame loss.

    A run in which it does not come to grasp has tried nothing, and is told as well.
    """
    alarms: list[str] = []
    left = seconds
    while left > 0.0:
        with started(hand, rate_hz, seed, {"noise": NOISE}) as course:
            for bus in hand.bus_names:
                course.peer.inject(f"drop bus={bus} p={LOSS} seed={seed}")
                course.peer.inject(f"deaf bus={bus} p={LOSS} seed={seed}")
            before, over = len(alarms), False
            while left > 0.0 and not over:
                out = course.tick()
                left -= course.period_ns * 1e-9
                alarms += [event.text for event in out.events if event.name == "fault" and _holds(event)]
                over = out.mode == Mode.DONE or course.k * course.period_ns >= RUN_NS
            if over and len(alarms) == before and course.out and course.out.phase != GRASPED:
                alarms.append(f"seed {seed} came to no grasp: {course.state.failure or course.out.phase}")
        seed += 1
    return alarms


def _holds(event: Event) -> bool:
    """Whether a fault that is told, its action at the end, makes the hand hold at least."""
    return Action[event.text.rpartition(" ")[2]] >= Action.HOLD
