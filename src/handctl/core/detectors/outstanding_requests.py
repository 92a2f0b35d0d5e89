"""Requests to motors that have not been answered yet.

A late reply answers an old request, so a late reply is not counted as a duplicate.

The host sends a request to each motor in every tick. A missing reply is either lost, or comes later
together with other replies. On a busy computer, all replies can come a tick late. If a bus adapter
pauses, the replies of many ticks come together. The host cannot distinguish a lost reply from a late
reply, so a request stays outstanding until its reply comes, but at most for ``LOSS_WINDOW_TICKS``
ticks. The newest outstanding request of a motor stays outstanding without a time limit. If there are
more replies than outstanding requests, at least one reply is a duplicate or comes from another node.
"""

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.detectors.frame_losses import OLDEST_BIT, count_marked_ticks, shift_tick_bits
from handctl.core.state_block import StateTables
from handctl.drives.contract import DrivePhase

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
        open_request_count = count_marked_ticks(x.tendon_int, s.OPEN_REQUEST_BITS, n)
        x.tendon_int[s.EXCESS_REPLY_COUNT, n] = 0
        if replies > open_request_count and c.tendon_int[h.HAS_SINGLE_ANSWER, n]:
            x.tendon_int[s.EXCESS_REPLY_COUNT, n] = 1 + open_request_count
            has_excess_replies = True
        for _ in range(min(replies, open_request_count)):
            row = s.OPEN_REQUEST_BITS + (x.tendon_int[s.OPEN_REQUEST_BITS, n] == 0)
            bits = x.tendon_int[row, n]
            # The AND operation clears the lowest bit that is 1. It belongs to the newest tick.
            x.tendon_int[row, n] = bits & (bits - 1)
    for g in range(x.group_int.shape[1]):
        has_excess_replies |= x.group_int[s.GROUP_FRAME_COUNT_IN_TICK, g] > 1
    return has_excess_replies


@kernel_helper
def _has_open_request(x: StateTables, n: int) -> bool:
    """Return True if motor n has not answered at least one request."""
    recent_bits = x.tendon_int[s.OPEN_REQUEST_BITS, n]
    return bool((recent_bits | x.tendon_int[s.OPEN_REQUEST_BITS + 1, n]) != 0)


@kernel_helper
def add_requests(x: StateTables) -> None:
    """Record that the host sends a request to every motor in the present tick.

    A motor that was not ready before this tick does not answer older requests, so only its new
    request is open.
    """
    for n in range(x.tendon.shape[1]):
        if x.tendon_int[s.LAST_DRIVE_PHASE, n] < READY_PHASE:
            x.tendon_int[s.OPEN_REQUEST_BITS, n] = x.tendon_int[s.OPEN_REQUEST_BITS + 1, n] = 0
        had_open_request = _has_open_request(x, n)
        shift_tick_bits(x.tendon_int, s.OPEN_REQUEST_BITS, n, 1 + x.run_int[s.MISSED_TICKS])
        if had_open_request and not _has_open_request(x, n):
            x.tendon_int[s.OPEN_REQUEST_BITS + 1, n] = OLDEST_BIT
        x.tendon_int[s.OPEN_REQUEST_BITS, n] |= 1
