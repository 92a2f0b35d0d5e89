"""Questions that are still open: what is owed may come late, what is not is a duplicate."""

import pytest

from handctl.safety.detectors.answers import MOST, answered, asked
from handctl.safety.detectors.counts import WINDOW


@pytest.mark.parametrize(("owed", "able", "after"), [
    (((), ()), (True, True), ((7,), (7,))),
    (((5, 6), ()), (True, True), ((5, 6, 7), (7,))),
    (((5, 6), (3, 4, 5)), (False, True), ((7,), (3, 4, 5, 7))),    # whoever does not answer all owes the last
    (((), ()), (False, False), ((7,), (7,))),
    ((tuple(range(7)), tuple(range(-1, 7))), (True, True), ((*range(7), 7), tuple(range(8)))),
    (((7 - WINDOW, 6), (8 - WINDOW, 6)), (True, True), ((6, 7), (8 - WINDOW, 6, 7))),    # too old: given up
    (((-WINDOW, 7 - WINDOW), (-WINDOW,)), (True, True), ((7 - WINDOW, 7), (-WINDOW, 7))),    # but the last one
])  # fmt: skip
def test_one_question_more(owed, able, after):
    assert asked(owed, able, 7) == after


def test_no_more_than_a_few_stay_open() -> None:
    owed = ((),)
    for k in range(3 * MOST):
        owed = asked(owed, (True,), k)
        assert len(owed[0]) == min(k + 1, MOST)
    assert owed[0] == tuple(range(2 * MOST, 3 * MOST))


@pytest.mark.parametrize(("owed", "came", "after", "too_many"), [
    (((1,), (1,)), [1, 1], ((), ()), []),
    (((1,), (1,)), [1, 0], ((), (1,)), []),
    (((1, 2), (2,)), [2, 1], ((), ()), []),                   # a late one with a fresh one
    (((1,), (1,)), [2, 1], ((), ()), [0]),
    (((), (1,)), [1, 3], ((), ()), [0, 1]),
    (((1, 2, 3), ()), [1, 0], ((1, 2), ()), []),              # what was lost grows old
    (((), ()), [0, 0], ((), ()), []),
    (((1,), (1, 2)), [1, 1], ((), (1,)), []),
    (((1,), ()), [1, 1], ((), ()), [1]),
    (((1, 2), (1, 2)), [1, 2], ((1,), ()), []),
])  # fmt: skip
def test_what_comes_pays_what_is_owed_and_the_rest_is_too_much(owed, came, after, too_many):
    assert answered(owed, came) == (after, too_many)


@pytest.mark.parametrize("ticks", [2, 3, MOST - 1])
def test_a_run_of_late_answers_is_paid_once_whenever_it_begins(ticks: int) -> None:
    """Some ticks without an answer, then all at once: nothing is a duplicate; one more is."""
    for start in range(2 * WINDOW):
        owed = ((),)
        for k in range(start, start + ticks + 1):
            owed = asked(owed, (True,), k)
            owed, extra = answered(owed, [0] if k < start + ticks else [ticks + 1])
            assert extra == [], f"from tick {start} on"
        assert owed == ((),)
        assert answered(asked(owed, (True,), k + 1), [2])[1] == [0]


def test_answers_that_were_lost_hide_no_duplicates_for_long() -> None:
    owed = ((),)
    for k in range(WINDOW + 3):
        owed, extra = answered(asked(owed, (True,), k), [0] if k < 3 else [1])
        assert extra == []
    assert owed == ((2,),), "the last one stays open: all may come a tick late"
    assert answered(asked(owed, (True,), k + 1), [3])[1] == [0]


def test_as_many_answers_as_nodes() -> None:
    with pytest.raises(ValueError, match="zip"):
        asked(((1,),), (True, True), 7)
    with pytest.raises(ValueError, match="zip"):
        answered(((1,), (1, 2)), [1])
