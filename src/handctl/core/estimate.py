"""Estimate and measurements of a tick, as views into the state block, for programs."""

import numpy as np
from numpy.typing import NDArray

from handctl.core import block as s
from handctl.core.types import Vector

Table = NDArray[np.float64]


class Estimate:
    """Estimate of the present instant. Each property is (N,) unless its text gives another shape.

    Attributes:
        tendon: table ``tendon`` of the state block.
        joint: table ``joint`` of the state block.
        digit: table ``digit`` of the state block.
        regimes: (N,) regime of each tendon: 0 free, 1 held, 2 slack.
    """

    __slots__ = ("digit", "joint", "regimes", "tendon")

    def __init__(self, tendon: Table, joint: Table, digit: Table, regimes: NDArray[np.int64]) -> None:
        """Keep the tables, without a copy.

        Args:
            tendon: table ``tendon`` of the state block.
            joint: table ``joint`` of the state block.
            digit: table ``digit`` of the state block.
            regimes: (N,) regime of each tendon.
        """
        self.tendon = tendon
        self.joint = joint
        self.digit = digit
        self.regimes = regimes

    @property
    def tension(self) -> Vector:
        """Return the tension at the load cell [N], 0 in slack."""
        return self.tendon[s.TENSION]

    @property
    def sigma(self) -> Vector:
        """Return the standard deviation of the tension [N]."""
        return self.tendon[s.TENSION_SIGMA]

    @property
    def travel(self) -> Vector:
        """Return the length of tendon wound on the spool [m]."""
        return self.tendon[s.TRAVEL]

    @property
    def speed(self) -> Vector:
        """Return the rate of the travel [m/s]."""
        return self.tendon[s.SPEED]

    @property
    def excursion(self) -> Vector:
        """Return the excursion at the joints [m]."""
        return self.tendon[s.EXCURSION]

    @property
    def rate(self) -> Vector:
        """Return the rate of the excursion [m/s]."""
        return self.tendon[s.EXCURSION_RATE]

    @property
    def disturbance(self) -> Vector:
        """Return the force on the motor that the model does not explain [N]."""
        return self.tendon[s.DISTURBANCE]

    @property
    def external(self) -> Vector:
        """Return the load force that the model does not explain, positive against closing [N]. Contact causes it."""
        return self.tendon[s.EXTERNAL_TENSION]

    @property
    def offset(self) -> Vector:
        """Return the travel less the excursion at which the stretch begins [m]."""
        return self.tendon[s.STRETCH_OFFSET]

    @property
    def innovation(self) -> Vector:
        """Return load cell minus prediction [N], NaN if missing."""
        return self.tendon[s.INNOVATION]

    @property
    def nis(self) -> Vector:
        """Return the normalised innovation squared of encoder and load cell, NaN if missing."""
        return self.tendon[s.NIS]

    @property
    def slack(self) -> NDArray[np.bool_]:
        """Return True for each slack tendon."""
        return np.asarray(self.regimes == 2)

    @property
    def q(self) -> Vector:
        """Return (J,) joint angles [rad]."""
        return self.joint[s.Q]

    @property
    def dq(self) -> Vector:
        """Return (J,) joint rates [rad/s]."""
        return self.joint[s.DQ]

    @property
    def q_sigma(self) -> Vector:
        """Return (J,) standard deviation of the joint angles [rad]."""
        return self.joint[s.Q_SIGMA]

    @property
    def contact_force(self) -> Vector:
        """Return (D,) contact force at the tips of closing digits, without errors before the contact [N]."""
        return self.digit[s.CONTACT_FORCE]

    @property
    def grip_opening(self) -> Vector:
        """Return the recent opening of a grip along the tendons [m]."""
        return np.asarray(self.tendon[s.GRIP_TRAVEL_SLOW] - self.tendon[s.GRIP_TRAVEL_FAST])

    @property
    def grip(self) -> Vector:
        """Return the length wound minus stretch, averaged over 0.2 s [m]."""
        return self.tendon[s.GRIP_TRAVEL_SLOW]


class Measured:
    """Measurements of a tick, NaN if missing. Each property is (N,) unless its text gives another shape."""

    __slots__ = ("joint", "tendon")

    def __init__(self, tendon: Table, joint: Table) -> None:
        """Keep the tables, without a copy.

        Args:
            tendon: table ``tendon`` of the state block.
            joint: table ``joint`` of the state block.
        """
        self.tendon = tendon
        self.joint = joint

    @property
    def travel(self) -> Vector:
        """Return the length wound on each spool, by the motor encoders [m]."""
        return self.tendon[s.MEASURED_TRAVEL]

    @property
    def position(self) -> Vector:
        """Return the motor positions by the encoders, at the spool [rad]."""
        return self.tendon[s.MEASURED_POSITION]

    @property
    def tension(self) -> Vector:
        """Return the load-cell readings, tared [N]."""
        return self.tendon[s.MEASURED_TENSION]

    @property
    def excursion(self) -> Vector:
        """Return the excursions from joint encoders [m]."""
        return self.tendon[s.MEASURED_EXCURSION]

    @property
    def joints(self) -> Vector:
        """Return (J,) joint encoder readings [rad]."""
        return self.joint[s.MEASURED_JOINT]
