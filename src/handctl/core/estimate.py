"""What programs read of a tick: estimate and measurements, as arrays over the block."""

import numpy as np
from numpy.typing import NDArray

from handctl.core import block as s
from handctl.core.types import Vector

Table = NDArray[np.float64]


class Estimate:
    """The present instant, (N,) each unless said otherwise.

    Attributes:
        tendon, joint, digit: tables of the block. regimes: (N,) 0 free, 1 held, 2 slack.
    """

    __slots__ = ("digit", "joint", "regimes", "tendon")

    def __init__(self, tendon: Table, joint: Table, digit: Table, regimes: NDArray[np.int64]) -> None:
        self.tendon, self.joint, self.digit, self.regimes = tendon, joint, digit, regimes

    @property
    def tension(self) -> Vector:
        """At the load cell [N]; 0 in slack."""
        return self.tendon[s.TENSION]

    @property
    def sigma(self) -> Vector:
        """Standard deviation of the tension [N]."""
        return self.tendon[s.SIGMA]

    @property
    def travel(self) -> Vector:
        """Tendon wound at the spool [m]."""
        return self.tendon[s.TRAVEL]

    @property
    def speed(self) -> Vector:
        """Rate of the travel [m/s]."""
        return self.tendon[s.SPEED]

    @property
    def excursion(self) -> Vector:
        """At the joints [m]."""
        return self.tendon[s.EXCURSION]

    @property
    def rate(self) -> Vector:
        """Rate of the excursion [m/s]."""
        return self.tendon[s.EXCURSION_RATE]

    @property
    def disturbance(self) -> Vector:
        """Force on the motor that the model lacks [N]."""
        return self.tendon[s.DISTURBANCE]

    @property
    def external(self) -> Vector:
        """Load force that the model lacks, positive against closing: contact [N]."""
        return self.tendon[s.EXTERNAL]

    @property
    def offset(self) -> Vector:
        """Stretch offset [m]."""
        return self.tendon[s.STRETCH_OFFSET]

    @property
    def innovation(self) -> Vector:
        """Load cell less prediction [N]; NaN if missing."""
        return self.tendon[s.INNOVATION]

    @property
    def nis(self) -> Vector:
        """Normalised innovation squared of encoder and load cell; NaN if missing."""
        return self.tendon[s.NIS]

    @property
    def slack(self) -> NDArray[np.bool_]:
        """Whether the tendon is slack."""
        return np.asarray(self.regimes == 2)

    @property
    def q(self) -> Vector:
        """(J,) joint angles [rad]."""
        return self.joint[s.Q]

    @property
    def dq(self) -> Vector:
        """(J,) joint rates [rad/s]."""
        return self.joint[s.DQ]

    @property
    def q_sigma(self) -> Vector:
        """(J,) standard deviation of the joint angles [rad]."""
        return self.joint[s.Q_SIGMA]

    @property
    def grown(self) -> Vector:
        """(D,) what counts as contact of the force felt at the tips of closing digits [N]."""
        return self.digit[s.GROWN]

    @property
    def opening(self) -> Vector:
        """How far a grip is being pushed open, along the tendons [m]."""
        return np.asarray(self.tendon[s.GRIP_SLOW] - self.tendon[s.GRIP_FAST])

    @property
    def grip(self) -> Vector:
        """Tendon wound less stretch, slowly averaged, up to a constant [m]."""
        return self.tendon[s.GRIP_SLOW]


class Measured:
    """Measurements of one tick, (N,) each unless said otherwise; NaN where nothing came."""

    __slots__ = ("joint", "tendon")

    def __init__(self, tendon: Table, joint: Table) -> None:
        self.tendon, self.joint = tendon, joint

    @property
    def travel(self) -> Vector:
        """Encoder, at the spool [m]."""
        return self.tendon[s.MEASURED_TRAVEL]

    @property
    def position(self) -> Vector:
        """Encoder, at the spool [rad]."""
        return self.tendon[s.MEASURED_POSITION]

    @property
    def tension(self) -> Vector:
        """Load cell, tared [N]."""
        return self.tendon[s.MEASURED_TENSION]

    @property
    def excursion(self) -> Vector:
        """By joint encoders [m]."""
        return self.tendon[s.MEASURED_EXCURSION]

    @property
    def joints(self) -> Vector:
        """(J,) joint encoders [rad]."""
        return self.joint[s.MEASURED_JOINT]
