"""One thing that the paper prints, and what is right: an item of the errata."""

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How what is printed compares with what is computed."""

    EQUAL = "equal"
    """Right as printed; of a statement: it holds."""
    ROUNDED = "rounded"
    """The exact value, correctly rounded to the printed digits (or computed from a value that was)."""
    TRUNCATED = "truncated"
    """The exact value with its further digits cut off (or computed from a value that was)."""
    BOUND = "bound"
    """A bound that holds: the exact or measured value is beyond it."""
    WRONG = "wrong"
    """Neither of these; of a statement: it does not hold."""
    UNDECIDABLE = "undecidable"
    """The paper contradicts itself, or can be read in several ways, and prints nothing that settles it."""


@dataclass(frozen=True, slots=True)
class Item:
    """One row of the errata.

    Attributes:
        id: unique, of words joined by dots, e.g. ``eq10.gravity``.
        where: equation or section.
        printed: as in the paper.
        computed: full precision, or the corrected expression; None if nothing can be computed.
        unit: of the computed value; empty for expressions and counts.
        verdict: derived from the two.
        why: what is wrong or how it comes about, for a reader who holds the paper.
        evidence: how it is known, e.g. ``arithmetic``, ``Euler-Lagrange``, ``dimensions``.
        deviation: of an expression, largest difference at random states relative to the right one; None for numbers.
    """

    id: str
    where: str
    printed: str
    computed: float | str | None
    unit: str
    verdict: Verdict
    why: str
    evidence: tuple[str, ...] = ()
    deviation: float | None = None
