"""Detectors of rows B01 to B17, see ``safety.faults.bus``."""

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.detectors.losses import lost, motor_age, ones
from handctl.safety.faults.bus import (
    B01,
    B02,
    B03A,
    B03B,
    B04,
    B05,
    B06,
    B07,
    B08,
    B09,
    B10,
    B11A,
    B11B,
    B17,
    LOST_MANY,
    LOST_SOME,
    MISSHAPEN_LIMIT,
    UNKNOWN_LIMIT,
)

Found = NDArray[np.float64]
"""Result table (faults, instances): evidence of each fault, NaN where the fault is absent."""


@inner
def detect(x: Tables, c: ConstantTables, armed: bool, found: Found) -> None:
    """Write the findings of the module's rows."""
    if x.run[s.UNKNOWN] > UNKNOWN_LIMIT:
        found[B10, 0] = x.run[s.UNKNOWN]
    if not armed:
        return
    _answers(x, c, found)
    _losses(x, found)
    _shapes(x, found)
    if x.run_int[s.STALE_NOW] == 1:
        found[B04, 0] = 0.0
    if x.run_int[s.STALE_NOW] == 2:
        found[B07, 0] = 1.0
    frames = x.run_int[s.FRAMES]
    if frames > c.run_int[h.FRAMES_LIMIT] * (1 + x.run_int[s.MISSED]):
        found[B11A, 0] = found[B11B, 0] = frames


@inner
def _answers(x: Tables, c: ConstantTables, found: Found) -> None:
    """Find overdue feedback. Ticks missed by this host had no request."""
    youngest = motor_age(x, c, 0, x.run_int[s.T_NS])
    for n in range(x.tendon.shape[1]):
        youngest = min(youngest, motor_age(x, c, n, x.run_int[s.T_NS]))
    for n in range(x.tendon.shape[1]):
        age = motor_age(x, c, n, x.run_int[s.T_NS])
        if age > x.run_int[s.MISSED]:
            found[B01, n] = age
        if age >= c.run_int[h.SILENT_TICKS]:
            found[B02, n] = age
        if age >= c.run_int[h.ONE_SILENT_TICKS] and youngest == 0:
            found[B17, n] = age


@inner
def _losses(x: Tables, found: Found) -> None:
    """Find lost and halved replies."""
    for node in range(x.node_int.shape[1]):
        number = lost(x, node)
        if number > LOST_SOME:
            found[B03A, node] = number
        if number > LOST_MANY:
            found[B03B, node] = number


@inner
def _shapes(x: Tables, found: Found) -> None:
    """Find malformed frames, duplicate and stale replies."""
    for node in range(x.node_int.shape[1]):
        if x.node_int[s.MISSHAPEN, node] & 1:
            number = ones(x.node_int[s.MISSHAPEN, node])
            found[B09, node] = number
            if number >= MISSHAPEN_LIMIT:
                found[B08, node] = number
        if x.node_int[s.TWICE, node] == 1:
            found[B05, node] = 0.0
        if x.node_int[s.TWICE, node] == 2:
            found[B06, node] = 1.0
