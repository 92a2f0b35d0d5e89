"""Test the start, the end and the derivatives of minimum-jerk trajectories.

No other trajectory with the same start and end has a smaller integral of the squared jerk.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.core.control_law.trajectory import (
    PEAK_SPEED_RATIO,
    CurveTrajectory,
    MinimumJerk,
    minimum_jerk_duration,
)
from handctl.core.plain_data import serialized_bytes

angle_pairs = st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=2).map(np.array)
move_durations = st.floats(0.01, 100.0)


@given(start_angles=angle_pairs, end_angles=angle_pairs, duration_s=move_durations)
def test_minimum_jerk_move_rests_at_both_ends(
    start_angles: np.ndarray, end_angles: np.ndarray, duration_s: float
) -> None:
    move = MinimumJerk(start_angles, end_angles, duration_s)
    for t, expected_position in (
        (0.0, start_angles),
        (duration_s, end_angles),
        (-1.0, start_angles),
        (duration_s + 5.0, end_angles),
    ):
        position, velocity, acceleration = move.motion_at(t)
        np.testing.assert_allclose(position, expected_position, atol=1e-12)
        np.testing.assert_allclose(velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)


@given(
    start_angles=angle_pairs,
    end_angles=angle_pairs,
    duration_s=move_durations,
    time_fraction=st.floats(0.01, 0.99),
)
def test_trajectory_derivatives_match_differences(
    start_angles: np.ndarray, end_angles: np.ndarray, duration_s: float, time_fraction: float
) -> None:
    move, h, t = (
        MinimumJerk(start_angles, end_angles, duration_s),
        1e-5 * duration_s,
        time_fraction * duration_s,
    )
    motion_before, now, motion_after = (
        move.motion_at(t - h),
        move.motion_at(t),
        move.motion_at(t + h),
    )
    distance_rad = np.abs(end_angles - start_angles).max() + 1e-9
    np.testing.assert_allclose(
        now[1],
        (motion_after[0] - motion_before[0]) / (2 * h),
        atol=1e-6 * distance_rad / duration_s,
    )
    np.testing.assert_allclose(
        now[2],
        (motion_after[1] - motion_before[1]) / (2 * h),
        atol=1e-5 * distance_rad / duration_s**2,
    )


@given(start_angles=angle_pairs, end_angles=angle_pairs, duration_s=move_durations)
def test_move_stays_between_its_ends_and_below_its_peak_speed(
    start_angles: np.ndarray, end_angles: np.ndarray, duration_s: float
) -> None:
    move = MinimumJerk(start_angles, end_angles, duration_s)
    position_samples = [move.motion_at(t) for t in np.linspace(0.0, duration_s, 101)]
    low, high = (
        np.minimum(start_angles, end_angles) - 1e-12,
        np.maximum(start_angles, end_angles) + 1e-12,
    )
    assert all(((low <= p) & (p <= high)).all() for p, _, _ in position_samples)
    steps = np.diff([p for p, _, _ in position_samples], axis=0) * np.sign(
        end_angles - start_angles
    )
    assert (steps >= -1e-12).all(), "straight there"
    speed = np.abs([v for _, v, _ in position_samples]).max(axis=0)
    np.testing.assert_allclose(
        speed,
        PEAK_SPEED_RATIO * np.abs(end_angles - start_angles) / duration_s,
        rtol=1e-6,
        atol=1e-12,
    )


def test_no_admissible_bump_has_less_jerk() -> None:
    """A disturbance that is added to a minimum-jerk move increases the integral of the squared jerk.

    The added disturbance has zero position, speed and acceleration at the start and at the end of
    the move.
    """
    move, t = MinimumJerk(np.array([0.0]), np.array([1.0]), 1.0), np.linspace(0.0, 1.0, 20001)
    acceleration = np.array([move.motion_at(time_s)[2][0] for time_s in t])
    acceleration_bump = np.gradient(np.gradient(t**3 * (1 - t) ** 3, t), t)

    def squared_jerk(a: np.ndarray) -> float:
        return float(np.trapezoid(np.gradient(a, t)[100:-100] ** 2, t[100:-100]))

    for size in (-0.5, 0.5):
        assert squared_jerk(acceleration + size * acceleration_bump) > squared_jerk(acceleration)


@pytest.mark.parametrize(("distance_rad", "peak_speed"), [(1.0, 2.0), (-0.5, 0.1), (0.0, 1.0)])
def test_duration_keeps_the_peak_speed(distance_rad: float, peak_speed: float) -> None:
    duration = minimum_jerk_duration(distance_rad, peak_speed, 0.05)
    assert duration >= 0.05
    move = MinimumJerk(np.array([0.0]), np.array([distance_rad]), duration)
    fastest = max(abs(move.motion_at(t)[1][0]) for t in np.linspace(0.0, duration, 1001))
    assert fastest <= peak_speed * (1 + 1e-9)
    if distance_rad:
        assert fastest == pytest.approx(peak_speed, rel=1e-5)


curve_times = st.lists(st.floats(0.05, 2.0), min_size=1, max_size=6).map(
    lambda steps: (0.0, *np.cumsum(steps).tolist())
)


@given(data=st.data())
def test_a_curve_goes_through_its_points_from_rest_to_rest(data: st.DataObject) -> None:
    when = data.draw(curve_times)
    points = tuple(
        data.draw(st.lists(st.floats(-0.5, 2.0), min_size=len(when), max_size=len(when)))
    )
    curve = CurveTrajectory.curve_through_points(when, points, 2)
    assert curve.duration == when[-1]
    for t, waypoint in zip(when, points, strict=True):
        np.testing.assert_allclose(curve.motion_at(t)[0], [waypoint, waypoint], atol=1e-9)
    for t in (-1.0, 0.0, when[-1], when[-1] + 1.0):
        np.testing.assert_allclose(curve.motion_at(t)[1], 0.0, atol=1e-9)
    for t in (-1.0, when[-1] + 1.0):
        np.testing.assert_array_equal(curve.motion_at(t)[2], 0.0)
        np.testing.assert_allclose(
            curve.motion_at(t)[0], curve.motion_at(min(max(t, 0.0), when[-1]))[0]
        )
    speeds = [abs(curve.motion_at(t)[1][0]) for t in np.linspace(0.0, when[-1], 2001)]
    assert max(speeds) <= curve.peak_speed() + 1e-9
    assert curve.peak_speed() <= max(speeds) * 1.01 + 1e-6


@given(
    curve_points=st.lists(st.floats(-0.5, 2.0), min_size=4, max_size=4),
    time_fraction=st.floats(0.02, 0.98),
)
def test_curve_derivatives_match_differences(
    curve_points: list[float], time_fraction: float
) -> None:
    curve, h = (
        CurveTrajectory.curve_through_points((0.0, 0.4, 1.0, 1.3), tuple(curve_points), 1),
        1e-5,
    )
    t = time_fraction * 1.3
    if min(abs(t - knot) for knot in (0.4, 1.0)) < 2 * h:
        return
    motion_before, now, motion_after = (
        curve.motion_at(t - h),
        curve.motion_at(t),
        curve.motion_at(t + h),
    )
    np.testing.assert_allclose(
        now[1], (motion_after[0] - motion_before[0]) / (2 * h), rtol=1e-5, atol=1e-5
    )
    np.testing.assert_allclose(
        now[2], (motion_after[1] - motion_before[1]) / (2 * h), rtol=1e-4, atol=1e-3
    )


def test_every_number_of_a_way_is_in_its_plain_form() -> None:
    """The plain form (see ``handctl.core.plain_data``) of a trajectory contains every number of the trajectory.

    The hash of a state is computed from the plain forms of its trajectories.
    """
    trajectories = [
        MinimumJerk(np.array([0.0]), np.array([1.0]), 1.0),
        MinimumJerk(np.array([0.1]), np.array([1.0]), 1.0),
        MinimumJerk(np.array([0.0]), np.array([1.1]), 1.0),
        MinimumJerk(np.array([0.0]), np.array([1.0]), 1.1),
        CurveTrajectory.curve_through_points((0.0, 1.0), (0.0, 1.0), 1),
        CurveTrajectory.curve_through_points((0.0, 1.1), (0.0, 1.0), 1),
        CurveTrajectory.curve_through_points((0.0, 1.0), (0.1, 1.0), 1),
        CurveTrajectory.curve_through_points((0.0, 1.0), (0.0, 1.1), 1),
        CurveTrajectory.curve_through_points((0.0, 1.0), (0.0, 1.0), 3),
    ]
    assert len({serialized_bytes(distance_rad) for distance_rad in trajectories}) == len(
        trajectories
    )
