"""Verdicts, derived from the printed digits and the exact value."""

from collections.abc import Sequence
from fractions import Fraction

from handctl.paper.item import ErrataVerdict

EXACT = Fraction(1, 10**12)
"""Relative difference that counts as rounding of the floats that some values come from."""


def of_number(printed: str, exact: Fraction | float) -> ErrataVerdict:
    """Compare printed digits with an exact value: equal, else rounded, else truncated, else wrong.

    Args:
        printed: decimal number, e.g. `18.33`.
        exact: exact value.
    """
    shown = Fraction(printed)
    value = Fraction(exact)
    unit = last_digit(printed)
    if abs(shown - value) <= EXACT * abs(value):
        return ErrataVerdict.EQUAL
    # Half a unit of the last printed digit.
    if 2 * abs(shown - value) <= unit:
        return ErrataVerdict.ROUNDED
    if shown * value >= 0 and 0 < abs(value) - abs(shown) < unit:
        return ErrataVerdict.TRUNCATED
    return ErrataVerdict.WRONG


def of_carried(printed: str, exact: Fraction | float, carried: Fraction, source: ErrataVerdict) -> ErrataVerdict:
    """Compare digits that were computed from digits printed before.

    Args:
        printed: decimal number.
        exact: exact value.
        carried: value that follows from the digits printed before.
        source: verdict on those digits. This verdict is passed on if the carried value explains
            the print.
    """
    verdict = of_number(printed, exact)
    explained = of_number(printed, carried) == ErrataVerdict.EQUAL
    return source if verdict == ErrataVerdict.WRONG and explained else verdict


def of_statement(holds: bool) -> ErrataVerdict:
    """Return the verdict of a statement that is true or false."""
    return ErrataVerdict.EQUAL if holds else ErrataVerdict.WRONG


def of_lower_bound(printed: str, value: float) -> ErrataVerdict:
    """Compare a claimed number with the reached one: equal as a number, else a bound or wrong."""
    verdict = of_number(printed, value)
    return ErrataVerdict.BOUND if verdict == ErrataVerdict.WRONG and value > float(printed) else verdict


def of_readings(right: Sequence[bool]) -> ErrataVerdict:
    """Return the verdict of several readings: right or wrong in all of them, or undecidable."""
    return of_statement(all(right)) if len(set(right)) == 1 else ErrataVerdict.UNDECIDABLE


def of_contradiction(printed: Sequence[str], exact: Fraction | float | None) -> ErrataVerdict:
    """Return the verdict of several values for one quantity.

    Without an exact value different ones cannot be decided.
    """
    if exact is None:
        return of_readings([value == printed[0] for value in printed])
    verdicts = [of_number(value, exact) for value in printed]
    # The order of the enumeration is the order of severity.
    return max(verdicts, key=list(ErrataVerdict).index)


def last_digit(printed: str) -> Fraction:
    """Return the value of one unit in the last printed digit."""
    return Fraction(1, 10 ** len(printed.partition(".")[2]))


def interval(printed: str) -> tuple[Fraction, Fraction]:
    """Return the interval of values that a correctly rounded number may stand for."""
    half = last_digit(printed) / 2
    return Fraction(printed) - half, Fraction(printed) + half
