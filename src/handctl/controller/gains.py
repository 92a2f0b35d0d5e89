"""Gains as data: what a person may tune, with units, bounds and the reason of each default."""

from pathlib import Path

from pydantic import Field

from handctl.document import Document, load_document


class FilterGains(Document):
    """Noise assumed by the tension filter.

    The disturbances stand for what the model lacks: friction error, gravity sag, contact. Their correlation times are
    those of the motions they come from.
    """

    motor_disturbance_N: float = Field(1.0, gt=0, le=50)
    motor_disturbance_time_s: float = Field(0.05, gt=0, le=10)
    load_disturbance_N: float = Field(1.0, gt=0, le=100)
    load_disturbance_time_s: float = Field(0.1, gt=0, le=10)
    held_speed_m_s: float = Field(1e-3, gt=0, le=1)
    """Along the tendon, of a digit that rests on something."""
    held_time_s: float = Field(0.05, gt=0, le=10)
    motor_acceleration_noise_N: float = Field(0.02, gt=0, le=10)
    load_acceleration_noise_N: float = Field(0.01, gt=0, le=10)
    offset_m: float = Field(1e-5, gt=0, le=0.01)
    offset_time_s: float = Field(60.0, gt=0, le=1e4)
    encoder_noise_counts: float = Field(0.5, gt=0, le=100)


class MotionGains(Document):
    """Weights of the motion loop by Bryson's rule: the error, speed error and force that count alike."""

    position_error_m: float = Field(6e-4, gt=0, le=0.1)
    speed_error_m_s: float = Field(0.06, gt=0, le=10)
    force_N: float = Field(20.0, gt=0, le=500)
    disturbance_rejection: float = Field(1.0, ge=0, le=1)
    """Share of the estimated motor disturbance that is cancelled."""
    tension_feedback: float = Field(0.3, ge=0, le=5)
    """Inner tension loop while moving: extra motor force per newton of tension error."""


class TensionGains(Document):
    """Weights of the tension loop by Bryson's rule, and its rate."""

    tension_error_N: float = Field(4.0, gt=0, le=100)
    speed_error_m_s: float = Field(0.03, gt=0, le=10)
    force_N: float = Field(15.0, gt=0, le=500)
    integral_per_s: float = Field(3.0, ge=0, le=100)
    rate_N_per_s: float = Field(200.0, gt=0, le=5000)


class ContactGains(Document):
    """When a tension that the model does not explain counts as contact."""

    threshold_N: float = Field(5.0, gt=0, le=100)
    ticks: int = Field(5, ge=1, le=1000)


class Gains(Document):
    """All gains of a controller; the defaults are those of the packaged hands."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    filter: FilterGains = FilterGains()
    motion: MotionGains = MotionGains()
    tension: TensionGains = TensionGains()
    contact: ContactGains = ContactGains()


def load_gains(path: Path | None) -> Gains:
    """Gains from a TOML file, or the defaults.

    Raises:
        ConfigError: the file cannot be read or a value is out of range.
    """
    return Gains() if path is None else load_document(path, Gains)
