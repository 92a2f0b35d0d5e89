"""Weights that no solver makes a gain of: within their bounds each, too far apart together."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from handctl.errors import ConfigError


@contextmanager
def solvable(section: str) -> Iterator[None]:
    """Whatever a solver says of weights becomes one line.

    Args:
        section: of the gains.

    Raises:
        ConfigError: no gain follows from them.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except (ValueError, ArithmeticError, TypeError) as error:  # as scipy, numpy and control say it
        right = "weights nearer to the packaged ones (handctl gains show)"
        raise ConfigError("no controller follows from these values", f"gains: {section}", right) from error


def check_finite(*found: NDArray[np.float64]) -> None:
    """Refuse a solution that is none.

    Raises:
        ValueError: a number of it is not finite.
    """
    if not all(np.isfinite(one).all() for one in found):
        raise ValueError("not finite")
