"""Test the record of requests that the drives have not answered yet.

A reply to an open request can be late, but it is no duplicate. A reply without any request is a
duplicate.
"""

import pytest

from handctl.core.detectors.outstanding_requests import (
    MAX_OUTSTANDING_REQUESTS,
    add_requests,
    close_answered_requests,
)
from handctl.drives.contract import DrivePhase
from handctl.safety.faults.bus import LOSS_WINDOW_TICKS
from tests.safety.synthetic_monitor import SyntheticMonitor, call_interpreted, synthetic_limits

RequestTicks = tuple[tuple[int, ...], ...]


class OpenRequests(SyntheticMonitor):
    """Record of the motors that have not yet replied to requests of earlier ticks."""

    def __init__(self, ticks_of_open_requests: RequestTicks) -> None:
        super().__init__(synthetic_limits(len(ticks_of_open_requests)))
        self.set_state_values({
            "open_questions": {n: len(ticks) for n, ticks in enumerate(ticks_of_open_requests)},
            "question": {(i, n): k for n, ticks in enumerate(ticks_of_open_requests) for i, k in enumerate(ticks)},
        })  # fmt: skip

    @property
    def outstanding_request_ticks(self) -> RequestTicks:
        """Return, for each motor, the ticks of the requests that have no reply yet."""
        numbers, ticks = (
            self.view("open_questions"),
            self.view("question").reshape(MAX_OUTSTANDING_REQUESTS, -1),
        )
        return tuple(tuple(ticks[:number, n].tolist()) for n, number in enumerate(numbers.tolist()))

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
        call_interpreted(add_requests, self.state_tables, tick_index)

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
    ((tuple(range(7)), tuple(range(-1, 7))), (True, True), ((*range(7), 7), tuple(range(8)))),
    (((7 - LOSS_WINDOW_TICKS, 6), (8 - LOSS_WINDOW_TICKS, 6)), (True, True),
        ((6, 7), (8 - LOSS_WINDOW_TICKS, 6, 7))),    # the oldest request expires
    (((-LOSS_WINDOW_TICKS, 7 - LOSS_WINDOW_TICKS), (-LOSS_WINDOW_TICKS,)), (True, True),
        ((7 - LOSS_WINDOW_TICKS, 7), (-LOSS_WINDOW_TICKS, 7))),    # the last request does not expire
])  # fmt: skip
def test_a_request_increases_the_number_of_outstanding_replies(
    ticks_of_open_requests, replies_to_each_request, outstanding_after_tick
):
    questions = OpenRequests(ticks_of_open_requests)
    questions.send_requests(7, replies_to_each_request)
    assert questions.outstanding_request_ticks == outstanding_after_tick


def test_outstanding_requests_are_limited() -> None:
    questions = OpenRequests(((),))
    for k in range(3 * MAX_OUTSTANDING_REQUESTS):
        questions.send_requests(k)
        assert len(questions.outstanding_request_ticks[0]) == min(k + 1, MAX_OUTSTANDING_REQUESTS)
    assert questions.outstanding_request_ticks[0] == tuple(
        range(2 * MAX_OUTSTANDING_REQUESTS, 3 * MAX_OUTSTANDING_REQUESTS)
    )


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


@pytest.mark.parametrize("ticks_without_reply", [2, 3, MAX_OUTSTANDING_REQUESTS - 1])
def test_a_series_of_late_replies_is_no_duplicate_whenever_it_begins(
    ticks_without_reply: int,
) -> None:
    """After some ticks without a reply, all missing replies can arrive at once.

    If one more reply arrives after all missing replies have arrived, this reply is a duplicate.
    """
    questions = OpenRequests(((),))
    for start in range(2 * LOSS_WINDOW_TICKS):
        questions.set_state_values({"open_questions": 0})
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
    for k in range(LOSS_WINDOW_TICKS + 3):
        questions.send_requests(k)
        assert questions.receive_replies([0] if k < 3 else [1]) == []
    assert questions.outstanding_request_ticks == ((2,),), (
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
