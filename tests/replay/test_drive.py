"""Test the repetition of a recorded grasp with a simulated hand."""

from pathlib import Path

import numpy as np
import pytest
import short_runs
from hypothesis import given
from hypothesis import strategies as st

from handctl.errors import IncomparableError
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.playback import RecordedGoals
from handctl.replay.log_execution import execute_log
from handctl.replay.motion_replay import (
    active_interval,
    compare_replay,
    playback_program,
    recorded_targets,
)
from handctl.replay.run_comparison import (
    check_same_hand,
    compare_signals,
    resampled_field,
    signal_delay,
)


@pytest.fixture(scope="module")
def replayed_logs(golden_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Repeat the golden log jamia-grasp on a simulated hand, at another control rate and with other sensor noise.

    Return the path of the new log.
    """
    path = tmp_path_factory.mktemp("drive") / "again.mcap"
    with RunLog(golden_folder / "jamia-grasp.mcap") as original_log:
        state = short_runs.record_lockstep_run(
            path,
            playback_program(original_log, 1 / 250, replays_tensions=False),
            rate_hz=250.0,
            seed=5,
        )
    assert state.failure == ""
    return path


def test_a_grasp_repeats_within_a_degree_and_five_percent_of_force(
    golden_folder: Path, replayed_logs: Path
) -> None:
    with (
        RunLog(golden_folder / "jamia-grasp.mcap") as original_log,
        RunLog(replayed_logs) as replayed_log,
    ):
        comparison = compare_replay(original_log, replayed_log)
        recorded_start, _ = active_interval(original_log)
        phase_starts_s = [
            change.t_ns * 1e-9
            for change in original_log.phases
            if change.name in ("hold", "release")
        ]
        times = np.arange(phase_starts_s[0] + 0.4, phase_starts_s[1], 0.005) - recorded_start
        start = next(
            change.t_ns * 1e-9 for change in replayed_log.phases if change.name == "playback"
        )
        recorded_tensions, repeated_tensions = (
            resampled_field(*run, times).mean(axis=0)
            for run in ((original_log, "tension", recorded_start), (replayed_log, "tension", start))
        )
    assert all(row["rms"] < 1.0 for row in comparison["joint_deg"].values())
    assert all(abs(row["delay_s"]) < 0.02 for row in comparison["joint_deg"].values())
    np.testing.assert_allclose(repeated_tensions, recorded_tensions, rtol=0.05)


def test_the_driven_run_can_be_executed_again(replayed_logs: Path) -> None:
    with RunLog(replayed_logs) as log:
        names = [change.name for change in log.phases]
        assert names.index("approach") < names.index("playback")
        assert execute_log(log).differing_ticks == 0


def test_a_replay_moves_slowly_to_the_first_pose(replayed_logs: Path) -> None:
    with RunLog(replayed_logs) as log:
        starts = {change.name: change.k for change in log.phases}
        path = (log.k >= starts["approach"]) & (log.k < starts["playback"])
        assert np.nanmax(np.abs(log.field("dq_goal")[path])) < np.radians(30.0)
        assert path.sum() == 500


def test_a_digit_under_tension_control_follows_tension_and_not_angles(golden_folder: Path) -> None:
    with RunLog(golden_folder / "jamia-grasp.mcap") as log:
        recorded_goals = recorded_targets(log, log.header.period_ns * 1e-9)
        start, end = active_interval(log)
        is_in_playback = (log.times >= start) & (log.times <= end)
        np.testing.assert_allclose(
            recorded_goals.q, log.field("q_goal")[is_in_playback], rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(
            recorded_goals.tension, log.field("tension_goal")[is_in_playback], rtol=0, atol=1e-9
        )
    assert np.isnan(recorded_goals.q).any()
    assert not np.isnan(recorded_goals.tension).any()
    assert (np.isnan(recorded_goals.q) == np.isnan(recorded_goals.ddq)).all()
    goals_from_text = RecordedGoals.from_text(recorded_goals.to_text(), 11, 4)
    assert all(
        first_array.tobytes() == second_array.tobytes()
        for first_array, second_array in zip(
            (recorded_goals.q, recorded_goals.ddq, recorded_goals.tension),
            (goals_from_text.q, goals_from_text.ddq, goals_from_text.tension),
            strict=True,
        )
    )


def test_another_hand_is_refused_with_both_identities(golden_folder: Path) -> None:
    jamia11 = load_hand("jamia11")
    with (
        RunLog(golden_folder / "jamia-grasp.mcap") as log,
        pytest.raises(IncomparableError) as caught,
    ):
        check_same_hand(log, jamia11.name, jamia11.identity, "--hand jamia11")
    assert jamia11.identity[:12] in str(caught.value)
    assert load_hand("jamia").identity[:12] in str(caught.value)


@given(st.integers(-15, 15), st.floats(0.5, 3.0))
def test_a_delay_is_measured(delay_ticks: int, rate_hz: float) -> None:
    t = np.arange(400) * 0.005
    original_signal, delayed_signal = (
        np.sin(2 * np.pi * rate_hz * (t - late)) for late in (0.0, delay_ticks * 0.005)
    )
    assert signal_delay(original_signal, delayed_signal, 0.005) == pytest.approx(
        delay_ticks * 0.005, abs=2e-4
    )


def test_a_constant_signal_has_no_delay() -> None:
    constant_signal = np.full(400, 30.0) + 0.01 * np.sin(np.arange(400))
    difference = compare_signals(
        ("a",), constant_signal[:, None], constant_signal[:, None] + 2.0, 0.005
    )["a"]
    assert (difference["rms"], difference["peak"]) == pytest.approx((2.0, 2.0))
    assert np.isnan(difference["delay_s"])
