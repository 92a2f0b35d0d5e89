"""Test the verdict on a printed number: equal, rounded, truncated or wrong.

The verdict depends on the exact value, and on the number of decimals that the paper prints.
"""

from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.paper.errata_item import ErrataVerdict
from handctl.paper.verdicts import (
    last_digit_value,
    rounding_interval,
    verdict_of_ambiguous_statement,
    verdict_of_contradiction,
    verdict_of_derived_number,
    verdict_of_lower_bound,
    verdict_of_number,
    verdict_of_statement,
)

EXACT_FRACTIONS = st.fractions(min_value=-1000, max_value=1000, max_denominator=10**6).filter(
    lambda value: abs(value) > 1
)


def rounded_number_text(exact_value: Fraction, decimal_places: int, rounding_mode: str) -> str:
    exact_decimal = Decimal(exact_value.numerator) / Decimal(exact_value.denominator)
    return str(exact_decimal.quantize(Decimal(1).scaleb(-decimal_places), rounding=rounding_mode))


@pytest.mark.parametrize(
    ("printed_number", "exact_value", "verdict"),
    [
        ("55", Fraction(55), ErrataVerdict.EQUAL),
        ("18.33", Fraction(55, 3), ErrataVerdict.ROUNDED),
        ("0.305", Fraction(6, 2) / Fraction(981, 100), ErrataVerdict.TRUNCATED),
        ("0.4166", Fraction(5, 12), ErrataVerdict.TRUNCATED),
        ("0.866", 0.8585678, ErrataVerdict.WRONG),
        ("0.86", 0.8585678, ErrataVerdict.ROUNDED),
        ("-2", Fraction(2), ErrataVerdict.WRONG),
        ("0", Fraction(0), ErrataVerdict.EQUAL),
        ("1", 0.9174311926605505, ErrataVerdict.ROUNDED),
        ("0.1", 0.1, ErrataVerdict.EQUAL),
        ("2.5", Fraction(255, 100), ErrataVerdict.ROUNDED),
        ("2.4", Fraction(255, 100), ErrataVerdict.WRONG),
    ],
)
def test_verdict_of_a_number(
    printed_number: str, exact_value: Fraction | float, verdict: ErrataVerdict
) -> None:
    assert verdict_of_number(printed_number, exact_value) == verdict


@given(EXACT_FRACTIONS, st.integers(0, 5))
def test_rounded_number_is_judged_as_rounded(exact_value: Fraction, decimal_places: int) -> None:
    assert verdict_of_number(
        rounded_number_text(exact_value, decimal_places, ROUND_HALF_EVEN), exact_value
    ) in (
        ErrataVerdict.EQUAL,
        ErrataVerdict.ROUNDED,
    )


@given(EXACT_FRACTIONS, st.integers(0, 5))
def test_truncated_number_is_judged_as_truncated(
    exact_value: Fraction, decimal_places: int
) -> None:
    number_text = rounded_number_text(exact_value, decimal_places, ROUND_DOWN)
    verdict = verdict_of_number(number_text, exact_value)
    assert verdict != ErrataVerdict.WRONG
    if 2 * abs(Fraction(number_text) - exact_value) > last_digit_value(number_text):
        assert verdict == ErrataVerdict.TRUNCATED


@given(EXACT_FRACTIONS, st.integers(0, 5), st.integers(1, 50))
def test_a_unit_of_the_last_digit_beyond_is_wrong(
    exact_value: Fraction, decimal_places: int, last_digit_units: int
) -> None:
    number_text = rounded_number_text(exact_value, decimal_places, ROUND_HALF_EVEN)
    wrong_value = Fraction(number_text) + (last_digit_units + 1) * last_digit_value(number_text) * (
        1 if exact_value > 0 else -1
    )
    text = rounded_number_text(wrong_value, decimal_places, ROUND_HALF_EVEN)
    assert verdict_of_number(text, exact_value) == ErrataVerdict.WRONG


def test_an_error_carried_over_from_a_number_has_its_verdict() -> None:
    torque = Fraction(55, 3) * 5 / 1000
    assert (
        verdict_of_derived_number(
            "0.09165", torque, Fraction("18.33") * 5 / 1000, ErrataVerdict.ROUNDED
        )
        == ErrataVerdict.ROUNDED
    )
    assert (
        verdict_of_derived_number(
            "0.09170", torque, Fraction("18.33") * 5 / 1000, ErrataVerdict.ROUNDED
        )
        == ErrataVerdict.WRONG
    )
    assert (
        verdict_of_derived_number(
            "0.09167", torque, Fraction("18.33") * 5 / 1000, ErrataVerdict.TRUNCATED
        )
        == ErrataVerdict.ROUNDED
    )


def test_verdict_of_readings_and_contradictions() -> None:
    assert (
        verdict_of_ambiguous_statement([True]) == verdict_of_statement(True) == ErrataVerdict.EQUAL
    )
    assert (
        verdict_of_ambiguous_statement([False, False])
        == verdict_of_statement(False)
        == ErrataVerdict.WRONG
    )
    assert verdict_of_ambiguous_statement([True, False]) == ErrataVerdict.UNDECIDABLE
    assert verdict_of_contradiction(["200", "250"], None) == ErrataVerdict.UNDECIDABLE
    assert verdict_of_contradiction(["200", "200"], None) == ErrataVerdict.EQUAL
    assert verdict_of_contradiction(["200", "250"], 200.0) == ErrataVerdict.WRONG


@pytest.mark.parametrize(
    ("measured_value", "verdict"),
    [
        (0.915, ErrataVerdict.EQUAL),
        (0.9152, ErrataVerdict.ROUNDED),
        (1.3, ErrataVerdict.LOWER_BOUND),
        (0.8, ErrataVerdict.WRONG),
    ],
)
def test_a_claim_that_is_exceeded_is_a_bound(measured_value: float, verdict: ErrataVerdict) -> None:
    assert verdict_of_lower_bound("0.915", measured_value) == verdict


def test_printed_number_stands_for_an_interval() -> None:
    low, high = rounding_interval("8.33")
    assert (low, high) == (Fraction("8.325"), Fraction("8.335"))
    assert low < Fraction(25, 3) < high
