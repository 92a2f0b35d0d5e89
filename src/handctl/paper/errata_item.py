"""Items of the errata, the list of errors in the paper.

Each item compares a printed statement of the paper with the correct statement.
"""

from dataclasses import dataclass
from enum import StrEnum


class ErrataVerdict(StrEnum):
    """Result of the comparison of a printed statement with the correct statement."""

    EQUAL = "equal"
    """The printed value is exact, or the printed statement is true."""
    ROUNDED = "rounded"
    """The printed value is the correctly rounded exact value, or was calculated from a correctly rounded value."""
    TRUNCATED = "truncated"
    """The printed value is the exact value without its last digits, or was calculated from a truncated value."""
    LOWER_BOUND = "bound"
    """The printed value is a lower bound, and the measured value is larger."""
    WRONG = "wrong"
    """The printed statement is false, or the printed value is neither exact nor rounded, truncated or a bound."""
    UNDECIDABLE = "undecidable"
    """The paper contradicts itself or is ambiguous, and nothing in the paper shows which meaning is right."""


@dataclass(frozen=True, slots=True)
class ErrataItem:
    """Row of the errata.

    Attributes:
        id: unique identifier of the item. The words of an identifier are joined by dots, e.g.
            `eq10.gravity`.
        where: equation or section of the paper with the statement.
        printed: statement of the paper, exactly as printed.
        computed: exact value in full precision, or the correct expression, or None if nothing can
            be calculated.
        unit: unit of the exact value. The text is empty for expressions and for numbers of things.
        verdict: verdict on the statement, derived from the printed and the exact value.
        why: explanation of the verdict, for readers of the paper.
        evidence: kinds of evidence for the verdict, e.g. `arithmetic`, `Lagrange`, `dimensions`.
        deviation: largest relative difference between the printed and the correct expression at
            random states, or None if the item is about a number.
    """

    id: str
    where: str
    printed: str
    computed: float | str | None
    unit: str
    verdict: ErrataVerdict
    why: str
    evidence: tuple[str, ...] = ()
    deviation: float | None = None
