"""Elements of one array or another: what ``numpy.where`` does, in a quarter of its time for a few elements."""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def chosen(mask: NDArray[np.bool_], yes: Array, no: Array) -> Array:
    """``yes`` where the mask is set, else ``no``.

    Args:
        mask, yes, no: of one shape.
    """
    result: Any = no.copy()
    np.putmask(result, mask, yes)
    return np.asarray(result)


def only(mask: NDArray[np.bool_], values: Array) -> Array:
    """The values where the mask is set, else 0; mask and values of one shape."""
    result = np.zeros(len(values))
    np.putmask(result, mask, values)
    return result


def known(values: Array) -> Array:
    """The values, in place, with 0 for what is not a number."""
    np.putmask(values, values != values, 0.0)
    return values


@functools.lru_cache(maxsize=32)
def nothing(size: int) -> Array:
    """(size,) NaN, read-only: what is not known of so many."""
    values = np.full(size, np.nan)
    values.flags.writeable = False
    return values


@functools.lru_cache(maxsize=32)
def zeros(size: int) -> Array:
    """(size,) zeros, read-only."""
    values = np.zeros(size)
    values.flags.writeable = False
    return values
