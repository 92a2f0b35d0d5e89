"""Read-back of drive settings.

The host reads each setting of a drive. If a setting has a wrong value, the host writes the setting
and reads it again. All drive protocols share the ``ReadbackCursor``, which is a position in the
list of settings. For each protocol, separate code encodes the payload of a request, and recognises
the reply to the latest request.

The torque limit and the watchdog in the drive protect the hand even if the host fails. A drive can
restart within a few milliseconds, and can then be enabled again. After a restart, the drive has its
saved settings, and has lost the settings that the host wrote before arming. The feedback of a drive
does not show a restart. To detect a restart, the host reads one setting of each enabled drive every
half second, one setting after the other. The time of a request within the half second depends on
the node number, so that drives with different node numbers get their requests at different times.

If a setting needs only one frame for the request and one frame for the answer, the protocol
describes both frames as a ``SettingRecheck``. While the drive is steady, compiled code in
``core.wire.cyclic_frames`` sends the request and accepts a reply that contains the required value
of the setting. The state machine of the drive handles all other replies.
"""

from typing import NamedTuple

from handctl.drives.frame import Frame

REQUEST_TIMEOUT_NS = 20_000_000
"""Time after which the host repeats a request without an answer [ns]."""
REQUEST_TRIES = 10
"""Number of unanswered requests for one setting after which the drive is in fault."""
RECHECK_PERIOD_NS = 500_000_000
"""Time between two read-back requests to an enabled drive [ns].

With a shorter time, a hand of 11 MIT motors at 200 Hz would overload a classical bus.
"""
RECHECKS_PER_SECOND = 1e9 / RECHECK_PERIOD_NS
"""Rate of read-back requests to an enabled drive [1/s]."""
RECHECK_STAGGER_NS = 37_000_000
"""Time between the requests to two drives with consecutive node numbers [ns].

In milliseconds, ``RECHECK_STAGGER_NS`` and ``RECHECK_PERIOD_NS`` have no common factor.
"""
RECHECK_TRIES = 20
"""Number of consecutive requests without an answer after which a setting of an enabled drive counts as lost.

If a bus loses a fifth of the frames in each direction, 20 consecutive requests have no answer once
in 10^9 periods.
"""


class ReadbackCursor(NamedTuple):
    """Position in the read-back of a drive's settings.

    Attributes:
        step: index of the present setting.
        must_write: True if the next request writes the present setting, because the value in the
            drive was wrong.
        write_count: number of writes of the present setting.
        sent_ns: time at which the host sent the unanswered request [ns], -1 if every request has an
            answer.
        tries: number of requests for the present setting.
    """

    step: int = 0
    must_write: bool = False
    write_count: int = 0
    sent_ns: int = -1
    tries: int = 0

    @property
    def is_waiting(self) -> bool:
        """Return True if the latest request has no answer yet."""
        return self.sent_ns >= 0

    def next_setting(self) -> "ReadbackCursor":
        """Return the cursor at the next setting. The caller must have verified the setting at the present cursor."""
        return ReadbackCursor(self.step + 1)

    def cursor_after_write(self) -> "ReadbackCursor":
        """Return the cursor after a write request.

        The request that follows a write request reads the written setting.
        """
        return ReadbackCursor(self.step, write_count=self.write_count + 1)


def is_request_due(cursor: ReadbackCursor, t_ns: int) -> bool:
    """Return True if every request has an answer, or if the latest request has timed out."""
    return not cursor.is_waiting or t_ns - cursor.sent_ns >= REQUEST_TIMEOUT_NS


def cursor_after_request(cursor: ReadbackCursor, t_ns: int) -> ReadbackCursor:
    """Return the cursor after a request was sent at ``t_ns`` [ns]."""
    return cursor._replace(sent_ns=t_ns, tries=cursor.tries + 1)


def request_setting(
    cursor: ReadbackCursor, name: str, t_ns: int, max_attempts: int = REQUEST_TRIES
) -> tuple[ReadbackCursor, bool, str]:
    """Decide if the host must send a request to read or write the present setting in the present tick.

    Args:
        cursor: position in the settings, not beyond the last setting.
        name: name of the setting.
        t_ns: time of the tick [ns].
        max_attempts: number of requests without an answer after which the drive has a problem.

    Returns:
        the new cursor, True if the host must send the request, and the problem in words (an empty
        text without a problem).
    """
    if not is_request_due(cursor, t_ns):
        return cursor, False, ""
    if cursor.tries >= max_attempts:
        return cursor, False, f"{name} is not answered"
    return cursor_after_request(cursor, t_ns), True, ""


def cursor_after_wrong_value(
    cursor: ReadbackCursor, name: str, value_text: str, expected_text: str, max_write_count: int
) -> tuple[ReadbackCursor, str]:
    """Return the read-back cursor after the drive has reported a wrong value.

    The request that follows the read of a wrong value writes the setting. The host writes a setting
    at most ``max_write_count`` times.

    Args:
        cursor: position in the settings.
        name: name of the setting.
        value_text: value in the drive, as text.
        expected_text: required value, as text.
        max_write_count: largest number of times that the setting is written.

    Returns:
        The new position in the read-back, and the problem in words (empty if there is no problem).
    """
    if cursor.write_count < max_write_count:
        return ReadbackCursor(cursor.step, must_write=True, write_count=cursor.write_count), ""
    write_note = " after writing" if cursor.write_count else ""
    return cursor, f"{name} reads {value_text}{write_note}, expected {expected_text}"


class RecheckCursor(NamedTuple):
    """Position in the read-back that is repeated while a drive is enabled.

    Attributes:
        step: index of the next setting.
        due_ns: time of the next request [ns].
        tries: number of consecutive requests without an answer.
    """

    step: int = 0
    due_ns: int = 0
    tries: int = 0

    @property
    def is_waiting(self) -> bool:
        """Return True if the latest request has no answer yet."""
        return self.tries > 0


class SettingRecheck(NamedTuple):
    """Request and reply for a setting that is read again while the drive is enabled.

    Attributes:
        name: name of the setting.
        request: frame of the request.
        reply: frame of the reply with the required value, with at most 8 bytes of payload.
        key_byte_range: range of the payload bytes that identify the reply to the request, as first
            byte and byte after the last. The reply to another request differs in the identifying
            bytes.
        compared_byte_range: range of the payload bytes that are compared with the required reply,
            as first byte and byte after the last.
    """

    name: str
    request: Frame
    reply: Frame
    key_byte_range: tuple[int, int]
    compared_byte_range: tuple[int, int]


def first_recheck(node_id: int, t_ns: int) -> RecheckCursor:
    """Return the first cursor of the repeated read-back, for a drive that was enabled at ``t_ns`` [ns]."""
    return RecheckCursor(due_ns=_next_request_time_ns(node_id, t_ns))


def cursor_after_recheck_request(
    check: RecheckCursor, name: str, node_id: int, t_ns: int
) -> tuple[RecheckCursor, str]:
    """Return the cursor after a request to an enabled drive, and the text of a problem.

    The text is empty if no problem has occurred.

    Args:
        check: position in the repeated read-back.
        name: name of the setting.
        node_id: node number of the drive.
        t_ns: time of the tick [ns].
    """
    check = check._replace(due_ns=_next_request_time_ns(node_id, t_ns), tries=check.tries + 1)
    return check, f"{name} is not answered while enabled" if check.tries >= RECHECK_TRIES else ""


def cursor_after_recheck_reply(
    check: RecheckCursor, setting_count: int, is_equal: bool, name: str, answer: str, expected: str
) -> tuple[RecheckCursor, str]:
    """Return the cursor after the answer of an enabled drive, and the text of a problem.

    If a setting of an enabled drive is wrong, the drive may have lost all settings.

    Args:
        check: position in the repeated read-back.
        setting_count: number of settings in the repeated read-back.
        is_equal: True if the setting has the required value.
        name: name of the setting.
        answer: answer of the drive in words, such as ``reads 3``.
        expected: required value, as text.

    Returns:
        the new position in the read-back, and the problem in words (an empty text without a
        problem).
    """
    if is_equal:
        return RecheckCursor((check.step + 1) % setting_count, check.due_ns), ""
    return RecheckCursor(), f"{name} {answer} while enabled, expected {expected}: settings are lost"


def _next_request_time_ns(node_id: int, t_ns: int) -> int:
    """Return the time of the next read-back request to a drive [ns].

    The times depend on the node number, so that the requests to different drives are at different
    times.
    """
    offset = node_id * RECHECK_STAGGER_NS % RECHECK_PERIOD_NS
    return ((t_ns - offset) // RECHECK_PERIOD_NS + 1) * RECHECK_PERIOD_NS + offset
