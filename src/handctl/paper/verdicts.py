"""Rules by which the verdict on a statement of the paper follows from the printed digits and the exact value."""

from collections.abc import Sequence
from fractions import Fraction

from handctl.paper.errata_item import ErrataVerdict

ROUNDING_TOLERANCE = Fraction(1, 10**12)
"""Largest relative difference that counts as a rounding error of floating-point numbers."""


def verdict_of_number(printed: str, exact: Fraction | float) -> ErrataVerdict:
    """Return the verdict on a printed number, given the exact value.

    The verdict is the first of ``equal``, ``rounded`` and ``truncated`` that applies. If none
    applies, it is ``wrong``.

    Args:
        printed: decimal number as printed, e.g. `18.33`.
        exact: exact value.
    """
    shown = Fraction(printed)
    value = Fraction(exact)
    unit = last_digit_value(printed)
    if abs(shown - value) <= ROUNDING_TOLERANCE * abs(value):
        return ErrataVerdict.EQUAL
    # The difference is at most half of one unit in the last printed digit.
    if 2 * abs(shown - value) <= unit:
        return ErrataVerdict.ROUNDED
    if shown * value >= 0 and 0 < abs(value) - abs(shown) < unit:
        return ErrataVerdict.TRUNCATED
    return ErrataVerdict.WRONG


def verdict_of_derived_number(
    printed: str, exact: Fraction | float, carried: Fraction, source: ErrataVerdict
) -> ErrataVerdict:
    """Return the verdict on a printed number that the paper has calculated from another printed number.

    Args:
        printed: decimal number as printed.
        exact: exact value.
        carried: value that results from a calculation with the other printed number.
        source: verdict on the other printed number. If the number is wrong but equals `carried`,
            the verdict on the other number is returned.
    """
    verdict = verdict_of_number(printed, exact)
    explained = verdict_of_number(printed, carried) == ErrataVerdict.EQUAL
    return source if verdict == ErrataVerdict.WRONG and explained else verdict


def verdict_of_statement(holds: bool) -> ErrataVerdict:
    """Return the verdict on a statement that is true or false."""
    return ErrataVerdict.EQUAL if holds else ErrataVerdict.WRONG


def verdict_of_lower_bound(printed: str, value: float) -> ErrataVerdict:
    """Return the verdict on a lower bound in the paper, given the value that was reached.

    The lower bound is first judged like any printed number. If this verdict is not ``wrong``, it is
    returned. Otherwise, the verdict is ``bound`` if the value is above the printed bound, and
    ``wrong`` if it is below.
    """
    verdict = verdict_of_number(printed, value)
    return (
        ErrataVerdict.BOUND
        if verdict == ErrataVerdict.WRONG and value > float(printed)
        else verdict
    )


def verdict_of_readings(right: Sequence[bool]) -> ErrataVerdict:
    """Return the verdict on a statement that can be read in several ways.

    If some readings are true and others are false, the verdict is undecidable.
    """
    return verdict_of_statement(all(right)) if len(set(right)) == 1 else ErrataVerdict.UNDECIDABLE


def verdict_of_contradiction(
    printed: Sequence[str], exact: Fraction | float | None
) -> ErrataVerdict:
    """Return the verdict on several printed values of the same quantity.

    If these values differ and there is no exact value, the verdict is undecidable.
    """
    if exact is None:
        return verdict_of_readings([value == printed[0] for value in printed])
    verdicts = [verdict_of_number(value, exact) for value in printed]
    # The members of this enumeration are listed in the order of severity.
    return max(verdicts, key=list(ErrataVerdict).index)


def last_digit_value(printed: str) -> Fraction:
    """Return the value of one unit of the last printed digit."""
    return Fraction(1, 10 ** len(printed.partition(".")[2]))


def rounding_interval(printed: str) -> tuple[Fraction, Fraction]:
    """Return the lower and the upper end of the interval of all values that would be rounded to a printed number."""
    half = last_digit_value(printed) / 2
    return Fraction(printed) - half, Fraction(printed) + half
