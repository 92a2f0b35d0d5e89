"""Estimate and measurements of a tick as arrays over the block, for programs."""

import numpy as np
from numpy.typing import NDArray

from handctl.core import block as s
from handctl.core.types import Vector

Table = NDArray[np.float64]


class Estimate:
    """Estimate of the present instant, (N,) each unless stated otherwise.

    Attributes:
        tendon: table of the block.
        joint: table of the block.
        digit: table of the block.
        regimes: (N,) 0 free, 1 held, 2 slack.
    """

    __slots__ = ("digit", "joint", "regimes", "tendon")

    def __init__(self, tendon: Table, joint: Table, digit: Table, regimes: NDArray[np.int64]) -> None:
        """Keep the tables, without a copy.

        Args:
            tendon: table of the block.
            joint: table of the block.
            digit: table of the block.
            regimes: (N,) of the tendons.
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
        return self.tendon[s.SIGMA]

    @property
    def travel(self) -> Vector:
        """Return the tendon wound at the spool [m]."""
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
        """Return the force on the motor beyond the model [N]."""
        return self.tendon[s.DISTURBANCE]

    @property
    def external(self) -> Vector:
        """Return the load force beyond the model, positive against closing: contact [N]."""
        return self.tendon[s.EXTERNAL]

    @property
    def offset(self) -> Vector:
        """Return the stretch offset [m]."""
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
        """Return (D,) contact force at the tips of closing digits, without the mean before contact [N]."""
        return self.digit[s.CONTACT_FORCE]

    @property
    def grip_opening(self) -> Vector:
        """Return the opening of a grip along the tendons [m]."""
        return np.asarray(self.tendon[s.GRIP_SLOW] - self.tendon[s.GRIP_FAST])

    @property
    def grip(self) -> Vector:
        """Return the tendon wound minus stretch, slowly averaged, up to a constant [m]."""
        return self.tendon[s.GRIP_SLOW]


class Measured:
    """Measurements of a tick, (N,) each unless stated otherwise, NaN if missing."""

    __slots__ = ("joint", "tendon")

    def __init__(self, tendon: Table, joint: Table) -> None:
        """Keep the tables, without a copy.

        Args:
            tendon: table of the block.
            joint: table of the block.
        """
        self.tendon = tendon
        self.joint = joint

    @property
    def travel(self) -> Vector:
        """Return the encoder readings along the tendon, at the spool [m]."""
        return self.tendon[s.MEASURED_TRAVEL]

    @property
    def position(self) -> Vector:
        """Return the encoder readings at the spool [rad]."""
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
