"""Observation of a hand in one tick, with the age of the observed values.

The observation is a numpy record. The names of the record's fields contain the units.
"""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TELEMETRY_AXES, HandMode, Vector
from handctl.hand.description import Hand
from handctl.programs.stream_plans import StreamStatus
from handctl.runtime.observations import PUBLISHED_NAME_BY_FIELD

AXIS_BY_FIELD = {PUBLISHED_NAME_BY_FIELD[name]: axis for name, axis in TELEMETRY_AXES.items()}
"""For each array in an observation, the kind of its elements: joint, tendon, motor or digit."""


class Observation:
    """State of the hand at one tick. Unknown numbers are NaN.

    Every field of ``record`` is also an attribute of the observation. The name of an attribute ends
    with the unit. In the shapes of the attributes, J, N, M and D are the numbers of joints,
    tendons, motors and digits. The elements of each attribute are in the order of the joints,
    tendons, motors or digits in the hand file. The method ``named`` returns the values of a field
    as a dict.

    Attributes:
        record: all values of the observation, as a numpy record of shape ().
        k: number of the tick.
        t_ns: time of the tick since the start of the run [ns].
        late_ns: lateness of the tick [ns].
        published_ns: reading of CLOCK_MONOTONIC after the commands of the tick were sent [ns].
        q_rad: (J,) estimated joint angles.
        q_sigma_rad: (J,) standard deviations of the joint angles.
        dq_rad_s: (J,) estimated joint rates.
        q_goal_rad: (J,) commanded joint angles. The value is NaN for a joint whose digit holds a
            tension instead of an angle.
        tension_N: (N,) estimated tendon tensions.
        tension_sigma_N: (N,) standard deviations of the tendon tensions.
        tension_goal_N: (N,) commanded tendon tensions.
        tip_force_N: (D,) contact forces on the tips of the digits, normal to the last links.
        tip_force_sigma_N: (D,) standard deviations of the contact forces.
        contact: (D,) 1 for each digit in contact, and 0 for each other digit.
        motor_position_rad: (M,) measured position at the spool. The value is NaN if the motor did
            not reply in this tick.
        motor_velocity_rad_s: (M,) measured motor velocities, converted to the spool.
        motor_torque_N_m: (M,) measured motor torques, converted to the spool.
        motor_temperature_degC: (M,) temperature of the hottest sensor in each drive.
        motor_age_s: (M,) age of the latest feedback of each motor.
    """

    k: int
    t_ns: int
    late_ns: int
    published_ns: int
    q_rad: Vector
    q_sigma_rad: Vector
    dq_rad_s: Vector
    q_goal_rad: Vector
    dq_goal_rad_s: Vector
    joint_torque_N_m: Vector
    tension_N: Vector
    tension_sigma_N: Vector
    tension_goal_N: Vector
    tip_force_N: Vector
    tip_force_sigma_N: Vector
    contact: Vector
    motor_position_rad: Vector
    motor_velocity_rad_s: Vector
    motor_torque_N_m: Vector
    motor_torque_goal_N_m: Vector
    motor_temperature_degC: Vector
    motor_age_s: Vector

    def __init__(self, record: NDArray[np.void], hand: Hand) -> None:
        """Create the observation from a record.

        Args:
            record: array of shape (), see ``runtime.observations.observation_dtype``.
            hand: description of the hand, for the names.
        """
        self.record = record
        self._hand = hand

    def __getattr__(self, name: str) -> Any:
        """Return the value of a field of the record, by the name of the field."""
        # An observation that is being copied or unpickled has no record yet.
        if name == "record":
            raise AttributeError(name)
        try:
            value = self.record[name]
        except (KeyError, ValueError):
            raise AttributeError(f"no field {name!r} in an observation") from None
        return value if value.shape else value.item()

    def __dir__(self) -> list[str]:
        """Return the names of all attributes, among them the fields of the record."""
        return sorted({*super().__dir__(), *(self.record.dtype.names or ())})

    @property
    def t_s(self) -> float:
        """Return the time of the tick since the start of the run [s]."""
        return int(self.record["t_ns"]) / 1e9

    @property
    def age_s(self) -> float:
        """Return the real time that has passed since the controller sent the commands of this tick [s]."""
        return (time.monotonic_ns() - int(self.record["published_ns"])) / 1e9

    @property
    def mode(self) -> str:
        """Return the mode of the hand, such as ``"ACTIVE"``."""
        return HandMode(int(self.record["mode"])).name

    @property
    def phase(self) -> str:
        """Return the phase of the program, such as ``"live"``."""
        return bytes(self.record["phase"].item()).decode("utf-8", "replace")

    @property
    def q_deg(self) -> Vector:
        """Return the estimated joint angles (J,) [deg], or positions [mm] for prismatic joints."""
        return self._hand.display_units.to_display_units(self.q_rad)

    @property
    def stream(self) -> StreamStatus:
        """Return the status of the open stream of targets, as the controller reports it."""
        fields = ("number", "age_s", "accepted", "clipped", "late", "refused", "limited")
        return StreamStatus(*[self.record[f"stream_{field}"].item() for field in fields])

    def names(self, field: str) -> tuple[str, ...]:
        """Return the name of each value in a field.

        For the field ``"q_rad"``, for example, the result contains the names of the joints.

        Raises:
            KeyError: the observation has no array with this name.
        """
        hand = self._hand
        axes = {"joint": hand.joints, "tendon": hand.tendon_names, "motor": hand.motor_names,
                "digit": hand.digit_names}  # fmt: skip
        return axes[AXIS_BY_FIELD[field]]

    def named(self, field: str) -> dict[str, float]:
        """Return the values of a field by name, as in ``observation.named("q_rad")["index_j1"]``."""
        return dict(zip(self.names(field), self.record[field].tolist(), strict=True))

    def __repr__(self) -> str:
        """Describe the observation in one line."""
        return f"<Observation k={self.k} t={self.t_s:.3f} s {self.mode} {self.phase}>"
