"""Plants that the real one may be: drawn around the hand as it is known, as far as that leaves them uncertain."""

from collections.abc import Mapping

import numpy as np
from scipy.stats import qmc

from handctl.core.identified import Identified

LEAST_SPREAD = {"stiffness": 0.2, "friction": 0.5, "mass": 0.2, "spring": 0.1, "motor_inertia": 0.1, "damping": 0.5}
"""Half width of each factor, at least: what an identification is never trusted beyond. The first two are those that a
tendon changes in service; keys are those of the simulator's ``perturb``."""

MOST_SPREAD = 0.9
"""A factor never comes near zero, where there is no plant."""


def ensemble(count: int, seed: int, spread: Mapping[str, float] | None = None) -> tuple[dict[str, float], ...]:
    """Factors on plant parameters: the nominal plant first, then a scrambled Sobol sequence.

    Args:
        count: plants, the nominal one included.
        seed: of the sequence.
        spread: half width of each factor by key, e.g. from an identification; never less than ``LEAST_SPREAD``.

    Returns:
        ``count`` times key to factor.
    """
    half = {key: min(MOST_SPREAD, max(least, (spread or {}).get(key, 0.0))) for key, least in LEAST_SPREAD.items()}
    drawn = qmc.Sobol(len(half), seed=seed).random(1 << max(0, (max(count - 1, 1) - 1).bit_length()))
    factors = 1.0 + np.array(list(half.values())) * (2.0 * drawn[: max(count - 1, 0)] - 1.0)
    nominal = dict.fromkeys(half, 1.0)
    return (nominal, *(dict(zip(half, map(float, row), strict=True)) for row in factors))[:count]


KINDS = {
    "rope_stiffness": "stiffness",
    "capstan": "friction",
    "motor_coulomb": "friction",
    "motor_viscous": "damping",
    "joint_damping": "damping",
    "spring_stiffness": "spring",
    "motor_inertia": "motor_inertia",
}
"""Key of the ensemble that covers each identified parameter."""


def widths(found: Mapping[str, Identified]) -> dict[str, float]:
    """Half width of each factor that reaches, around what was identified, to the ends of every 95 % interval.

    Args:
        found: identified parameters by tendon.
    """
    spread: dict[str, float] = {}
    for known in found.values():
        for name, value, half in zip(known.names, known.values, known.half_widths, strict=True):
            if name in KINDS and value > 0.0:
                spread[KINDS[name]] = max(spread.get(KINDS[name], 0.0), half / value)
    return spread
