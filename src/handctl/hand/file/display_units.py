"""Units of joint positions for a user: deg for a hinge, and mm for a prismatic joint.

Inside handctl, the units of joint positions are rad and m.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

EQUIVALENT_M_PER_RAD = 0.01
"""Motion of a prismatic joint that counts as 1 rad of a hinge in thresholds and tolerances [m/rad].

The value is the moment arm of a tendon at a usual hinge. A tendon motion of 0.01 m turns a hinge
with a moment arm of 0.01 m by 1 rad.
"""
DISPLAY_UNIT_NAMES = ("deg", "mm")
"""Displayed units of the positions of a hinge and of a prismatic joint."""
SI_UNIT_NAMES = ("rad", "m")
"""Units of the positions of a hinge and of a prismatic joint, in logs and calculations."""


class DisplayUnits(NamedTuple):
    """Conversion of the positions (n,) of joints or coordinates between SI units and displayed units.

    Attributes:
        is_prismatic: (n,) True for the positions that are in m.
        factor: (n,) displayed value per SI value [deg/rad or mm/m].
        si_factor: (n,) SI value per displayed value.
        scale: (n,) factor that converts a threshold in rad to the unit of each position: 1, or
            ``EQUIVALENT_M_PER_RAD``.
        displayed_per_degree: (n,) displayed change that counts as 1 deg in a speed limit: 1, or 0.17 mm.
    """

    is_prismatic: NDArray[np.bool_]
    factor: Array
    si_factor: Array
    scale: Array
    displayed_per_degree: Array

    @classmethod
    def of(cls, is_prismatic: ArrayLike) -> "DisplayUnits":
        """Return the units of positions (n,). ``is_prismatic`` is True for each position of a prismatic joint."""
        prismatic_mask = np.asarray(is_prismatic, dtype=np.bool_)
        # The factors of hinges are the same as in math.degrees and math.radians.
        return cls(
            prismatic_mask,
            np.where(prismatic_mask, 1000.0, 180.0 / np.pi),
            np.where(prismatic_mask, 0.001, np.pi / 180.0),
            np.where(prismatic_mask, EQUIVALENT_M_PER_RAD, 1.0),
            np.where(prismatic_mask, 1000.0 * EQUIVALENT_M_PER_RAD * np.pi / 180.0, 1.0),
        )

    def to_display_units(self, values: ArrayLike) -> Array:
        """Convert positions (.., n) [rad or m] to displayed units [deg or mm]."""
        return np.asarray(np.asarray(values, dtype=np.float64) * self.factor)

    def to_si_units(self, values: ArrayLike) -> Array:
        """Convert displayed positions (.., n) [deg or mm] to SI units [rad or m]."""
        return np.asarray(np.asarray(values, dtype=np.float64) * self.si_factor)

    def as_equivalent_angles(self, values: ArrayLike) -> Array:
        """Convert positions (.., n) [rad or m] to angles [rad] that can be compared with each other.

        The angle of a hinge stays the same. For a prismatic joint, a distance of 1 mm becomes an
        angle of 1 deg.
        """
        return np.asarray(np.asarray(values, dtype=np.float64) / (self.si_factor / (np.pi / 180.0)))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the displayed unit of each position."""
        return tuple(
            DISPLAY_UNIT_NAMES[int(unit_is_length)] for unit_is_length in self.is_prismatic
        )
