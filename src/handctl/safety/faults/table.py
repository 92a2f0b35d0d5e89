"""Fault table and fault catalogue, which contain all declarations, and arrays for compiled detectors."""

import numpy as np

from handctl.safety.faults import fault as declared
from handctl.safety.faults.fault import CatalogueRow, Fault

FAULT_TABLE: tuple[Fault, ...] = tuple(declared.DECLARED_FAULTS)
"""All faults, in the order of the catalogue."""
FAULT_BY_ID = {fault.id: fault for fault in FAULT_TABLE}
"""All faults by identifier."""
FAULT_CATALOGUE: tuple[CatalogueRow, ...] = tuple(declared.DECLARED_ROWS)
"""All rows of the catalogue."""

DETECTOR_ROWS: tuple[tuple[Fault, str], ...] = tuple(declared.DETECTOR_ROWS)
"""Fault and kind of part for each row of the evidence table, in which the detectors store their results."""
DEBOUNCE_TICKS = np.array([fault.debounce_ticks for fault, _ in DETECTOR_ROWS], dtype=np.int64)
"""(rows,) number of consecutive ticks with a fault after which the fault becomes active."""
ACTION_NUMBERS = np.array([int(fault.action) for fault, _ in DETECTOR_ROWS], dtype=np.int64)
"""(rows,) reaction to the fault, as a value of ``SafetyAction``."""

FAULTS_BY_EVENT_KIND: dict[str, tuple[Fault, ...]] = {
    kind: tuple(fault for fault in FAULT_TABLE if kind in fault.reports)
    for kind in dict.fromkeys(kind for fault in FAULT_TABLE for kind in fault.reports)
}
"""Faults that each kind of event from a bus, the host, or the recorder reports."""


def remedy_for(text: str) -> str:
    """Return the remedy for the fault that an event text reports.

    The result is empty if the event text does not begin with the identifier of a fault.
    """
    fault = FAULT_BY_ID.get(text.partition(" ")[0])
    return fault.remedy if fault else ""
