"""Outstanding requests of motors. A late reply is matched to an old request, so it does not count as a duplicate.

The host sends a request to each motor in every tick. A missing reply was lost, or comes later
together with others, or all replies come a tick late while a machine is busy. These cases look
alike, so a request stays outstanding until a reply or for ``WINDOW`` ticks. The last request stays
outstanding without a limit. A reply beyond all outstanding requests is a duplicate, or comes from
another node.
"""

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.safety.faults.bus import WINDOW

MAX_REQUESTS = 8
"""Largest number of outstanding requests. A node without replies for longer is silent, and older requests are lost."""
PHASE_READY = 2


@inner
def close_answered_requests(x: Tables, c: ConstantTables) -> bool:
    """Close the newest outstanding request for each reply of the tick. A lost request stays open and grows old.

    Returns:
        True if a node sent more replies than requests. ``EXCESS_REPLIES`` is then the number of
            outstanding requests plus 1, and 0 for other motors.
    """
    any_excess = False
    for n in range(x.tendon.shape[1]):
        replies = x.tendon_int[s.ANSWERED, n]
        outstanding = x.tendon_int[s.OUTSTANDING, n]
        x.tendon_int[s.EXCESS_REPLIES, n] = 0
        if replies > outstanding and c.tendon_int[h.ANSWERS_ONCE, n]:
            x.tendon_int[s.EXCESS_REPLIES, n] = 1 + outstanding
            any_excess = True
        x.tendon_int[s.OUTSTANDING, n] = max(outstanding - replies, 0)
    for g in range(x.group_int.shape[1]):
        any_excess |= x.group_int[s.GROUP_ANSWERED, g] > 1
    return any_excess


@inner
def add_requests(x: Tables, k: int) -> None:
    """Add an outstanding request for every motor in tick k.

    A motor that was not ready may have left older requests without a reply. Only the new request is
    outstanding then.
    """
    for n in range(x.tendon.shape[1]):
        count = x.tendon_int[s.OUTSTANDING, n]
        if x.tendon_int[s.PHASE_BEFORE, n] < PHASE_READY:
            count = 0
        remaining = 0
        # Keep at most QUESTIONS - 1 old requests, to leave a place for the new one.
        for i in range(max(count - MAX_REQUESTS + 1, 0), count):
            outstanding = x.tendon_int[s.REQUEST_TICKS + i, n]
            if i == count - 1 or k - outstanding < WINDOW:
                x.tendon_int[s.REQUEST_TICKS + remaining, n] = outstanding
                remaining += 1
        x.tendon_int[s.REQUEST_TICKS + remaining, n] = k
        x.tendon_int[s.OUTSTANDING, n] = remaining + 1
