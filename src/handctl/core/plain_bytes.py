"""Plain values as bytes, for the state's hash: equal values are written alike, whoever else refers to them."""

import marshal
from typing import Any

FORMAT = 2
"""Of ``marshal``: the last one that does not tell values that are shared from values that are equal."""


def plain_bytes(values: Any) -> bytes:
    """Bytes of numbers, texts, and tuples and lists of them."""
    return marshal.dumps(values, FORMAT)
