"""Random numbers with a normal distribution, drawn in blocks.

The random numbers equal those of ``random.Random(seed).gauss(0, 1)``.
"""

import math
import random
from types import FunctionType
from typing import Any

import numpy as np

from firmware_sim.compiled import compiled

NOISE_BLOCK_SIZE = 512
"""Count of random numbers in a block.

The size of a block is even, because the algorithm generates pairs of numbers.
"""


@compiled("vector", "vector")
def _normal_from_uniform(uniform_numbers: Any, normal_numbers: Any) -> None:
    """Convert pairs of uniformly distributed numbers to pairs of normally distributed numbers.

    Source: Python, ``random.Random.gauss``.
    """
    for i in range(0, len(normal_numbers), 2):
        angle = uniform_numbers[i] * 2.0 * math.pi
        radius = math.sqrt(-2.0 * math.log(1.0 - uniform_numbers[i + 1]))
        normal_numbers[i] = math.cos(angle) * radius
        normal_numbers[i + 1] = math.sin(angle) * radius


class NormalNoise:
    """A sequence of random numbers with a normal distribution.

    Attributes:
        numbers: array with the drawn numbers.
        bounds: index of the next unused number in ``numbers``, and index after the last drawn
            number.
    """

    def __init__(self, seed: str) -> None:
        """Start the sequence of random numbers with a seed.

        Args:
            seed: seed of the sequence.
        """
        _, words, _ = random.Random(seed).getstate()
        # Python and numpy both use the generator MT19937, and convert its integers to doubles in
        # the same way. Therefore the sequences of Python and numpy have the same bits.
        self._uniform = np.random.RandomState()
        self._uniform.set_state(("MT19937", np.array(words[:-1], np.uint32), words[-1], 0, 0.0))
        self.numbers: Any = np.zeros(2 * NOISE_BLOCK_SIZE)
        self.bounds: Any = np.zeros(2, np.int64)

    def draw(self, count: int) -> None:
        """Draw random numbers until at least ``count`` unused numbers are available.

        The argument ``count`` must be at most ``NOISE_BLOCK_SIZE``.
        """
        first_index, end = self.bounds.tolist()
        if end - first_index < count:
            self.numbers[: end - first_index] = self.numbers[first_index:end]
            self.numbers[end - first_index : end - first_index + NOISE_BLOCK_SIZE] = (
                self._draw_block()
            )
            self.bounds[:] = 0, end - first_index + NOISE_BLOCK_SIZE

    def _draw_block(self) -> Any:
        """Draw the next block of random numbers."""
        uniform_numbers = self._uniform.random_sample(NOISE_BLOCK_SIZE)
        block = np.empty(NOISE_BLOCK_SIZE)
        if isinstance(
            _normal_from_uniform, FunctionType
        ):  # If the kernel ``_normal_from_uniform`` is not compiled, lists are faster than arrays.
            noise_values = [0.0] * NOISE_BLOCK_SIZE
            _normal_from_uniform(uniform_numbers.tolist(), noise_values)
            return noise_values
        _normal_from_uniform(uniform_numbers, block)
        return block

    def take(self, count: int) -> Any:
        """Return the next ``count`` random numbers of mean 0 and standard deviation 1, shape (count,)."""
        self.draw(count)
        first_index = int(self.bounds[0])
        self.bounds[0] = first_index + count
        return self.numbers[first_index : first_index + count].copy()
