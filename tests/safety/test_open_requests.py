"""Test the record of requests that the drives have not answered yet.

A reply to an open request can be late, but it is no duplicate. A reply without any request is a
duplicate.
"""

import pytest

from handctl.core.detectors.frame_losses import BITS_PER_WORD
from handctl.core.detectors.outstanding_requests import add_requests, close_answered_requests
from handctl.drives.contract import DrivePhase
from handctl.safety.faults.bus import LOSS_WINDOW_TICKS
from tests.safety.synthetic_monitor import SyntheticMonitor, call_interpreted, synthetic_limits

RequestTicks = tuple[tuple[int, ...], ...]
LAST_TICK = 6
"""Last tick with a request before each test."""


class OpenRequests(SyntheticMonitor):
    """Record of the motors that have not yet replied to requests of earlier ticks."""

    def __init__(self, ticks_of_open_requests: RequestTicks) -> None:
        super().__init__(synthetic_limits(len(ticks_of_open_requests)))
        self.last_tick = LAST_TICK
        self.set_ticks_of_open_requests(ticks_of_open_requests)

    def set_ticks_of_open_requests(self, ticks_of_open_requests: RequestTicks) -> None:
        words: dict[tuple[int, int], int] = {}
        for n, ticks in enumerate(ticks_of_open_requests):
            bits = sum(1 << self.last_tick - k for k in ticks)
            words[0, n] = bits & (1 << BITS_PER_WORD) - 1
            words[1, n] = bits >> BITS_PER_WORD
        self.set_state_values({"open_requests": words})

    @property
    def outstanding_request_ticks(self) -> RequestTicks:
        """Return, for each motor, the ticks of the requests that have no reply yet."""
        words = self.view("open_requests").reshape(2, -1).tolist()
        return tuple(
            tuple(
                self.last_tick - age
                for age in reversed(range(LOSS_WINDOW_TICKS))
                if (recent | older << BITS_PER_WORD) >> age & 1
            )
            for recent, older in zip(*words, strict=True)
        )

    def send_requests(
        self, tick_index: int, motors_must_reply: tuple[bool, ...] | None = None
    ) -> None:
        """Send one request to every motor.

        A motor that is not in ``motors_must_reply`` is allowed to leave its request unanswered.
        """
        if motors_must_reply:
            self.set_state_values(
                {
                    "phase_before": [
                        int(DrivePhase.READY if must_reply else DrivePhase.READY - 1)
                        for must_reply in motors_must_reply
                    ]
                }
            )
        self.set_state_values({"missed": tick_index - self.last_tick - 1})
        call_interpreted(add_requests, self.state_tables)
        self.last_tick = tick_index

    def receive_replies(self, reply_counts: list[int]) -> list[int]:
        """Receive ``reply_counts[n]`` replies from each motor n.

        Return the indices of motors that replied more often than requested.
        """
        self.set_state_values({"answered": reply_counts})
        has_surplus = call_interpreted(close_answered_requests, self.state_tables, self.hand_tables)
        surplus = self.view("surplus")
        assert has_surplus == bool(surplus.any())
        return [n for n, count in enumerate(surplus.tolist()) if count]


@pytest.mark.parametrize(("ticks_of_open_requests", "replies_to_each_request", "outstanding_after_tick"), [
    (((), ()), (True, True), ((7,), (7,))),
    (((5, 6), ()), (True, True), ((5, 6, 7), (7,))),
    (((5, 6), (3, 4, 5)), (False, True), ((7,), (3, 4, 5, 7))),    # the first drive need only reply to the last request
    (((), ()), (False, False), ((7,), (7,))),
    ((tuple(range(7)), tuple(range(-60, 7))), (True, True), (tuple(range(8)), tuple(range(-60, 8)))),
    (((7 - LOSS_WINDOW_TICKS, 6), (8 - LOSS_WINDOW_TICKS, 6)), (True, True),
        ((6, 7), (8 - LOSS_WINDOW_TICKS, 6, 7))),    # the oldest request expires
    (((7 - LOSS_WINDOW_TICKS,), (6,)), (True, True),
        ((8 - LOSS_WINDOW_TICKS, 7), (6, 7))),    # the last request does not expire, and counts as the oldest tick
])  # fmt: skip
def test_a_request_increases_the_number_of_outstanding_replies(
    ticks_of_open_requests, replies_to_each_request, outstanding_after_tick
):
    questions = OpenRequests(ticks_of_open_requests)
    questions.send_requests(7, replies_to_each_request)
    assert questions.outstanding_request_ticks == outstanding_after_tick


@pytest.mark.parametrize("missed_ticks", [1, 49, 50, 51, 97, 98, 1000])
def test_requests_become_older_while_the_host_misses_ticks(missed_ticks: int) -> None:
    questions = OpenRequests(((5, 6),))
    tick = LAST_TICK + 1 + missed_ticks
    questions.send_requests(tick)
    oldest_tick = tick - LOSS_WINDOW_TICKS + 1
    assert questions.outstanding_request_ticks == (
        (*([k for k in (5, 6) if k >= oldest_tick] or [oldest_tick]), tick),
    )


def test_requests_of_all_ticks_of_the_window_can_be_outstanding() -> None:
    questions = OpenRequests(((),))
    for k in range(LAST_TICK + 1, LAST_TICK + 3 * LOSS_WINDOW_TICKS):
        questions.send_requests(k)
        first = max(LAST_TICK + 1, k - LOSS_WINDOW_TICKS + 1)
        assert questions.outstanding_request_ticks[0] == tuple(range(first, k + 1))


@pytest.mark.parametrize((
    "ticks_of_open_requests", "reply_counts", "outstanding_after_tick", "motors_with_excess_replies",
), [
    (((1,), (1,)), [1, 1], ((), ()), []),
    (((1,), (1,)), [1, 0], ((), (1,)), []),
    # a late reply and a new reply arrive in one tick
    (((1, 2), (2,)), [2, 1], ((), ()), []),
    (((1,), (1,)), [2, 1], ((), ()), [0]),
    (((), (1,)), [1, 3], ((), ()), [0, 1]),
    # a request whose reply is lost stays without a reply
    (((1, 2, 3), ()), [1, 0], ((1, 2), ()), []),
    (((), ()), [0, 0], ((), ()), []),
    (((1,), (1, 2)), [1, 1], ((), (1,)), []),
    (((1,), ()), [1, 1], ((), ()), [1]),
    (((1, 2), (1, 2)), [1, 2], ((1,), ()), []),
])  # fmt: skip
def test_replies_match_requests_and_the_rest_is_excess(
    ticks_of_open_requests, reply_counts, outstanding_after_tick, motors_with_excess_replies
):
    questions = OpenRequests(ticks_of_open_requests)
    assert questions.receive_replies(reply_counts) == motors_with_excess_replies
    assert questions.outstanding_request_ticks == outstanding_after_tick
    expected = [
        1 + len(ticks) if n in motors_with_excess_replies else 0
        for n, ticks in enumerate(ticks_of_open_requests)
    ]
    assert questions.field_values("surplus") == expected


@pytest.mark.parametrize("ticks_without_reply", [2, 3, 49, 50, LOSS_WINDOW_TICKS - 1])
def test_a_series_of_late_replies_is_no_duplicate_whenever_it_begins(
    ticks_without_reply: int,
) -> None:
    """After some ticks without a reply, all missing replies can arrive at once.

    If one more reply arrives after all missing replies have arrived, this reply is a duplicate.
    """
    questions = OpenRequests(((),))
    for start in range(2 * LOSS_WINDOW_TICKS):
        questions.last_tick = start - 1
        questions.set_ticks_of_open_requests(((),))
        for k in range(start, start + ticks_without_reply + 1):
            questions.send_requests(k)
            motors_with_excess_replies = questions.receive_replies(
                [0] if k < start + ticks_without_reply else [ticks_without_reply + 1]
            )
            assert motors_with_excess_replies == [], f"from tick {start} on"
        assert questions.outstanding_request_ticks == ((),)
        questions.send_requests(k + 1)
        assert questions.receive_replies([2]) == [0]


def test_lost_replies_do_not_hide_duplicates_for_long() -> None:
    questions = OpenRequests(((),))
    for k in range(LAST_TICK + 1, LAST_TICK + LOSS_WINDOW_TICKS + 4):
        questions.send_requests(k)
        assert questions.receive_replies([0] if k < LAST_TICK + 4 else [1]) == []
    assert questions.outstanding_request_ticks == ((LAST_TICK + 4,),), (
        "the last one stays open: all may come a tick late"
    )
    questions.send_requests(k + 1)
    assert questions.receive_replies([3]) == [0]


def test_node_with_cyclic_messages_has_no_outstanding_requests() -> None:
    questions = OpenRequests(((), ()))
    questions.set_constants(answers_once=[0, 1])
    assert questions.receive_replies([3, 2]) == [1]


def test_a_second_frame_of_a_load_cell_is_in_excess() -> None:
    questions = OpenRequests(((),))
    questions.set_state_values({"answered": 0, "group_answered": {0: 2}})
    assert call_interpreted(close_answered_requests, questions.state_tables, questions.hand_tables)
