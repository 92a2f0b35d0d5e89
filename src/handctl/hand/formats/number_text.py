"""Conversion of numbers to text for the attributes of XML files."""

import numpy as np


def number_text(value: float) -> str:
    """Return the shortest text that reads back as an equal number."""
    return repr(float(value))


def numbers_text(values: object) -> str:
    """Return numbers separated by spaces."""
    return " ".join(number_text(value) for value in np.asarray(values, dtype=float).tolist())
