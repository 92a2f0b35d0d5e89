"""Conversion of numbers to text for the attributes of XML files."""

import numpy as np


def number_text(value: float) -> str:
    """Return the shortest text from which an equal number can be read."""
    return repr(float(value))


def numbers_text(values: object) -> str:
    """Return numbers separated by spaces."""
    return " ".join(number_text(value) for value in np.asarray(values, dtype=float).tolist())
