"""The one look at a tick that shows nothing: it never hides what a row would find; and limits made of others."""

import math

import pytest

from handctl.drives.causes import Cause
from handctl.safety.calm import calm
from handctl.safety.faults.table import TABLE
from handctl.safety.signals import Limits, Signals
from tests.safety.test_table import CASES, LIMITS, OTHER_SIGNS

NOTHING = Signals(
    armed=True, motor_age=(0, 0), sensor_age=(0, 0), tension=(20.0, 20.0), temperature=(40.0, math.nan), frames=7,
)  # fmt: skip


def test_a_usual_tick_is_calm() -> None:
    assert calm(LIMITS, NOTHING)
    assert calm(LIMITS, Signals(armed=False))
    assert not any(fault.detect(LIMITS, NOTHING) for fault in TABLE)


@pytest.mark.parametrize(("changed", "is_calm"), [
    ({"missed": 1}, False), ({"late": 0.25}, True), ({"late": 0.251}, False),
    ({"frames": 64}, True), ({"frames": 65}, False), ({"unknown": 50.0}, True), ({"unknown": 50.1}, False),
    ({"motor_age": (0, 1)}, False), ({"motor_age": ()}, True), ({"sensor_age": (5, 0)}, True),
    ({"sensor_age": (0, 6)}, False), ({"sensor_age": ()}, True), ({"tension": (50.0, 20.0)}, True),
    ({"tension": (50.1, 20.0)}, False), ({"tension": (-4.9, 20.0)}, True), ({"tension": (20.0, -5.0)}, False),
    ({"tension": ()}, True), ({"tension": (20.0, math.nan)}, True), ({"temperature": (70.0, 0.0)}, True),
    ({"temperature": (math.nan, 70.1)}, False), ({"temperature": ()}, True),
    ({"jumped": (("m0", 1.0),)}, False), ({"io": (("x", "y", 1),)}, False), ({"residual": (0.0, 0.0)}, False),
    ({"armed": False, "motor_age": (9, 9), "sensor_age": (9, 9), "tension": (-9.0, 0.0)}, True),
    ({"armed": False, "tension": (51.0, 0.0)}, False), ({"armed": False, "heard": False}, True),
])  # fmt: skip
def test_each_limit_from_both_sides(changed: dict[str, object], is_calm: bool) -> None:
    assert calm(LIMITS, NOTHING._replace(**changed)) is is_calm  # type: ignore[arg-type]


def test_a_cell_at_its_rail_is_not_calm_even_where_no_tension_trips() -> None:
    """Without limits on tension the rail alone is left."""
    limits = Limits(("a",), (), 244.0, ("m",), tension_low=-5.0)
    assert calm(limits, Signals(armed=True, motor_age=(0,), tension=(243.9,)))
    assert not calm(limits, Signals(armed=True, motor_age=(0,), tension=(244.0,)))


@pytest.mark.parametrize("id_", CASES)
def test_what_a_row_finds_is_never_calm(id_: str) -> None:
    for signals in (CASES[id_].present, *OTHER_SIGNS.get(id_, ())):
        assert not calm(LIMITS, signals)
    sparse = {
        name: value
        for name, value in CASES[id_].present._asdict().items()
        if value != getattr(CASES["B01"].almost, name)
    }
    assert not calm(LIMITS, NOTHING._replace(**sparse)), sparse


def test_an_error_of_a_drive_is_not_calm() -> None:
    assert not calm(LIMITS, NOTHING._replace(drive_errors=(("m", 1, Cause.OTHER),)))


def test_the_least_limits_of_a_hand() -> None:
    assert LIMITS.trip_least == 50.0
    assert LIMITS.warm_least == 70.0
    assert Limits(("a",), (90.0,), 200.0, ("m",), drive_limit=(80.0,), temperature_soft=99.0).trip_least == 80.0
    assert Limits(("a",), (90.0,), 200.0, ("m",), temperature_soft=99.0).warm_least == 85.0
    assert Limits(("a",), (), 200.0, ("m",)).trip_least == math.inf
    assert LIMITS.nodes == ("m0", "m1", "load cells")
