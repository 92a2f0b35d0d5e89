"""Model of a hand.

The model contains all constants of a run that follow from the hand description and the gains.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.core.control_law.computed_torque import MIN_RELAXED_TENSION_N
from handctl.core.control_law.tendon_redundancy import TendonRedundancy, redundancy_of_hand
from handctl.core.deferred_imports import DeferredModule
from handctl.core.estimation.filter_types import FilterDesign
from handctl.core.gains.filter_design import design_filter
from handctl.core.gains.gains import Gains
from handctl.core.gains.motion_design import MotionDesign, design_motion
from handctl.core.tendon_constants import TendonConstants, collect_tendon_constants
from handctl.core.tick_types import Vector
from handctl.hand.description import Hand
from handctl.hand.digit import JointValues
from handctl.hand.dynamics import DigitModel, required_torque
from handctl.hand.link_tree import LinkTree

linalg = DeferredModule("scipy.linalg")

MARGIN_SIGMAS_WITHOUT_CELL = 2.0
"""Margin of the tension limits of a tendon without load cell, in standard deviations of its estimated tension."""
InverseDynamics = Callable[[DigitModel, JointValues, JointValues, JointValues], tuple[float, ...]]
"""Inverse dynamics: a function of digit, joint angles, rates and accelerations that returns the joint torques."""


@dataclass(frozen=True, slots=True, eq=False)
class HandModel:
    """A hand, its gains, and all constants that follow from both.

    Attributes:
        hand: description of the hand.
        gains: gains of the controller.
        period: control period [s].
        digits: digit models, in file order.
        coupling: (J, C) change of each joint angle per unit of each coordinate of the digits.
        digit_tendons: for each digit, the slice of its tendons among all tendons of the hand.
        digit_coordinates: for each digit, the slice of its coordinates among all coordinates of the
            hand.
        coordinate_limits: (2, C) lowest and highest value of each coordinate [rad].
        tendon_constants: constants of the hand along the tendons.
        filter_design: constant Kalman filter of each tendon.
        motion_design: feedback gains of the motion loop and the tension loop of each tendon.
        digit_of_tendon: for each tendon, the index of its digit.
        excursion_to_joints: (J, N) change of each joint angle per excursion of each tendon [rad/m].
        torque_to_tension: (N, J) smallest tensions per torque of each joint [1/m].
        pulleys: (N, J) 1 if a tendon passes the pulley of a joint, 0 if not.
        pulley_weights: (N, J) moment arm at each pulley, divided by the sum of all moment arms of
            the tendon.
        friction_coefficient: (N,) friction coefficient of the pulleys.
        wrap_angle: (N,) wrap angle of each tendon before its first joint pulley [rad].
        floor: (N,) smallest allowed tension at the load cell [N]. For a spool pair, the smallest
            value is the negative of the largest net tension.
        ceiling: (N,) largest allowed tension at the load cell [N]. For a spool pair, the value is
            the largest net tension.
        torque_limit: (N,) largest motor torque that the host is allowed to command [N m].
        redundancy: directions of the tendons, and tensions that balance each other.
        link_tree: tree of all links of the hand.
        margin_without_cell: (N,) margin by which the tension limits of a tendon without a load cell are
            stricter [N]. The value is 0 for a tendon with a load cell.
        torque_gain: (N,) torque at the spool per commanded torque. None if no run has
            identified it.
        inverse_dynamics: function of the inverse dynamics of a digit. Experiments can replace the
            function.
    """

    hand: Hand
    gains: Gains
    period: float
    digits: tuple[DigitModel, ...]
    coupling: Vector
    digit_tendons: tuple[slice, ...]
    digit_coordinates: tuple[slice, ...]
    coordinate_limits: Vector
    digit_of_tendon: tuple[int, ...]
    tendon_constants: TendonConstants
    filter_design: FilterDesign
    motion_design: MotionDesign
    excursion_to_joints: Vector
    torque_to_tension: Vector
    pulleys: Vector
    pulley_weights: Vector
    friction_coefficient: Vector
    wrap_angle: Vector
    floor: Vector
    ceiling: Vector
    torque_limit: Vector
    redundancy: TendonRedundancy
    link_tree: LinkTree
    margin_without_cell: Vector
    torque_gain: Vector | None = None
    inverse_dynamics: InverseDynamics = required_torque

    @staticmethod
    def from_hand(
        hand: Hand, gains: Gains, rate_hz: float, torque_gain: Vector | None = None
    ) -> "HandModel":
        """Compute the model of a hand, and design all gains of the controller.

        The design of the gains takes about 0.1 s.

        Args:
            hand: description of the hand.
            gains: gains of the controller.
            rate_hz: control rate [Hz].
            torque_gain: (N,) torque at the spool divided by the commanded torque, or None if no run
                has identified this ratio.
        """
        digits = tuple(DigitModel.from_hand(hand, digit.name) for digit in hand.digit)
        tendon_constants = collect_tendon_constants(hand, digits)
        tendons = hand.tendon
        arms = np.abs(hand.moment_arms_of_own_digit)
        period = 1.0 / rate_hz
        filter_design = design_filter(
            tendon_constants, gains.filter, period, _joint_period(hand, period)
        )
        margin = np.where(
            hand.has_cell, 0.0, MARGIN_SIGMAS_WITHOUT_CELL * filter_design.held_tension_sigma
        )
        # The margin of tendons without load cell raises the tension floor only in digits with more
        # tendons than coordinates. A higher tension floor would close any other digit.
        has_surplus_tendons = np.array(
            [
                len(digit.moment_arms) > digit.coupling.shape[1]
                for digit in digits
                for _ in digit.moment_arms
            ]
        )
        floor = np.array([tendon.tension_floor_N for tendon in tendons]) + np.where(
            has_surplus_tendons, margin, 0.0
        )
        ceiling = np.array([tendon.tension_max_N for tendon in tendons]) - margin
        floor = np.where(hand.is_pair, -ceiling, floor)
        return HandModel(
            hand=hand,
            gains=gains,
            period=1.0 / rate_hz,
            digits=digits,
            coupling=linalg.block_diag(*(digit.coupling for digit in digits)),
            digit_tendons=tuple(digit.tendons for digit in digits),
            digit_coordinates=_coordinate_slices(digits),
            coordinate_limits=np.concatenate([digit.coordinate_limits for digit in digits], axis=1),
            digit_of_tendon=tuple(
                d
                for d, digit in enumerate(digits)
                for _ in range(digit.tendons.start, digit.tendons.stop)
            ),
            tendon_constants=tendon_constants,
            filter_design=filter_design,
            motion_design=design_motion(tendon_constants, gains, 1.0 / rate_hz),
            excursion_to_joints=linalg.block_diag(*(digit.excursion_to_joints for digit in digits)),
            torque_to_tension=linalg.block_diag(*(digit.torque_to_tension for digit in digits)),
            pulleys=(arms > 0.0).astype(np.float64),
            pulley_weights=arms / arms.sum(axis=1, keepdims=True),
            friction_coefficient=np.array([tendon.friction_coefficient for tendon in tendons]),
            wrap_angle=np.array([tendon.wrap_angle_rad for tendon in tendons]),
            floor=floor,
            ceiling=ceiling,
            torque_limit=_torque_limit(hand, torque_gain),
            redundancy=redundancy_of_hand(digits, floor, ceiling, hand.is_pair),
            link_tree=LinkTree.from_hand(hand, digits),
            margin_without_cell=margin,
            torque_gain=torque_gain,
        )

    @property
    def tendon_count(self) -> int:
        """Return N, the number of tendons of the hand."""
        return len(self.floor)

    @property
    def relaxed_tensions(self) -> Vector:
        """Return the tensions of all tendons of a relaxed hand (N,) [N].

        In a relaxed hand, a digit with more tendons than coordinates keeps balance tensions, which
        make no torque. A spool pair has no net tension in a relaxed hand.
        """
        unpaired_tensions = np.where(
            self.redundancy.balance_tension > 0.0,
            self.redundancy.balance_tension,
            MIN_RELAXED_TENSION_N,
        )
        return np.where(self.is_pair, 0.0, unpaired_tensions)

    @property
    def is_pair(self) -> NDArray[np.bool_]:
        """Return True for each tendon that is a spool pair (N,)."""
        return self.hand.is_pair

    @property
    def coordinate_count(self) -> int:
        """Return C, the total number of reduced coordinates of all digits."""
        return int(self.coupling.shape[1])


def _coordinate_slices(digits: tuple[DigitModel, ...]) -> tuple[slice, ...]:
    """Return for each digit the slice of its coordinates among all coordinates of the hand."""
    counts = [digit.coupling.shape[1] for digit in digits]
    end_indices = np.cumsum(counts).tolist()
    return tuple(slice(end - count, end) for end, count in zip(end_indices, counts, strict=True))


def _torque_limit(hand: Hand, gain: Vector | None) -> Vector:
    """Return the largest torque that the host is allowed to command to each drive (N,) [N m at the spool].

    The hand file and the drive limit the torque. A drive with a torque gain below 1 makes less
    torque than commanded, and the torque gain reduces its largest torque as well. A drive refuses a
    command that exceeds the torque limit, even by a rounding error. The conversion of a torque by
    the spool radius and the torque gain has rounding errors, so the torque could exceed the limit.
    The returned limit is smaller than the exact limit by the fraction 1e-12, so that no drive
    refuses a command.
    """
    torque_limit = np.array(
        [hand.motor_of_tendon(tendon.name).torque_max_N_m for tendon in hand.tendon]
    ) * (1.0 - 1e-12)
    return torque_limit if gain is None else torque_limit * np.minimum(gain, 1.0)


def _joint_period(hand: Hand, period_s: float) -> Vector:
    """Return the sampling period of the joint encoders along each tendon (N,) [s].

    If any joint of a tendon has no encoder, the period of the tendon is inf.
    """
    return np.where(
        hand.tendons_with_encoders, hand.sensor_node.joint_decimation * period_s, np.inf
    )
