"""Detectors of host faults, rows H01 to H03, I07 and I11 of the fault catalogue, see ``safety.faults.host``."""

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import is_target_stream_running
from handctl.core.detectors.bus_faults import EvidenceTable
from handctl.core.state_block import StateTables
from handctl.safety.faults.host import (
    H01_LATE_TICK,
    H02_MISSED_TICK,
    H03_STALLED_HOST,
    I07A_REFUSED_REQUEST,
    I07B_MALFORMED_REQUESTS,
    I11A_MISSING_TARGETS,
    I11B_ENDED_STREAM,
    LATE_TICK_FRACTION,
    REFUSED_REQUESTS_LIMIT,
)


@kernel_helper
def detect_host_faults(
    x: StateTables, c: ConstantTables, is_armed: bool, evidence: EvidenceTable
) -> None:
    """Run the detectors of host faults, and write their results into the evidence table."""
    # Delay of the start of the tick, as a fraction of the control period.
    lateness_in_periods = x.run_int[s.TICK_DELAY_NS] / c.run_int[h.CONTROL_PERIOD_NS]
    missed_ticks = x.run_int[s.MISSED_TICKS]
    if lateness_in_periods > LATE_TICK_FRACTION:
        evidence[H01_LATE_TICK, 0] = lateness_in_periods
    if missed_ticks >= 1:
        evidence[H02_MISSED_TICK, 0] = missed_ticks
    if is_armed and missed_ticks >= c.run_int[h.STALLED_TICKS]:
        evidence[H03_STALLED_HOST, 0] = missed_ticks
    if is_armed and x.run_int[s.REFUSED_REQUESTS_IN_TICK]:
        evidence[I07A_REFUSED_REQUEST, 0] = x.run_int[s.REFUSED_REQUESTS_IN_TICK]
        if x.run_int[s.REFUSED_REQUESTS] >= REFUSED_REQUESTS_LIMIT:
            evidence[I07B_MALFORMED_REQUESTS, 0] = x.run_int[s.REFUSED_REQUESTS]
    if is_armed and is_target_stream_running(x):
        silence_ns = x.run_int[s.TICK_TIME_NS] - x.run_int[s.STREAM_SENT_NS]
        if silence_ns > c.run_int[h.STREAM_HOLD_DELAY_NS]:
            evidence[I11A_MISSING_TARGETS, 0] = silence_ns / 1e9
        if silence_ns > c.run_int[h.STREAM_RELAX_DELAY_NS]:
            evidence[I11B_ENDED_STREAM, 0] = silence_ns / 1e9
