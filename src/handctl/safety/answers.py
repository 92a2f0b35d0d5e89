"""Answers that a node still owes: a late one is no second one, whenever it comes and however it is stamped.

Every tick of the host asks each node one question. An answer too few was lost, or comes later together with others, or
all answers come a tick late for as long as a machine is busy: nothing tells which, so one question stays open until it
is answered, and more of them for a while. What comes beyond all open questions is a duplicate, or another node.
"""

from collections.abc import Sequence

from handctl.safety.counts import WINDOW

Owed = tuple[int, ...]
MOST = 8
"""Questions that stay open: a node that says nothing for longer is silent, and all that it owed is lost."""


def asked(owed: Owed, answering: Sequence[bool], k: int) -> Owed:
    """One question more to every node.

    Args:
        owed: open questions.
        answering: per node, whether it answered every question so far; of others only the new one is open.
        k: number of the tick; of several open questions one is given up in every ``WINDOW``.
    """
    given_up = not k % WINDOW
    rows = zip(owed, answering, strict=True)
    return tuple([min(old - (given_up and old > 1), MOST - 1) + 1 if able else 1 for old, able in rows])


def answered(owed: Owed, answers: list[int]) -> tuple[Owed, list[int]]:
    """One tick's answers.

    Args:
        owed: open questions.
        answers: per node, how many came.

    Returns:
        what is still open, and the indices of the nodes that answered more often than they were asked.
    """
    n = len(owed)
    if owed == (1,) * n and answers == [1] * n:  # nearly always: one question, one answer
        return (0,) * n, []
    rows = list(zip(owed, answers, strict=True))
    return tuple([max(0, old - new) for old, new in rows]), [i for i, (old, new) in enumerate(rows) if new > old]
