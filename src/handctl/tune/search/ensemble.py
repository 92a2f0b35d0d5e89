"""Random ensembles of plants. The parameters of the plants differ from those of the identified hand.

If the identified parameters are more uncertain, the differences between the plants are larger.
"""

from collections.abc import Mapping

import numpy as np
from scipy.stats import qmc

from handctl.core.identified_parameters import IdentifiedParameters

MIN_FACTOR_SPREAD = {
    "stiffness": 0.2,
    "friction": 0.5,
    "mass": 0.2,
    "spring": 0.1,
    "motor_inertia": 0.1,
    "damping": 0.5,
}
"""Smallest half width of the range of each factor, even if an identification is more precise.

The smallest half widths exist because stiffness and friction of a tendon change during use. The
keys of the table are the keys of the option `perturb` of the simulator.
"""

MAX_FACTOR_SPREAD = 0.9
"""Largest half width of the range of a factor. No real plant has a factor near zero."""


def sample_ensemble(
    plant_count: int, seed: int, spread_of_factor: Mapping[str, float] | None = None
) -> tuple[dict[str, float], ...]:
    """Return factors for the parameters of each plant: first the nominal plant, and then random plants.

    The random plants are points of a scrambled Sobol sequence.

    Args:
        plant_count: number of plants, including the nominal plant.
        seed: seed of the sequence.
        spread_of_factor: half width of the range of each factor, for example from an
            identification. If the half width is smaller than the value in `MIN_FACTOR_SPREAD`, the
            value in this table is used.

    Returns:
        `plant_count` tables, each with the factor of each key.
    """
    half_widths = {
        key: min(MAX_FACTOR_SPREAD, max(min_spread, (spread_of_factor or {}).get(key, 0.0)))
        for key, min_spread in MIN_FACTOR_SPREAD.items()
    }
    # A Sobol sequence is balanced only if its length is a power of two. Therefore the length of the
    # sequence is rounded up to a power of two.
    drawn_samples = qmc.Sobol(len(half_widths), seed=seed).random(
        1 << max(0, (max(plant_count - 1, 1) - 1).bit_length())
    )
    factors = 1.0 + np.array(list(half_widths.values())) * (
        2.0 * drawn_samples[: max(plant_count - 1, 0)] - 1.0
    )
    nominal = dict.fromkeys(half_widths, 1.0)
    return (nominal, *(dict(zip(half_widths, map(float, row), strict=True)) for row in factors))[
        :plant_count
    ]


FACTOR_BY_PARAMETER = {
    "tendon_stiffness": "stiffness",
    "capstan": "friction",
    "motor_coulomb": "friction",
    "motor_viscous": "damping",
    "joint_damping": "damping",
    "spring_stiffness": "spring",
    "motor_inertia": "motor_inertia",
}
"""Name of the ensemble factor that scales each identified parameter."""


def factor_half_widths(identified: Mapping[str, IdentifiedParameters]) -> dict[str, float]:
    """Return, for each factor, half of the width of the factor's range.

    A factor is relative to the identified value of a parameter. The range of the factor contains
    the 95 % confidence interval of this parameter for each tendon.

    Args:
        identified: identified parameters, by the name of the tendon.
    """
    spread: dict[str, float] = {}
    for tendon in identified.values():
        for name, value, half_width in zip(
            tendon.names, tendon.values, tendon.half_widths, strict=True
        ):
            if name in FACTOR_BY_PARAMETER and value > 0.0:
                spread[FACTOR_BY_PARAMETER[name]] = max(
                    spread.get(FACTOR_BY_PARAMETER[name], 0.0), half_width / value
                )
    return spread
