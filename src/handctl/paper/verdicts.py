"""Rules that derive a verdict from the printed digits and the exact value."""

from collections.abc import Sequence
from fractions import Fraction

from handctl.paper.item import ErrataVerdict

ROUNDING_TOLERANCE = Fraction(1, 10**12)
"""Largest relative difference that counts as floating-point rounding, in values computed with floats."""


def verdict_of_number(printed: str, exact: Fraction | float) -> ErrataVerdict:
    """Return the verdict on printed digits with an exact value.

    The verdict is the first of ``equal``, ``rounded`` and ``truncated`` that is true, or else ``wrong``.

    Args:
        printed: decimal number, e.g. `18.33`.
        exact: exact value.
    """
    shown = Fraction(printed)
    value = Fraction(exact)
    unit = last_digit_value(printed)
    if abs(shown - value) <= ROUNDING_TOLERANCE * abs(value):
        return ErrataVerdict.EQUAL
    # Half a unit of the last printed digit.
    if 2 * abs(shown - value) <= unit:
        return ErrataVerdict.ROUNDED
    if shown * value >= 0 and 0 < abs(value) - abs(shown) < unit:
        return ErrataVerdict.TRUNCATED
    return ErrataVerdict.WRONG


def verdict_of_derived_number(
    printed: str, exact: Fraction | float, carried: Fraction, source: ErrataVerdict
) -> ErrataVerdict:
    """Return the verdict on digits that were computed from digits printed earlier.

    Args:
        printed: decimal number.
        exact: exact value.
        carried: value computed from the digits printed earlier.
        source: verdict on the digits printed earlier. This verdict is returned if the carried value
            explains the print.
    """
    verdict = verdict_of_number(printed, exact)
    explained = verdict_of_number(printed, carried) == ErrataVerdict.EQUAL
    return source if verdict == ErrataVerdict.WRONG and explained else verdict


def verdict_of_statement(holds: bool) -> ErrataVerdict:
    """Return the verdict on a statement, from its truth value."""
    return ErrataVerdict.EQUAL if holds else ErrataVerdict.WRONG


def verdict_of_lower_bound(printed: str, value: float) -> ErrataVerdict:
    """Return the verdict on a claimed lower bound with the reached value.

    The verdict is equal (as a number), else bound, else wrong.
    """
    verdict = verdict_of_number(printed, value)
    return ErrataVerdict.BOUND if verdict == ErrataVerdict.WRONG and value > float(printed) else verdict


def verdict_of_readings(right: Sequence[bool]) -> ErrataVerdict:
    """Return the verdict on several readings: right in all, wrong in all, or undecidable."""
    return verdict_of_statement(all(right)) if len(set(right)) == 1 else ErrataVerdict.UNDECIDABLE


def verdict_of_contradiction(printed: Sequence[str], exact: Fraction | float | None) -> ErrataVerdict:
    """Return the verdict on several printed values for one quantity.

    If the printed values differ and there is no exact value, the verdict is undecidable.
    """
    if exact is None:
        return verdict_of_readings([value == printed[0] for value in printed])
    verdicts = [verdict_of_number(value, exact) for value in printed]
    # The order of the enumeration is the order of severity.
    return max(verdicts, key=list(ErrataVerdict).index)


def last_digit_value(printed: str) -> Fraction:
    """Return the value of one unit in the last printed digit."""
    return Fraction(1, 10 ** len(printed.partition(".")[2]))


def rounding_interval(printed: str) -> tuple[Fraction, Fraction]:
    """Return the interval of values that round to a printed number."""
    half = last_digit_value(printed) / 2
    return Fraction(printed) - half, Fraction(printed) + half
