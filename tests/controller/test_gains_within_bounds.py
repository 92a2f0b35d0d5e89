"""Test the design of controllers with gains within their bounds.

For any gains within their bounds, handctl either designs a controller, or prints one error line
with the reason why no design exists.
"""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handctl.core.gains.gain_bounds import gain_bounds, gains_with_values
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.errors import ConfigError
from handctl.hand.hand_loading import load_hand

EXTREME_GAINS = {
    "motion.force_N": 1e-9,
    "motion.position_error_m": 1e-200,
    "motion.speed_error_m_s": 1e-12,
    "tension.tension_error_N": 1e-150,
    "filter.free_time_s": 1e-300,
    "filter.held_time_s": 1e-12,
    "filter.encoder_noise_counts": 1e-200,
}
GAIN_WEIGHT_KEYS = [
    key
    for key, bound in gain_bounds().items()
    if bound.is_low_excluded and not key.startswith("contact")
]


@pytest.mark.parametrize("gain_key", EXTREME_GAINS)
def test_solver_failure_is_one_line(gain_key: str) -> None:
    gains = gains_with_values(Gains(), {gain_key: EXTREME_GAINS[gain_key]}, "test")
    with pytest.raises(
        ConfigError, match=f"gains: {gain_key.partition('.')[0]}: no controller follows"
    ):
        HandModel.from_hand(load_hand("jamia"), gains, 500.0)


@settings(max_examples=12)
@given(st.dictionaries(st.sampled_from(GAIN_WEIGHT_KEYS), st.floats(-30.0, 0.0), min_size=1))
def test_gains_within_bounds_are_designed_or_refused(exponent_by_gain: dict[str, float]) -> None:
    known_bounds = gain_bounds()
    gains = gains_with_values(
        Gains(),
        {key: known_bounds[key].high * math.exp(power) for key, power in exponent_by_gain.items()},
        "test",
    )
    with suppress(ConfigError):
        model = HandModel.from_hand(load_hand("jamia_bench"), gains, 500.0)
        design_arrays = [
            model.motion_design.stiffness,
            model.motion_design.damping,
            model.motion_design.tension,
            model.motion_design.tension_speed,
        ]
        design_arrays += [block.K for blocks in model.filter_design.blocks for block in blocks]
        assert all(np.isfinite(design_array).all() for design_array in design_arrays)
