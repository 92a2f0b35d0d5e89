"""The fault table and the catalogue as declared, and arrays for the compiled judge."""

import numpy as np

from handctl.safety.faults import fault as declared
from handctl.safety.faults.fault import Fault, Row

TABLE: tuple[Fault, ...] = tuple(declared.TABLE)
"""All faults, in the order of the catalogue."""
BY_ID = {fault.id: fault for fault in TABLE}
CATALOGUE: tuple[Row, ...] = tuple(declared.CATALOGUE)
"""All rows of the catalogue."""

FOUND: tuple[tuple[Fault, str], ...] = tuple(declared.FOUND)
"""Fault and kind of instance of each row of the detectors' result table."""
DEBOUNCE = np.array([fault.debounce for fault, _ in FOUND], dtype=np.int64)
"""(rows,) consecutive ticks before a fault counts."""
ACTIONS = np.array([int(fault.action) for fault, _ in FOUND], dtype=np.int64)
"""(rows,) action of the fault."""

REPORTS: dict[str, tuple[Fault, ...]] = {
    kind: tuple(fault for fault in TABLE if kind in fault.reports)
    for kind in dict.fromkeys(kind for fault in TABLE for kind in fault.reports)
}
"""Faults of each kind of report from a bus, the host or the recorder."""
