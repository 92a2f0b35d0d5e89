"""Test the comparison of two runs, and the check that a log is intact."""

from pathlib import Path
from unittest.mock import PropertyMock, patch

import numpy as np
import pytest

from handctl.errors import IncomparableError
from handctl.log.read.reader import RunLog
from handctl.replay.log_check import check_log
from handctl.replay.phase_comparison import compare_logs
from handctl.replay.run_comparison import compare_signals, difference_lines, signal_delay


def test_a_run_does_not_differ_from_itself(golden_folder: Path) -> None:
    with (
        RunLog(golden_folder / "jamia-grasp.mcap") as first_log,
        RunLog(golden_folder / "jamia-grasp.mcap") as second_log,
    ):
        comparison = compare_logs(first_log, second_log, "b")
    assert (comparison["gains"], comparison["only_in_first"], comparison["only_in_second"]) == (
        {},
        [],
        [],
    )
    for phase in comparison["phases"].values():
        rows = [
            row for signal in ("joint_deg", "tendon_N") for row in phase.get(signal, {}).values()
        ]
        assert all(row["rms"] == row["peak"] == 0.0 for row in rows)
    assert "joint_deg" in comparison["phases"]["hold"]


def test_a_lost_object_is_seen_in_the_hold_phase(golden_folder: Path) -> None:
    with (
        RunLog(golden_folder / "jamia-grasp.mcap") as first_log,
        RunLog(golden_folder / "jamia-lost.mcap") as second_log,
    ):
        comparison = compare_logs(first_log, second_log, "b")
    # While a digit is in contact, its tension determines its joint angles. A tension difference of
    # one newton changes the joint angles of the digit by some degrees.
    assert comparison["phases"]["preshape"]["joint_deg"]["index_j1"]["peak"] < 5.0
    assert comparison["phases"]["hold"]["joint_deg"]["index_j1"]["peak"] > 20.0


def test_phases_of_only_one_run_are_named(golden_folder: Path) -> None:
    with (
        RunLog(golden_folder / "jamia-grasp.mcap") as first_log,
        RunLog(golden_folder / "jamia-fault.mcap") as second_log,
    ):
        comparison = compare_logs(first_log, second_log, "b")
    assert comparison["only_in_first"] == ["release", "end"]


def test_another_hand_s_log_is_refused(golden_folder: Path) -> None:
    with (
        RunLog(golden_folder / "jamia-grasp.mcap") as first_log,
        RunLog(golden_folder / "jamia11-grasp.mcap") as second_log,
        pytest.raises(IncomparableError, match="jamia11"),
    ):
        compare_logs(first_log, second_log, "b")


@pytest.mark.parametrize("log_name", ["jamia-grasp", "jamia-fault", "jamia11-grasp"])
def test_golden_logs_pass_the_check(golden_folder: Path, log_name: str) -> None:
    with RunLog(golden_folder / f"{log_name}.mcap") as log:
        assert check_log(log) == []


def test_a_wrong_clock_and_a_gap_are_reported(golden_folder: Path) -> None:
    with RunLog(golden_folder / "jamia-grasp.mcap") as log:
        changed_times = log.t_ns.copy()
        changed_times[10] += 1
        with patch.object(RunLog, "t_ns", PropertyMock(return_value=changed_times)):
            assert check_log(log) == ["the time of tick 10 is not its number times the period"]
        tick_numbers_with_gap = np.where(np.arange(len(log)) >= 20, log.k + 3, log.k)
        with patch.object(RunLog, "k", PropertyMock(return_value=tick_numbers_with_gap)):
            assert "gap: 3 ticks are missing between 19 and 23" in check_log(log)


def test_a_wrong_identity_is_reported(golden_folder: Path) -> None:
    with RunLog(golden_folder / "jamia-grasp.mcap") as log:
        log.header.metadata["identity"] = "0" * 64
        findings = check_log(log)
    assert findings[0].startswith("hand.toml has identity")
    assert findings[1].startswith("the hash chain breaks at tick 0:")


@pytest.mark.filterwarnings("error")
def test_unknown_values_have_no_difference_and_no_delay() -> None:
    original_signals = np.sin(np.linspace(0.0, 9.0, 400))[:, None] * np.ones(3)
    repeated_signals = np.roll(original_signals, 10, axis=0)
    repeated_signals[:, 1], repeated_signals[7, 2] = np.nan, np.nan
    comparison = compare_signals(
        ("known", "unknown", "nearly"), original_signals, repeated_signals, 0.01
    )
    assert comparison["known"]["delay_s"] == pytest.approx(0.1, abs=0.02)
    assert np.isnan(list(comparison["unknown"].values())).all()
    assert np.isfinite(comparison["nearly"]["rms"])


def test_moving_signals_have_a_delay_and_noise_has_none() -> None:
    """Test that the comparison reports a delay for moving signals, but not for noise.

    If a joint is at rest, the signal of its angle is only noise in both runs. There is always a
    time shift at which the noise of both runs agrees best. The comparison must not report a time
    shift between two noise signals as a delay of the joint.
    """
    noise = np.random.default_rng(3).normal(scale=0.02, size=(2, 400))
    sine_signal = np.sin(np.linspace(0.0, 9.0, 420))
    original_signals = np.column_stack([noise[0], 0.1 + noise[0], sine_signal[20:] + noise[0]])
    repeated_signals = np.column_stack(
        [noise[1], 0.1 + noise[1], 0.5 + 0.9 * sine_signal[10:-10] + noise[1]]
    )
    comparison = compare_signals(
        ("stands", "stands elsewhere", "moves, weaker and beside"),
        original_signals,
        repeated_signals,
        0.01,
    )
    delays = [row["delay_s"] for row in comparison.values()]
    assert np.isnan(delays[:2]).all()
    assert delays[2] == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("shift", [0, 3])
def test_the_delay_of_a_copy_is_exact(shift: int) -> None:
    """A parabola through the neighbouring shifts would give another delay for a signal that is not symmetric."""
    signal = np.exp(np.linspace(0.0, 2.0, 200)) ** 2
    assert signal_delay(signal[10:190], signal[10 - shift : 190 - shift], 0.01) == shift * 0.01


def test_unknown_differences_are_not_printed() -> None:
    """handctl does not print differences that are NaN. Differences in a task phase of one or two ticks are NaN.

    If the second run is ahead of the first run, handctl prints "10.0 ms ahead", and not "-10 ms
    behind".
    """
    unknown_difference = {"rms": float("nan"), "peak": float("nan"), "delay_s": float("nan")}
    early_difference = {"rms": 0.5, "peak": 1.0, "delay_s": -0.01}
    simultaneous_difference = early_difference | {"delay_s": -1e-6}
    compared = {
        "joint_deg": {"j1": unknown_difference, "j2": early_difference},
        "tendon_N": {"slack": unknown_difference, "rope": simultaneous_difference},
    }
    assert list(difference_lines(compared)) == [
        "j2               rms 0.500 deg, peak 1.000 deg, 10.0 ms ahead",
        "rope             rms 0.500 N, peak 1.000 N, in time",
    ]
