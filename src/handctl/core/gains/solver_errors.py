"""Conversion of solver failures into error messages of one line.

A solver can fail although each weight is within its bounds, because the weights differ too much.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from handctl.errors import ConfigError


@contextmanager
def solver_failures_as_errors(gains_section: str) -> Iterator[None]:
    """Convert a failure of a solver within a ``with`` block into an error with a one-line message.

    Args:
        gains_section: section of the gains file from which the gains are designed.

    Raises:
        ConfigError: if the solver fails.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except (
        ValueError,
        ArithmeticError,
        TypeError,
    ) as error:  # the exceptions above are those of scipy, numpy and control
        expected = (
            "weights nearer to the packaged ones (handctl gains show), "
            "or values in the hand file nearer to those of a packaged hand"
        )
        raise ConfigError(
            "no controller follows from these values", f"gains: {gains_section}", expected
        ) from error


def require_finite_solution(*solutions: NDArray[np.float64]) -> None:
    """Raise an error if a solution contains infinite or undefined numbers.

    Raises:
        ValueError: a number is not finite.
    """
    if not all(np.isfinite(solution).all() for solution in solutions):
        raise ValueError("not finite")
