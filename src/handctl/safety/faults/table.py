"""Fault table and catalogue with all declarations, and arrays for the compiled detectors."""

import numpy as np

from handctl.safety.faults import fault as declared
from handctl.safety.faults.fault import CatalogueRow, Fault

TABLE: tuple[Fault, ...] = tuple(declared.TABLE)
"""All faults, in the order of the catalogue."""
BY_ID = {fault.id: fault for fault in TABLE}
"""All faults by identifier."""
CATALOGUE: tuple[CatalogueRow, ...] = tuple(declared.CATALOGUE)
"""All rows of the catalogue."""

DETECTOR_ROWS: tuple[tuple[Fault, str], ...] = tuple(declared.DETECTOR_ROWS)
"""Fault and kind of instance for each row of the detectors' result table."""
DEBOUNCE = np.array([fault.debounce for fault, _ in DETECTOR_ROWS], dtype=np.int64)
"""(rows,) number of consecutive ticks after which a fault becomes active."""
ACTIONS = np.array([int(fault.action) for fault, _ in DETECTOR_ROWS], dtype=np.int64)
"""(rows,) reaction to the fault, a number of ``Action``."""

REPORTS: dict[str, tuple[Fault, ...]] = {
    kind: tuple(fault for fault in TABLE if kind in fault.reports)
    for kind in dict.fromkeys(kind for fault in TABLE for kind in fault.reports)
}
"""Faults that each kind of event from a bus, the host, or the recorder reports."""


def remedy_for(text: str) -> str:
    """Return the remedy for the fault in an event text, empty if the text does not begin with a fault id."""
    fault = BY_ID.get(text.partition(" ")[0])
    return fault.remedy if fault else ""
