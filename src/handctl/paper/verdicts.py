"""Rules for the verdicts on statements of the paper.

The verdict on a number compares the printed digits with the exact value.
"""

from collections.abc import Sequence
from fractions import Fraction

from handctl.paper.errata_item import ErrataVerdict

ROUNDING_TOLERANCE = Fraction(1, 10**12)
"""Largest relative difference that counts as a rounding error of floating-point numbers."""


def verdict_of_number(printed_number: str, exact_value: Fraction | float) -> ErrataVerdict:
    """Return the verdict on a printed number, given the exact value.

    The verdict is the first of ``equal``, ``rounded`` and ``truncated`` that applies. If none of
    the three applies, the verdict is ``wrong``.

    Args:
        printed_number: decimal number as printed, e.g. `18.33`.
        exact_value: exact value.
    """
    printed_value = Fraction(printed_number)
    value = Fraction(exact_value)
    unit = last_digit_value(printed_number)
    if abs(printed_value - value) <= ROUNDING_TOLERANCE * abs(value):
        return ErrataVerdict.EQUAL
    # The difference between the numbers is at most half of one unit in the last printed digit.
    if 2 * abs(printed_value - value) <= unit:
        return ErrataVerdict.ROUNDED
    if printed_value * value >= 0 and 0 < abs(value) - abs(printed_value) < unit:
        return ErrataVerdict.TRUNCATED
    return ErrataVerdict.WRONG


def verdict_of_derived_number(
    printed_number: str,
    exact_value: Fraction | float,
    value_from_other_number: Fraction,
    source_verdict: ErrataVerdict,
) -> ErrataVerdict:
    """Return the verdict on a printed number that the paper has calculated from another printed number.

    Args:
        printed_number: decimal number as printed.
        exact_value: exact value.
        value_from_other_number: value that results from a calculation with the other printed number.
        source_verdict: verdict on the other printed number. If the printed number is wrong but
            equals `value_from_other_number`, the verdict on the other number is returned.
    """
    verdict = verdict_of_number(printed_number, exact_value)
    is_explained = verdict_of_number(printed_number, value_from_other_number) == ErrataVerdict.EQUAL
    return source_verdict if verdict == ErrataVerdict.WRONG and is_explained else verdict


def verdict_of_statement(is_true: bool) -> ErrataVerdict:
    """Return the verdict on a statement that is true or false."""
    return ErrataVerdict.EQUAL if is_true else ErrataVerdict.WRONG


def verdict_of_lower_bound(printed_number: str, value: float) -> ErrataVerdict:
    """Return the verdict on a lower bound that the paper states.

    The argument ``value`` is a value that the bounded quantity reached in practice. The verdict
    compares ``value`` with the printed bound, as for any printed number, with one exception. If
    ``value`` differs from the printed bound, but is above the printed bound, the verdict is
    ``bound`` instead of ``wrong``.
    """
    verdict = verdict_of_number(printed_number, value)
    return (
        ErrataVerdict.LOWER_BOUND
        if verdict == ErrataVerdict.WRONG and value > float(printed_number)
        else verdict
    )


def verdict_of_ambiguous_statement(are_readings_true: Sequence[bool]) -> ErrataVerdict:
    """Return the verdict on a printed statement that has several possible meanings.

    If the statement is true with one meaning and false with another, the verdict is undecidable.
    """
    return (
        verdict_of_statement(all(are_readings_true))
        if len(set(are_readings_true)) == 1
        else ErrataVerdict.UNDECIDABLE
    )


def verdict_of_contradiction(
    printed_numbers: Sequence[str], exact_value: Fraction | float | None
) -> ErrataVerdict:
    """Return the verdict on several printed values of the same quantity.

    If the printed values differ and there is no exact value, the verdict is undecidable.
    """
    if exact_value is None:
        return verdict_of_ambiguous_statement(
            [value == printed_numbers[0] for value in printed_numbers]
        )
    verdicts = [verdict_of_number(value, exact_value) for value in printed_numbers]
    # The members of ``ErrataVerdict`` are listed in the order of severity.
    return max(verdicts, key=list(ErrataVerdict).index)


def last_digit_value(printed_number: str) -> Fraction:
    """Return the value of one unit of the last printed digit."""
    return Fraction(1, 10 ** len(printed_number.partition(".")[2]))


def rounding_interval(printed_number: str) -> tuple[Fraction, Fraction]:
    """Return the lower and the upper end of the rounding interval of a printed number.

    The interval contains all values that are equal to the printed number after rounding.
    """
    half_last_digit = last_digit_value(printed_number) / 2
    return Fraction(printed_number) - half_last_digit, Fraction(printed_number) + half_last_digit
