"""Gains of the controller: values that can be tuned, with units, bounds and defaults.

With the default gains, the motion and tension loops of the Jamia hands have a gain margin of at
least 6 dB and a phase margin of at least 45 degrees. The margins of the default gains hold at
control rates of 500 Hz (jamia) and 200 Hz (jamia11 on a single bus). The gain margin and the phase
margin hold for the plant of the hand file, and for random variants of the plant. If a packaged hand
does not have these margins with the default gains, the folder ``packaged`` contains a gains file
for the hand.
"""

from pathlib import Path

from pydantic import Field, model_validator

from handctl.document import Document, load_document
from handctl.hand.file.toml_text import toml_text

PACKAGED_GAINS_FOLDER = Path(__file__).parent / "packaged"
"""Folder with the gains of packaged hands for which the default gains do not fit."""


class FilterGains(Document):
    """Noise that the tension filter assumes.

    The disturbances stand for effects that are not in the model: friction, springs and contact. The
    correlation time of a disturbance is the correlation time of the motion that causes the
    disturbance.
    """

    motor_disturbance_N: float = Field(0.12, gt=0, le=50)
    """Standard deviation of the motor's disturbance force, for example by friction [N]."""
    motor_disturbance_time_s: float = Field(0.05, gt=0, le=10)
    """Correlation time of the motor's disturbance force [s]."""
    free_rate_N_per_s: float = Field(40.0, gt=0, le=1e4)
    """Rate at which the tension of a freely moving digit changes, in addition to the planned change [N/s]."""
    free_time_s: float = Field(0.05, gt=0, le=10)
    """Correlation time of the rate of change of a freely moving digit's tension [s]."""
    held_speed_m_s: float = Field(1.5e-3, gt=0, le=1)
    """Speed along the tendon of a digit at rest on an object [m/s]."""
    held_time_s: float = Field(0.1, gt=0, le=10)
    """Correlation time of the speed of a digit at rest on an object [s]."""
    held_disturbance_N: float = Field(0.3, gt=0, le=50)
    """Standard deviation of the disturbance force on the motor of a held digit [N].

    Friction at low speed is hardly known.
    """
    held_disturbance_time_s: float = Field(0.3, gt=0, le=10)
    """Correlation time of the disturbance force on the motor of a held digit [s]."""
    held_acceleration_noise_N: float = Field(0.022, gt=0, le=10)
    """White force noise on the rotor of a held digit [N]."""
    motor_acceleration_noise_N: float = Field(0.03, gt=0, le=10)
    """White force noise on the rotor of a free digit [N].

    A larger value reduces the phase lag of the filter in the loops (Doyle and Stein, 1979), and
    passes more encoder noise on to the torque.
    """
    joint_time_s: float = Field(0.1, gt=0, le=10)
    """Time in which joint encoders separate excursion from stretch offset [s]."""
    cell_drift_N: float = Field(1.0, gt=0, le=100)
    """Standard deviation of a load cell's drift after ``cell_drift_time_s``, as a random walk [N]."""
    cell_drift_time_s: float = Field(100.0, gt=0, le=1e5)
    """Time to which ``cell_drift_N`` refers [s]."""
    cell_tared_s: float = Field(5.0, ge=0, le=1e5)
    """Time since a taut tendon was last slack, as assumed for the variance of its tension [s]."""
    offset_m: float = Field(1e-5, gt=0, le=0.01)
    """Standard deviation of the stretch offset's change after ``offset_time_s``, as a random walk [m]."""
    offset_time_s: float = Field(60.0, gt=0, le=1e4)
    """Time to which ``offset_m`` refers [s]."""
    encoder_noise_counts: float = Field(0.3, gt=0, le=100)
    """Standard deviation of a motor encoder's noise in counts.

    Rounding alone causes a standard deviation of 1 / sqrt(12) counts.
    """


class MotionGains(Document):
    """Weights of the motion loop, chosen by Bryson's rule, and settings of feedforward and inner tension loop.

    The weights are an excursion error, a speed error and a motor force. Each of these three values
    alone causes the same cost.
    """

    position_error_m: float = Field(6e-4, gt=0, le=0.1)
    """Error of the excursion with the cost of ``speed_error_m_s`` or ``force_N`` [m]."""
    speed_error_m_s: float = Field(0.028, gt=0, le=10)
    """Error of the tendon speed with the cost of ``position_error_m`` or ``force_N`` [m/s]."""
    force_N: float = Field(13.0, gt=0, le=500)
    """Motor force with the cost of ``position_error_m`` or ``speed_error_m_s``, at 500 Hz and above [N].

    At control rates below 500 Hz, a smaller force is used, see ``motion_design``.
    """
    inertia_share: float = Field(1.0, ge=0, le=1)
    """Fraction of the rotor's inertia that the feedforward compensates."""
    friction_share: float = Field(1.0, ge=0, le=1)
    """Fraction of pulley and motor friction that the feedforward compensates."""
    disturbance_rejection: float = Field(0.7, ge=0, le=1)
    """Fraction of the estimated motor disturbance that the motor force cancels."""
    tension_feedback: float = Field(0.3, ge=0, le=5)
    """Gain of the inner tension loop of a moving digit: added motor force per newton of tension error."""


class TensionGains(Document):
    """Weights of the tension loop, chosen by Bryson's rule, and the slope of the tension setpoint."""

    tension_error_N: float = Field(4.0, gt=0, le=100)
    """Error of the tension with the cost of ``speed_error_m_s`` or ``force_N`` [N]."""
    speed_error_m_s: float = Field(0.03, gt=0, le=10)
    """Tendon speed with the cost of ``tension_error_N`` or ``force_N`` [m/s]."""
    force_N: float = Field(5.0, gt=0, le=500)
    """Motor force with the cost of ``tension_error_N`` or ``speed_error_m_s``, at 500 Hz and above [N]."""
    integral_per_s: float = Field(3.0, ge=0, le=100)
    """Integral gain: rate at which the tension error is integrated to a motor force [1/s]."""
    rate_N_per_s: float = Field(200.0, gt=0, le=5000)
    """Rate at which the tension setpoint approaches the target [N/s]."""


class ContactGains(Document):
    """Threshold above which a closing digit counts as touching an object."""

    threshold_N: float = Field(0.3, gt=0, le=100)
    """Contact force at the tip of a digit of two joints, smoothed over 5 ms [N].

    The threshold is 1.5 times as large for a digit of three joints, and 2 times as large near the
    end of the joints' range.
    """
    ticks: int = Field(1, ge=1, le=1000)
    """Number of ticks in a row above the threshold after which the digit counts as in contact."""


class TendonForces(Document):
    """Forces for a single tendon.

    Each force is a weight of the motor force, and replaces the weight for all tendons. Digits of
    different mass need different force weights. For example, the force weight for a wrist that
    carries five fingers is a thirtieth of the force weight for a fingertip.
    """

    name: str
    """Name of the tendon."""
    motion_force_N: float | None = Field(None, gt=0, le=500)
    """Force of the tendon ``name`` in place of ``motion.force_N`` [N]."""
    tension_force_N: float | None = Field(None, gt=0, le=500)
    """Force of the tendon ``name`` in place of ``tension.force_N`` [N]."""


class Gains(Document):
    """All gains of a controller. The default values are the gains of the Jamia hands."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    filter: FilterGains = FilterGains()
    motion: MotionGains = MotionGains()
    tension: TensionGains = TensionGains()
    contact: ContactGains = ContactGains()
    tendon: tuple[TendonForces, ...] = ()

    @model_validator(mode="after")
    def _refuse_repeated_names(self) -> "Gains":
        names = [tendon_gains.name for tendon_gains in self.tendon]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(
                f"tendon {repeated[0]!r} is there twice, expected one entry for each tendon"
            )
        return self

    def force_weights_of_tendon(self, tendon: str) -> tuple[float, float]:
        """Return the force weights of a tendon in the motion loop and in the tension loop [N]."""
        tendon_gains = next(
            (tendon_gains for tendon_gains in self.tendon if tendon_gains.name == tendon),
            TendonForces(name=tendon),
        )
        motion = (
            self.motion.force_N
            if tendon_gains.motion_force_N is None
            else tendon_gains.motion_force_N
        )
        tension = (
            self.tension.force_N
            if tendon_gains.tension_force_N is None
            else tendon_gains.tension_force_N
        )
        return motion, tension


class GainsProvenance(Document):
    """Origin of gains, from which a user can judge the quality of the gains."""

    made: str = ""
    """Date and time at which the gains were made, ISO 8601, UTC."""
    version: str = ""
    """Version of handctl that made the gains."""
    hand: str = ""
    """Name of the hand for which the gains were made."""
    identity: str = ""
    """Hash of the hand description with which the gains were designed."""
    log: tuple[str, ...] = ()
    """Logs of the runs from which the gains were derived."""
    fit: str = ""
    """Calibration file whose identified parameters were used for the design."""
    study: str = ""
    """Search that found the gains of the file."""
    note: str = ""
    """Note of the user about the gains of the file."""
    number: int = Field(0, ge=0)
    """Number of the gains in the history of gains, 0 for gains outside of a history."""
    replaces: int = Field(0, ge=0)
    """Number of the replaced gains in the history of gains, 0 for the packaged gains."""
    restores: int | None = Field(None, ge=0)
    """Number of the gains in the history that a rollback restored, 0 for the packaged gains.

    The value is None if no rollback was made.
    """


class GainsFile(Gains):
    """Content of a gains file: gains with their provenance."""

    provenance: GainsProvenance = GainsProvenance()

    @property
    def gains(self) -> Gains:
        """Return the gains without the information about their origin.

        Values that are missing in the file are also missing in ``model_fields_set`` of the result.
        """
        value_by_key = {
            name: getattr(self, name) for name in self.model_fields_set - {"provenance"}
        }
        return Gains(**value_by_key)


def load_gains(path: Path | None) -> Gains:
    """Return gains from a TOML file, or the default gains.

    Raises:
        ConfigError: the file cannot be read, or a value is out of range.
    """
    return Gains() if path is None else load_gains_file(path).gains


def packaged_gains(hand: str) -> Gains:
    """Return the gains of a packaged hand, from the gains file in ``packaged`` if there is one.

    Args:
        hand: name of the hand.
    """
    path = PACKAGED_GAINS_FOLDER / f"{hand}.toml"
    return load_gains_file(path).gains if path.is_file() else Gains()


def load_gains_file(path: Path) -> GainsFile:
    """Return gains and provenance from a TOML file.

    Raises:
        ConfigError: if the file cannot be read or a value is out of range.
    """
    return load_document(path, GainsFile)


def gains_text(gains: Gains, provenance: GainsProvenance) -> str:
    """Return the text of a gains file with all values, including those that equal the default."""
    provenance_fields = provenance.model_dump()
    section_texts = {
        key: value
        for key, value in provenance_fields.items()
        if value or (key == "restores" and value == 0)
    }
    content = gains.model_dump(by_alias=True, include=set(Gains.model_fields))
    return toml_text(content | ({"provenance": section_texts} if section_texts else {}))
