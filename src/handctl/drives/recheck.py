"""When to read the settings of an enabled drive again: limit and watchdog are what makes it the first guard.

A drive whose processor restarts within a few milliseconds may come back enabled, with the settings that were saved and
without those that were written before arming. Feedback does not show it. One setting per drive is read each half
second, in turn, at an offset that differs from drive to drive, so that no tick carries the requests of several.
"""

from typing import NamedTuple

PERIOD_NS = 500_000_000
"""Time between two requests to a drive [ns]: 11 MIT motors at 200 Hz leave no room for more on a classical bus."""
PER_SECOND = 1e9 / PERIOD_NS
STAGGER_NS = 37_000_000
"""Offset between drives with consecutive node numbers [ns]; it and the period have no common factor in milliseconds."""
TRIES = 20
"""Requests in a row without an answer that count as a lost setting: on a bus that loses a fifth of all frames each way
this happens once in 10^9 periods."""


class Recheck(NamedTuple):
    """How far the settings were read again.

    Attributes:
        step: index of the setting that is asked for next.
        due_ns: when [ns].
        waiting: whether an answer is awaited.
        tries: requests without an answer.
    """

    step: int = 0
    due_ns: int = 0
    waiting: bool = False
    tries: int = 0

    @property
    def unanswered(self) -> bool:
        """Whether the setting has been asked for too often in vain."""
        return self.tries >= TRIES


def begin(node_id: int, t_ns: int) -> Recheck:
    """Return the state of a drive that is about to be enabled at ``t_ns`` [ns]."""
    return Recheck(due_ns=_next(node_id, t_ns))


def asked(check: Recheck, node_id: int, t_ns: int) -> Recheck:
    """Return the state after a request at ``t_ns`` [ns]."""
    return check._replace(due_ns=_next(node_id, t_ns), waiting=True, tries=check.tries + 1)


def agreed(check: Recheck, count: int) -> Recheck:
    """Return the state after an answer that is as it must be; ``count``: how many settings there are."""
    return Recheck((check.step + 1) % count, check.due_ns)


def _next(node_id: int, t_ns: int) -> int:
    """Return the next time at which it is this drive's turn [ns]."""
    offset = node_id * STAGGER_NS % PERIOD_NS
    return ((t_ns - offset) // PERIOD_NS + 1) * PERIOD_NS + offset
