"""What a search may turn: gains by key, with the range of each."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from handctl.controller.gains import Gains
from handctl.errors import ConfigError


class Range(NamedTuple):
    """Of one gain; ``log``: factors count, not differences."""

    low: float
    high: float
    log: bool


SPACE = {
    "motion.position_error_m": Range(2e-4, 6e-3, True),
    "motion.speed_error_m_s": Range(0.02, 0.4, True),
    "motion.disturbance_rejection": Range(0.0, 1.0, False),
    "motion.tension_feedback": Range(0.0, 1.0, False),
    "tension.tension_error_N": Range(1.0, 60.0, True),
    "tension.speed_error_m_s": Range(0.01, 0.4, True),
    "tension.integral_per_s": Range(0.3, 20.0, True),
    "filter.motor_disturbance_N": Range(0.1, 5.0, True),
    "filter.load_disturbance_N": Range(0.1, 5.0, True),
}
"""Weights, rejection and filter; the force of Bryson's rule is left alone, for only ratios count."""


def value_of(gains: Gains, key: str) -> float:
    """The value of ``section.name``."""
    section, _, name = key.partition(".")
    return float(getattr(getattr(gains, section), name))


def with_values(gains: Gains, values: Mapping[str, float]) -> Gains:
    """The gains with other values.

    Raises:
        ConfigError: no such key, or a value out of its bounds.
    """
    table: dict[str, Any] = gains.model_dump(by_alias=True)
    for key, value in values.items():
        section, _, name = key.partition(".")
        if not isinstance(table.get(section), dict) or name not in table[section]:
            raise ConfigError("no such gain", key, f"one of {', '.join(SPACE)}")
        table[section][name] = value
    try:
        return Gains.model_validate(table)
    except ValueError as error:
        raise ConfigError(str(error).splitlines()[0], "gains", "values in their bounds") from None


def within(gains: Gains) -> dict[str, float]:
    """The gains as a point of the space, moved to its edge where they are outside."""
    return {key: min(max(value_of(gains, key), one.low), one.high) for key, one in SPACE.items()}
