"""Requests to motors that have not been answered yet.

A late reply answers an old request, so a late reply is not counted as a duplicate.

The host sends a request to each motor in every tick. A missing reply is either lost, or comes later
together with other replies. On a busy computer, all replies can come a tick late. The host cannot
distinguish a lost reply from a late reply, so a request stays outstanding until its reply comes,
but at most for ``LOSS_WINDOW_TICKS`` ticks. The last request to a motor stays outstanding without a
time limit. If there are more replies than outstanding requests, at least one reply is a duplicate
or comes from another node.
"""

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.state_block import StateTables
from handctl.drives.contract import DrivePhase
from handctl.safety.faults.bus import LOSS_WINDOW_TICKS

MAX_OUTSTANDING_REQUESTS = 8
"""Largest number of outstanding requests of a motor.

A motor with more outstanding requests than ``MAX_OUTSTANDING_REQUESTS`` is silent, and its oldest
requests are dropped.
"""
READY_PHASE = int(DrivePhase.READY)
"""Value of ``drives.contract.DrivePhase.READY``."""


@kernel_helper
def close_answered_requests(x: StateTables, c: ConstantTables) -> bool:
    """Close the newest open request for each reply of the present tick.

    If a reply is lost, its request stays open.

    Returns:
        True if a motor or the sensor node sent more replies than it had open requests. For a motor
        that sent too many replies, ``EXCESS_REPLY_COUNT`` is set to the number of its open requests
        plus 1. For all other motors, ``EXCESS_REPLY_COUNT`` is set to 0.
    """
    has_excess_replies = False
    for n in range(x.tendon.shape[1]):
        replies = x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n]
        open_request_count = x.tendon_int[s.OUTSTANDING_REQUEST_COUNT, n]
        x.tendon_int[s.EXCESS_REPLY_COUNT, n] = 0
        if replies > open_request_count and c.tendon_int[h.HAS_SINGLE_ANSWER, n]:
            x.tendon_int[s.EXCESS_REPLY_COUNT, n] = 1 + open_request_count
            has_excess_replies = True
        x.tendon_int[s.OUTSTANDING_REQUEST_COUNT, n] = max(open_request_count - replies, 0)
    for g in range(x.group_int.shape[1]):
        has_excess_replies |= x.group_int[s.GROUP_FRAME_COUNT_IN_TICK, g] > 1
    return has_excess_replies


@kernel_helper
def add_requests(x: StateTables, k: int) -> None:
    """Record that the host sends a request to every motor in tick k.

    A motor that was not ready before tick k does not answer older requests, so only its new request
    is open.
    """
    for n in range(x.tendon.shape[1]):
        count = x.tendon_int[s.OUTSTANDING_REQUEST_COUNT, n]
        if x.tendon_int[s.LAST_DRIVE_PHASE, n] < READY_PHASE:
            count = 0
        remaining = 0
        # At most MAX_OUTSTANDING_REQUESTS - 1 old requests are kept, so that the new request can be
        # stored.
        for i in range(max(count - MAX_OUTSTANDING_REQUESTS + 1, 0), count):
            request_tick = x.tendon_int[s.OUTSTANDING_REQUEST_TICKS + i, n]
            if i == count - 1 or k - request_tick < LOSS_WINDOW_TICKS:
                x.tendon_int[s.OUTSTANDING_REQUEST_TICKS + remaining, n] = request_tick
                remaining += 1
        x.tendon_int[s.OUTSTANDING_REQUEST_TICKS + remaining, n] = k
        x.tendon_int[s.OUTSTANDING_REQUEST_COUNT, n] = remaining + 1
