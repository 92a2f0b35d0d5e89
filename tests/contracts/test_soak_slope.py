"""What the soak says of memory: a leak is told, what is given back and taken again is none."""

import random

import pytest

from fuzz.soak import LONG_ENOUGH_S, WARM_S, Sample, slope


def watched(seconds: float, mib_per_h: float = 0.0, swings_mib: float = 0.0) -> list[Sample]:
    chance = random.Random(1)
    times = [30.0 * i for i in range(int(seconds / 30) + 1)]
    return [Sample(t, 350.0 + mib_per_h * t / 3600 + swings_mib * chance.random(), 7) for t in times]


def test_growth_is_told_in_mebibytes_an_hour() -> None:
    assert slope(watched(3600.0, mib_per_h=2.0)) == pytest.approx(2.0, abs=0.01)
    assert slope([one._replace(rss=one.rss + 9 * (one.t < WARM_S)) for one in watched(3600.0)]) == pytest.approx(0.0)


def test_what_is_given_back_and_taken_again_is_no_growth() -> None:
    """A recorder that held 1.5 MiB more in some looks than in others "grew" by three an hour."""
    falling_back = watched(2400.0)
    low = [one._replace(rss=one.rss - 1.5 * (600 <= one.t < 1170 and one.t % 300 > 30)) for one in falling_back]
    assert slope(low) == pytest.approx(0.0, abs=1e-6)
    assert slope(watched(7200.0, mib_per_h=2.0, swings_mib=1.5)) == pytest.approx(2.0, abs=0.3)


def test_too_short_a_time_tells_nothing() -> None:
    assert slope(watched(WARM_S + LONG_ENOUGH_S - 60.0)) is None
    assert slope(watched(WARM_S + LONG_ENOUGH_S + 60.0)) is not None
