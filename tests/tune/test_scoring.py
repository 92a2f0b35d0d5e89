"""Scoring of gains on a plant unlike the hand file: the exercise completes, however bad the gains are."""

import pytest

from benchmarks.tuning import PLANT, detuned_gains
from handctl.core.model import HandModel
from handctl.hand.load import load_hand
from handctl.tune.scoring import score_exercise


@pytest.mark.parametrize("seed", [1000, 1002])
def test_motor_short_of_its_goal_is_no_stuck_encoder(seed: int) -> None:
    """Regression: N04 was raised at 2.5 s, because the lagging goal moved after the motor had stopped 0.4 mm short."""
    hand = load_hand("jamia")
    score = score_exercise(hand, HandModel.of(hand, detuned_gains(), 500.0), PLANT, seed)
    assert score.failure == ""
    assert 1.0 < score.tracking_deg < 3.0, "the detuned gains track badly, without a fault"
