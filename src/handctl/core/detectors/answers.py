"""Answers that a motor still owes: a late one is no second one, whenever it comes and however it is stamped.

Every tick of the host asks each motor one question. An answer too few was lost, or comes later together with others, or
all answers come a tick late for as long as a machine is busy: nothing tells which, so a question stays open until it is
answered or ``WINDOW`` ticks old; the last one for ever. What comes beyond all open questions is a duplicate, or another
node.
"""

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.safety.faults.bus import WINDOW

QUESTIONS = 8
"""Questions that stay open: a node that says nothing for longer is silent, and all that it owed is lost."""
READY = 2


@inner
def answered(x: Tables, c: ConstantTables) -> bool:
    """Close the newest question for each answer of this tick, so that one that was lost grows old.

    Returns:
        whether a node answered more often than it was asked. ``SURPLUS`` is then one more than the questions that were
        open, 0 for other motors.
    """
    found = False
    for n in range(x.tendon.shape[1]):
        came, asked = x.tendon_int[s.ANSWERED, n], x.tendon_int[s.OPEN_QUESTIONS, n]
        x.tendon_int[s.SURPLUS, n] = 0
        if came > asked and c.tendon_int[h.ANSWERS_ONCE, n]:
            x.tendon_int[s.SURPLUS, n] = 1 + asked
            found = True
        x.tendon_int[s.OPEN_QUESTIONS, n] = max(asked - came, 0)
    for g in range(x.group_int.shape[1]):
        found |= x.group_int[s.GROUP_ANSWERED, g] > 1
    return found


@inner
def ask(x: Tables, k: int) -> None:
    """Note one question more to every motor in tick k.

    Of a motor that did not answer every question so far, because it was not ready, only the new one is open.
    """
    for n in range(x.tendon.shape[1]):
        count = x.tendon_int[s.OPEN_QUESTIONS, n]
        if x.tendon_int[s.PHASE_BEFORE, n] < READY:
            count = 0
        kept = 0
        for i in range(max(count - QUESTIONS + 1, 0), count):
            asked = x.tendon_int[s.QUESTION + i, n]
            if i == count - 1 or k - asked < WINDOW:
                x.tendon_int[s.QUESTION + kept, n] = asked
                kept += 1
        x.tendon_int[s.QUESTION + kept, n] = k
        x.tendon_int[s.OPEN_QUESTIONS, n] = kept + 1
