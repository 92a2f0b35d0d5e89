"""Counts of lost frames, malformed frames and frames with unknown identifiers.

Each node has one bit for each recent tick, see ``shift_tick_bits``. A bit is 1 if a frame of the
node was lost in the tick of the bit. A further integer of each node has a bit of 1 for each tick in
which the node sent a malformed frame.
"""

from typing import Any

from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.state_block import StateTables
from handctl.safety.faults.bus import LOSS_WINDOW_TICKS, MALFORMED_WINDOW_TICKS
from handctl.safety.faults.node import HALF_RATE_LOSS_COUNT

TICKS_OVERDUE_BEFORE_FIRST_READING = 1_000_000
"""Assumed age of the last reading of a node that has not sent a reading yet [ticks]."""
BITS_PER_WORD = LOSS_WINDOW_TICKS // 2
"""Number of used bits in each of the two integers with one bit for each tick."""
WORD_MASK = (1 << BITS_PER_WORD) - 1
"""Mask of the used bits of an integer."""
OLDEST_BIT = 1 << BITS_PER_WORD - 1
"""Bit of the oldest tick, in the second integer."""
MALFORMED_WINDOW_MASK = (1 << MALFORMED_WINDOW_TICKS) - 1
"""Mask of the bits that belong to the last ``MALFORMED_WINDOW_TICKS`` ticks."""


@kernel_helper
def shift_tick_bits(table: NDArray[Any], row: int, column: int, ticks: int) -> None:
    """Shift the bits of a column by some ticks, and set the bits of the new ticks to 0.

    The bits are in two integers: one bit for each of the last ``BITS_PER_WORD`` ticks, and one bit
    for each of the ``BITS_PER_WORD`` ticks before. Bit 0 belongs to the newest tick. The bits of
    older ticks are lost.

    Args:
        table: (rows, columns) table of integers, modified in place.
        row: row of the first integer.
        column: column of both integers.
        ticks: number of new ticks.
    """
    for _ in range(min(ticks, LOSS_WINDOW_TICKS)):
        recent_bits = table[row, column]
        table[row + 1, column] = (
            table[row + 1, column] << 1 | recent_bits >> (BITS_PER_WORD - 1)
        ) & WORD_MASK
        table[row, column] = recent_bits << 1 & WORD_MASK


@kernel_helper
def count_set_bits(bits: int) -> int:
    """Return the number of 1 bits in an integer."""
    number = 0
    while bits:
        # The AND operation clears the lowest bit that is 1.
        bits &= bits - 1
        number += 1
    return number


@kernel_helper
def count_marked_ticks(table: NDArray[Any], row: int, column: int) -> int:
    """Return the number of ticks whose bit is 1, in the integers of rows ``row`` and ``row + 1``."""
    return count_set_bits(table[row, column]) + count_set_bits(table[row + 1, column])


@kernel_helper
def ticks_overdue(now_ns: int, last_reading_ns: int, send_period_ns: int, period_ns: int) -> int:
    """Return the number of whole ticks by which a reading of a node is overdue.

    A reading from the last control period is not overdue.

    Args:
        now_ns: time of the tick [ns].
        last_reading_ns: time of the latest reading [ns], -1 before the first reading.
        send_period_ns: period in which the node sends readings without a request [ns], or 0 if every
            tick requests a reading.
        period_ns: control period [ns].
    """
    if last_reading_ns < 0:
        return TICKS_OVERDUE_BEFORE_FIRST_READING
    return max((now_ns - send_period_ns - last_reading_ns) // period_ns, 0)


@kernel_helper
def motor_ticks_overdue(x: StateTables, c: ConstantTables, n: int, now_ns: int) -> int:
    """Return the number of ticks by which the feedback of motor n is overdue."""
    return ticks_overdue(
        now_ns,
        x.tendon_int[s.FEEDBACK_RECEIVED_NS, n],
        c.tendon_int[h.CYCLIC_FEEDBACK_PERIOD_NS, n],
        c.run_int[h.CONTROL_PERIOD_NS],
    )


@kernel_helper
def cell_ticks_overdue(x: StateTables, c: ConstantTables, n: int, now_ns: int) -> int:
    """Return the number of ticks by which the load-cell reading of a tendon is overdue.

    For a tendon without a load cell, the latest load-cell frame of the sensor node is used. The
    result is 0 in a hand without load cells.
    """
    cell_group = c.tendon_int[h.CELL_GROUP, n]
    last_reading_ns = -1
    for g in range(c.run_int[h.TENSION_GROUP_COUNT]):
        if g == cell_group or cell_group < 0:
            last_reading_ns = max(last_reading_ns, x.group_int[s.GROUP_RECEIVED_NS, g])
    if c.run_int[h.TENSION_GROUP_COUNT] == 0:
        return 0
    return ticks_overdue(now_ns, last_reading_ns, 0, c.run_int[h.CONTROL_PERIOD_NS])


@kernel_helper
def update_loss_counts(
    x: StateTables,
    c: ConstantTables,
    now_ns: int,
    unknown_frame_count: int,
    count_missing_replies: bool,
) -> None:
    """Update the counts of lost frames, malformed frames and unknown frames of all nodes.

    Args:
        x: state tables.
        c: constants of the hand.
        now_ns: time of the tick [ns].
        unknown_frame_count: number of frames with unknown identifiers in the tick.
        count_missing_replies: True to count missing replies. Missing replies are counted if the
            motors are allowed to make torque and the host missed no tick.
    """
    tendons = x.tendon.shape[1]
    for node in range(tendons + 1):
        is_late = False
        if node < tendons:
            is_late = motor_ticks_overdue(x, c, node, now_ns) > 0
        else:
            for n in range(tendons):
                is_late |= cell_ticks_overdue(x, c, n, now_ns) > 0
        shift_tick_bits(x.node_int, s.LOST_REPLY_BITS, node, 1)
        x.node_int[s.LOST_REPLY_BITS, node] |= is_late and count_missing_replies
        is_malformed = x.node_int[s.HAS_MALFORMED_FRAME, node] != 0
        x.node_int[s.MALFORMED_FRAME_TICKS, node] = (
            x.node_int[s.MALFORMED_FRAME_TICKS, node] << 1 | is_malformed
        ) & MALFORMED_WINDOW_MASK
    # The count of unknown frames decays with a time constant of 1 s. A small count of unknown
    # frames is set to 0, so that the stored value becomes constant.
    decayed_rate = (
        x.run[s.UNKNOWN_FRAME_RATE] * (1.0 - c.run[h.CONTROL_PERIOD]) + unknown_frame_count
    )
    x.run[s.UNKNOWN_FRAME_RATE] = decayed_rate if decayed_rate > 1e-3 else 0.0


@kernel_helper
def count_lost_replies(x: StateTables, node: int) -> int:
    """Return the number of ticks without a reply of a node among the last ``LOSS_WINDOW_TICKS`` ticks."""
    return count_marked_ticks(x.node_int, s.LOST_REPLY_BITS, node)


@kernel_helper
def misses_every_second_reply(x: StateTables, node: int) -> bool:
    """Return True if about every second reply of a node is missing.

    The function tests the replies of the last ``MALFORMED_WINDOW_TICKS`` ticks. If every second
    reply is missing, the window contains at most one pair of consecutive missing replies.
    """
    recent_losses = x.node_int[s.LOST_REPLY_BITS, node] & MALFORMED_WINDOW_MASK
    # The integer of lost frames is combined by AND with the same integer, shifted by one bit. The
    # result of the AND operation has a bit of 1 for each pair of consecutive missing replies.
    return (
        count_set_bits(recent_losses) >= HALF_RATE_LOSS_COUNT
        and count_set_bits(recent_losses & recent_losses >> 1) <= 1
    )
