"""The numbers of ``random.Random(seed).gauss(0, 1)``, many at a time: the same stream, drawn in blocks."""

import random
from math import cos, log, pi, sin, sqrt
from typing import Any

import numpy as np

BLOCK = 512
"""Numbers drawn at a time; even, since they come in pairs."""


class Noise:
    """A stream of normal numbers."""

    def __init__(self, seed: str) -> None:
        """Args: seed of the stream."""
        self._uniform = random.Random(seed).random
        self._left: Any = np.empty(0)
        self._first = 0

    def take(self, count: int) -> Any:
        """Return the next numbers of mean 0 and standard deviation 1, shape (count,)."""
        while len(self._left) < self._first + count:
            self._left, self._first = np.concatenate((self._left[self._first :], self._block())), 0
        first = self._first
        self._first = first + count
        return self._left[first : first + count]

    def _block(self) -> list[float]:
        """Return more numbers. Source: Python, ``random.Random.gauss``."""
        uniform, block = self._uniform, []
        for _ in range(0, BLOCK, 2):
            angle, radius = uniform() * 2.0 * pi, sqrt(-2.0 * log(1.0 - uniform()))
            block += [cos(angle) * radius, sin(angle) * radius]
        return block
