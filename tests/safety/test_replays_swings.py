"""Test the detection of repeated load-cell readings, and of oscillating tensions.

Without repeated readings or oscillations, the detectors report nothing.
"""

import math
import os

import numpy as np
import pytest

from handctl.campaign.fault_matrix import GRASP_STAGE
from handctl.campaign.run_stages import advance_to_stage, hand_with_protocol, homed_run
from handctl.core.detectors import replayed_readings
from handctl.core.tick_types import HandMode
from handctl.safety.faults.node import OSCILLATION_DURATION_S
from handctl.session.run_plan import default_control_rate
from tests.safety.synthetic_monitor import SyntheticMonitor, synthetic_limits

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
NOISE_SEEDS = range(20)
READING_STEP_N = 0.0625


def noisy_readings(seed: int, tick_count: int, noise_N: float, cell_count: int = 4) -> np.ndarray:
    """Return noisy readings (ticks, n) [N] of n load cells at a tension of 20 N.

    Each reading is rounded to a count of the load cell.
    """
    chance = np.random.default_rng(seed)
    return (
        np.round((20.0 + chance.normal(0.0, noise_N, (tick_count, cell_count))) / READING_STEP_N)
        * READING_STEP_N
    )


def first_repetition_tick(cell_readings: np.ndarray) -> tuple[int, list[tuple[int, int]]]:
    """Return the first tick in which repeated readings are detected, and a list of the affected tendons.

    If no repeated readings are detected, the tick is -1. The list has two numbers for each affected
    tendon: the index of the tendon, and the age of its repeated readings [ticks].
    """
    monitor = SyntheticMonitor(synthetic_limits(cell_readings.shape[1]))
    for k, row in enumerate(cell_readings):
        if age_by_name := monitor.tick(measured_tension=row).get("T05b"):
            return k, [
                (monitor.limits.tendons.index(name), int(age)) for name, age in age_by_name.items()
            ]
    return -1, []


@pytest.mark.parametrize("repetition_age", [16, 32, 50, replayed_readings.MAX_READING_AGE_TICKS])
@pytest.mark.parametrize("seed", NOISE_SEEDS)
def test_repeated_content_is_found_within_sixteen_ticks(seed: int, repetition_age: int) -> None:
    rows = noisy_readings(seed, 300, 0.5)
    rows_with_repetition = rows.copy()
    rows_with_repetition[200:, 2] = rows[200 - repetition_age : 300 - repetition_age, 2]
    k, repetitions = first_repetition_tick(rows_with_repetition)
    assert 207 <= k < 200 + min(repetition_age, 24)
    assert repetitions == [(2, repetition_age)]


@pytest.mark.parametrize("noise_N", [0.0, 0.02, 0.05, 0.1, 0.5, 1.5])
@pytest.mark.parametrize("seed", range(20 if NIGHTLY else 4))
def test_fresh_readings_are_no_repetition_at_any_noise(seed: int, noise_N: float) -> None:
    """New readings with any noise are not regarded as repeated readings.

    Constant readings, and readings that alternate between two counts, are not regarded as repeated
    readings either.
    """
    assert first_repetition_tick(noisy_readings(seed, 20_000 if NIGHTLY else 3_000, noise_N)) == (
        -1,
        [],
    )


@pytest.mark.parametrize(
    "limit_cycle_N", [[3.0], [3.0, 2.9375], [2.9375, 3.0, 3.0], [3.0, 3.0625, 3.0, 2.9375, 3.0]]
)
def test_limit_cycle_of_a_few_counts_is_no_repetition(limit_cycle_N: list[float]) -> None:
    """With coarse load cells, a tension loop has a limit cycle even without noise.

    A limit cycle of the tension loop has occurred during commissioning.
    """
    assert first_repetition_tick(
        np.array([[limit_cycle_N[k % len(limit_cycle_N)]] for k in range(500)])
    ) == (-1, [])


def test_a_missing_reading_is_no_repetition() -> None:
    rows = noisy_readings(0, 300, 0.5)
    rows[100:200] = np.nan
    assert first_repetition_tick(rows) == (-1, [])


def first_oscillation(tension_deviation: np.ndarray, period_s: float) -> tuple[float, float]:
    """Return the time of the first reported oscillation [s], and the RMS of the oscillation [N].

    The monitor searches the signal ``tension_deviation`` [N] for oscillations. If no oscillation is
    reported, the time is -1.
    """
    monitor = SyntheticMonitor(synthetic_limits(2), period=period_s)
    for k, value in enumerate(tension_deviation):
        if value_by_name := monitor.tick(measured_tension=[value, 0.0], wanted=0.0).get("N14b"):
            assert list(value_by_name) == ["t0"]
            return k * period_s, value_by_name["t0"]
    return -1.0, 0.0


@pytest.mark.parametrize("control_rate_hz", [100.0, 200.0, 500.0, 1000.0])
@pytest.mark.parametrize("swing_frequency_hz", [15.0, 25.0, 40.0])
def test_a_swing_of_twenty_newtons_is_found_in_a_third_of_a_second(
    control_rate_hz: float, swing_frequency_hz: float
) -> None:
    t = np.arange(0.0, 1.0, 1.0 / control_rate_hz) + 0.3e-3
    when, rms = first_oscillation(
        20.0 * np.sin(2.0 * math.pi * swing_frequency_hz * t), 1.0 / control_rate_hz
    )
    assert OSCILLATION_DURATION_S <= when < 0.35
    assert 8.0 < rms < 20.0


@pytest.mark.parametrize("control_rate_hz", [100.0, 500.0])
def test_step_and_small_swing_are_no_oscillation(control_rate_hz: float) -> None:
    t = np.arange(0.0, 2.0, 1.0 / control_rate_hz)
    assert (
        first_oscillation(
            75.0 * np.clip(1.0 - t / 0.015, 0.0, 1.0) + 75.0 * np.exp(-t / 0.03),
            1.0 / control_rate_hz,
        )[0]
        < 0.0
    )
    assert first_oscillation(9.0 * np.sin(2.0 * math.pi * 20.0 * t), 1.0 / control_rate_hz)[0] < 0.0
    assert (
        first_oscillation(60.0 * np.sin(2.0 * math.pi * 0.5 * t), 1.0 / control_rate_hz)[0] < 0.0
    ), "slow"
    assert first_oscillation(np.full(len(t), np.nan), 1.0 / control_rate_hz)[0] < 0.0


@pytest.mark.parametrize("seed", NOISE_SEEDS if NIGHTLY else (3,))
@pytest.mark.parametrize(
    ("fault_command", "expected_faults", "duration_s"),
    [
        ("old cell={tendon} size=16", {"T05b"}, 0.08),
        ("replay node=sensors size=16", {"N02", "B03b"}, 0.2),
        ("ripple node={motor} size=0.2 hz=25", {"N14b"}, 0.7),
    ],
)
def test_a_grasping_hand_relaxes(
    fault_command: str, expected_faults: set[str], duration_s: float, seed: int
) -> None:
    hand = hand_with_protocol("jamia", "mit")
    with homed_run(hand, default_control_rate(hand), seed) as hand_run:
        advance_to_stage(hand_run, GRASP_STAGE)
        which = seed % 4
        hand_run.simulated_hand.inject(
            fault_command.format(tendon=hand.tendon[which].name, motor=hand.motor[which].name)
        )
        assert hand_run.run_until(
            lambda out: out.mode in (HandMode.RELAX, HandMode.CUT), duration_s
        )
        assert {mark.id for mark in hand_run.state.latched_faults} <= expected_faults
        assert hand_run.simulated_hand.fault_states()[0]["felt"]
