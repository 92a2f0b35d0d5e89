"""How soon a rope is known to be taut again."""

import numpy as np
import pytest

from handctl.core.estimation.filter_stack import STATES, O, Regime, X
from handctl.core.estimation.take_up import NEAR_M, has_turned, near, turning

SLACK = int(Regime.SLACK)


@pytest.mark.parametrize(("length_is_known", "samples"), [(True, 1), (False, 3)])
def test_a_rope_whose_length_is_known_is_taut_at_the_first_clear_sample(length_is_known: bool, samples: int) -> None:
    """At 200 Hz a rope gains 1 N from one sample to the next, so that each of them counts."""
    points, taken = 0, 0
    while not has_turned(SLACK, points):
        points = turning(SLACK, points, 0.0, 1.6, 0.0, length_is_known)
        taken += 1
    assert taken == samples


def test_a_rope_is_near_from_a_small_length_of_loose_rope_on() -> None:
    x = np.zeros(STATES)
    x[O] = 1e-3
    x[X] = x[O] - 0.9 * NEAR_M
    assert near(x)
    x[X] = x[O] - 1.1 * NEAR_M
    assert not near(x)
