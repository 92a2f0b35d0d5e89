"""Count losses, misshapen and unknown frames over some time, in bits of the last ticks, the newest lowest."""

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.safety.faults.bus import SHORT, WINDOW
from handctl.safety.faults.node import HALVED_MISSES

NEVER = 1_000_000
"""Age of what never came [ticks]."""
HALF = WINDOW // 2
"""Bits in each of the two words of a window."""
HALF_MASK, SHORT_MASK = (1 << HALF) - 1, (1 << SHORT) - 1


@inner
def ticks_late(now_ns: int, heard_ns: int, cyclic_ns: int, period_ns: int) -> int:
    """Return by how many whole ticks a reading is overdue; one that came within the last period is on time.

    Args:
        now_ns: time of the tick. heard_ns: of the reading, -1 if there was none.
        cyclic_ns: how often it comes by itself, 0 if every tick asks for it. period_ns: of control. All in [ns].
    """
    if heard_ns < 0:
        return NEVER
    return max((now_ns - cyclic_ns - heard_ns) // period_ns, 0)


@inner
def motor_age(x: Tables, c: ConstantTables, n: int, now_ns: int) -> int:
    """Return by how many ticks a motor's feedback is overdue."""
    return ticks_late(now_ns, x.tendon_int[s.FEEDBACK_NS, n], c.tendon_int[h.CYCLIC_NS, n], c.run_int[h.PERIOD_NS])


@inner
def cell_age(x: Tables, c: ConstantTables, n: int, now_ns: int) -> int:
    """Return by how many ticks a load cell is overdue; a tendon without one is as the node's latest frame."""
    group, heard_ns = c.tendon_int[h.CELL_GROUP, n], -1
    for g in range(c.run_int[h.TENSION_GROUPS]):
        if g == group or group < 0:
            heard_ns = max(heard_ns, x.group_int[s.GROUP_NS, g])
    return ticks_late(now_ns, heard_ns, 0, c.run_int[h.PERIOD_NS])


@inner
def count(x: Tables, c: ConstantTables, now_ns: int, strange: int, judged: bool) -> None:
    """Take in one tick.

    Args:
        x: tables. c: constants. now_ns: time of the tick [ns].
        strange: frames of unknown identifiers in it.
        judged: whether a missing answer counts: torque may act, and no tick was missed.
    """
    tendons = x.tendon.shape[1]
    for node in range(tendons + 1):
        late = False
        if node < tendons:
            late = motor_age(x, c, node, now_ns) > 0
        else:
            for n in range(tendons):
                late |= cell_age(x, c, n, now_ns) > 0
        recent, earlier = x.node_int[s.LOST, node], x.node_int[s.LOST + 1, node]
        x.node_int[s.LOST + 1, node] = (earlier << 1 | recent >> (HALF - 1)) & HALF_MASK
        x.node_int[s.LOST, node] = (recent << 1 | (late and judged)) & HALF_MASK
        misread = x.node_int[s.MISREAD_NOW, node] != 0
        x.node_int[s.MISSHAPEN, node] = (x.node_int[s.MISSHAPEN, node] << 1 | misread) & SHORT_MASK
    leaked = x.run[s.UNKNOWN] * (1.0 - c.run[h.PERIOD]) + strange
    x.run[s.UNKNOWN] = leaked if leaked > 1e-3 else 0.0


@inner
def ones(bits: int) -> int:
    """Return the number of bits that are set."""
    number = 0
    while bits:
        bits &= bits - 1
        number += 1
    return number


@inner
def lost(x: Tables, node: int) -> int:
    """Return how many of the last ``WINDOW`` ticks had no answer."""
    return ones(x.node_int[s.LOST, node]) + ones(x.node_int[s.LOST + 1, node])


@inner
def halved(x: Tables, node: int) -> bool:
    """Return whether a node misses about every second of the last ``SHORT`` ticks, and at most once two in a row."""
    recent = x.node_int[s.LOST, node] & SHORT_MASK
    return ones(recent) >= HALVED_MISSES and ones(recent & recent >> 1) <= 1
