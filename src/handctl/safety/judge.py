"""Debounce, latch, and the largest action wins: the last word before encoding."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from handctl.safety.action import Action
from handctl.safety.calm import calm
from handctl.safety.faults.fault import Fault, Reading
from handctl.safety.faults.table import TABLE
from handctl.safety.signals import Limits, Signals


class Latched(NamedTuple):
    """A fault that counts now: present (and debounced), or latched since."""

    id: str
    instance: str


class Finding(NamedTuple):
    """A fault that has just begun to count."""

    fault: Fault
    instance: str
    value: float


@dataclass(frozen=True, slots=True)
class SafetyState:
    """What safety carries from tick to tick.

    Attributes:
        counting: (id, instance, consecutive ticks) of every condition present.
        latched: faults that only a person clears.
    """

    counting: tuple[tuple[str, str, int], ...] = ()
    latched: tuple[Latched, ...] = ()


@dataclass(frozen=True, slots=True)
class Verdict:
    """The judgement of one tick.

    Attributes:
        action: the largest action demanded.
        findings: faults that began to count in this tick.
    """

    action: Action
    findings: tuple[Finding, ...]


CALM, NOTHING = SafetyState(), Verdict(Action.PASS, ())


def judge(
    state: SafetyState, limits: Limits, signals: Signals, table: tuple[Fault, ...] = TABLE
) -> tuple[SafetyState, Verdict]:
    """Judge one tick.

    Args:
        state: from the last tick.
        limits: thresholds of the hand.
        signals: facts of this tick.
        table: the fault table.
    """
    if calm(limits, signals):
        return _count(state, [], table) if state.latched else (CALM, NOTHING)
    present = []
    for fault in table:
        readings = fault.detect(limits, signals)
        if readings:
            present.append((fault, readings))
    if not present and not state.latched:
        return CALM, NOTHING
    return _count(state, present, table)


def _count(
    state: SafetyState, present: list[tuple[Fault, Sequence[Reading]]], table: tuple[Fault, ...]
) -> tuple[SafetyState, Verdict]:
    """Count what is present, latch what has been there for long enough, and take the largest action."""
    before = {(id_, instance): ticks for id_, instance, ticks in state.counting}
    counting: list[tuple[str, str, int]] = []
    latched = list(state.latched)
    findings: list[Finding] = []
    action = Action.PASS
    for fault, instance, value in [(fault, *reading) for fault, readings in present for reading in readings]:
        ticks = before.get((fault.id, instance), 0) + 1
        counting.append((fault.id, instance, ticks))
        if ticks < fault.debounce:
            continue
        action = max(action, fault.action)
        mark = Latched(fault.id, instance)
        if ticks == fault.debounce and mark not in latched:
            findings.append(Finding(fault, instance, value))
        if fault.latched and mark not in latched:
            latched.append(mark)
    actions = {fault.id: fault.action for fault in table}
    action = max([action, *(actions[mark.id] for mark in latched)])
    return SafetyState(tuple(counting), tuple(latched)), Verdict(action, tuple(findings))


def clear(state: SafetyState) -> SafetyState:
    """Drop all latches on a person's order; what is still present will latch again in the next tick."""
    return SafetyState(state.counting, ())
