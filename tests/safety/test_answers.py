"""Questions that are still open: what is owed may come late, what is not is a duplicate."""

import pytest

from handctl.safety.answers import MOST, answered, asked
from handctl.safety.counts import WINDOW

K = 7
"""A tick in which nothing is given up."""


@pytest.mark.parametrize(("owed", "able", "k", "after"), [
    ((0, 0), (True, True), K, (1, 1)),
    ((2, 0), (True, True), K, (3, 1)),
    ((2, 5), (False, True), K, (1, 6)),                  # whoever does not answer every question owes the last one only
    ((0, 0), (False, False), K, (1, 1)),
    ((MOST - 1, MOST), (True, True), K, (MOST, MOST)),
    ((2, 1), (True, True), WINDOW, (2, 2)),              # one of several is given up, the only one is not
    ((2, 0), (True, True), 0, (2, 1)),
    ((MOST, 3), (True, True), 3 * WINDOW, (MOST, 3)),
    ((3, 3), (True, True), WINDOW + 1, (4, 4)),
])  # fmt: skip
def test_one_question_more(owed, able, k, after):
    assert asked(owed, able, k) == after


@pytest.mark.parametrize(("owed", "came", "after", "too_many"), [
    ((1, 1), [1, 1], (0, 0), []),
    ((1, 1), [1, 0], (0, 1), []),
    ((2, 1), [2, 1], (0, 0), []),                        # a late one with a fresh one
    ((1, 1), [2, 1], (0, 0), [0]),
    ((0, 1), [1, 3], (0, 0), [0, 1]),
    ((3, 0), [1, 0], (2, 0), []),
    ((0, 0), [0, 0], (0, 0), []),
    ((1, 2), [1, 1], (0, 1), []),
    ((1, 0), [1, 1], (0, 0), [1]),
    ((2, 2), [1, 1], (1, 1), []),
])  # fmt: skip
def test_what_comes_pays_what_is_owed_and_the_rest_is_too_much(owed, came, after, too_many):
    assert answered(owed, came) == (after, too_many)


def test_a_run_of_late_answers_is_paid_once():
    """Three ticks without an answer, then all four at once: nothing is a duplicate; one more is."""
    owed = (0,)
    for k in range(1, 5):
        owed = asked(owed, (True,), k)
        owed, extra = answered(owed, [0] if k < 4 else [4])
        assert extra == []
    assert owed == (0,)
    assert answered(asked(owed, (True,), 5), [2])[1] == [0]


def test_as_many_answers_as_nodes() -> None:
    with pytest.raises(ValueError, match="zip"):
        asked((1,), (True, True), K)
    with pytest.raises(ValueError, match="zip"):
        answered((1, 2), [1])
