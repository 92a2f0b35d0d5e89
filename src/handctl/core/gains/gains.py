"""Gains as data: what a person may tune, with units, bounds and the reason of each default.

The defaults keep a gain margin of 6 dB and a phase margin of 45 degrees in both loops of the packaged hands, on the
hand file's plant and on those drawn around it, at 500 Hz (jamia) and at the 200 Hz of jamia11 on one bus.
"""

from pathlib import Path

from pydantic import Field

from handctl.document import Document, load_document
from handctl.hand.file.toml_text import toml_text


class FilterGains(Document):
    """Noise assumed by the tension filter.

    The disturbances stand for what the model lacks: friction, springs, contact. Their correlation times are those of
    the motions they come from.
    """

    motor_disturbance_N: float = Field(0.12, gt=0, le=50)
    motor_disturbance_time_s: float = Field(0.05, gt=0, le=10)
    free_rate_N_per_s: float = Field(40.0, gt=0, le=1e4)
    """How fast the tension of a freely moving digit changes, beside what the motion asks."""
    free_time_s: float = Field(0.05, gt=0, le=10)
    held_speed_m_s: float = Field(1.5e-3, gt=0, le=1)
    """Along the tendon, of a digit that rests on something."""
    held_time_s: float = Field(0.1, gt=0, le=10)
    held_disturbance_N: float = Field(0.3, gt=0, le=50)
    """Of the motor while its digit rests on something: it turns so slowly that what friction takes is hardly known."""
    held_disturbance_time_s: float = Field(0.3, gt=0, le=10)
    held_acceleration_noise_N: float = Field(0.022, gt=0, le=10)
    motor_acceleration_noise_N: float = Field(0.03, gt=0, le=10)
    """Force on the rotor from one instant to the next that nothing explains; the more of it, the less phase the filter
    costs the loops (Doyle and Stein, 1979), and the more of the encoder's noise reaches the torque."""
    joint_time_s: float = Field(0.1, gt=0, le=10)
    """In which joint encoders part excursion from stretch offset."""
    cell_drift_N: float = Field(1.0, gt=0, le=100)
    """Drift of a load cell in ``cell_drift_time_s``, a random walk."""
    cell_drift_time_s: float = Field(100.0, gt=0, le=1e5)
    cell_tared_s: float = Field(5.0, ge=0, le=1e5)
    """Time since a rope was loose, for which the variance of a taut one is told."""
    offset_m: float = Field(1e-5, gt=0, le=0.01)
    offset_time_s: float = Field(60.0, gt=0, le=1e4)
    encoder_noise_counts: float = Field(0.3, gt=0, le=100)
    """A count's rounding: 1 / sqrt(12)."""


class MotionGains(Document):
    """Weights of the motion loop by Bryson's rule: the error, speed error and force that count alike."""

    position_error_m: float = Field(6e-4, gt=0, le=0.1)
    speed_error_m_s: float = Field(0.028, gt=0, le=10)
    force_N: float = Field(13.0, gt=0, le=500)
    """At 500 Hz and above; slower loops bear less, see ``motion_design``."""
    inertia_share: float = Field(1.0, ge=0, le=1)
    """Share of the rotor's inertia that is made up for on the way."""
    friction_share: float = Field(1.0, ge=0, le=1)
    """Share of the friction of pulleys and motor that is."""
    disturbance_rejection: float = Field(0.7, ge=0, le=1)
    """Share of the estimated motor disturbance that is cancelled."""
    tension_feedback: float = Field(0.3, ge=0, le=5)
    """Inner tension loop while moving: extra motor force per newton of tension error."""


class TensionGains(Document):
    """Weights of the tension loop by Bryson's rule, and its rate."""

    tension_error_N: float = Field(4.0, gt=0, le=100)
    speed_error_m_s: float = Field(0.03, gt=0, le=10)
    force_N: float = Field(5.0, gt=0, le=500)
    """As that of motion."""
    integral_per_s: float = Field(3.0, ge=0, le=100)
    rate_N_per_s: float = Field(200.0, gt=0, le=5000)


class ContactGains(Document):
    """When tension that the model does not explain counts as contact of a closing digit."""

    threshold_N: float = Field(0.3, gt=0, le=100)
    """As a force at the tip of a digit of two joints, smoothed over 5 ms.

    Half as much again of a digit of three, and twice as much of one that is at the end of its way.
    """
    ticks: int = Field(1, ge=1, le=1000)


class Gains(Document):
    """All gains of a controller; the defaults are those of the packaged hands."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    filter: FilterGains = FilterGains()
    motion: MotionGains = MotionGains()
    tension: TensionGains = TensionGains()
    contact: ContactGains = ContactGains()


class Provenance(Document):
    """Where gains come from: what a person needs to believe them, or to find out why not."""

    made: str = ""
    """Date and time, ISO 8601, UTC."""
    version: str = ""
    """Of handctl."""
    hand: str = ""
    identity: str = ""
    """Hash of the hand description they were made for."""
    log: tuple[str, ...] = ()
    """Recorded runs they rest on."""
    fit: str = ""
    """Calibration file with the identified parameters."""
    study: str = ""
    """Search that found them."""
    note: str = ""
    number: int = Field(0, ge=0)
    """In the history; 0 outside of it."""
    replaces: int = Field(0, ge=0)
    """Number of those that these took the place of; 0: the packaged ones."""
    restores: int | None = Field(None, ge=0)
    """Number of those that a rollback brought back, 0 for the packaged ones; absent: these are no rollback."""


class GainsFile(Gains):
    """Gains with their provenance, as in a file."""

    provenance: Provenance = Provenance()

    @property
    def gains(self) -> Gains:
        """The gains alone; what the file does not say is not said there either."""
        given = {name: getattr(self, name) for name in self.model_fields_set - {"provenance"}}
        return Gains(**given)


def load_gains(path: Path | None) -> Gains:
    """Gains from a TOML file, or the packaged ones.

    Raises:
        ConfigError: the file cannot be read or a value is out of range.
    """
    return Gains() if path is None else load_gains_file(path).gains


def load_gains_file(path: Path) -> GainsFile:
    """Gains and provenance from a TOML file.

    Raises:
        ConfigError: the file cannot be read or a value is out of range.
    """
    return load_document(path, GainsFile)


def gains_text(gains: Gains, provenance: Provenance) -> str:
    """A gains file with every value, defaults included."""
    told = {key: value for key, value in provenance.model_dump().items() if value or (key == "restores" and value == 0)}
    content = gains.model_dump(by_alias=True, include=set(Gains.model_fields))
    return toml_text(content | ({"provenance": told} if told else {}))
