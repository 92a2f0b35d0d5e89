"""The numbers of ``random.Random(seed).gauss(0, 1)``, many at a time: the same stream, drawn in blocks."""

import math
import random
from typing import Any

import numpy as np

from firmware_sim.compiled import VECTOR, compiled

BLOCK = 512
"""Numbers drawn at a time; even, since they come in pairs."""


@compiled(VECTOR)
def _to_normal(numbers: Any) -> None:
    """Turn pairs of uniform numbers into pairs of normal ones. Source: Python, ``random.Random.gauss``."""
    for i in range(0, len(numbers), 2):
        angle, radius = numbers[i] * (2.0 * math.pi), math.sqrt(-2.0 * math.log(1.0 - numbers[i + 1]))
        numbers[i], numbers[i + 1] = math.cos(angle) * radius, math.sin(angle) * radius


class Noise:
    """A stream of normal numbers."""

    def __init__(self, seed: str) -> None:
        """Args: seed of the stream."""
        self._uniform = random.Random(seed).random
        self._left: Any = np.empty(0)

    def take(self, count: int) -> Any:
        """Return the next numbers of mean 0 and standard deviation 1, shape (count,)."""
        while len(self._left) < count:
            uniform = self._uniform
            block = np.array([uniform() for _ in range(BLOCK)])
            _to_normal(block)
            self._left = np.concatenate((self._left, block))
        taken, self._left = self._left[:count], self._left[count:]
        return taken
