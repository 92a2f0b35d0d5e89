"""Detectors of bus faults, rows B01 to B17 of the fault catalogue, see ``safety.faults.bus``."""

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.detectors.frame_losses import (
    count_lost_replies,
    count_set_bits,
    motor_ticks_overdue,
)
from handctl.core.state_block import StateTables
from handctl.safety.faults.bus import (
    FAULT_B01,
    FAULT_B02,
    FAULT_B03A,
    FAULT_B03B,
    FAULT_B04,
    FAULT_B05,
    FAULT_B06,
    FAULT_B07,
    FAULT_B08,
    FAULT_B09,
    FAULT_B10,
    FAULT_B11A,
    FAULT_B11B,
    FAULT_B17,
    LOST_FRAMES_FOR_HOLD,
    LOST_FRAMES_FOR_RELAX,
    MALFORMED_FRAMES_LIMIT,
    MAX_UNKNOWN_FRAMES_PER_S,
)

EvidenceTable = NDArray[np.float64]
"""Result table of all detectors, (faults, instances).

An element is a number that shows the fault, or NaN if the fault is absent.
"""


@kernel_helper
def detect_bus_faults(
    x: StateTables, c: ConstantTables, is_armed: bool, evidence: EvidenceTable
) -> None:
    """Run the detectors of bus faults, and write their results into the evidence table."""
    if x.run[s.UNKNOWN_FRAME_RATE] > MAX_UNKNOWN_FRAMES_PER_S:
        evidence[FAULT_B10, 0] = x.run[s.UNKNOWN_FRAME_RATE]
    if not is_armed:
        return
    _detect_overdue_feedback(x, c, evidence)
    _detect_lost_replies(x, evidence)
    _detect_bad_frames(x, evidence)
    if x.run_int[s.STALE_FRAME_STATE] == 1:
        evidence[FAULT_B04, 0] = 0.0
    if x.run_int[s.STALE_FRAME_STATE] == 2:
        evidence[FAULT_B07, 0] = 1.0
    frames = x.run_int[s.RECEIVED_FRAME_COUNT]
    if frames > c.run_int[h.MAX_FRAMES_PER_TICK] * (1 + x.run_int[s.MISSED_TICKS]):
        evidence[FAULT_B11A, 0] = evidence[FAULT_B11B, 0] = frames


@kernel_helper
def _detect_overdue_feedback(x: StateTables, c: ConstantTables, evidence: EvidenceTable) -> None:
    """Find motors whose feedback is overdue.

    In a tick that the host has missed, no feedback was requested. Missed ticks therefore do not
    cause the fault B01.
    """
    lowest_age = motor_ticks_overdue(x, c, 0, x.run_int[s.TICK_TIME_NS])
    for n in range(x.tendon.shape[1]):
        lowest_age = min(lowest_age, motor_ticks_overdue(x, c, n, x.run_int[s.TICK_TIME_NS]))
    for n in range(x.tendon.shape[1]):
        age = motor_ticks_overdue(x, c, n, x.run_int[s.TICK_TIME_NS])
        if age > x.run_int[s.MISSED_TICKS]:
            evidence[FAULT_B01, n] = age
        if age >= c.run_int[h.SILENT_TICKS]:
            evidence[FAULT_B02, n] = age
        if age >= c.run_int[h.SILENT_TICKS_OF_SINGLE_MOTOR] and lowest_age == 0:
            evidence[FAULT_B17, n] = age


@kernel_helper
def _detect_lost_replies(x: StateTables, evidence: EvidenceTable) -> None:
    """Find nodes with many missing replies."""
    for node in range(x.node_int.shape[1]):
        number = count_lost_replies(x, node)
        if number > LOST_FRAMES_FOR_HOLD:
            evidence[FAULT_B03A, node] = number
        if number > LOST_FRAMES_FOR_RELAX:
            evidence[FAULT_B03B, node] = number


@kernel_helper
def _detect_bad_frames(x: StateTables, evidence: EvidenceTable) -> None:
    """Find malformed frames, and duplicate replies with equal or different bytes."""
    for node in range(x.node_int.shape[1]):
        if x.node_int[s.MALFORMED_FRAME_TICKS, node] & 1:
            number = count_set_bits(x.node_int[s.MALFORMED_FRAME_TICKS, node])
            evidence[FAULT_B09, node] = number
            if number >= MALFORMED_FRAMES_LIMIT:
                evidence[FAULT_B08, node] = number
        if x.node_int[s.DUPLICATE_REPLIES, node] == 1:
            evidence[FAULT_B05, node] = 0.0
        if x.node_int[s.DUPLICATE_REPLIES, node] == 2:
            evidence[FAULT_B06, node] = 1.0
