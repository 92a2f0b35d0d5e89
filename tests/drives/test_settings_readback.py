"""Test how the settings of a drive are written and read back.

The procedure of writing and reading back is the same for all drive protocols.
"""

import pytest

from handctl.drives import readback
from handctl.drives.readback import REQUEST_TIMEOUT_NS, REQUEST_TRIES, ReadbackCursor


def test_a_request_is_repeated_when_its_answer_is_overdue_and_not_for_ever() -> None:
    cursor, sent_ns = ReadbackCursor(), list[int]()
    for t_ns in range(0, 2 * REQUEST_TRIES * REQUEST_TIMEOUT_NS, REQUEST_TIMEOUT_NS // 4):
        cursor, send, problem = readback.request_setting(cursor, "setting 1", t_ns)
        sent_ns += [t_ns] * send
        if problem:
            break
    assert problem == "setting 1 is not answered"
    assert not send
    assert sent_ns == [i * REQUEST_TIMEOUT_NS for i in range(REQUEST_TRIES)]


def test_each_setting_has_its_own_tries() -> None:
    cursor, send, _ = readback.request_setting(ReadbackCursor(), "first", 0)
    assert send
    assert cursor.next_setting() == ReadbackCursor(1)
    assert readback.request_setting(cursor.next_setting(), "second", 1)[1], "at once"


@pytest.mark.parametrize("lost_writes", [0, 1, 3])
def test_wrong_setting_is_written_and_read_again(lost_writes: int) -> None:
    cursor = ReadbackCursor(2, sent_ns=5, tries=1)
    for number in range(lost_writes):
        cursor, problem = readback.cursor_after_wrong_value(cursor, "limit", "3", "4", lost_writes)
        assert (cursor, problem) == (ReadbackCursor(2, must_write=True, write_count=number), "")
        cursor = cursor.cursor_after_write()
        assert cursor == ReadbackCursor(2, write_count=number + 1)
        cursor, send, _ = readback.request_setting(cursor, "limit", 7)
        assert send
    cursor_after, problem = readback.cursor_after_wrong_value(
        cursor, "limit", "3", "4", lost_writes
    )
    assert cursor_after == cursor
    assert problem == f"limit reads 3{' after writing' if lost_writes else ''}, expected 4"


def test_a_setting_that_is_read_again_while_enabled() -> None:
    check, problem = readback.cursor_after_recheck_request(
        readback.first_recheck(1, 0), "limit", 1, readback.RECHECK_PERIOD_NS
    )
    assert (check.is_waiting, check.tries, problem) == (True, 1, "")
    good, problem = readback.cursor_after_recheck_reply(check, 2, True, "limit", "reads 4", "4")
    assert (good.step, good.is_waiting, good.tries, problem) == (1, False, 0, "")
    lost, problem = readback.cursor_after_recheck_reply(check, 2, False, "limit", "reads 3", "4")
    assert lost == readback.RecheckCursor()
    assert problem == "limit reads 3 while enabled, expected 4: settings are lost"
    for _ in range(readback.RECHECK_TRIES - 1):
        check, problem = readback.cursor_after_recheck_request(
            check, "limit", 1, readback.RECHECK_PERIOD_NS
        )
    assert problem == "limit is not answered while enabled"
