"""Item of the errata: a statement of the paper, and the correct one."""

from dataclasses import dataclass
from enum import StrEnum


class ErrataVerdict(StrEnum):
    """Comparison of a printed statement with the computed one."""

    EQUAL = "equal"
    """Correct as printed. A statement is true."""
    ROUNDED = "rounded"
    """The exact value, correctly rounded to the printed digits, or computed from such a value."""
    TRUNCATED = "truncated"
    """The exact value with further digits cut off, or computed from such a value."""
    BOUND = "bound"
    """A true bound: the exact or measured value is beyond the bound."""
    WRONG = "wrong"
    """None of the above. A statement is false."""
    UNDECIDABLE = "undecidable"
    """The paper contradicts itself or is ambiguous, and prints nothing that decides."""


@dataclass(frozen=True, slots=True)
class Item:
    """One row of the errata.

    Attributes:
        id: unique id of words joined by dots, e.g. `eq10.gravity`.
        where: equation or section.
        printed: statement as in the paper.
        computed: value in full precision, or the corrected expression. None if nothing can be
            computed.
        unit: unit of the computed value, empty for expressions and counts.
        verdict: verdict, derived from the two.
        why: explanation for a reader of the paper.
        evidence: kinds of evidence, e.g. `arithmetic`, `Euler-Lagrange`, `dimensions`.
        deviation: largest relative difference of an expression at random states, None for
            numbers.
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
