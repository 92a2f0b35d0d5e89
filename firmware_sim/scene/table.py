"""The table under the object, which sinks once the object is held."""

from firmware_sim.scene.scene import Support


class Table:
    """Decides when the table sinks and how far it has sunk.

    Attributes:
        depth: how far below its first place [m].
        dropped_at: plant time at which it began to sink [s]; None before.
    """

    def __init__(self, support: Support, opposed: list[bool]) -> None:
        """Args: the scene's support; for each digit, whether it closes against the first one."""
        self._support, self._opposed = support, opposed
        self._held_since: float | None = None
        self.depth = 0.0
        self.dropped_at: float | None = None

    @property
    def settled(self) -> bool:
        """Whether it stays where it is from now on."""
        if self.dropped_at is None:
            return self._support.drop_when != "grasped"
        return self.depth >= self._support.sink_depth

    def update(self, time: float, forces: list[float]) -> float:
        """Return the depth [m] at a time [s], given x, y, z of the contact force on each digit [N] in one list."""
        if self.dropped_at is None:
            self._watch(time, forces)
        if self.dropped_at is not None:
            self.depth = min(self._support.sink_depth, self._support.sink_speed * (time - self.dropped_at))
        return self.depth

    def _watch(self, time: float, forces: list[float]) -> None:
        if self._support.drop_when != "grasped" or not self._grasped(forces):
            self._held_since = None
            return
        if self._held_since is None:
            self._held_since = time
        if time - self._held_since >= self._support.drop_hold:
            self.dropped_at = time

    def _grasped(self, forces: list[float]) -> bool:
        """Whether enough digits press, and if so asked from both sides."""
        least = self._support.drop_force**2
        squares = [x * x + y * y + z * z for x, y, z in zip(forces[::3], forces[1::3], forces[2::3], strict=True)]
        pressing = [side for side, square in zip(self._opposed, squares, strict=True) if square > least]
        enough = len(pressing) >= self._support.drop_digits
        return enough and (not self._support.drop_opposed or (any(pressing) and not all(pressing)))
