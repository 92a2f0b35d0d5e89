"""Plants that the real one may be: drawn around the hand file, as far as the identification leaves them uncertain."""

from collections.abc import Mapping

import numpy as np
from scipy.stats import qmc

LEAST_SPREAD = {"stiffness": 0.2, "friction": 0.5, "mass": 0.2, "spring": 0.1, "motor_inertia": 0.1, "damping": 0.5}
"""Half width of each factor, at least: what an identification is never trusted beyond. The first two are those that a
tendon changes in service; keys are those of the simulator's ``perturb``."""


def ensemble(count: int, seed: int, spread: Mapping[str, float] | None = None) -> tuple[dict[str, float], ...]:
    """Factors on plant parameters: the nominal plant first, then a scrambled Sobol sequence.

    Args:
        count: plants, the nominal one included.
        seed: of the sequence.
        spread: half width of each factor by key, e.g. from an identification; never less than ``LEAST_SPREAD``.

    Returns:
        ``count`` times key to factor.
    """
    widths = {key: max(least, (spread or {}).get(key, 0.0)) for key, least in LEAST_SPREAD.items()}
    drawn = qmc.Sobol(len(widths), seed=seed).random(1 << max(0, (max(count - 1, 1) - 1).bit_length()))
    factors = 1.0 + np.array(list(widths.values())) * (2.0 * drawn[: max(count - 1, 0)] - 1.0)
    nominal = dict.fromkeys(widths, 1.0)
    return (nominal, *(dict(zip(widths, map(float, row), strict=True)) for row in factors))[:count]
