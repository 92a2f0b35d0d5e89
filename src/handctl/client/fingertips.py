"""Conversion of goal positions of the fingertips to goal angles of the joints.

The positions of the fingertips are given in the palm frame. The inverse kinematics finds joint
angles within the joint limits.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.client.stream import StreamOwner, TargetStream
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.inverse_kinematics import closest_tip
from handctl.hand.kinematics import joint_points
from handctl.runtime.target_socket import TargetSender

TipPositions = Mapping[str, Sequence[float] | NDArray[np.floating[Any]]] | NDArray[np.floating[Any]]
"""Positions of fingertips in the palm frame [m]: (D, 3) in the order of the digits, or (3,) for each digit by name."""


class Fingertips:
    """Inverse kinematics of digits.

    A search varies the joint angles until the fingertips are as close as possible to the given
    positions.

    Some digits cannot reach every position, for example a digit with one tendon for three joints.
    The tip of a digit that cannot reach its goal comes as close to the goal as possible. Each
    search starts from the result of the previous search, so that a continuous motion of the
    fingertips gives joint angles without jumps.

    Attributes:
        digits: names of the digits.
        joints: names of the joints of the digits, in order.
        distances_m: (D,) distance between each fingertip and its goal that remained after the
            latest search. Before the first search, the distance is NaN.
    """

    def __init__(self, hand: Hand, digits: Sequence[str] | None = None) -> None:
        """Build the kinematic models of digits.

        Args:
            hand: description of the hand.
            digits: names of the digits. If ``digits`` is None, all digits that are attached to the
                palm are used.

        Raises:
            ConfigError: the hand has no such digit, a name is given twice, or a digit is mounted on
                another digit. The tip of a digit that is mounted on another digit would move with
                the other digit.
        """
        fingertips_on_palm = [digit.name for digit in hand.digit if digit.mount_on is None]
        self.digits = tuple(fingertips_on_palm if digits is None else digits)
        for name in self.digits:
            if name not in fingertips_on_palm or self.digits.count(name) > 1:
                expected = f"some of {', '.join(fingertips_on_palm)}, each once"
                raise ConfigError(
                    f"{name!r}: no digit on the palm, or twice", "fingertips", expected
                )
        self._digit_models = [DigitModel.from_hand(hand, name) for name in self.digits]
        self.joints = tuple(joint for model in self._digit_models for joint in model.joint_names)
        self.distances_m = np.full(len(self.digits), np.nan)
        self._coordinates: list[NDArray[np.float64] | None] = [None] * len(self.digits)

    def tips(self, angles_rad: Mapping[str, float]) -> NDArray[np.float64]:
        """Return the positions (D, 3) [m] of the fingertips in the palm frame, at given joint angles.

        Args:
            angles_rad: joint angles [rad], by name of the joint, e.g. ``seen.named("q_rad")``
                [rad].
        """
        return np.array(
            [
                joint_points(model, [angles_rad[joint] for joint in model.joint_names])[-1]
                for model in self._digit_models
            ]
        )

    def angles_deg(self, positions: TipPositions) -> dict[str, float]:
        """Return the joint angles [deg] for positions of fingertips, by name of the joint, as ``hand.move`` needs them.

        Args:
            positions: goal positions of the fingertips. If a mapping does not contain a digit, the
                result has no angles for the joints of this digit.

        Raises:
            ConfigError: the positions have a wrong shape, a digit is unknown, or a position is not
                finite.
        """
        angles: dict[str, float] = {}
        for d, target in self._positions_by_digit(positions).items():
            model = self._digit_models[d]
            solution = closest_tip(model, target, self._coordinates[d])
            self._coordinates[d] = solution.coordinates
            self.distances_m[d] = solution.distance
            joints = model.joint_units.to_display_units(
                model.coupling @ solution.coordinates
            ).tolist()
            angles |= dict(zip(model.joint_names, joints, strict=True))
        return angles

    def _positions_by_digit(self, positions: TipPositions) -> dict[int, NDArray[np.float64]]:
        """Check goal positions of fingertips, and return a mapping from the index of each digit to its position."""
        if isinstance(positions, Mapping):
            if unknown_digits := [str(name) for name in positions if name not in self.digits]:
                raise ConfigError(
                    f"no {unknown_digits[0]!r}", "fingertips", f"some of {', '.join(self.digits)}"
                )
            position_by_digit = {
                self.digits.index(name): np.asarray(tip_position, np.float64)
                for name, tip_position in positions.items()
            }
        else:
            table = np.asarray(positions, np.float64)
            if table.shape != (len(self.digits), 3):
                raise ConfigError(
                    f"positions of shape {table.shape}", "fingertips", f"({len(self.digits)}, 3)"
                )
            position_by_digit = dict(enumerate(table))
        for d, target in position_by_digit.items():
            if target.shape != (3,) or not np.isfinite(target).all():
                raise ConfigError(
                    f"{target.tolist()} for {self.digits[d]}", "fingertips", "x, y, z [m]"
                )
        return position_by_digit


class FingertipStream(TargetStream):
    """Stream of fingertip positions. The method ``HandClient.stream`` returns such a stream.

    The client computes joint angles from the positions. The controller receives these joint angles,
    and limits the angles as in every stream.

    Attributes:
        fingertips: inverse kinematics of the digits. Its attribute ``distances_m`` contains the
            distance between each fingertip and its latest target.
    """

    def __init__(
        self, hand: StreamOwner, sender: TargetSender, goal: Mapping[str, Any], fingertips: Fingertips,
        horizon_s: float, time_scale: float,
    ) -> None:  # fmt: skip
        """Create a stream with which the client sends positions of fingertips.

        Args:
            hand: client of the hand.
            sender: sender of the targets.
            goal: request with which the stream was opened. The stream moves the joints of
                ``fingertips``.
            fingertips: inverse kinematics of the digits.
            horizon_s: time from the sending of a target until the hand should reach this target
                [s].
            time_scale: time of the hand that passes in a second of real time [s].
        """
        super().__init__(hand, sender, goal, "deg", horizon_s, time_scale)
        self.fingertips = fingertips
        self.space = "fingertip"
        self.joints = self.names
        self.names = fingertips.digits

    def _ordered_values(self, values: Any) -> NDArray[np.float64]:
        """Return the joint angles for positions of fingertips [deg].

        If a mapping leaves out a digit, the joint angles of this digit do not change.
        """
        angles = self.fingertips.angles_deg(values)
        target = self._present_values() if self._last is None else self._last.copy()
        for name, angle in angles.items():
            target[self.joints.index(name)] = angle
        return target

    def _present_values(self) -> NDArray[np.float64]:
        """Return the present joint angles [deg]."""
        present_angles = self._hand.observe().named("q_rad")
        display_units = self._hand.description.display_units
        factor_by_joint = dict(
            zip(self._hand.description.joints, display_units.factor.tolist(), strict=True)
        )
        return np.array([factor_by_joint[joint] * present_angles[joint] for joint in self.joints])
