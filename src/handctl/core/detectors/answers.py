"""Outstanding requests of motors. A late reply is matched to an old request, so it does not count as a duplicate.

The host sends a request to each motor in every tick. A missing reply may be lost. It may also come
later together with other replies, or all replies come a tick late because a machine is busy. These
cases cannot be distinguished at first, so a request stays outstanding until its reply, or for
``WINDOW`` ticks. The last request stays outstanding without a limit. A reply beyond all outstanding
requests is a duplicate, or comes from another node.
"""

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.safety.faults.bus import WINDOW

MAX_REQUESTS = 8
"""Largest number of outstanding requests. A node with more of them is silent, and its older requests are lost."""
PHASE_READY = 2
"""Number of ``drives.contract.Phase.READY``."""


@inner
def close_answered_requests(x: Tables, c: ConstantTables) -> bool:
    """Close the newest outstanding request for each reply of the tick. The request of a lost reply stays open.

    Returns:
        True if a node sent more replies than it had outstanding requests. ``EXCESS_REPLIES`` of
        such a motor is the number of outstanding requests plus 1. It is 0 for all other motors.
    """
    any_excess = False
    for n in range(x.tendon.shape[1]):
        replies = x.tendon_int[s.FEEDBACKS_NOW, n]
        outstanding = x.tendon_int[s.OUTSTANDING_REQUESTS, n]
        x.tendon_int[s.EXCESS_REPLIES, n] = 0
        if replies > outstanding and c.tendon_int[h.ANSWERS_ONCE, n]:
            x.tendon_int[s.EXCESS_REPLIES, n] = 1 + outstanding
            any_excess = True
        x.tendon_int[s.OUTSTANDING_REQUESTS, n] = max(outstanding - replies, 0)
    for g in range(x.group_int.shape[1]):
        any_excess |= x.group_int[s.GROUP_FRAMES_NOW, g] > 1
    return any_excess


@inner
def add_requests(x: Tables, k: int) -> None:
    """Add an outstanding request for every motor in tick k.

    A motor that was not ready before this tick does not answer older requests. Only the new request
    is outstanding then.
    """
    for n in range(x.tendon.shape[1]):
        count = x.tendon_int[s.OUTSTANDING_REQUESTS, n]
        if x.tendon_int[s.PHASE_BEFORE, n] < PHASE_READY:
            count = 0
        remaining = 0
        # Keep at most MAX_REQUESTS - 1 old requests, to leave a place for the new one.
        for i in range(max(count - MAX_REQUESTS + 1, 0), count):
            outstanding = x.tendon_int[s.REQUEST_TICKS + i, n]
            if i == count - 1 or k - outstanding < WINDOW:
                x.tendon_int[s.REQUEST_TICKS + remaining, n] = outstanding
                remaining += 1
        x.tendon_int[s.REQUEST_TICKS + remaining, n] = k
        x.tendon_int[s.OUTSTANDING_REQUESTS, n] = remaining + 1
