"""Random sequences of faults: in no order may they make a hand dangerous, or a controller forget what it has latched.

The matrix asks whether each fault is found in time. Here nobody knows what will be found: several faults come one after
the other, last for a while or for good, on any instance and in any stage, and a person asks for things in between.

What must hold whatever comes: no tick raises; the mode never goes back; what has latched stays latched until a person
clears it; no set-point rises while the hand relaxes; no rope bears more than its trip limit or, if a drive runs away,
than that drive and its momentum explain; a stop ends the run and all torque, or tells a person to remove the power; and
the same inputs come to the same states again.
"""

import random
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from handctl.campaign.scenarios import HOST, MATRIX, texts
from handctl.campaign.stage import STAGES, try_all
from handctl.campaign.trial import RUNS_AWAY, Host, Result, overshoot
from handctl.controller.state import State
from handctl.core.types import Mode
from handctl.errors import REMOVE_POWER
from handctl.hand.description import Hand
from handctl.runtime.mailbox import CLEAR, STOP
from handctl.session.simulate import Simulation

TICKS, FEWEST, MOST = 200, 2, 6
"""Length of a sequence, and how many faults it has."""
LASTING_MS = (5, 200)
"""Of the faults that end by themselves [ms]."""
FOR_GOOD = ("snap", "slack")
"""What does not mend by itself."""
BETWEEN_SHARE, BRIEF_SHARE = 0.2, 0.6
BETWEEN = (f"{HOST}ask stop", f"{HOST}ask clear", f"{HOST}ask nonsense 1", f"{HOST}skip 3", f"{HOST}late 0.3")
"""What a person asks, and what the host does, in between."""
END_S = 2.5
"""From the stop on: relaxing and disarming, each with its timeout, and what an ODrive's heartbeat takes [s]."""
WATCHDOG_S, REACTION_TICKS = 0.05, 10
"""After so long a drive that hears nothing is off by itself [s]; ticks in which the hand lets one go that runs away."""
FORWARD = (Mode.ARMING, Mode.ACTIVE, Mode.RELAX, Mode.CUT, Mode.DISARM, Mode.DONE)
"""Modes in the order in which a run may come to them."""


class Step(NamedTuple):
    """One fault of a sequence. Attributes: tick: when, from the stage on. fault: text for simulator or host."""

    tick: int
    fault: str


class Sequence(NamedTuple):
    """Several faults.

    Attributes:
        seed: it was drawn with. stage: where it begins. steps: in the order of their ticks.
    """

    seed: int
    stage: str
    steps: tuple[Step, ...]

    @property
    def id(self) -> str:
        """It is of no row."""
        return "sequence"

    @property
    def name(self) -> str:
        """For people."""
        return f"seed {self.seed}, {self.stage}: " + "; ".join(f"{step.tick}: {step.fault}" for step in self.steps)


def draw(hand: Hand, protocol: str, period_ms: float, seed: int) -> Sequence:
    """The sequence of a seed; the same for the same hand, protocol and control period [ms]."""
    chance = random.Random(f"sequence {seed}")
    rows = [row for row in MATRIX if protocol in row.protocols]
    count = chance.randint(FEWEST, MOST)
    steps = []
    for tick in sorted(chance.sample(range(TICKS), count)):
        if chance.random() < BETWEEN_SHARE:
            steps.append(Step(tick, chance.choice(BETWEEN)))
            continue
        fault = chance.choice(texts(hand, chance.choice(rows).fault, period_ms) or list(BETWEEN))
        brief = not fault.startswith((HOST, *FOR_GOOD)) and " for=" not in fault and chance.random() < BRIEF_SHARE
        steps.append(Step(tick, f"{fault} for={chance.randint(*LASTING_MS)}ms" if brief else fault))
    return Sequence(seed, STAGES[seed % len(STAGES)], tuple(steps))


def run(
    hand: Hand,
    protocol: str,
    rate_hz: float,
    seeds: Iterable[int],
    *,
    jobs: int,
    told: Callable[[int], None],
    keep: Callable[[Simulation, Result], None],
) -> list[Result]:
    """Bring one run to each stage, and let the sequences that begin there branch off.

    Args:
        hand: with its drives in ``protocol``. rate_hz: control rate.
        seeds: of the sequences. jobs: processes at a time.
        told: called with how many are done. keep: called where a rule was broken, with the course.
    """
    todo, found = [draw(hand, protocol, 1e3 / rate_hz, seed) for seed in seeds], list[Result]()

    def done(result: Result) -> None:
        found.append(result)
        told(len(found))

    try_all(hand, rate_hz, todo, jobs, endure, done, keep)
    return found


def endure(course: Simulation, sequence: Sequence) -> Result:
    """Let a sequence happen, stop the hand, and look which rules were not kept.

    Args:
        course: at the stage of the sequence; it is used up.
        sequence: what happens.
    """
    begin, taut = (course.state, len(course.kept)), course.peer.truth()["tension"]
    broken: list[str] = []
    tension = 0.0
    for now in _ticks(course, sequence):
        before = course.state
        course.tick(**now)
        tension = max(tension, *course.peer.truth()["tension"])
        broken += broken_in_step(before, course.state, cleared=CLEAR in now["requests"])
        if course.state.mode == Mode.DONE:
            break
    felt = sum(int(fault["felt"]) > 0 for fault in course.peer.told())
    most = _explained(course, sequence, taut)
    if tension > most:
        broken.append(f"{tension:.0f} N in a rope, at most {most:.0f} are explained")
    broken += [*broken_at_end(course), *broken_again(course, *begin)]
    why = "; ".join(dict.fromkeys(broken))
    return Result(
        sequence.name, sequence.id, sequence.stage, felt=felt, tension=tension, most=most, ok=not broken, why=why
    )


def _ticks(course: Simulation, sequence: Sequence) -> Iterator[dict[str, Any]]:
    """What each tick is given; the faults of the simulator begin on the way, and at the end a person stops the hand."""
    hosts: list[tuple[int, Host]] = []
    for i in range(TICKS + round(END_S * 1e9 / course.period_ns)):
        for fault in [step.fault for step in sequence.steps if step.tick == i]:
            if fault.startswith(HOST):
                hosts.append((i, Host(fault.removeprefix(HOST))))
            else:
                course.peer.inject(fault)
        now: dict[str, Any] = {"io": (), "requests": (STOP,) if i == TICKS else ()}
        for began, host in hosts:
            for key, value in host.at(i - began, course).items():
                now[key] = now[key] + value if key in ("io", "requests") else value
        yield now


def broken_in_step(before: State, after: State, cleared: bool) -> list[str]:
    """Rules of one tick that are broken."""
    broken = []
    if FORWARD.index(after.mode) < FORWARD.index(before.mode):
        broken.append(f"the mode goes back: {before.mode.name} to {after.mode.name}")
    gone = set(before.latched) - set(after.latched)
    if gone and not cleared:
        broken.append(f"no longer latched: {', '.join(sorted(mark.id for mark in gone))}")
    if before.mode == after.mode == Mode.RELAX and np.any(after.view("setpoint") > before.view("setpoint") + 1e-9):
        broken.append("a set-point rises while the hand relaxes")
    if after.mode == Mode.RELAX and np.any(after.view("asked") > np.maximum(before.view("asked"), 0.0) * (1.0 + 1e-9)):
        broken.append("a motor is commanded to pull harder while the hand relaxes")
    return broken


def _explained(course: Simulation, sequence: Sequence, taut: list[float]) -> float:
    """Largest tension that may be [N]; of a drive that runs away from a slack rope, until its watchdog has fired."""
    limits, model = course.controller.limits, course.controller.model
    if not any(step.fault.startswith(RUNS_AWAY) for step in sequence.steps):
        return max(*limits.tension_trip, *taut)
    still = [0.0] * model.tendon_count
    return overshoot(model, still, still, WATCHDOG_S + REACTION_TICKS * course.period_ns * 1e-9)


def broken_at_end(course: Simulation) -> list[str]:
    """Rules of the end that are broken."""
    state, names = course.state, course.controller.model.hand.tendon_names
    if state.mode != Mode.DONE:
        return [f"the run does not end: {state.mode.name}"]
    left = [name for name, torque in zip(names, course.peer.truth()["torque"], strict=True) if torque]
    return [f"torque is left: {', '.join(left)}"] if left and REMOVE_POWER not in state.failure else []


def broken_again(course: Simulation, state: State, first: int) -> list[str]:
    """The first tick that does not come to the same from the same inputs."""
    for entry, out in course.kept[first:]:
        state, again = course.controller.tick(state, entry)
        if (again.state_hash, again.frames, again.events) != (out.state_hash, out.frames, out.events):
            return [f"tick {entry.k} does not come to the same again"]
    return []
