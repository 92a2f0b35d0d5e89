"""Test trajectory files.

The curve of a trajectory file passes through all points of the file, and begins and ends at rest.
The function that loads a trajectory file refuses a wrong file, before any motion.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from handctl.core.control_law.trajectory import CurveTrajectory
from handctl.errors import ConfigError
from handctl.programs.task import FollowPhase, load_trajectory

VALID_TRAJECTORY = """schema = 1
name = "wave"
time_s = [0.0, 0.5, 1.0, 2.0]
[angle_deg]
index = [0.0, 20.0, 10.0, 30.0]
thumb = [5.0, 5.0, 15.0, 0.0]
"""


def test_a_curve_meets_its_points_and_rests_at_the_ends() -> None:
    times, angles = (0.0, 0.4, 1.0, 1.5), (0.1, 0.5, 0.2, 0.9)
    curve = CurveTrajectory.curve_through_points(times, angles, 3)
    for t, angle in zip(times, angles, strict=True):
        np.testing.assert_allclose(curve.motion_at(t)[0], np.full(3, angle), atol=1e-12)
    for t in (0.0, curve.duration):
        np.testing.assert_allclose(curve.motion_at(t)[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(curve.motion_at(9.0)[0], angles[-1])
    assert not np.any(curve.motion_at(9.0)[2])


def test_velocity_and_acceleration_are_the_derivatives() -> None:
    curve, h = (
        CurveTrajectory.curve_through_points((0.0, 0.3, 0.9, 1.4), (0.0, 0.6, 0.1, 0.4), 1),
        1e-5,
    )
    for t in np.linspace(0.05, 1.35, 40):
        (position_before, _, _), (_, speed, acceleration), (position_after, _, _) = (
            curve.motion_at(t + d) for d in (-h, 0.0, h)
        )
        assert (position_after - position_before) / (2 * h) == pytest.approx(speed, abs=1e-6)
        velocity_after, velocity_before = curve.motion_at(t + h)[1], curve.motion_at(t - h)[1]
        assert (velocity_after - velocity_before) / (2 * h) == pytest.approx(acceleration, abs=1e-3)


def test_peak_speed_is_the_largest_on_the_way() -> None:
    curve = CurveTrajectory.curve_through_points((0.0, 0.3, 0.9, 1.4), (0.0, 0.6, 0.1, 0.4), 1)
    peak_sampled_speed = max(abs(curve.motion_at(t)[1][0]) for t in np.linspace(0.0, 1.4, 20001))
    assert curve.peak_speed() == pytest.approx(peak_sampled_speed, rel=1e-6)


def test_a_file_becomes_a_slow_move_and_the_curve(tmp_path: Path) -> None:
    path = tmp_path / "wave.toml"
    path.write_text(VALID_TRAJECTORY)
    first_phase, follow = load_trajectory(path).phase
    assert first_phase.angle_deg == {"index": 0.0, "thumb": 5.0}  # type: ignore[union-attr]
    assert isinstance(follow, FollowPhase)
    assert follow.time_s[-1] == 2.0


@pytest.mark.parametrize(
    ("original_line", "replaced_line", "expected_message"),
    [
        ("0.0, 0.5, 1.0, 2.0]", "0.0, 0.5, 0.5, 2.0]", "rise"),
        ("0.0, 0.5, 1.0, 2.0]", "0.1, 0.5, 1.0, 2.0]", "rise"),
        ("20.0, 10.0, 30.0", "20.0, 10.0", "each of the 4 values of time_s"),
        ("20.0, 10.0, 30.0", "20.0, nan, 30.0", "finite"),
        ("20.0, 10.0, 30.0", "20.0, 1000.0, 30.0", "150"),
        ("0.0, 0.5, 1.0, 2.0]", "0.0, 0.01, 0.02, 0.03]", "deg/s"),
        ("schema = 1", "schema = 2", "schema"),
        ("time_s", "times_s", "times_s"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(
    tmp_path: Path, original_line: str, replaced_line: str, expected_message: str
) -> None:
    path = tmp_path / "wave.toml"
    path.write_text(VALID_TRAJECTORY.replace(original_line, replaced_line))
    with pytest.raises(ConfigError) as refused:
        load_trajectory(path)
    assert expected_message in str(refused.value)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)


def test_radians_are_not_degrees(tmp_path: Path) -> None:
    path = tmp_path / "wave.toml"
    path.write_text(VALID_TRAJECTORY)
    follow = load_trajectory(path).phase[1]
    assert isinstance(follow, FollowPhase)
    curve = CurveTrajectory.curve_through_points(
        follow.time_s, tuple(map(math.radians, follow.angle_deg["index"])), 1
    )
    assert curve.motion_at(0.5)[0][0] == pytest.approx(math.radians(20.0))


@pytest.mark.parametrize("time_gap_s", [5e-324, 1e-310, 1e-160, 1e-5])
def test_very_close_times_do_not_bypass_the_speed_limit(time_gap_s, recwarn):
    """If the times of two points of a trajectory are very close, the coefficients of the spline overflow.

    After the overflow, the computed speed is NaN. A NaN speed is refused in the same way as a speed
    above the limit.
    """
    angles = {"index": (0.0, 1.0, 0.0)}
    with pytest.raises(ValueError, match="at most 700 deg/s"):
        FollowPhase(kind="follow", time_s=(0.0, time_gap_s, 1.0), angle_deg=angles)
    assert not recwarn.list
