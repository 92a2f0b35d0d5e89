"""Test how long the filter takes to detect that a slack tendon has become taut."""

import pytest

from handctl.core.estimation.filter_types import TendonRegime
from handctl.core.estimation.slack_detection import (
    NEARLY_TAUT_M,
    is_nearly_taut,
    is_regime_over,
    regime_evidence,
)
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from tests.controller.synthetic_states import active_state, uncompiled_function

SLACK_REGIME = int(TendonRegime.SLACK)


@pytest.mark.parametrize(("is_length_known", "sample_count"), [(True, 1), (False, 3)])
def test_a_tendon_whose_length_is_known_is_taut_at_the_first_clear_sample(
    is_length_known: bool, sample_count: int
) -> None:
    """In this test at 200 Hz, the tension grows by 1 N from one load-cell reading to the next.

    When the tension rises by 1 N per reading, the filter must use the first load-cell reading that
    clearly shows tension.
    """
    points, samples_taken = 0, 0
    while not uncompiled_function(is_regime_over)(SLACK_REGIME, points, False):
        points = uncompiled_function(regime_evidence)(
            SLACK_REGIME, points, 0.0, 1.6, 0.0, is_length_known
        )
        samples_taken += 1
    assert samples_taken == sample_count


def test_a_tendon_is_near_when_little_slack_length_remains(model: HandModel) -> None:
    state = active_state(model)
    state.view("stretch_offset")[...] = 1e-3
    for hangs, is_near in ((0.9 * NEARLY_TAUT_M, True), (1.1 * NEARLY_TAUT_M, False)):
        state.view("travel")[...] = 1e-3 - hangs
        assert (
            uncompiled_function(is_nearly_taut)(
                uncompiled_function(state_tables)(state.block, state.layout.offsets), 1
            )
            == is_near
        )
