"""Test the repetition of a recorded grasp with the true values of the simulator.

The truth files of the simulator contain the angles, tensions and forces of the recorded run and of
the repetition.

Both runs are in lockstep, so the tests get the same numbers every time. The control rate and the
sensor noise of the repetition differ from those of the recorded run.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import short_runs
from numpy.typing import NDArray

from handctl.log.read.reader import RunLog
from handctl.replay.motion_replay import active_interval, compare_replay, playback_program
from handctl.report.truth_record import read_truth

FloatArray = NDArray[np.float64]
RATE_HZ, SETTLING_TIME_S = 250.0, 0.4
DIGIT_NAMES = ("index", "middle", "ring", "thumb")


@dataclass(frozen=True)
class RunWithRepetition:
    """A run and its repetition: the logs of both runs, and the true values of both runs in a common interval."""

    folder: Path
    follows_tensions: bool

    def compare_replay(self) -> dict[str, dict[str, dict[str, float]]]:
        with (
            RunLog(self.folder / "first.mcap") as original_log,
            RunLog(self.repeated_log_path) as replayed_log,
        ):
            return compare_replay(original_log, replayed_log)

    @property
    def repeated_log_path(self) -> Path:
        return self.folder / f"again-{self.follows_tensions}.mcap"

    def true_values(self, *truth_columns: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times since the start of the motion [s], and the true values of both runs at these times.

        In each run, time 0 is the start of the motion in this run. The values of each run have the
        shape (times, columns).
        """
        with (
            RunLog(self.folder / "first.mcap") as original_log,
            RunLog(self.repeated_log_path) as replayed_log,
        ):
            recorded_start, end = active_interval(original_log)
            start = next(change.t_ns for change in replayed_log.phases if change.name == "playback")
        t_ns = np.arange(0, int((end - recorded_start) * 1e9), 2_000_000)
        recorded_truth, repeated_truth = (
            read_truth(path)
            for path in (self.folder / "first.truth", self.repeated_log_path.with_suffix(".truth"))
        )
        return (
            t_ns / 1e9,
            recorded_truth.interpolated_columns(
                list(truth_columns), t_ns + int(recorded_start * 1e9)
            ),
            repeated_truth.interpolated_columns(list(truth_columns), t_ns + start),
        )

    def rest_interval(self) -> tuple[float, float]:
        """Return start and end of the interval in which the hand holds the object at rest [s].

        The start and the end of the interval are times since the start of the recorded motion.
        """
        with RunLog(self.folder / "first.mcap") as original_log:
            phase_starts_s = {change.name: change.t_ns * 1e-9 for change in original_log.phases}
            start, _ = active_interval(original_log)
        return phase_starts_s["hold"] + SETTLING_TIME_S - start, phase_starts_s["release"] - start

    def mean_values_at_rest(self, *truth_columns: str) -> tuple[FloatArray, FloatArray]:
        """Return the mean values of both runs while the grasp is at rest.

        The result of each run is an array (columns,), with one mean value for each of the given
        columns.
        """
        times, recorded_values, repeated_values = self.true_values(*truth_columns)
        start, end = self.rest_interval()
        is_at_rest = (times >= start) & (times <= end)
        return recorded_values[is_at_rest].mean(axis=0), repeated_values[is_at_rest].mean(axis=0)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a run, and return the folder that contains its log and its truth file."""
    folder = tmp_path_factory.mktemp("pair")
    short_runs.record_lockstep_run(
        folder / "first.mcap",
        short_runs.short_task(folder),
        rate_hz=200.0,
        truth=folder / "first.truth",
    )
    return folder


@pytest.fixture(scope="module", params=[False, True], ids=["trajectories", "tensions"])
def run_with_repetition(run_folder: Path, request: pytest.FixtureRequest) -> RunWithRepetition:
    """Return a recorded run and its repetition.

    The repetition follows either the recorded angles or the recorded tensions.
    """
    run_pair = RunWithRepetition(run_folder, request.param)
    with RunLog(run_folder / "first.mcap") as original_log:
        program = playback_program(original_log, 1 / RATE_HZ, run_pair.follows_tensions)
    truth = run_pair.repeated_log_path.with_suffix(".truth")
    assert (
        short_runs.record_lockstep_run(
            run_pair.repeated_log_path, program, rate_hz=RATE_HZ, seed=5, truth=truth
        ).failure
        == ""
    )
    return run_pair


def test_the_repetition_gives_the_same_log(run_with_repetition: RunWithRepetition) -> None:
    """Compare the log of the repetition with the log of the recorded run.

    If a replay repeats only the tensions, no control loop corrects the angle of a moving digit.
    Without a control loop for the angle, a tension error of half a newton turns a digit by six
    degrees against its springs.

    Both runs estimate the joint angles. When a digit first touches the object, a tension error of
    one newton increases the difference between the two estimates by two degrees.
    """
    comparison = run_with_repetition.compare_replay()
    worst = (
        {"joint_deg": 12.0, "tendon_N": 13.0}
        if run_with_repetition.follows_tensions
        else {"joint_deg": 3.0, "tendon_N": 13.0}
    )
    max_rms_by_signal = (
        {"joint_deg": 3.0, "tendon_N": 2.2}
        if run_with_repetition.follows_tensions
        else {"joint_deg": 1.5, "tendon_N": 2.2}
    )
    for signal in worst:
        assert max(row["peak"] for row in comparison[signal].values()) < worst[signal]
        assert max(row["rms"] for row in comparison[signal].values()) < max_rms_by_signal[signal]


@pytest.mark.parametrize("digit", DIGIT_NAMES)
def test_the_repetition_gives_the_same_truth(
    run_with_repetition: RunWithRepetition, digit: str
) -> None:
    """The test compares the mean joint angle of each digit.

    The test does not compare the angles of single joints, because contact and friction determine
    how the motion of a tendon is divided among the joints.
    """
    joints = [f"q/{digit}_j{n}" for n in range(1, 3 if digit == "thumb" else 4)]
    _, recorded_angles, repeated_angles = run_with_repetition.true_values(*joints)
    angle_difference = np.degrees(
        np.abs(repeated_angles.mean(axis=1) - recorded_angles.mean(axis=1))
    )
    assert angle_difference.max() < (6.0 if run_with_repetition.follows_tensions else 1.0)
    assert angle_difference.mean() < (1.5 if run_with_repetition.follows_tensions else 0.3)


def test_a_replayed_grasp_is_as_strong_as_the_recorded_one(
    run_with_repetition: RunWithRepetition,
) -> None:
    tensions = [f"tension/{digit}_tendon" for digit in DIGIT_NAMES]
    forces = [f"contact_force/{digit}/{axis}" for digit in DIGIT_NAMES for axis in "xyz"]
    recorded_tensions, repeated_tensions = run_with_repetition.mean_values_at_rest(*tensions)
    np.testing.assert_allclose(
        repeated_tensions,
        recorded_tensions,
        rtol=0.08 if run_with_repetition.follows_tensions else 0.05,
    )
    recorded_forces, repeated_forces = (
        np.linalg.norm(mean_forces.reshape(-1, 3), axis=1)
        for mean_forces in run_with_repetition.mean_values_at_rest(*forces)
    )
    assert recorded_forces.min() > 1.0, "every digit has contact"
    np.testing.assert_allclose(
        repeated_forces, recorded_forces, rtol=0.2 if run_with_repetition.follows_tensions else 0.05
    )
