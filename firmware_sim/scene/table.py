"""The table under the object, which sinks once the object is held."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from firmware_sim.compiled import compiled
from firmware_sim.scene.scene import Support


@compiled("vector", "counts", "counts", "real", "count", "flag")
def grasped(forces: Any, places: Any, opposed: Any, least: float, digits: int, both_sides: bool) -> bool:
    """Return whether enough digits press and, if so required, from both sides.

    Args:
        forces: x, y, z of the contact force on each digit [N], among other values.
        places: of the first value of each digit. opposed: for each digit, whether it closes against the first one.
        least: square of the force of a digit that presses [N2]. digits: that have to press. both_sides: see above.
    """
    pressing, against = 0, 0
    for i in range(len(places)):
        x, y, z = forces[places[i]], forces[places[i] + 1], forces[places[i] + 2]
        if x * x + y * y + z * z > least:
            pressing += 1
            against += opposed[i]
    return pressing >= digits and (not both_sides or 0 < against < pressing)


class Table:
    """Decides when the table sinks and how far it has sunk.

    Attributes:
        depth: how far below its first place [m].
        dropped_at: plant time at which it began to sink [s]; None before.
    """

    def __init__(self, support: Support, opposed: list[bool], places: Sequence[int] = (), laws: Any = None) -> None:
        """Set the table up.

        Args:
            support: of the scene.
            opposed: for each digit, whether it closes against the first one.
            places: of each digit's first value among the forces; by default one digit follows the other.
            laws: compiled ones of this module, which take the forces as an array; None for plain ones.
        """
        self._support = support
        where, sides = list(places) or list(range(0, 3 * len(opposed), 3)), [int(side) for side in opposed]
        self._law: Callable[..., bool] = laws.grasped if laws else grasped
        self._digits = (np.array(where, np.int64), np.array(sides, np.int64)) if laws else (where, sides)
        self._asked = support.drop_force**2, support.drop_digits, support.drop_opposed
        self._held_since: float | None = None
        self.depth = 0.0
        self.dropped_at: float | None = None

    @property
    def settled(self) -> bool:
        """Whether it stays where it is from now on."""
        if self.dropped_at is None:
            return self._support.drop_when != "grasped"
        return self.depth >= self._support.sink_depth

    def update(self, time: float, forces: Any) -> float:
        """Return the depth [m] at a time [s], given x, y, z of the contact force on each digit [N] in one list."""
        if self.dropped_at is None:
            self._watch(time, forces)
        if self.dropped_at is not None:
            self.depth = min(self._support.sink_depth, self._support.sink_speed * (time - self.dropped_at))
        return self.depth

    def _watch(self, time: float, forces: Any) -> None:
        if self._support.drop_when != "grasped" or not self._law(forces, *self._digits, *self._asked):
            self._held_since = None
            return
        if self._held_since is None:
            self._held_since = time
        if time - self._held_since >= self._support.drop_hold:
            self.dropped_at = time
