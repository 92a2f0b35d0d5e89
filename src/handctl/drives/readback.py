"""Settings of a drive: read, written where they are wrong, and read again, until all are as they must be.

This is the walk that all protocols share. A protocol adds the bytes of a request, and whether a reply is that of the
open request.

Limit and watchdog make a drive the first guard, and are read again while it is enabled. A drive whose processor
restarts within a few milliseconds may come back enabled, with the settings that were saved and without those that were
written before arming. Feedback does not show it. One setting per drive is read each half second, in turn, at an offset
that differs from drive to drive, so that no tick carries the requests of several.
"""

from typing import NamedTuple

REQUEST_TIMEOUT_NS = 20_000_000
REQUEST_TRIES = 10
RECHECK_NS = 500_000_000
"""Time between two requests to an enabled drive [ns]: 11 MIT motors at 200 Hz leave no room for more on a classical
bus."""
RECHECKS_PER_SECOND = 1e9 / RECHECK_NS
STAGGER_NS = 37_000_000
"""Offset between drives with consecutive node numbers [ns]; it and the period have no common factor in milliseconds."""
RECHECK_TRIES = 20
"""Requests in a row without an answer that count as a lost setting: on a bus that loses a fifth of all frames each way
this happens once in 10^9 periods."""


class Walk(NamedTuple):
    """How far a drive's settings are known.

    Attributes:
        step: index of the setting.
        writing: whether it is to be written next, because it was read and is wrong.
        written: how often it was written.
        sent_ns: when the open request was sent [ns]; -1 if none is.
        tries: how often.
    """

    step: int = 0
    writing: bool = False
    written: int = 0
    sent_ns: int = -1
    tries: int = 0

    @property
    def waiting(self) -> bool:
        """Whether an answer is awaited."""
        return self.sent_ns >= 0

    def right(self) -> "Walk":
        """Return the walk after a setting that is as it must be."""
        return Walk(self.step + 1)

    def wrote(self) -> "Walk":
        """Return the walk after the setting was written: it is read next."""
        return Walk(self.step, written=self.written + 1)


def due(walk: Walk, t_ns: int) -> bool:
    """Return whether a request is due: none is open, or it has been for too long."""
    return not walk.waiting or t_ns - walk.sent_ns >= REQUEST_TIMEOUT_NS


def sent(walk: Walk, t_ns: int) -> Walk:
    """Return the walk after a request at ``t_ns`` [ns]."""
    return walk._replace(sent_ns=t_ns, tries=walk.tries + 1)


def ask(walk: Walk, name: str, t_ns: int, tries: int = REQUEST_TRIES) -> tuple[Walk, bool, str]:
    """Judge whether the setting must be asked for, or written.

    Args:
        walk: so far; not beyond the last setting. name: of the setting. t_ns: now [ns].
        tries: requests after which a setting counts as not answered.

    Returns:
        the walk from here; whether to send the request; what is wrong, empty if nothing is.
    """
    if not due(walk, t_ns):
        return walk, False, ""
    if walk.tries >= tries:
        return walk, False, f"{name} is not answered"
    return sent(walk, t_ns), True, ""


def differs(walk: Walk, name: str, read: str, expected: str, writes: int) -> tuple[Walk, str]:
    """Have a setting that was read and is wrong written, ``writes`` times at most.

    Args:
        walk: so far. name: of the setting. read, expected: its values, for people. writes: how often.

    Returns:
        the walk from here, and what is wrong, empty if nothing is.
    """
    if walk.written < writes:
        return Walk(walk.step, writing=True, written=walk.written), ""
    after = " after writing" if walk.written else ""
    return walk, f"{name} reads {read}{after}, expected {expected}"


class Recheck(NamedTuple):
    """How far the settings of an enabled drive were read again.

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


def begin_recheck(node_id: int, t_ns: int) -> Recheck:
    """Return the state of a drive that is about to be enabled at ``t_ns`` [ns]."""
    return Recheck(due_ns=_next(node_id, t_ns))


def ask_again(check: Recheck, name: str, node_id: int, t_ns: int) -> tuple[Recheck, str]:
    """Return the state after a request to the enabled drive, and what is wrong, empty if nothing is.

    Args:
        check: so far. name: of the setting. node_id: of the drive. t_ns: now [ns].
    """
    check = check._replace(due_ns=_next(node_id, t_ns), waiting=True, tries=check.tries + 1)
    return check, f"{name} is not answered while enabled" if check.tries >= RECHECK_TRIES else ""


def take_again(check: Recheck, count: int, same: bool, name: str, says: str, expected: str) -> tuple[Recheck, str]:
    """Judge a setting that was read again while enabled; another value means that all may be lost.

    Args:
        check: so far. count: of the settings that are read again. same: whether it is as it must be.
        name: of the setting. says: what the drive says of it, such as ``reads 3``. expected: its value.

    Returns:
        the state from here, and what is wrong, empty if nothing is.
    """
    if same:
        return Recheck((check.step + 1) % count, check.due_ns), ""
    return Recheck(), f"{name} {says} while enabled, expected {expected}: settings are lost"


def _next(node_id: int, t_ns: int) -> int:
    """Return the next time at which it is this drive's turn [ns]."""
    offset = node_id * STAGGER_NS % RECHECK_NS
    return ((t_ns - offset) // RECHECK_NS + 1) * RECHECK_NS + offset
