"""Read-back of drive settings: read each setting, write it if it is wrong, and read it again.

All protocols share the ``Cursor``, the position in their list of settings. A protocol adds the
payload of each request, and recognises the reply to the open request.

The torque limit and the watchdog in the drive protect the hand even if the host fails. Therefore
both are read again while the drive is enabled. A drive may restart within a few milliseconds and be
enabled again. The drive then has its saved settings, but not the settings written by the host
before arming. Feedback does not show such a restart. Every half second one setting of each drive is
read, in turn. Each drive has its own time offset, so that no tick contains the requests of several
drives.
"""

from typing import NamedTuple

REQUEST_TIMEOUT_NS = 20_000_000
"""Time after which an open request is repeated [ns]."""
REQUEST_TRIES = 10
"""Number of unanswered requests for one setting after which the drive is in fault."""
RECHECK_NS = 500_000_000
"""Time between two requests to an enabled drive [ns].

A shorter time would overload a classical bus with 11 MIT motors at 200 Hz.
"""
RECHECKS_PER_SECOND = 1e9 / RECHECK_NS
"""Rate of requests to an enabled drive [1/s]."""
STAGGER_NS = 37_000_000
"""Offset between drives with consecutive node numbers [ns].

Offset and period in milliseconds have no common factor.
"""
RECHECK_TRIES = 20
"""Number of requests in a row without an answer after which the setting counts as lost.

On a bus that loses a fifth of the frames in each direction, 20 requests in a row stay unanswered
once in 10^9 periods.
"""


class Cursor(NamedTuple):
    """Position in the read-back of a drive's settings.

    Attributes:
        step: index of the present setting.
        writing: True if the next request writes, because the value read was wrong.
        written: number of writes of this setting so far.
        sent_ns: time of the open request [ns], -1 without an open request.
        tries: number of requests for this setting so far.
    """

    step: int = 0
    writing: bool = False
    written: int = 0
    sent_ns: int = -1
    tries: int = 0

    @property
    def waiting(self) -> bool:
        """Return True if a request has no answer yet."""
        return self.sent_ns >= 0

    def next_setting(self) -> "Cursor":
        """Return the cursor at the next setting, after the present one was verified."""
        return Cursor(self.step + 1)

    def after_write(self) -> "Cursor":
        """Return the cursor after a write request. The next request reads the setting back."""
        return Cursor(self.step, written=self.written + 1)


def is_request_due(cursor: Cursor, t_ns: int) -> bool:
    """Return True if no request waits for an answer, or if the open request timed out."""
    return not cursor.waiting or t_ns - cursor.sent_ns >= REQUEST_TIMEOUT_NS


def cursor_after_request(cursor: Cursor, t_ns: int) -> Cursor:
    """Return the cursor after a request was sent at ``t_ns`` [ns]."""
    return cursor._replace(sent_ns=t_ns, tries=cursor.tries + 1)


def request_setting(cursor: Cursor, name: str, t_ns: int, tries: int = REQUEST_TRIES) -> tuple[Cursor, bool, str]:
    """Decide whether a read or write request for the present setting is sent now.

    Args:
        cursor: cursor, not beyond the last setting.
        name: name of the setting.
        t_ns: time of the tick [ns].
        tries: number of requests after which the setting counts as not answered.

    Returns:
        the new cursor, True to send the request, and the problem in words, empty without a problem.
    """
    if not is_request_due(cursor, t_ns):
        return cursor, False, ""
    if cursor.tries >= tries:
        return cursor, False, f"{name} is not answered"
    return cursor_after_request(cursor, t_ns), True, ""


def on_wrong_value(cursor: Cursor, name: str, read: str, expected: str, writes: int) -> tuple[Cursor, str]:
    """Request a write of a setting whose value is wrong, at most ``writes`` times.

    Args:
        cursor: cursor.
        name: name of the setting.
        read: value read, as text.
        expected: required value, as text.
        writes: largest number of writes.

    Returns:
        the new cursor, and the problem in words, empty without a problem.
    """
    if cursor.written < writes:
        return Cursor(cursor.step, writing=True, written=cursor.written), ""
    after = " after writing" if cursor.written else ""
    return cursor, f"{name} reads {read}{after}, expected {expected}"


class Recheck(NamedTuple):
    """Position in the read-back that is repeated while a drive is enabled.

    Attributes:
        step: index of the next setting.
        due_ns: time of the next request [ns].
        waiting: True if a request is open.
        tries: number of requests in a row without an answer.
    """

    step: int = 0
    due_ns: int = 0
    waiting: bool = False
    tries: int = 0


def first_recheck(node_id: int, t_ns: int) -> Recheck:
    """Return the start of the repeated read-back for a drive that is enabled at ``t_ns`` [ns]."""
    return Recheck(due_ns=_next_slot_ns(node_id, t_ns))


def next_recheck(check: Recheck, name: str, node_id: int, t_ns: int) -> tuple[Recheck, str]:
    """Return the position after a request to the enabled drive, and the problem in words.

    Args:
        check: cursor.
        name: name of the setting.
        node_id: node number of the drive.
        t_ns: time of the tick [ns].
    """
    check = check._replace(due_ns=_next_slot_ns(node_id, t_ns), waiting=True, tries=check.tries + 1)
    return check, f"{name} is not answered while enabled" if check.tries >= RECHECK_TRIES else ""


def on_recheck_reply(
    check: Recheck, count: int, same: bool, name: str, answer: str, expected: str
) -> tuple[Recheck, str]:
    """Compare a setting, read again while the drive is enabled, with its required value.

    A wrong value means that the drive may have lost all its settings.

    Args:
        check: cursor.
        count: number of settings in the repeated read-back.
        same: True if the value is the required one.
        name: name of the setting.
        answer: answer of the drive in words, such as ``reads 3``.
        expected: required value, as text.

    Returns:
        the new cursor, and the problem in words, empty without a problem.
    """
    if same:
        return Recheck((check.step + 1) % count, check.due_ns), ""
    return Recheck(), f"{name} {answer} while enabled, expected {expected}: settings are lost"


def _next_slot_ns(node_id: int, t_ns: int) -> int:
    """Return the time of the next request, in the drive's own time slot [ns]."""
    offset = node_id * STAGGER_NS % RECHECK_NS
    return ((t_ns - offset) // RECHECK_NS + 1) * RECHECK_NS + offset
