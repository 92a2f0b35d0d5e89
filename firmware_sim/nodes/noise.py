"""The numbers of ``random.Random(seed).gauss(0, 1)``, many at a time: the same stream, drawn in blocks."""

import math
import random
from types import FunctionType
from typing import Any

import numpy as np

from firmware_sim.compiled import compiled

BLOCK = 512
"""Numbers drawn at a time; even, since they come in pairs."""


@compiled("vector", "vector")
def _normal(uniform: Any, out: Any) -> None:
    """Make normal numbers of uniform ones, two of two. Source: Python, ``random.Random.gauss``."""
    for i in range(0, len(out), 2):
        angle, radius = uniform[i] * 2.0 * math.pi, math.sqrt(-2.0 * math.log(1.0 - uniform[i + 1]))
        out[i] = math.cos(angle) * radius
        out[i + 1] = math.sin(angle) * radius


class Noise:
    """A stream of normal numbers.

    Attributes:
        left: numbers that were drawn. places: of the next of them, and of what comes behind the last one.
    """

    def __init__(self, seed: str) -> None:
        """Args: seed of the stream."""
        _, words, _ = random.Random(seed).getstate()
        # both generators are MT19937 and make a double of two words alike
        self._uniform = np.random.RandomState()
        self._uniform.set_state(("MT19937", np.array(words[:-1], np.uint32), words[-1], 0, 0.0))
        self.left: Any = np.zeros(2 * BLOCK)
        self.places: Any = np.zeros(2, np.int64)

    def draw(self, count: int) -> None:
        """See to it that so many numbers, at most ``BLOCK``, are there."""
        first, end = self.places.tolist()
        if end - first < count:
            self.left[: end - first] = self.left[first:end]
            self.left[end - first : end - first + BLOCK] = self._block()
            self.places[:] = 0, end - first + BLOCK

    def _block(self) -> Any:
        uniform, block = self._uniform.random_sample(BLOCK), np.empty(BLOCK)
        if isinstance(_normal, FunctionType):  # not compiled: lists are faster than arrays then
            plain = [0.0] * BLOCK
            _normal(uniform.tolist(), plain)
            return plain
        _normal(uniform, block)
        return block

    def take(self, count: int) -> Any:
        """Return the next numbers of mean 0 and standard deviation 1, shape (count,)."""
        self.draw(count)
        first = int(self.places[0])
        self.places[0] = first + count
        return self.left[first : first + count].copy()
