"""The table under the object of a scene. The table sinks after the hand has grasped the object."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.compiled import compiled
from firmware_sim.scene.scene import SinkingTable


@compiled("vector", "counts", "counts", "real", "count", "flag")
def is_object_grasped(
    contact_forces: Any,
    force_indices: Any,
    is_opposed: Any,
    min_force_squared: float,
    digits: int,
    both_sides: bool,
) -> bool:
    """Return True if enough digits press on the object.

    If ``both_sides`` is True, digits must press on both sides of the object.

    Args:
        contact_forces: array that contains x, y, z of the contact force on each digit [N], among other
            values.
        force_indices: index in ``contact_forces`` of the first value of each digit, shape
            (digits,).
        is_opposed: 1 for each digit that closes against the first digit, and 0 for the other
            digits, shape (digits,).
        min_force_squared: square of the smallest force with which a digit counts as pressing [N2].
        digits: number of digits that must press.
        both_sides: True if digits on both sides of the object must press.
    """
    pressing_digit_count = 0
    opposed_digit_count = 0
    for i in range(len(force_indices)):
        x = contact_forces[force_indices[i]]
        y = contact_forces[force_indices[i] + 1]
        z = contact_forces[force_indices[i] + 2]
        if x * x + y * y + z * z > min_force_squared:
            pressing_digit_count += 1
            opposed_digit_count += is_opposed[i]
    # If both sides are required, at least one opposed digit and at least one other digit must
    # press.
    return pressing_digit_count >= digits and (
        not both_sides or 0 < opposed_digit_count < pressing_digit_count
    )


class SupportTable:
    """The sinking table under the object.

    Attributes:
        depth: distance of the table below its initial position [m].
        dropped_at: plant time when the table started to sink [s], or None before the table sinks.
    """

    def __init__(
        self,
        support: SinkingTable,
        is_opposed: list[bool],
        indices: Sequence[int] = (),
        kernels: Any = None,
    ) -> None:
        """Place the table at its initial position.

        Args:
            support: description of the table, from the scene.
            is_opposed: True for each digit that closes against the first digit.
            indices: for each digit, the index in ``forces`` at which the force on this digit
                begins. By default, the forces are three values for each digit, one digit after the
                other.
            kernels: compiled kernels of this module, for forces in an array. If None, the table
                uses the Python functions.
        """
        self._support = support
        start_indices = list(indices) or list(range(0, 3 * len(is_opposed), 3))
        opposed_flags = [int(side) for side in is_opposed]
        self._grasped: Callable[..., bool] = (
            kernels.is_object_grasped if kernels else is_object_grasped
        )
        self._digits = (
            (np.array(start_indices, np.int64), np.array(opposed_flags, np.int64))
            if kernels
            else (start_indices, opposed_flags)
        )
        # If the hand has fewer digits than required, all digits of the hand must hold the object.
        digits = min(support.drop_digits, len(is_opposed))
        self._criteria = support.drop_force**2, digits, support.drop_opposed
        self._grasped_since: float | None = None
        self.depth = 0.0
        self.dropped_at: float | None = None

    @property
    def is_settled(self) -> bool:
        """Return True if the table will not move any more."""
        if self.dropped_at is None:
            return self._support.drop_when != "grasped"
        return self.depth >= self._support.sink_depth

    def update(self, time: float, forces: Any) -> float:
        """Update how far the table has sunk, and return the depth.

        Args:
            time: present time of the plant [s].
            forces: components x, y, z of the contact force on each digit [N], in one list or array.

        Returns:
            The depth of the table below its initial position [m].
        """
        if self.dropped_at is None:
            self._check_grasp(time, forces)
        if self.dropped_at is not None:
            self.depth = min(
                self._support.sink_depth, self._support.sink_speed * (time - self.dropped_at)
            )
        return self.depth

    def _check_grasp(self, time: float, forces: Any) -> None:
        """Let the table sink when the digits have held the object long enough.

        The digits must hold the object for the time ``drop_hold`` without a break.
        """
        if self._support.drop_when != "grasped" or not self._grasped(
            forces, *self._digits, *self._criteria
        ):
            self._grasped_since = None
            return
        if self._grasped_since is None:
            self._grasped_since = time
        if time - self._grasped_since >= self._support.drop_hold:
            self.dropped_at = time
