"""One scenario on a run that has come so far: disturb, see whether it was felt, and how soon what was done about it."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from handctl.campaign.scenarios import GRASP, HOST, Row, Scenario
from handctl.core.model import HandModel
from handctl.core.types import IoEvent, Mode, TickOut
from handctl.errors import REMOVE_POWER
from handctl.runtime.mailbox import CUT
from handctl.safety.action import Action
from handctl.session.simulate import Simulation

AFTER_S = 1.3
"""How much longer than its bound a scenario is watched: until no torque is left [s]."""
RUNS_AWAY = "runaway"
BEYOND = (Mode.DISARM, Mode.DONE)
SECOND_AT_TICKS, PAIR_TICKS = 5, 2
"""Ticks between the two faults of a pair; and what the second may delay: a missed tick and its neighbour."""


@dataclass
class Result:
    """What a scenario came to.

    Attributes:
        scenario, id, stage: which.
        felt: positive control: how often the disturbance did something.
        ticks: from the physical event to the frames that carry the reaction; -1 if there was none.
        bound: most ticks that it may take.
        found: row that found it, as id and instance; empty if none did.
        safe_ticks: from the event until no motor is asked for torque; -1 if it never was so.
        tension: largest true tension from the event on [N]. most: what it may be [N]; see ``explained``.
        ok: felt, found by one of its rows, and in time.
        why: what is wrong if it is not.
    """

    scenario: str
    id: str
    stage: str
    felt: int = 0
    ticks: int = -1
    bound: int = 0
    found: str = ""
    safe_ticks: int = -1
    tension: float = 0.0
    most: float = 0.0
    ok: bool = False
    why: str = ""

    def plain(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)


def try_out(course: Simulation, scenario: Scenario, protocol: str) -> Result:
    """Run a scenario to its end.

    Args:
        course: at the stage of the scenario; it is used up.
        scenario: what to do.
        protocol: of the drives.
    """
    row = scenario.row
    bound = row.bound(protocol, course.period_ns / 1e6) + (PAIR_TICKS if scenario.second else 0)
    result = Result(scenario.name, row.id, scenario.stage, bound=bound)
    begin_ns, before = course.k * course.period_ns, course.peer.truth()["tension"]
    speed = _speeds(course)
    host = Host(scenario.fault.removeprefix(HOST)) if scenario.fault.startswith(HOST) else None
    if host is None:
        course.peer.inject(scenario.fault)
    other = Host(scenario.second.removeprefix(HOST)) if scenario.second.startswith(HOST) else None
    for i in range(bound + SECOND_AT_TICKS + round(AFTER_S * 1e9 / course.period_ns)):
        now: dict[str, Any] = {"requests": (CUT,)} if i == 1 and row.id == "N16" else {}
        now |= host.at(i, course) if host else {}
        if i == SECOND_AT_TICKS and other:
            now |= other.at(0, course)
        elif i == SECOND_AT_TICKS and scenario.second:
            course.peer.inject(scenario.second)
        t_ns = (course.k + int(now.get("skip", 0))) * course.period_ns
        begin_ns = t_ns if host and i == 0 else begin_ns  # a host that stood still is judged from its wake
        out = course.tick(**now)
        _look(result, course, scenario, out, _felt_ns(course, host, begin_ns), t_ns)
        if out.mode == Mode.DONE:
            break
    result.felt = 1 if host else int(course.peer.told()[0]["felt"])
    result.most = explained(course, scenario, before, speed, max(result.safe_ticks, bound) * course.period_ns * 1e-9)
    return _judged(result, row)


def _speeds(course: Simulation) -> list[float]:
    """Speed of each cable as the controller knows it [m/s]; none before the first tick."""
    if course.out is None:
        return [0.0] * course.controller.model.tendon_count
    spool = course.controller.model.space.spool
    return [float(v) for v in np.nan_to_num(np.abs(course.out.telemetry.motor_velocity * spool))]


def explained(course: Simulation, scenario: Scenario, before: list[float], speed: list[float], seconds: float) -> float:
    """Largest tension that drive and momentum explain [N].

    Of all faults but one nobody's drive needs to be feared: they must stay below the limit at which one sample means
    that the hand relaxes.

    Args:
        course: of the run. scenario: what was done.
        before, speed: of each rope when it was done [N], [m/s].
        seconds: time until no torque is asked for.
    """
    if RUNS_AWAY not in (scenario.fault.split()[0], *scenario.second.split()[:1]):
        return max(*course.controller.limits.tension_trip, *before)
    return overshoot(course.controller.model, before, speed, 0.0 if scenario.stage == GRASP else seconds)


def overshoot(model: HandModel, before: Sequence[float], speed: Sequence[float], seconds: float) -> float:
    """Largest tension that a drive that runs away explains [N].

    It pushes its rotor, of mass m at the cable, with its own limit F against the stiffness k of the rope, from the
    tension T that was there: it overshoots to F + sqrt((F - T)^2 + k m v^2), where v is the speed that the rotor had,
    and where the finger is free what F adds to it until the torque is gone.

    Args:
        model: the hand.
        before, speed: of each rope when it began [N], [m/s].
        seconds: for which the finger is free.
    """
    space, bounds = model.space, []
    for tendon, k, m, taut, v in zip(model.hand.tendon, space.stiffness, space.motor_mass, before, speed, strict=True):
        limit = tendon.drive_limit_N
        bounds.append(limit + math.sqrt((limit - taut) ** 2 + k * m * (v + limit / m * seconds) ** 2))
    return float(max(bounds))


def _felt_ns(course: Simulation, host: "Host | None", begin_ns: int) -> int:
    """When the disturbance was felt first [ns]; -1 as long as it was not."""
    if host is not None:
        return begin_ns
    return int(course.peer.told()[0]["first_ns"])


def _look(result: Result, course: Simulation, scenario: Scenario, out: TickOut, felt_ns: int, t_ns: int) -> None:
    """Take down what a tick shows."""
    row, truth = scenario.row, course.peer.truth()
    result.tension = max(result.tension, *truth["tension"])
    if felt_ns < 0:
        return
    since = math.ceil((t_ns - felt_ns) / course.period_ns)
    for event in out.events:
        told = event.name == "fault" or REMOVE_POWER in event.text
        own = event.text.startswith(tuple(filter(None, row.rows))) or not any(row.rows) or scenario.second
        if not result.found and told and own:
            result.found = " ".join(event.text.split(":")[0].split()[:1]) + f" {event.where}"
    reacted = out.action >= row.action or (row.action >= Action.RELAX and out.mode in (*BEYOND, Mode.RELAX, Mode.CUT))
    reacted = reacted and not (row.action == Action.CUT and out.mode == Mode.RELAX)
    if row.id == "H01":
        reacted = bool(result.found)
    if result.ticks < 0 and reacted and (result.found or not any(row.rows) or out.mode in BEYOND):
        result.ticks = max(0, since)
    if result.ticks >= 0 and result.safe_ticks < 0 and not any(truth["torque"]):
        result.safe_ticks = max(0, since)


def _judged(result: Result, row: Row) -> Result:
    """Whether all is well, and why not."""
    why = []
    if not result.felt:
        why.append("the disturbance was not felt")
    elif result.ticks < 0:
        why.append("no reaction")
    elif result.ticks > result.bound:
        why.append(f"late: {result.ticks} ticks, at most {result.bound}")
    elif not result.found and any(row.rows):
        why.append(f"none of {', '.join(filter(None, row.rows))} was told")
    if row.action >= Action.RELAX and result.felt and result.safe_ticks < 0:
        why.append("torque is left")
    if result.tension > result.most:
        why.append(f"{result.tension:.0f} N in a rope, at most {result.most:.0f} are explained")
    result.ok, result.why = not why, "; ".join(why)
    return result


class Host:
    """What is done to the host: ``io KIND [WHERE] [lasting]``, ``skip N``, ``late SHARE``, ``ask REQUEST [TIMES]``."""

    def __init__(self, text: str) -> None:
        self.verb, *self.words = text.split()

    def at(self, i: int, course: Simulation) -> dict[str, Any]:
        """Arguments of the i-th tick since."""
        first = i == 0
        if self.verb == "io":
            if not first and "lasting" not in self.words:
                return {}
            where = self.words[1] if len(self.words) > 1 and self.words[1] != "lasting" else "bus"
            return {"io": (IoEvent(self.words[0], where),)}
        if not first:
            return {}
        if self.verb == "skip":
            return {"skip": int(self.words[0])}
        if self.verb == "late":
            return {"late_ns": round(float(self.words[0]) * course.period_ns)}
        times = int(self.words[1]) if len(self.words) > 1 else 1
        return {"requests": (f'{{"do": "{self.words[0]}"}}',) * times}
