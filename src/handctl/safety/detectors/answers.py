"""Answers that a node still owes: a late one is no second one, whenever it comes and however it is stamped.

Every tick of the host asks each node one question. An answer too few was lost, or comes later together with others, or
all answers come a tick late for as long as a machine is busy: nothing tells which, so a question stays open until it is
answered or ``WINDOW`` ticks old; the last one for ever. What comes beyond all open questions is a duplicate, or another
node.
"""

from collections.abc import Sequence

from handctl.safety.detectors.counts import WINDOW

Owed = tuple[tuple[int, ...], ...]
"""Per node, the ticks whose questions are open, the oldest first."""
MOST = 8
"""Questions that stay open: a node that says nothing for longer is silent, and all that it owed is lost."""


def asked(owed: Owed, answering: Sequence[bool], k: int) -> Owed:
    """One question more to every node.

    Args:
        owed: open questions.
        answering: per node, whether it answered every question so far; of others only the new one is open.
        k: number of the tick, in which they are asked.
    """
    new, rows = (k,), zip(owed, answering, strict=True)
    return tuple([(_kept(old, k) if able else ()) + new if old else new for old, able in rows])


def _kept(old: tuple[int, ...], k: int) -> tuple[int, ...]:
    """What stays open beside a new question: the last of the old ones, and those before it that are not too old."""
    *earlier, last = old[-MOST + 1 :]
    return (*[then for then in earlier if k - then < WINDOW], last)


def answered(owed: Owed, answers: list[int]) -> tuple[Owed, list[int]]:
    """One tick's answers; each closes the newest question, so that one that was lost grows old.

    Args:
        owed: open questions.
        answers: per node, how many came.

    Returns:
        what is still open, and the indices of the nodes that answered more often than they were asked.
    """
    rows = list(zip(owed, answers, strict=True))
    still = tuple([old[:-new] if new else old for old, new in rows])
    return still, [i for i, (old, new) in enumerate(rows) if new > len(old)]
