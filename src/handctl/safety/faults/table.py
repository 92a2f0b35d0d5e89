"""The fault table: what is detected, how long it may last, what is done, and who may clear it.

One row a fault (or a stage of one); the identifiers are those of the project's fault catalogue. A detector is a pure
function of one tick's ``Signals``. Debounce, latch and the choice of the action are in ``judge``; what a row needs to
know of the past is counted and filtered in ``watch``.
"""

from handctl.safety.faults.bus import BUS_FAULTS
from handctl.safety.faults.fault import Fault
from handctl.safety.faults.host import HOST_FAULTS
from handctl.safety.faults.node import NODE_FAULTS
from handctl.safety.faults.tendon import TENDON_FAULTS

TABLE: tuple[Fault, ...] = (*BUS_FAULTS, *NODE_FAULTS, *TENDON_FAULTS, *HOST_FAULTS)
"""All rows, in the order of the catalogue."""
BY_ID = {fault.id: fault for fault in TABLE}
