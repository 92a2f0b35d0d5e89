"""What is counted over some time: losses, misshapen and unknown frames, refused goals."""

from typing import NamedTuple

WINDOW, SHORT = 100, 20
"""Ticks over which losses, and misshapen frames, are counted."""
_MASK, _SHORT_MASK = (1 << WINDOW) - 1, (1 << SHORT) - 1
HALF = 7
"""So many of ``SHORT`` ticks a node misses that answers every second one; where its turn shifts, two in a row."""


class Counts(NamedTuple):
    """Bits of the last ticks, the newest lowest; an empty tuple as long as nothing happened.

    Attributes:
        lost: per node, ticks without an answer.
        misshapen: per node, ticks with a frame of a wrong shape.
        unknown: frames of unknown identifiers in about a second.
        refused: tick numbers of refused goals, those of the last second.
    """

    lost: tuple[int, ...] = ()
    misshapen: tuple[int, ...] = ()
    unknown: float = 0.0
    refused: tuple[int, ...] = ()


def shift(bits: tuple[int, ...], now: tuple[bool, ...]) -> tuple[int, ...]:
    """One tick more; empty again when the last bit has left."""
    if not bits and True not in now:
        return bits
    shifted = tuple([(old << 1 | new) & _MASK for old, new in zip(bits or (0,) * len(now), now, strict=True)])
    return shifted if any(shifted) else ()


def number(bits: tuple[int, ...]) -> tuple[int, ...]:
    """How many ticks of the window."""
    return tuple([b.bit_count() for b in bits])


def lately(bits: int) -> int:
    """How many of the last ``SHORT`` ticks."""
    return (bits & _SHORT_MASK).bit_count()


def halved(bits: int) -> bool:
    """Whether about every second of the last ``SHORT`` ticks is set, and at most once two in a row."""
    recent = bits & _SHORT_MASK
    return recent.bit_count() >= HALF and (recent & recent >> 1).bit_count() <= 1


def step(
    state: Counts, lost: tuple[bool, ...], misshapen: tuple[bool, ...], unknown: int, refused: int, k: int, rate: float
) -> Counts:
    """One tick.

    Args:
        state: from the last tick.
        lost, misshapen: per node, in this tick.
        unknown, refused: how many in this tick.
        k: its number.
        rate: ticks a second [Hz].
    """
    leaked = state.unknown * (1.0 - 1.0 / rate) + unknown
    goals = state.refused
    if refused or goals:
        goals = tuple(then for then in (*goals, *(k,) * refused) if k - then < rate)
    return Counts(shift(state.lost, lost), shift(state.misshapen, misshapen), leaked if leaked > 1e-3 else 0.0, goals)
