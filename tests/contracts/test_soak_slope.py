"""Test the soak run: a long run of a controller, during which the memory of its processes is measured.

The soak run must report a memory leak. The soak run must not report memory that a process frees and
allocates again. The soak run must be able to start a controller.
"""

import random
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz import soak
from fuzz.soak import MIN_SLOPE_SAMPLING_S, WARM_UP_S, MemorySample, memory_slope
from handctl.hand.hand_loading import load_hand
from handctl.session.calibration import load_calibration


def memory_samples(
    duration_s: float, mib_per_h: float = 0.0, noise_mib: float = 0.0
) -> list[MemorySample]:
    chance = random.Random(1)
    sample_times_s = [30.0 * i for i in range(int(duration_s / 30) + 1)]
    return [
        MemorySample(t, 350.0 + mib_per_h * t / 3600 + noise_mib * chance.random(), 7)
        for t in sample_times_s
    ]


def test_a_controller_gets_a_calibration_of_its_hand(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Reproduce a defect: the soak run wrote a hand file to the path of the calibration.

    A hand file is no valid calibration, so the soak run ended before it started a controller.
    """
    monkeypatch.chdir(tmp_path)
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    monkeypatch.setattr(soak, "start_handctl", lambda *words: done)
    assert not soak.SoakTest(1, 1.0).start_controller(), (
        "without a calibration no controller starts"
    )
    hand = load_hand("jamia")
    assert set(load_calibration(tmp_path / "c.toml", hand).drive) == {
        motor.name for motor in hand.motor
    }


def test_growth_is_reported_in_mebibytes_per_hour() -> None:
    assert memory_slope(memory_samples(3600.0, mib_per_h=2.0)) == pytest.approx(2.0, abs=0.01)
    assert memory_slope(
        [
            memory_sample._replace(
                rss_mib=memory_sample.rss_mib + 9 * (memory_sample.time_s < WARM_UP_S)
            )
            for memory_sample in memory_samples(3600.0)
        ]
    ) == pytest.approx(0.0)


def test_memory_that_is_freed_and_allocated_again_is_no_growth() -> None:
    """Reproduce a defect: the soak run reported a memory growth of 3 MiB per hour, although no memory leaked.

    In some of the samples, the memory of a recorder was 1.5 MiB smaller than in the other samples.
    """
    samples_with_drops = memory_samples(2400.0)
    low = [
        sample._replace(
            rss_mib=sample.rss_mib
            - 1.5 * (600 <= sample.time_s < 1170 and sample.time_s % 300 > 30)
        )
        for sample in samples_with_drops
    ]
    assert memory_slope(low) == pytest.approx(0.0, abs=1e-6)
    assert memory_slope(memory_samples(7200.0, mib_per_h=2.0, noise_mib=1.5)) == pytest.approx(
        2.0, abs=0.3
    )


def test_too_short_a_time_has_no_slope() -> None:
    assert memory_slope(memory_samples(WARM_UP_S + MIN_SLOPE_SAMPLING_S - 60.0)) is None
    assert memory_slope(memory_samples(WARM_UP_S + MIN_SLOPE_SAMPLING_S + 60.0)) is not None
