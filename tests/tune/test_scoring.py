"""Test how gains are scored on a simulated hand that differs from its hand file.

The exercise completes, however bad the gains are.
"""

import pytest

from benchmarks.tuning import PLANT, detuned_gains
from handctl.core.model import HandModel
from handctl.hand.load import load_hand
from handctl.tune.scoring import score_exercise


@pytest.mark.parametrize("seed", [1000, 1002])
def test_motor_short_of_its_goal_is_no_stuck_encoder(seed: int) -> None:
    """Regression: a motor had stopped 0.4 mm short of its goal.

    The lagging goal then moved on, and at 2.5 s this was the fault N04.
    """
    hand = load_hand("jamia")
    score = score_exercise(hand, HandModel.of(hand, detuned_gains(), 500.0), PLANT, seed)
    assert score.failure == ""
    assert 1.0 < score.tracking_deg < 3.0, "the detuned gains track badly, without a fault"
