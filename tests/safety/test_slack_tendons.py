"""Test the detection of slack tendons, of snapped tendons, and of tendons that a disabled motor still pulls.

Each detector is tested just below and just above its limit.
"""

import math
from typing import Any

import numpy as np
import pytest

from handctl.core.control_law.digit_goal import GoalKind
from handctl.core.control_law.digit_reference import MINIMUM_JERK
from handctl.core.detectors.residuals import TENSION
from handctl.core.tick_types import HandMode
from handctl.safety.faults.node import TENSION_AFTER_CUT_N
from handctl.safety.faults.tendon import SLACK_TENSION_N, SNAP_MIN_COMMAND_N, TAUT_TENSION_N
from tests.safety.synthetic_monitor import (
    PERIOD_S,
    SPOOL_RADIUS_M,
    SyntheticMonitor,
    synthetic_limits,
)

NAN = math.nan
TensionList = list[float]


class FilteredTensionMonitor(SyntheticMonitor):
    """Tendons with a safety monitor. The test sets the filtered tensions of the tendons."""

    def __init__(self, tendon_count: int, **value_by_field: Any) -> None:
        super().__init__(synthetic_limits(tendon_count), residual_fraction=0.0)
        self.set_state_values(value_by_field)

    def run_tick(
        self, tension: TensionList, commanded_tension: TensionList, **value_by_field: Any
    ) -> list[tuple[int, int]]:
        """Run a tick with given measured tensions and commanded tensions.

        Return two counts for each tendon: the ticks since the tendon was last taut, and the ticks
        in which the tendon was slack.
        """
        self.reported = self.tick(
            residual={TENSION: tension}, wanted=commanded_tension, **value_by_field
        )
        return list(
            zip(self.field_values("taut_ago"), self.field_values("slack_ticks"), strict=True)
        )

    def run_tick_after_cut(self, tension: TensionList, **value_by_field: Any) -> dict[str, float]:
        """Run a tick with load-cell readings after the motors were disabled.

        Return the tendons that a motor still pulls, each with its tension or force [N].
        """
        return self.tick(measured_tension=tension, mode=int(HandMode.CUT), **value_by_field).get(
            "N16", {}
        )


@pytest.mark.parametrize(("cell_tension_N", "commanded_tension_N", "counts_before", "counts_after"), [
    # Columns: tension [N], commanded tension [N], (ticks since taut, ticks slack) before the tick
    # and after it
    (2.6, 20.0, (-1, 0), (0, 0)),     # the tendon is taut for the first time
    (2.6, 20.0, (7, 5), (0, 0)),      # taut again
    (2.5, 20.0, (-1, 0), (-1, 0)),    # the tendon has never been taut, so it cannot become slack
    (0.0, 20.0, (-1, 0), (-1, 0)),
    (2.5, 20.0, (0, 0), (1, 0)),      # the tension is between slack and taut
    # the tension is just high enough not to be slack, so the count of slack ticks begins again
    (2.0, 20.0, (3, 4), (4, 0)),
    (1.9, 20.0, (3, 4), (4, 5)),
    (1.9, 2.5, (3, 4), (4, 0)),       # the commanded tension is so low that slack is allowed
    (1.9, 2.6, (3, 4), (4, 5)),
    (1.9, NAN, (3, 4), (-1, 0)),      # without tension control, slack is allowed, and the tendon counts as never taut
    (30.0, NAN, (3, 4), (-1, 0)),
    (NAN, 20.0, (3, 4), (4, 0)),      # without a reading, a tendon is neither slack nor taut
])  # fmt: skip
def test_slack_detector_updates_its_counts_in_each_tick(
    cell_tension_N, commanded_tension_N, counts_before, counts_after
):
    tendons = FilteredTensionMonitor(1, taut_ago=counts_before[0], slack_ticks=counts_before[1])
    assert tendons.run_tick([cell_tension_N], [commanded_tension_N]) == [counts_after]


def test_tendons_count_separately_and_begin_as_never_taut():
    tendons = FilteredTensionMonitor(3)
    assert tendons.run_tick([20.0, 0.0, 1.0], [24.0, 24.0, NAN]) == [(0, 0), (-1, 0), (-1, 0)]
    assert tendons.run_tick([0.0, 20.0, 1.0], [24.0, 24.0, 24.0]) == [(1, 1), (0, 0), (-1, 0)]


def test_slack_is_reported_by_name_and_in_seconds():
    tendons = FilteredTensionMonitor(3, taut_ago=[0, 8, 1], slack_ticks=[0, 25, 24])
    tendons.run_tick([20.0, 0.0, 0.0], [20.0] * 3)
    assert tendons.reported["T02a"] == {"t1": 26 * PERIOD_S}
    tendons = FilteredTensionMonitor(2, taut_ago=9, slack_ticks=[249, 250])
    tendons.run_tick([0.0] * 2, [20.0] * 2)
    assert tendons.reported["T02a"] == {"t0": 250 * PERIOD_S, "t1": 251 * PERIOD_S}
    assert tendons.reported["T02b"] == {"t1": 251 * PERIOD_S}
    tendons = FilteredTensionMonitor(1)
    tendons.run_tick([0.0], [20.0])
    assert "T02a" not in tendons.reported


@pytest.mark.parametrize(("ticks_since_taut", "cell_tension_N", "commanded_tension_N", "spool_speed", "is_detected"), [
    (0, 0.0, 24.0, 0.05, True),
    (49, 0.0, 24.0, 0.05, True),
    (50, 0.0, 24.0, 0.05, False),     # the tendon was last taut 100 ms ago
    (-1, 0.0, 24.0, 0.05, False),     # the tendon has never been taut
    (0, 4.7, 24.0, 0.05, True),
    (0, 4.81, 24.0, 0.05, False),     # more than a fifth of the commanded tension is left
    (0, 4.0, 20.0, 0.05, False),      # exactly a fifth of the commanded tension is left
    (0, 0.0, 8.0, 0.05, False),       # the commanded tension was too low for a decision
    (0, 0.0, 8.1, 0.05, True),
    (0, 0.0, 24.0, 0.03, False),      # the spool is too slow
    (0, 0.0, 24.0, 0.031, True),
    (0, 0.0, 24.0, -0.05, False),     # the spool pays out
    (0, NAN, 24.0, 0.05, False),
    (0, 0.0, NAN, 0.05, False),
    (0, 0.0, 24.0, NAN, False),
])  # fmt: skip
def test_a_snapped_tendon_is_detected(
    ticks_since_taut, cell_tension_N, commanded_tension_N, spool_speed, is_detected
):
    """Test a digit whose first tendon is taut. In some cases, the second tendon is neither slack nor taut.

    If a tendon is neither slack nor taut, the detector continues to count the ticks since the
    tendon was last taut.
    """
    tendons = FilteredTensionMonitor(
        2, taut_ago=[0, ticks_since_taut - 1 if ticks_since_taut > 0 else ticks_since_taut]
    )
    second_tension_N = 20.0 if ticks_since_taut == 0 else 2.2
    tendons.run_tick(
        [20.0, second_tension_N],
        [24.0, commanded_tension_N],
        measured_tension=[20.0, cell_tension_N],
        speed=[0.05, spool_speed],
    )
    assert tendons.field_values("taut_ago")[1] == (
        ticks_since_taut if commanded_tension_N == commanded_tension_N else -1
    )
    assert tendons.reported.get("T01", {}) == ({"t1": spool_speed} if is_detected else {})


@pytest.mark.parametrize(("commanded_tension_N", "speed_gain", "friction_N", "is_digit_moving", "speed_limit"), [
    # The tension loop has the gain 0.1. A free spool reaches ((1 + 0.1) goal - friction) / speed_gain.
    (11.0, 460.0, 3.0, False, 0.6 * 9.1 / 460.0),   # 0.0119 m/s, the extensor of n_plus_1
    (24.0, 460.0, 3.0, False, 0.03),                # 0.6 times the speed of the free spool is 0.0305 m/s
    (8.1, 460.0, 3.0, False, 0.01),                 # 0.6 times the speed of the free spool is 0.0077 m/s
    (8.1, 460.0, 9.0, False, 0.01),                 # the friction is larger than the force
    (11.0, 0.0, 3.0, False, 0.03),                  # a tension loop without damping
    (11.0, 460.0, 3.0, True, 0.03),                 # the final speed of a moving digit is unknown
])  # fmt: skip
def test_the_speed_of_a_snapped_tendon_depends_on_its_tension_loop(
    commanded_tension_N, speed_gain, friction_N, is_digit_moving, speed_limit
):
    """During a grasp, the extensor tendon of a digit has a small commanded tension.

    Reproduce a defect: for a snapped extensor, the fault T01 (a tendon snapped) was not reported.
    The detector required a spool speed of more than 0.03 m/s, but the tension loop kept the spool
    slower.
    """

    def is_snapped(spool_speed):
        tendon = FilteredTensionMonitor(1, taut_ago=0, goal_kind=int(GoalKind.TENSION))
        if is_digit_moving:
            tendon.set_state_values({"way_kind": MINIMUM_JERK})
        tendon.set_constants(tension_gain=0.1, tension_speed_gain=speed_gain, coulomb=friction_N)
        tendon.run_tick([2.2], [commanded_tension_N], measured_tension=0.0, speed=spool_speed)
        return "T01" in tendon.reported

    assert not is_snapped(speed_limit - 1e-6)
    assert is_snapped(speed_limit + 1e-6)


def test_no_tendon_snaps_before_tension_is_commanded():
    tendons = FilteredTensionMonitor(1)
    tendons.run_tick([0.0], [24.0], measured_tension=0.0, speed=0.05)
    assert "T01" not in tendons.reported


def test_tension_at_the_cut_is_stored_and_ticks_are_counted():
    tendons = FilteredTensionMonitor(2, taut_ago=0, slack_ticks=[0, 3], cell_value=[31.0, 21.0])
    tendons.run_tick_after_cut([30.0, 20.0])
    assert (tendons.field_values("cut_ticks"), tendons.field_values("cut_from")) == (
        [0],
        [30.0, 20.0],
    )
    tendons.run_tick_after_cut([10.0, NAN])
    assert (tendons.field_values("cut_ticks"), tendons.field_values("cut_from")) == (
        [1],
        [30.0, 20.0],
    )
    tendons.run_tick_after_cut([10.0, 10.0])
    assert tendons.field_values("cut_ticks") == [2]


def test_a_missing_sample_at_the_cut_is_replaced_by_the_previous_one():
    tendons = FilteredTensionMonitor(2, cell_value=[31.0, NAN])
    tendons.run_tick_after_cut([NAN, 20.0])
    assert tendons.field_values("cut_from") == [31.0, 20.0]
    tendons.run_tick_after_cut([10.0, 10.0])
    assert tendons.field_values("cut_from") == [31.0, 20.0]


def test_a_tendon_without_a_sample_before_the_cut_counts_from_its_first_reading():
    tendons = FilteredTensionMonitor(2)
    tendons.run_tick_after_cut([NAN, 20.0])
    assert math.isnan(tendons.field_values("cut_from")[0])
    tendons.run_tick_after_cut([NAN, NAN], cell_value=40.0)
    assert math.isnan(tendons.field_values("cut_from")[0]), (
        "what there was before the cut is asked for once"
    )
    tendons.run_tick_after_cut([25.0, 5.0])
    assert tendons.field_values("cut_from") == [25.0, 20.0]
    tendons.run_tick_after_cut([24.0, 5.0])
    assert tendons.field_values("cut_from") == [25.0, 20.0]


@pytest.mark.parametrize(("ticks_after_cut", "tension_before_cut", "present_tension", "is_detected"), [
    (49, 30.0, 30.0, False),          # the time limit for the release has not passed
    (50, 30.0, 30.0, True),
    (51, 30.0, 30.0, True),
    (50, 30.0, 15.1, True),
    (50, 30.0, 14.9, False),          # the tension has fallen below half of the value before disabling
    (50, 24.0, 12.0, False),          # the tension has fallen to exactly half of the value before disabling
    (50, 10.0, 10.0, False),          # the tension is no more than springs and weight cause
    (50, 10.1, 10.1, True),
    (50, 5.0, 40.0, True),            # the tension has grown
    (50, 30.0, NAN, False),
    (50, NAN, 30.0, False),           # the tendon had no reading before the present tick
])  # fmt: skip
def test_a_tendon_still_pulled_by_its_motor_is_detected(
    ticks_after_cut, tension_before_cut, present_tension, is_detected
):
    """The detector compares a tendon's tension with the tension before the motors were disabled.

    If no reading exists from the time before the motors were disabled, the detector uses the first
    reading after this time.
    """
    tendons = FilteredTensionMonitor(
        2, cut_ticks=ticks_after_cut - 1, cut_from=[0.0, tension_before_cut], cut_bears=NAN
    )
    reported_tick = tendons.run_tick_after_cut([0.0, present_tension])
    if math.isnan(tension_before_cut):
        assert tendons.field_values("cut_from") == [0.0, 30.0]
        assert reported_tick == {"t1": present_tension}, (
            "a reading of 100 ms after the cut is one of a tendon that is pulled"
        )
    else:
        assert reported_tick == ({"t1": present_tension} if is_detected else {})


@pytest.mark.parametrize(
    ("paid_out_m", "is_detected"),
    [(0.0, True), (0.002, True), (-0.006, True), (0.006, False), (NAN, True)],
)
def test_a_spool_that_has_paid_out_is_released(paid_out_m, is_detected):
    """Reproduce two defects.

    At the end of a run with the hand jamia11, the controller reported the fault N16 (a drive does
    not release), although every drive had released. The springs of a digit accelerated the rotor of
    a released tendon, and the tension stayed at 10 N during the acceleration. An earlier version of
    the detector used the estimated speed of the spool to avoid false alarms. With the hand t42 and
    ODrive drives, the earlier version of the detector overlooked a motor that did not release.
    """
    position = 1.0 - paid_out_m / SPOOL_RADIUS_M
    tendons = FilteredTensionMonitor(
        1,
        cut_ticks=49,
        cut_from=11.0,
        cut_bears=NAN,
        cut_position=1.0,
        position=position,
        speed=-0.1,
    )
    assert tendons.run_tick_after_cut([10.5]) == ({"t0": 10.5} if is_detected else {})


def test_the_last_tension_counts_if_the_latest_sample_is_missing():
    """The detector uses load-cell readings from at least 80 ms after the motors were disabled.

    Earlier load-cell readings do not show whether a motor has released its tendon.
    """
    tendons = FilteredTensionMonitor(2)
    for k in range(50):
        tendons.run_tick_after_cut([30.0 if k < 40 else NAN, 30.0 if k < 41 else NAN])
        np.testing.assert_array_equal(
            tendons.field_values("cut_bears"), [NAN, NAN if k < 40 else 30.0]
        )
    assert tendons.run_tick_after_cut([NAN, NAN]) == {"t1": 30.0}
    assert tendons.run_tick_after_cut([NAN, 9.0]) == {}


@pytest.mark.parametrize(("force_before_cut", "present_force", "is_detected"), [
    # Columns: reported force [N] in the last tick before the motor was disabled, and 100 ms later.
    # A force of 8.5 N is less than springs and weight can cause at a load cell.
    (8.5, 8.5, True),
    (-1.4, -1.4, True),      # a motor with two tendons that pulls the second one
    (8.5, 0.05, False),
    (8.5, 4.2, False),       # the reported force has fallen below half
    (0.9, 0.9, False),       # the reported force is no more than the noise of a current sensor
    (8.5, NAN, False),
    (NAN, 8.5, False),       # the drive has sent no report while it made torque
])  # fmt: skip
@pytest.mark.parametrize("cell_group", [-1, 0])
def test_a_drive_that_still_reports_torque_after_a_cut_is_detected(
    cell_group, force_before_cut, present_force, is_detected
):
    """If a drive keeps its torque after it was disabled, the controller detects this fault from the reported torque.

    Reproduce two defects. At a tendon without a load cell, the controller never reported a drive
    that did not release (fault N16). At a tendon with a load cell, the controller did not report a
    drive that kept a force of 9 N.
    """
    tendons = FilteredTensionMonitor(1)
    tendons.set_constants(cell_group=cell_group)
    tendons.tick(measured_force=force_before_cut, asked=force_before_cut)
    reported_ticks = [
        tendons.run_tick_after_cut([NAN], measured_force=present_force, asked=0.0)
        for _ in range(52)
    ]
    assert reported_ticks[48] == {}
    assert reported_ticks[-1] == ({"t0": abs(present_force)} if is_detected else {})


@pytest.mark.parametrize(("torque_step_N", "is_detected"), [(0.0, True), (0.1, True), (1.2, False)])
def test_a_step_of_a_coarse_torque_report_is_no_pull(torque_step_N, is_detected):
    """Reproduce a defect.

    The torque reports of a CubeMars AK70-10 have no code for zero torque. Therefore a disabled
    AK70-10 reports a torque that corresponds to a tendon force of 1.2 N. The reported torque caused
    the fault N16 (a drive does not release).
    """
    tendons = FilteredTensionMonitor(1)
    tendons.set_constants(torque_step=torque_step_N)
    tendons.tick(measured_force=1.2, asked=1.2)
    reported_ticks = [
        tendons.run_tick_after_cut([NAN], measured_force=1.2, asked=0.0) for _ in range(52)
    ]
    assert reported_ticks[-1] == ({"t0": 1.2} if is_detected else {})


def test_an_old_torque_is_no_sign_of_a_drive_that_does_not_release():
    """If a drive sends no torque after it was disabled, its last reported torque is ignored.

    An example of a drive that sends no torque after it was disabled is an ODrive with torque
    feedback.
    """
    tendons = FilteredTensionMonitor(1)
    tendons.set_constants(answers_once=0)
    tendons.tick(measured_force=20.0, asked=20.0)
    for _ in range(60):
        assert tendons.run_tick_after_cut([0.0], measured_force=20.0) == {}


def test_thresholds_leave_room_between_slack_and_taut():
    assert SLACK_TENSION_N < TAUT_TENSION_N < SNAP_MIN_COMMAND_N < TENSION_AFTER_CUT_N
