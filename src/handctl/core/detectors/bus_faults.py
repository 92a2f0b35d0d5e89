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
    B01_MISSING_REPLY,
    B02_SILENT_MOTOR,
    B03A_LOST_REPLIES,
    B03B_MANY_LOST_REPLIES,
    B04_DELAYED_FRAME,
    B05_DUPLICATE_FRAME,
    B06_CONFLICTING_FRAMES,
    B07_WRONG_FRAME_ORDER,
    B08_CORRUPT_PAYLOADS,
    B09_MALFORMED_FRAME,
    B10_UNKNOWN_IDENTIFIERS,
    B11A_FLOODED_BUS,
    B11B_LASTING_FLOOD,
    B17_DEAF_NODES,
    LOST_FRAMES_FOR_HOLD,
    LOST_FRAMES_FOR_RELAX,
    MALFORMED_FRAMES_LIMIT,
    MAX_UNKNOWN_FRAMES_PER_S,
)

EvidenceTable = NDArray[np.float64]
"""Result table of all detectors, (faults, instances).

An element of the table is a number that shows the fault, or NaN if the fault is absent.
"""


@kernel_helper
def detect_bus_faults(
    x: StateTables, c: ConstantTables, is_armed: bool, evidence: EvidenceTable
) -> None:
    """Run the detectors of bus faults, and write their results into the evidence table."""
    if x.run[s.UNKNOWN_FRAME_RATE] > MAX_UNKNOWN_FRAMES_PER_S:
        evidence[B10_UNKNOWN_IDENTIFIERS, 0] = x.run[s.UNKNOWN_FRAME_RATE]
    if not is_armed:
        return
    _detect_overdue_feedback(x, c, evidence)
    _detect_lost_replies(x, evidence)
    _detect_bad_frames(x, evidence)
    if x.run_int[s.STALE_FRAME_STATE] == 1:
        evidence[B04_DELAYED_FRAME, 0] = 0.0
    if x.run_int[s.STALE_FRAME_STATE] == 2:
        evidence[B07_WRONG_FRAME_ORDER, 0] = 1.0
    frames = x.run_int[s.RECEIVED_FRAME_COUNT]
    if frames > c.run_int[h.MAX_FRAMES_PER_TICK] * (1 + x.run_int[s.MISSED_TICKS]):
        evidence[B11A_FLOODED_BUS, 0] = evidence[B11B_LASTING_FLOOD, 0] = frames


@kernel_helper
def _detect_overdue_feedback(x: StateTables, c: ConstantTables, evidence: EvidenceTable) -> None:
    """Find motors whose feedback is overdue.

    In a tick that the host has missed, the host requests no feedback, so missed ticks do not cause
    the fault B01.
    """
    min_ticks_overdue = motor_ticks_overdue(x, c, 0, x.run_int[s.TICK_TIME_NS])
    for n in range(x.tendon.shape[1]):
        min_ticks_overdue = min(
            min_ticks_overdue, motor_ticks_overdue(x, c, n, x.run_int[s.TICK_TIME_NS])
        )
    for n in range(x.tendon.shape[1]):
        ticks_overdue = motor_ticks_overdue(x, c, n, x.run_int[s.TICK_TIME_NS])
        if ticks_overdue > x.run_int[s.MISSED_TICKS]:
            evidence[B01_MISSING_REPLY, n] = ticks_overdue
        if ticks_overdue >= c.run_int[h.SILENT_TICKS]:
            evidence[B02_SILENT_MOTOR, n] = ticks_overdue
        if ticks_overdue >= c.run_int[h.SILENT_TICKS_OF_SINGLE_MOTOR] and min_ticks_overdue == 0:
            evidence[B17_DEAF_NODES, n] = ticks_overdue


@kernel_helper
def _detect_lost_replies(x: StateTables, evidence: EvidenceTable) -> None:
    """Find nodes with many missing replies."""
    for node in range(x.node_int.shape[1]):
        number = count_lost_replies(x, node)
        if number > LOST_FRAMES_FOR_HOLD:
            evidence[B03A_LOST_REPLIES, node] = number
        if number > LOST_FRAMES_FOR_RELAX:
            evidence[B03B_MANY_LOST_REPLIES, node] = number


@kernel_helper
def _detect_bad_frames(x: StateTables, evidence: EvidenceTable) -> None:
    """Find malformed frames, duplicate replies with equal bytes, and duplicate replies with different bytes."""
    for node in range(x.node_int.shape[1]):
        if x.node_int[s.MALFORMED_FRAME_TICKS, node] & 1:
            number = count_set_bits(x.node_int[s.MALFORMED_FRAME_TICKS, node])
            evidence[B09_MALFORMED_FRAME, node] = number
            if number >= MALFORMED_FRAMES_LIMIT:
                evidence[B08_CORRUPT_PAYLOADS, node] = number
        if x.node_int[s.DUPLICATE_REPLIES, node] == 1:
            evidence[B05_DUPLICATE_FRAME, node] = 0.0
        if x.node_int[s.DUPLICATE_REPLIES, node] == 2:
            evidence[B06_CONFLICTING_FRAMES, node] = 1.0
