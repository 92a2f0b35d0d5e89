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
        _, state, _ = random.Random(seed).getstate()
        generator = np.random.RandomState()
        # numpy makes its numbers of that state as Python does
        generator.set_state(("MT19937", np.array(state[:-1], np.uint32), state[-1], 0, 0.0))
        self._uniform = generator.random_sample
        self._left: Any = np.empty(0)
        self._first = 0

    def take(self, count: int) -> Any:
        """Return the next numbers of mean 0 and standard deviation 1, shape (count,)."""
        while len(self._left) < self._first + count:
            block = self._uniform(BLOCK)
            _to_normal(block)
            self._left, self._first = np.concatenate((self._left[self._first :], block)), 0
        first = self._first
        self._first = first + count
        return self._left[first : first + count]
