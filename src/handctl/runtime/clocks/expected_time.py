"""Expected duration of something that the control loop repeats in every tick."""

from dataclasses import dataclass

RISE_SHARE = 1 / 4
FALL_SHARE = 1 / 16
"""Fractions of the difference between measured and expected time by which the expected time rises and falls."""
MAX_GROWTH = 1.25
"""Largest factor by which an expected time grows at once.

An interruption by the operating system can make a single measured time very long.
"""


@dataclass
class ExpectedTime:
    """Time that is expected to be measured next. It rises faster than it falls.

    Attributes:
        expected_ns: the expected time [ns].
    """

    expected_ns: float

    def follow(self, measured_ns: int) -> None:
        """Move the expected time toward a measured time [ns]."""
        difference_ns = measured_ns - self.expected_ns
        share = RISE_SHARE if difference_ns > 0 else FALL_SHARE
        self.expected_ns = min(
            self.expected_ns + share * difference_ns, MAX_GROWTH * self.expected_ns
        )
