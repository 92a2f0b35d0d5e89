"""Latches, reports of buses and host, and the largest action wins: the last word before encoding.

What detectors find is debounced by compiled code (``core.detectors.judge``). Here the faults that begin to count get
their names, what latches stays until an operator clears it, and reports are counted.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.safety.action import Action
from handctl.safety.faults.bus import UNANSWERED
from handctl.safety.faults.fault import JOINT, MOTOR, NODE, TENDON, Fault
from handctl.safety.faults.host import FOREIGN
from handctl.safety.faults.table import BY_ID, DEBOUNCE, FOUND, REPORTS
from handctl.safety.limits import Limits

Report = tuple[str, str, float]
"""Kind of event, where, and its number."""
ALONE = BY_ID["B18"]


class Latched(NamedTuple):
    """A fault that has counted, and counts until an operator clears it."""

    id: str
    instance: str


class Counting(NamedTuple):
    """A reported fault that is present, and for how many ticks in a row."""

    id: str
    instance: str
    ticks: int


class Finding(NamedTuple):
    """A fault that has just begun to count."""

    fault: Fault
    instance: str
    value: float


class Verdict(NamedTuple):
    """The judgement of one tick.

    Attributes:
        action: the largest action demanded.
        findings: faults that began to count in this tick.
        latched: faults that only an operator clears, after this tick.
        counting: reported faults that are present.
    """

    action: Action
    findings: tuple[Finding, ...]
    latched: tuple[Latched, ...]
    counting: tuple[Counting, ...]


_ACTIONS = {int(action): action for action in Action}


def judge(
    latched: tuple[Latched, ...],
    counting: tuple[Counting, ...],
    found: Sequence[Finding],
    demanded: int,
    reports: Iterable[Report],
) -> Verdict:
    """Judge one tick.

    Args:
        latched, counting: from the last tick.
        found: faults of the detectors that begin to count; see ``begun``.
        demanded: largest action of those that count.
        reports: of buses, host and recorder in this tick; see ``reported``.
    """
    action, findings, still = demanded, list(found), []
    before = {(one.id, one.instance): one.ticks for one in counting}
    for fault, where, value in reported(reports):
        ticks = before.get((fault.id, where), 0) + 1
        still.append(Counting(fault.id, where, ticks))
        if ticks >= fault.debounce:
            action = max(action, fault.action)
        if ticks == fault.debounce:
            findings.append(Finding(fault, where, value))
    fresh = [one for one in findings if Latched(one.fault.id, one.instance) not in latched]
    latched += tuple(dict.fromkeys(Latched(one.fault.id, one.instance) for one in fresh if one.fault.latched))
    action = max([action, *(BY_ID[mark.id].action for mark in latched)])
    fresh.sort(key=lambda one: _ORDER[one.fault.id])
    return Verdict(_ACTIONS[action], tuple(fresh), latched, tuple(still))


def begun(limits: Limits, found: NDArray[np.float64], ticks: NDArray[np.int64]) -> list[Finding]:
    """Return the faults that begin to count in this tick, in the order of the table.

    Args:
        limits: names of the hand.
        found: (rows, instances) values that show faults, NaN where there is none.
        ticks: (rows, instances) for how long each is present.
    """
    rows, instances = np.nonzero((ticks[: len(DEBOUNCE)] == DEBOUNCE[:, None]) & ~np.isnan(found))
    pairs = zip(rows.tolist(), instances.tolist(), strict=True)
    return [Finding(FOUND[row][0], _name(limits, *FOUND[row], i), float(found[row, i])) for row, i in pairs]


def _name(limits: Limits, fault: Fault, kind: str, i: int) -> str:
    """Return the name of an instance."""
    names = {TENDON: limits.tendons, MOTOR: limits.motors, JOINT: limits.joints, NODE: limits.nodes}
    return names[kind][i] if kind in names else fault.name


def reported(reports: Iterable[Report]) -> list[tuple[Fault, str, float]]:
    """Return the faults that reports mean, each with where and its value; those of one kind and place once."""
    found: dict[tuple[str, str], tuple[Fault, str, float]] = {}
    for kind, where, value in reports:
        key = f"{kind}:{where}" if kind == "recorder" else kind
        for fault in REPORTS.get(key, ()):
            name = where or kind
            found[fault.id, name] = (fault, name, value)
    return sorted(found.values(), key=lambda one: _ORDER[one[0].id])


_ORDER = {id_: place for place, id_ in enumerate(BY_ID)}


def alone(reports: Iterable[Report], heard: bool) -> list[Report]:
    """Return the reports without error frames, but for the first that says that nobody hears this host (B18).

    Args:
        reports: of this tick. heard: whether any node has ever answered, or torque may act.
    """
    kept, error = [], None
    for one in reports:
        if one[0] != "error_frame":
            kept.append(one)
        elif error is None and not heard and any(word in one[1] for word in UNANSWERED):
            error = one
    return [*kept, error] if error else kept


def foreign(signs: Iterable[str]) -> list[Report]:
    """Return the reports of a second controller (H13), one for each sign of it."""
    return [(FOREIGN, sign, 1.0) for sign in signs]
