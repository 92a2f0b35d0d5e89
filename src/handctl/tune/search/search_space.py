"""Gains that a search varies, with the range of each gain."""

from typing import NamedTuple

from handctl.core.gains.gain_bounds import values_by_key
from handctl.core.gains.gains import Gains


class GainRange(NamedTuple):
    """Range of a gain in a search.

    If `is_logarithmic` is True, the search varies the logarithm of the gain uniformly.
    """

    low: float
    high: float
    is_logarithmic: bool


GAIN_RANGES = {
    "motion.position_error_m": GainRange(2e-4, 6e-3, True),
    "motion.speed_error_m_s": GainRange(0.02, 0.4, True),
    "motion.disturbance_rejection": GainRange(0.0, 1.0, False),
    "motion.tension_feedback": GainRange(0.0, 1.0, False),
    "tension.tension_error_N": GainRange(1.0, 60.0, True),
    "tension.speed_error_m_s": GainRange(0.01, 0.4, True),
    "tension.integral_per_s": GainRange(0.3, 20.0, True),
    "filter.motor_disturbance_N": GainRange(0.03, 3.0, True),
    "filter.free_rate_N_per_s": GainRange(5.0, 400.0, True),
}
"""Ranges of all gains that a search varies: weights, disturbance rejection, and filter parameters.

The force of Bryson's rule is fixed, because only ratios of the LQR weights have an effect.
"""


def clamped_gains(gains: Gains) -> dict[str, float]:
    """Return gains as a point of the search space.

    Values outside of their range are clamped to the range.
    """
    values = values_by_key(gains)
    return {
        key: min(max(values[key], gain_range.low), gain_range.high)
        for key, gain_range in GAIN_RANGES.items()
    }
