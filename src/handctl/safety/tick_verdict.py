"""Safety decision in each tick: active faults, latched faults, and the reaction.

Compiled code (``core.detectors.fault_detection``) debounces the faults that the detectors find.
This module determines which part of the hand each newly active fault affects, and debounces the
reported faults. This module also latches faults until an operator clears the faults, and chooses
the most severe reaction.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.safety.faults.bus import MISSING_ACKNOWLEDGE_TEXTS
from handctl.safety.faults.fault import (
    FAULT_PLACE_JOINT,
    FAULT_PLACE_MOTOR,
    FAULT_PLACE_NODE,
    FAULT_PLACE_TENDON,
    Fault,
)
from handctl.safety.faults.host import FOREIGN_CONTROLLER_EVENT
from handctl.safety.faults.table import (
    DEBOUNCE_TICKS,
    DETECTOR_ROWS,
    FAULT_BY_ID,
    FAULTS_BY_EVENT_KIND,
)
from handctl.safety.safety_action import SafetyAction
from handctl.safety.safety_limits import SafetyLimits

EventReport = tuple[str, str, float]
"""Report of an event of a bus, of the host or of the recorder: kind, location, and number."""


class LatchedFault(NamedTuple):
    """Fault that stays active until an operator clears it."""

    id: str
    part_name: str


class ReportedFault(NamedTuple):
    """Fault that a bus, the host or the recorder reports in the present tick.

    The attribute ``ticks`` is the number of consecutive ticks, up to the present tick, in which the
    fault was reported.
    """

    id: str
    part_name: str
    ticks: int


class FaultFinding(NamedTuple):
    """Fault that became active in the present tick."""

    fault: Fault
    part_name: str
    value: float


class TickVerdict(NamedTuple):
    """Safety decision in a tick: the reaction to the present faults, and the state of all faults.

    Attributes:
        action: most severe reaction to the faults that are present.
        findings: faults that became active in this tick.
        latched_faults: all faults that are latched at the end of the tick.
        reported_faults: faults that are reported in this tick.
    """

    action: SafetyAction
    findings: tuple[FaultFinding, ...]
    latched_faults: tuple[LatchedFault, ...]
    reported_faults: tuple[ReportedFault, ...]


_ACTION_BY_NUMBER = {int(action): action for action in SafetyAction}


def judge_tick(
    latched_faults: tuple[LatchedFault, ...],
    reported_faults: tuple[ReportedFault, ...],
    detected_faults: Sequence[FaultFinding],
    demanded_action: int,
    event_reports: Iterable[EventReport],
) -> TickVerdict:
    """Judge a tick: count the reported faults, latch faults, and choose the most severe reaction.

    Args:
        latched_faults: latched faults of the last tick.
        reported_faults: faults that were reported in the last tick.
        detected_faults: faults that became active in the present tick according to the detectors,
            from ``newly_active_faults``.
        demanded_action: most severe reaction to all active faults that the detectors have found.
        event_reports: reports of buses, host and recorder in the present tick, for
            ``locate_reports``.
    """
    action = demanded_action
    findings = list(detected_faults)
    present_reports = []
    # A reported fault without a report in the present tick is dropped. If a dropped fault is
    # reported later, the count of its ticks starts at 1.
    tick_count_by_fault = {
        (report.id, report.part_name): report.ticks for report in reported_faults
    }
    for fault, location, value in locate_reports(event_reports):
        ticks = tick_count_by_fault.get((fault.id, location), 0) + 1
        present_reports.append(ReportedFault(fault.id, location, ticks))
        if ticks >= fault.debounce_ticks:
            action = max(action, fault.action)
        if ticks == fault.debounce_ticks:
            findings.append(FaultFinding(fault, location, value))
    # A detector can find a latched fault a second time, but the log gets no second entry for the
    # fault.
    new_findings = [
        finding for finding in findings if _latched_fault_of(finding) not in latched_faults
    ]
    latched_faults += tuple(
        dict.fromkeys(
            _latched_fault_of(finding) for finding in new_findings if finding.fault.is_latched
        )
    )
    action = max(
        [action, *(FAULT_BY_ID[latched_fault.id].action for latched_fault in latched_faults)]
    )
    new_findings.sort(key=lambda finding: _POSITION_BY_FAULT_ID[finding.fault.id])
    return TickVerdict(
        _ACTION_BY_NUMBER[action], tuple(new_findings), latched_faults, tuple(present_reports)
    )


def _latched_fault_of(finding: FaultFinding) -> LatchedFault:
    """Convert a finding to a latched fault: the identifier of the fault, and the name of the affected part."""
    return LatchedFault(finding.fault.id, finding.part_name)


def newly_active_faults(
    limits: SafetyLimits, evidence: NDArray[np.float64], ticks: NDArray[np.int64]
) -> list[FaultFinding]:
    """Return the faults that became active in the present tick, in the order of the fault table.

    Args:
        limits: safety limits of the hand, with the names of tendons, motors, joints and nodes.
        evidence: (rows, instances) evidence of each fault. The evidence of an absent fault is NaN.
        ticks: (rows, instances) number of consecutive ticks with the fault, up to now.
    """
    # The compiled detectors continue to count the ticks after the debounce, so the count equals the
    # debounce in only one tick.
    rows, instances = np.nonzero(
        (ticks[: len(DEBOUNCE_TICKS)] == DEBOUNCE_TICKS[:, None]) & ~np.isnan(evidence)
    )
    findings = []
    for row, i in zip(rows.tolist(), instances.tolist(), strict=True):
        fault, kind = DETECTOR_ROWS[row]
        findings.append(
            FaultFinding(fault, _faulty_part_name(limits, fault, kind, i), float(evidence[row, i]))
        )
    return findings


def _faulty_part_name(limits: SafetyLimits, fault: Fault, fault_place: str, i: int) -> str:
    """Return the name of the motor, tendon, joint, or node with a fault."""
    names = {
        FAULT_PLACE_TENDON: limits.tendons,
        FAULT_PLACE_MOTOR: limits.motors,
        FAULT_PLACE_JOINT: limits.joints,
        FAULT_PLACE_NODE: limits.node_names,
    }
    return names[fault_place][i] if fault_place in names else fault.name


def locate_reports(event_reports: Iterable[EventReport]) -> list[tuple[Fault, str, float]]:
    """Return the fault, the location and the value that belong to each report.

    Event reports come from a bus, the host or the recorder. If a fault is reported several times at
    the same location, only the last report is returned.
    """
    faults: dict[tuple[str, str], tuple[Fault, str, float]] = {}
    for kind, location, value in event_reports:
        # The location of a recorder event is the kind of the event ("disk_full"). The key of a
        # recorder event contains the kind "recorder" and the location.
        key = f"{kind}:{location}" if kind == "recorder" else kind
        for fault in FAULTS_BY_EVENT_KIND.get(key, ()):
            name = location or kind
            faults[fault.id, name] = (fault, name, value)
    return sorted(faults.values(), key=lambda row: _POSITION_BY_FAULT_ID[row[0].id])


# Position of each fault in the fault table. Faults that occur at the same time are sorted by their
# position in the fault table.
_POSITION_BY_FAULT_ID = {id_: position for position, id_ in enumerate(FAULT_BY_ID)}


def filter_error_frames(
    event_reports: Iterable[EventReport], has_node_answered: bool
) -> list[EventReport]:
    """Remove all error frames from the reports, except the first report of a missing acknowledge (B18).

    Args:
        event_reports: reports of buses, host and recorder in the tick.
        has_node_answered: True if any node has ever answered, or if a motor is allowed to make
            torque. If a node has answered, the fault B18 cannot occur.
    """
    kept_frames, error = [], None
    for event_report in event_reports:
        if event_report[0] != "error_frame":
            kept_frames.append(event_report)
        elif (
            error is None
            and not has_node_answered
            and any(word in event_report[1] for word in MISSING_ACKNOWLEDGE_TEXTS)
        ):
            error = event_report
    return [*kept_frames, error] if error else kept_frames


def second_controller_reports(sign_texts: Iterable[str]) -> list[EventReport]:
    """Return a report of the fault H13 for each sign of a second controller on the bus."""
    return [(FOREIGN_CONTROLLER_EVENT, sign, 1.0) for sign in sign_texts]
