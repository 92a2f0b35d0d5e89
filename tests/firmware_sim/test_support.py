"""Test the conditions under which the table below the object sinks."""

import pytest

from firmware_sim.scene.scene import SinkingTable
from firmware_sim.scene.support_table import SupportTable

OPPOSED_DIGITS = [False, False, False, True]
TABLE_SETTINGS = SinkingTable(
    drop_when="grasped", drop_force=1.0, drop_hold=1.5, sink_speed=0.05, sink_depth=0.2
)


def contact_forces(*force_by_digit: float) -> list[float]:
    """Return a contact force vector for each digit.

    Each vector has the given magnitude, and is not parallel to any axis.
    """
    return [
        force_component
        for size in force_by_digit
        for force_component in (0.6 * size, 0.0, -0.8 * size)
    ]


def advance_table(
    table: SupportTable, start_s: float, stop_s: float, *force_by_digit: float
) -> float:
    steps = round((stop_s - start_s) * 1000)
    for i in range(steps + 1):
        table.update(start_s + i / 1000, contact_forces(*force_by_digit))
    return table.depth


def test_the_table_sinks_after_a_grasp_of_a_second_and_a_half() -> None:
    table = SupportTable(TABLE_SETTINGS, OPPOSED_DIGITS)
    advance_table(table, 0.0, 0.999, 0, 0, 0, 0)
    assert advance_table(table, 1.0, 2.498, 1.1, 1.1, 0, 1.1) == 0.0
    assert table.dropped_at is None
    advance_table(table, 2.499, 2.51, 1.1, 1.1, 0, 1.1)
    assert table.dropped_at == pytest.approx(2.5, abs=2e-3)
    assert advance_table(table, 2.51, 3.5, 0, 0, 0, 0) == pytest.approx(0.05, abs=2e-4), (
        "the table sinks further without contact"
    )
    assert advance_table(table, 3.5, 9.0, 0, 0, 0, 0) == pytest.approx(0.2)


@pytest.mark.parametrize(
    "force_by_digit", [(5, 5, 5, 0), (5, 0, 0, 5), (0.9, 0.9, 0.9, 9), (0, 0, 0, 9)]
)
def test_contact_with_too_few_digits_is_no_grasp(force_by_digit: tuple[float, ...]) -> None:
    assert (
        advance_table(SupportTable(TABLE_SETTINGS, OPPOSED_DIGITS), 0.0, 5.0, *force_by_digit)
        == 0.0
    )


def test_a_released_grasp_restarts_the_wait() -> None:
    table = SupportTable(TABLE_SETTINGS, OPPOSED_DIGITS)
    advance_table(table, 0.0, 1.4, 2, 2, 2, 2)
    advance_table(table, 1.4, 1.41, 0, 0, 0, 0)
    assert advance_table(table, 1.42, 2.8, 2, 2, 2, 2) == 0.0
    assert advance_table(table, 2.8, 3.5, 2, 2, 2, 2) > 0.0


def test_a_table_that_never_sinks() -> None:
    assert advance_table(SupportTable(SinkingTable(), OPPOSED_DIGITS), 0.0, 5.0, 9, 9, 9, 9) == 0.0


def test_a_hand_of_two_opposed_digits_holds_with_both() -> None:
    assert advance_table(SupportTable(TABLE_SETTINGS, [False, True]), 0.0, 2.0, 2, 2) > 0.0
    assert advance_table(SupportTable(TABLE_SETTINGS, [False, True]), 0.0, 2.0, 2, 0) == 0.0
    assert advance_table(SupportTable(TABLE_SETTINGS, [False, False]), 0.0, 2.0, 2, 2) == 0.0
