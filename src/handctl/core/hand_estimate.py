"""Estimate and measurements of a tick, as properties that task programs read.

The estimate and the measurements are views of the state block.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.estimation import contact_force
from handctl.core.estimation.filter_types import SLACK_REGIME
from handctl.core.tick_types import Vector

QuantityTable = NDArray[np.float64]


class _StateView(NamedTuple):
    """View of a state block, whose properties are read by task programs.

    Attributes:
        layout: layout of the state block.
        block: state block, not copied.
    """

    layout: BlockLayout
    block: BlockArray

    # Most ticks of a program need no table, so the views of the tables are created only when they
    # are used.

    @property
    def tendon(self) -> QuantityTable:
        """Return the table ``tendon`` of the state block."""
        return self.layout.table(self.block, "tendon")


class HandEstimate(_StateView):
    """Estimate of the hand's state at the present time.

    A property has the shape (N,), unless its docstring states another shape.
    """

    __slots__ = ()

    @property
    def joint(self) -> QuantityTable:
        """Return the table ``joint`` of the state block."""
        return self.layout.table(self.block, "joint")

    @property
    def digit(self) -> QuantityTable:
        """Return the table ``digit`` of the state block."""
        return self.layout.table(self.block, "digit")

    @property
    def regimes(self) -> NDArray[np.int64]:
        """Return the value of ``TendonRegime`` for each tendon: 0 free, 1 held, 2 slack.

        A taut tendon is free while its digit moves freely. A taut tendon is held while its digit
        rests on an object or on its open stop.
        """
        return self.layout.view(self.block, "regime")

    @property
    def tension(self) -> Vector:
        """Return the tension of each tendon at its load cell [N].

        The tension of a slack tendon is 0.
        """
        return self.tendon[s.TENSION]

    @property
    def tension_sigma(self) -> Vector:
        """Return the standard deviation of each tension [N]."""
        return self.tendon[s.TENSION_SIGMA]

    @property
    def travel(self) -> Vector:
        """Return the tendon length that each spool has wound [m]."""
        return self.tendon[s.SPOOL_TRAVEL]

    @property
    def tendon_speed(self) -> Vector:
        """Return the rate of each tendon's travel [m/s]."""
        return self.tendon[s.SPOOL_SPEED]

    @property
    def excursion(self) -> Vector:
        """Return the excursion of each tendon at the joints [m]."""
        return self.tendon[s.EXCURSION]

    @property
    def excursion_rate(self) -> Vector:
        """Return the rate of each tendon's excursion [m/s]."""
        return self.tendon[s.EXCURSION_RATE]

    @property
    def motor_disturbance(self) -> Vector:
        """Return the part of the force on each motor that the model does not explain [N]."""
        return self.tendon[s.MOTOR_DISTURBANCE]

    @property
    def external_tension(self) -> Vector:
        """Return the part of the load force on each tendon that the model does not explain [N].

        A force that resists the closing of the digit is positive. Contact with an object causes a
        positive force.
        """
        return self.tendon[s.EXTERNAL_TENSION]

    @property
    def stretch_offset(self) -> Vector:
        """Return the stretch offset of each tendon [m].

        If travel minus excursion is larger than the stretch offset, the tendon is stretched.
        """
        return self.tendon[s.STRETCH_OFFSET]

    @property
    def innovation(self) -> Vector:
        """Return the load-cell reading of each tendon minus the expected reading [N].

        If the reading is missing, the result is NaN.
        """
        return self.tendon[s.INNOVATION]

    @property
    def nis(self) -> Vector:
        """Return the normalised innovation squared (NIS) of the encoder and the load cell of each tendon.

        If a reading is missing, the NIS is NaN.
        """
        return self.tendon[s.NIS]

    @property
    def is_slack(self) -> NDArray[np.bool_]:
        """Return True for each tendon that is slack."""
        return np.asarray(self.regimes == SLACK_REGIME)

    @property
    def q(self) -> Vector:
        """Return the estimated joint angles (J,) [rad]."""
        return self.joint[s.Q]

    @property
    def dq(self) -> Vector:
        """Return the estimated joint rates (J,) [rad/s]."""
        return self.joint[s.DQ]

    @property
    def q_sigma(self) -> Vector:
        """Return the standard deviations of the joint angles (J,) [rad]."""
        return self.joint[s.Q_SIGMA]

    @property
    def contact_force(self) -> Vector:
        """Return the contact forces at the tips of closing digits (D,) [N].

        The result is corrected by the force error that was estimated before the contact.
        """
        return self.digit[s.CONTACT_FORCE]

    @property
    def grip_opening(self) -> Vector:
        """Return how far a digit that holds an object has recently opened, as a length along each tendon [m].

        For a tendon that opens its digit, an opening of the digit is negative.
        """
        return np.asarray(self.tendon[s.SLOW_GRIP_TRAVEL] - self.tendon[s.FAST_GRIP_TRAVEL])

    def largest_grip_opening(self, closing_sign: Vector, held_tension: Vector) -> tuple[int, float]:
        """Return the tendon whose gripping digit has recently opened most, and the opening along this tendon [m].

        The function ``contact_force.largest_grip_opening`` explains the result.
        """
        return contact_force.largest_grip_opening(
            self.block, self.layout.offsets, closing_sign, held_tension
        )

    @property
    def grip_travel(self) -> Vector:
        """Return the length on each spool minus the stretch of the tendon, averaged over 0.2 s [m]."""
        return self.tendon[s.SLOW_GRIP_TRAVEL]


class TickMeasurements(_StateView):
    """Measurements of a tick. A missing measurement is NaN.

    A property has the shape (N,), unless its docstring states another shape.
    """

    __slots__ = ()

    @property
    def travel(self) -> Vector:
        """Return the tendon length on each spool, as the motor encoders measure it [m]."""
        return self.tendon[s.MEASURED_TRAVEL]

    @property
    def motor_position(self) -> Vector:
        """Return the measured motor positions at the spool [rad]."""
        return self.tendon[s.MEASURED_POSITION]

    @property
    def tension(self) -> Vector:
        """Return the load-cell readings minus their tare [N]."""
        return self.tendon[s.MEASURED_TENSION]

    @property
    def excursion(self) -> Vector:
        """Return the excursion of each tendon, computed from the readings of the joint encoders [m]."""
        return self.tendon[s.MEASURED_EXCURSION]

    @property
    def joint_angles(self) -> Vector:
        """Return the readings of the joint encoders (J,) [rad]."""
        return self.layout.view(self.block, "measured_joint")
