"""Items of the errata: each compares a statement of the paper with the correct statement."""

from dataclasses import dataclass
from enum import StrEnum


class ErrataVerdict(StrEnum):
    """Comparison of a printed statement with the computed one."""

    EQUAL = "equal"
    """Correct as printed. A statement is true."""
    ROUNDED = "rounded"
    """Printed value is the exact value correctly rounded to the printed digits, or computed from such a value."""
    TRUNCATED = "truncated"
    """Printed value is the exact value with further digits cut off, or computed from such a value."""
    BOUND = "bound"
    """Printed value is a bound, and the exact or measured value is beyond this bound."""
    WRONG = "wrong"
    """None of the above, or a false statement."""
    UNDECIDABLE = "undecidable"
    """The paper contradicts itself or is ambiguous, and offers no way to decide."""


@dataclass(frozen=True, slots=True)
class Item:
    """Row of the errata.

    Attributes:
        id: unique id of words joined by dots, e.g. `eq10.gravity`.
        where: equation or section.
        printed: statement as in the paper.
        computed: value in full precision, or the corrected expression. None if nothing can be
            computed.
        unit: unit of the computed value, empty for expressions and counts.
        verdict: verdict, derived from printed and computed value.
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
