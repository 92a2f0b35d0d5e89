"""Test the state that the safety monitor keeps from one tick to the next.

Each fault is tested just below and just above its limit, with a generated hand of two tendons.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handctl.controller.monitor import safety_thresholds
from handctl.core import state_block as s
from handctl.core.detectors import residuals
from handctl.core.detectors.residuals import (
    BALANCE,
    EXCESS_FRICTION,
    MOTOR_FORCE,
    QUICK_FORCE,
    RESIDUAL_TIME_CONSTANTS_S,
    TENSION,
)
from handctl.core.state_block import STATE_SCHEMA
from handctl.core.tick_types import HandMode
from tests.safety.synthetic_monitor import (
    NOW_NS,
    PERIOD_NS,
    PERIOD_S,
    SPOOL_RADIUS_M,
    SyntheticMonitor,
    call_interpreted,
    synthetic_limits,
)

NAN = np.nan
TWO_TENDON_LIMITS = replace(
    synthetic_limits(2), tendons=("a", "b"), motors=("ma", "mb"), joints=("ja", "jb"),
    tension_rail=240.0, drive_limit=(1e9, 1e9),
)  # fmt: skip
FindingsByFault = dict[str, dict[str, float]]


def make_monitor(
    tendon_stiffness: float = 1e5, motor_period: Any = PERIOD_S, joint_period: float = PERIOD_S
) -> SyntheticMonitor:
    """Return the safety monitor of two tendons.

    The arguments are the tendon stiffnesses [N/m] and the sampling periods of motors and joints
    [s].
    """
    arms = np.array([0.02, 0.01])
    monitor = SyntheticMonitor(
        TWO_TENDON_LIMITS, motor_period, joint_period, stiffness=tendon_stiffness, arms_sum=arms,
        excursion_to_joints=np.diag(1.0 / arms),
        step_limit=[0.1, 0.2], joint_step_limit=[0.3, 0.4],
    )  # fmt: skip
    monitor.set_state_values({"residual": 0.0, "filtered": 0})
    return monitor


STATE_FIELD_BY_READING = {"tension": "measured_tension", "travel": "measured_travel", "position": "measured_position",
                 "speed": "speed",
         "force": "measured_force", "excursion": "measured_excursion", "joints": "measured_joint",
         "read": "joints_read"}  # fmt: skip


def measurements_at_rest(**changed_measurements: Any) -> dict[str, Any]:
    """Return the measurements of two tendons that rest under 20 N.

    ``changed_measurements`` replaces some of the measurements at rest. A single number in place of
    two values applies to both tendons.
    """
    resting_measurements = {
        "tension": 20.0,
        "travel": 0.0,
        "speed": 0.0,
        "force": 20.0,
        "excursion": NAN,
        "joints": NAN,
        "read": False,
    }
    resting_measurements |= changed_measurements
    # Travel and position come from the same encoder. The travel is the position times the spool
    # radius.
    resting_measurements.setdefault(
        "position", np.asarray(resting_measurements["travel"]) / SPOOL_RADIUS_M
    )
    return {STATE_FIELD_BY_READING[name]: value for name, value in resting_measurements.items()}


def monitor_at_20_newton(
    monitor: SyntheticMonitor | None = None, **changed_measurements: Any
) -> SyntheticMonitor:
    """Return the monitor of a hand at rest. The commanded and planned tensions of the hand are 20 N."""
    monitor = monitor or make_monitor()
    monitor.set_state_values(
        {"asked": 20.0, "wanted": 20.0, "followed": 0.0} | changed_measurements
    )
    return monitor


def run_ticks(
    tick_count: int, monitor: SyntheticMonitor | None = None, **changed_measurements: Any
) -> tuple[SyntheticMonitor, FindingsByFault]:
    """Run the same tick several times.

    Return the monitor and the findings of the last tick. The value of a keyword can be a function
    that computes the value from the index of the tick.
    """
    monitor, findings = monitor or monitor_at_20_newton(), {}
    for k in range(tick_count):
        findings = monitor.tick(
            measurements_at_rest(
                **{name: v(k) if callable(v) else v for name, v in changed_measurements.items()}
            )
        )
    return monitor, findings


def test_at_rest_nothing_is_reported():
    monitor, findings = run_ticks(600)
    assert findings == {}
    assert monitor.view("taut_s") == pytest.approx([1.2, 1.2])
    assert (monitor.field_values("taut_ago"), monitor.field_values("slack_ticks")) == (
        [0, 0],
        [0, 0],
    )


def test_a_hand_that_is_armed_while_its_tendons_are_taut_is_not_stuck():
    """When a hand is armed, its filters start at the present values of tension and force.

    In this test, tension and force stay constant after the hand was armed. Constant readings of a
    hand at rest are no sign of a stuck sensor.
    """
    _, findings = run_ticks(200, monitor_at_20_newton(wanted=NAN, followed=NAN, asked=NAN))
    assert findings == {}


def test_without_torque_all_history_but_the_counts_is_reset():
    monitor, _ = run_ticks(10)
    monitor.set_state_values(
        {"unknown": 3.0, "open_requests": {(0, 0): 2, (0, 1): 1}, "lost": 5, "misshapen": 3}
    )
    assert monitor.tick(measurements_at_rest(), mode=int(HandMode.READY)) == {}
    for field in STATE_SCHEMA.fields:
        first_row, end = {
            "tendon": s.RESET_TENDON_ROWS,
            "tendon_int": s.RESET_TENDON_INTEGER_ROWS,
            "joint": s.RESET_JOINT_ROWS,
            "joint_int": s.RESET_JOINT_INTEGER_ROWS,
            "run_int": s.RESET_RUN_INTEGER_ROWS,
        }.get(field.table, (0, 0))  # fmt: skip
        if first_row <= field.first_row < end:
            initial = monitor.layout.view(monitor.layout.initial, field.name)
            np.testing.assert_array_equal(monitor.view(field.name), initial, err_msg=field.name)
    assert monitor.view("unknown").item() == pytest.approx(3.0 * (1.0 - PERIOD_S))
    assert monitor.field_values("open_requests")[0] == [2, 1]
    assert monitor.field_values("lost")[0] == [10, 10, 10]
    assert monitor.field_values("misshapen") == [6, 6, 6]


def test_a_tendon_that_stays_taut_after_the_cut_is_reported():
    monitor = run_ticks(3)[0]
    monitor.set_state_values({"mode": int(HandMode.CUT)})
    for _ in range(50):
        assert "N16" not in monitor.tick(measurements_at_rest(tension=[30.0, 8.0], force=0.0))
    assert monitor.tick(measurements_at_rest(tension=[30.0, 8.0], force=0.0))["N16"] == {"a": 30.0}
    assert monitor.field_values("cut_from") == [30.0, 8.0]


def test_a_tendon_that_stays_taut_is_reported_despite_a_lost_sample_at_the_cut():
    monitor = run_ticks(3, tension=[30.0, 25.0])[0]
    run_ticks(2, monitor, tension=NAN)
    monitor.set_state_values({"mode": int(HandMode.CUT)})
    for k in range(51):
        findings = monitor.tick(measurements_at_rest(tension=[30.0, 8.0] if k else NAN, force=0.0))
    assert findings["N16"] == {"a": 30.0}
    assert monitor.field_values("cut_from") == [30.0, 25.0]


def unexplained_tensions(monitor: SyntheticMonitor) -> list[float]:
    return [
        call_interpreted(
            residuals.unexplained_tension, monitor.state_tables, monitor.hand_tables, n
        )
        for n in (0, 1)
    ]


@pytest.mark.parametrize(
    ("tension", "expected_residual"),
    [(29.8, 4.8), (30.2, 5.2), (9.7, 5.3), (5.0, 10.0), (20.0, 0.0)],
)
def test_lasting_residual_is_a_fault(tension, expected_residual):
    """The residual is the measured tension minus the tension that the model explains.

    In this test, friction can cause a residual of up to 3 N. At a tension of 20 N, the 10 %
    tolerance of the torque constant can add 2 N to the residual.
    """
    monitor, findings = run_ticks(1200, tension=tension)
    assert unexplained_tensions(monitor) == pytest.approx([expected_residual] * 2, abs=0.05)
    expected_residuals = {name: pytest.approx(expected_residual, abs=0.05) for name in "ab"}
    assert findings.get("T04a", {}) == (expected_residuals if expected_residual > 5.0 else {})


@pytest.mark.parametrize(
    ("commanded_force_N", "reported_force_N", "is_reported"),
    [
        (20.0, 9.1, False),
        (20.0, 8.9, True),
        (20.0, 30.9, False),
        (20.0, 31.1, True),
        (60.0, 45.1, False),
        (60.0, 44.9, True),
        (60.0, 75.1, True),
    ],
)
def test_missing_torque_is_a_fault(commanded_force_N, reported_force_N, is_reported):
    """Without a load cell, the limit for the difference between commanded and reported force depends on the command.

    The limit is 6 N plus a quarter of the commanded force, but at most 15 N.
    """
    monitor = monitor_at_20_newton(asked=commanded_force_N, wanted=commanded_force_N)
    monitor.set_constants(cell_group=[-1, -1])
    _, findings = run_ticks(600, monitor, force=reported_force_N, tension=reported_force_N)
    difference = abs(commanded_force_N - reported_force_N)
    expected_findings = {name: pytest.approx(difference, abs=0.01) for name in ("ma", "mb")}
    assert findings.get("N14", {}) == (expected_findings if is_reported else {})


@pytest.mark.parametrize(("excess_friction_N", "is_reported"), [(5.8, False), (6.1, True)])
def test_friction_above_the_hand_file_is_a_fault(excess_friction_N, is_reported):
    """The monitor reports a fault if the friction exceeds the modelled friction by more than a limit for some seconds.

    In this test, the limit is 3 N plus 10 % of the motor force of 29 N, which is 5.9 N. The 10 % of
    the motor force cover the tolerance of the torque constant.
    """
    monitor = run_ticks(30)[0]
    monitor.set_state_values({"residual": {EXCESS_FRICTION: excess_friction_N, MOTOR_FORCE: 29.0}})
    _, findings = run_ticks(1, monitor, force=29.0, tension=29.0)
    excess_frictions = [
        call_interpreted(residuals.excess_friction, monitor.state_tables, n) for n in (0, 1)
    ]
    assert excess_frictions == pytest.approx([excess_friction_N - 2.9] * 2, abs=0.01)
    assert findings.get("T09", {}) == (
        dict(zip("ab", excess_frictions, strict=True)) if is_reported else {}
    )


def test_a_noisy_encoder_is_detected():
    """In this test, an encoder position alternates between -d and d.

    The mean square of the second difference of the encoder position is 16 d^2.
    """
    for size, expected_findings in (
        (2.4e-3, {}),
        (2.6e-3, dict.fromkeys(("ma", "mb"), pytest.approx(1.08e-4, rel=0.02))),
    ):
        _, findings = run_ticks(600, position=lambda k, size=size: size * (-1.0) ** k)
        assert findings.get("N07", {}) == expected_findings


def test_a_slack_tendon_and_a_torn_tendon_are_distinguished():
    monitor, _ = run_ticks(100)
    _, findings = run_ticks(90, monitor, tension=[0.0, 20.0])
    assert list(findings["T02a"]) == ["a"]
    assert "T01" not in findings
    monitor, _ = run_ticks(100)
    _, findings = run_ticks(3, monitor, tension=[0.0, 20.0], speed=[0.05, 0.05])
    assert findings["T01"] == {"a": 0.05}


def test_joint_and_spool_are_compared_once_the_tendon_is_taut():
    """The moment arms of tendon a have a sum of 20 mm, so an angle of 3 deg corresponds to 1.05 mm.

    The limit of 15 deg applies to the difference between the measured angle of the joint and its
    angle according to the spool, both unfiltered.
    """

    def findings_after_slip(deg):
        monitor, _ = run_ticks(100, excursion=0.0, read=True)
        assert not np.isnan(monitor.view("slip_from")).any()
        return run_ticks(1500, monitor, excursion=[-0.02 * np.radians(deg), 0.0], read=True)[1]

    assert "N06a" not in findings_after_slip(2.9)
    reported_findings = findings_after_slip(3.1)
    assert reported_findings["N06a"] == {"a": pytest.approx(3.1, abs=0.02)}
    assert "T08" not in reported_findings
    assert "T08" not in findings_after_slip(14.9)
    assert findings_after_slip(-15.1)["T08"] == {"a": pytest.approx(15.1, abs=1e-6)}


def test_joint_and_spool_are_not_compared_during_slack_or_shortly_after():
    monitor, _ = run_ticks(100, excursion=0.0, read=True)
    run_ticks(1, monitor, tension=[1.9, 20.0], excursion=0.0, read=True)
    assert (monitor.field_values("taut_s")[0], np.isnan(monitor.field_values("slip_from")[0])) == (
        0.0,
        True,
    )
    run_ticks(5, monitor, tension=[2.2, 20.0], excursion=0.0, read=True)
    assert monitor.field_values("taut_s")[0] == 0.0, "between slack and taut no time passes"
    run_ticks(49, monitor, excursion=0.5, read=True)
    assert np.isnan(monitor.field_values("slip_from")[0]), "100 ms after it became taut"
    run_ticks(3, monitor, excursion=0.5, read=True)
    begin = monitor.field_values("slip_from")[0]
    assert begin == pytest.approx(-20.0 / 1e5 - 0.5)
    _, reported = run_ticks(1, monitor, excursion=NAN)
    assert monitor.field_values("slip_from")[0] == begin
    assert "T08" not in reported


TICKS_PER_JOINT_READING = 4
"""Number of ticks from one joint reading to the next.

A slow bus is possibly not able to transmit joint readings more often.
"""


def run_with_sparse_joint_readings(
    tick_count: int, monitor: SyntheticMonitor, **changed_measurements: Any
) -> list[FindingsByFault]:
    """Run ticks of a hand whose joints are read only in every fourth tick.

    Return the findings of the safety monitor in each tick.
    """
    reported = []
    for k in range(tick_count):
        read = (
            {"read": True} | changed_measurements
            if k % TICKS_PER_JOINT_READING == 0
            else {n: v for n, v in changed_measurements.items() if n == "travel"}
        )
        reported.append(monitor.tick(measurements_at_rest(**read)))
    return reported


def test_a_derailed_tendon_is_found_in_three_readings_at_any_joint_rate():
    monitor = monitor_at_20_newton(make_monitor(joint_period=TICKS_PER_JOINT_READING * PERIOD_S))
    run_with_sparse_joint_readings(100, monitor, excursion=0.0, joints=0.0)
    off = {"excursion": [-0.02 * np.radians(15.1), 0.0], "joints": 0.0}
    reported_findings = run_with_sparse_joint_readings(9, monitor, **off)
    assert [k for k, findings in enumerate(reported_findings) if "T08" in findings] == [8]
    assert reported_findings[8]["T08"] == {"a": pytest.approx(15.1, abs=1e-6)}
    reported_findings = run_with_sparse_joint_readings(8, monitor, **off)
    assert [k for k, findings in enumerate(reported_findings) if "T08" in findings] == [0, 4], (
        "in ticks in which joints are read"
    )


def test_good_reading_restarts_the_count_of_derailed_readings():
    monitor = monitor_at_20_newton(make_monitor(joint_period=TICKS_PER_JOINT_READING * PERIOD_S))
    run_with_sparse_joint_readings(100, monitor, excursion=0.0, joints=0.0)
    off = {"excursion": [-0.02 * np.radians(15.1), 0.0], "joints": 0.0}
    assert not any(
        "T08" in findings for findings in run_with_sparse_joint_readings(8, monitor, **off)
    )
    run_with_sparse_joint_readings(4, monitor, excursion=0.0, joints=0.0)
    assert not any(
        "T08" in findings for findings in run_with_sparse_joint_readings(8, monitor, **off)
    )


def test_the_joint_spool_filter_has_one_time_constant_at_any_joint_rate():
    """After an input step to 3.5 deg, a filter with a time constant of 0.3 s needs 0.58 s to reach 3 deg.

    The time of 0.58 s is the time constant of 0.3 s times ln 7.
    """
    for ticks_per_reading in (1, TICKS_PER_JOINT_READING):
        monitor = monitor_at_20_newton(make_monitor(joint_period=ticks_per_reading * PERIOD_S))
        run_ticks(100, monitor, excursion=0.0, read=True)
        detection_time_s = None
        for k in range(400):
            read = (
                {"excursion": [-0.02 * np.radians(3.5), 0.0], "read": True}
                if k % ticks_per_reading == 0
                else {}
            )
            findings = monitor.tick(measurements_at_rest(**read))
            detection_time_s = (
                k * PERIOD_S
                if detection_time_s is None and "N06a" in findings
                else detection_time_s
            )
        assert detection_time_s == pytest.approx(0.584, abs=0.01)


def test_a_stuck_encoder_is_reported_after_the_same_time_at_any_rate():
    monitor = monitor_at_20_newton(
        make_monitor(
            motor_period=(TICKS_PER_JOINT_READING * PERIOD_S, PERIOD_S),
            joint_period=TICKS_PER_JOINT_READING * PERIOD_S,
        )
    )
    run_with_sparse_joint_readings(100, monitor, travel=0.0, excursion=0.0, joints=0.2)
    run_with_sparse_joint_readings(4, monitor, travel=0.0, excursion=0.0, joints=0.3)
    reported_findings = run_with_sparse_joint_readings(
        56, monitor, travel=[np.radians(10.1) / 50.0, 0.0], excursion=0.0, joints=0.3
    )
    joint = [
        k
        for k, findings_of_tick in enumerate(reported_findings)
        if "ja" in findings_of_tick.get("N04", {})
    ]
    assert joint[0] == 48, "100 ms are 12.5 readings after one"
    monitor = monitor_after_motion(
        make_monitor(
            motor_period=(TICKS_PER_JOINT_READING * PERIOD_S, PERIOD_S),
            joint_period=TICKS_PER_JOINT_READING * PERIOD_S,
        )
    )
    monitor.set_state_values({"followed": [0.51e-3, 0.0]})
    first_reported_tick = None
    for k in range(60):
        findings = monitor.tick(
            measurements_at_rest(travel=1e-5 if k % TICKS_PER_JOINT_READING == 0 else [NAN, 1e-5])
        )
        first_reported_tick = (
            k if first_reported_tick is None and "N04" in findings else first_reported_tick
        )
    assert first_reported_tick == 48


def monitor_after_motion(
    monitor: SyntheticMonitor | None = None, **changed_measurements: Any
) -> SyntheticMonitor:
    """Return the monitor of a hand whose motors moved in the last tick.

    Before the last tick, the filters of the hand have settled.
    """
    return run_ticks(
        1,
        run_ticks(150, monitor_at_20_newton(monitor), **changed_measurements)[0],
        **{"travel": 1e-5} | changed_measurements,
    )[0]


@pytest.mark.parametrize(("tick_count", "goal_change_m", "is_reported"), [
    (51, 0.51e-3, True), (50, 0.51e-3, False),      # 50 ticks are 100 ms
    (60, 0.49e-3, False), (60, -0.51e-3, True),
])  # fmt: skip
def test_constant_motor_reading_is_stuck_while_its_goal_moves(
    tick_count, goal_change_m, is_reported
):
    monitor = monitor_after_motion()
    monitor.set_state_values({"followed": [goal_change_m, 0.0]})
    _, findings = run_ticks(tick_count, monitor, travel=1e-5)
    assert findings.get("N04", {}) == ({"ma": pytest.approx(0.51)} if is_reported else {})


def test_constant_motor_reading_is_stuck_while_the_tension_changes():
    for tension, expected_names in ((27.9, []), (28.2, ["mb"]), (11.8, ["mb"])):
        _, findings = run_ticks(
            200, monitor_after_motion(), travel=1e-5, tension=[20.0, tension], force=[20.0, tension]
        )
        assert list(findings.get("N04", {})) == expected_names


def test_constant_joint_reading_is_stuck_while_the_spool_turns():
    for angle, expected_names in ((9.9, []), (10.1, ["ja"])):
        joints = {"excursion": 0.0, "read": True}
        monitor = monitor_after_motion(joints=0.2, **joints)
        run_ticks(1, monitor, travel=1e-5, joints=0.3, **joints)
        travel = [1e-5 + np.radians(angle) / 50.0, 1e-5]
        _, findings = run_ticks(55, monitor, travel=travel, joints=0.3, **joints)
        assert [name for name in findings.get("N04", {}) if name[0] == "j"] == expected_names


def test_a_turning_spool_with_a_slack_tendon_does_not_make_a_joint_stuck():
    """The spool of a slack tendon turns without moving the joint.

    The spool and the joint of a tendon move together only after the tendon has become taut.
    """
    turn, joints = np.radians(10.1) / 50.0, {"joints": 0.3, "excursion": 0.0, "read": True}

    def stuck_joint_names(findings: FindingsByFault) -> list[str]:
        return [name for name in findings.get("N04", {}) if name[0] == "j"]

    slack = {"tension": 0.5, "force": 0.5}
    monitor, reported = run_ticks(
        200, None, **slack, travel=lambda k: [3.0 * turn * (k > 20), 0.0], **joints
    )
    assert stuck_joint_names(reported) == []
    _, reported = run_ticks(200, monitor, travel=[3.0 * turn, 0.0], **joints)
    assert stuck_joint_names(reported) == [], "that it has become taut moves nothing"
    _, reported = run_ticks(200, monitor, travel=[4.1 * turn, 0.0], **joints)
    assert stuck_joint_names(reported) == ["ja"]


@pytest.mark.parametrize(("tension", "expected_stuck_joints"), [(2.1, ["ja"]), (1.9, [])])
def test_a_joint_is_compared_with_its_spool_until_the_tendon_is_slack(
    tension, expected_stuck_joints
):
    joints = {"joints": 0.3, "excursion": 0.0, "read": True}
    monitor, _ = run_ticks(200, None, tension=2.6, force=2.6, **joints)
    run_ticks(200, monitor, tension=tension, force=tension, **joints)
    _, findings = run_ticks(
        60, monitor, tension=tension, force=tension, travel=[np.radians(12.0) / 50.0, 0.0], **joints
    )
    assert [name for name in findings.get("N04", {}) if name[0] == "j"] == expected_stuck_joints


def test_each_joint_is_checked_with_its_own_tendons():
    """Tendon b moves joint b.

    While tendon a is slack, the monitor continues to compare the angle of joint b with the motion
    of tendon b.
    """
    joints = {"joints": 0.3, "excursion": 0.0, "read": True}
    monitor, _ = run_ticks(200, None, tension=[0.5, 20.0], force=[0.5, 20.0], **joints)
    travel = [np.radians(12.0) / 50.0, np.radians(12.0) / 100.0]
    _, findings = run_ticks(
        60, monitor, tension=[0.5, 20.0], force=[0.5, 20.0], travel=travel, **joints
    )
    assert [name for name in findings.get("N04", {}) if name[0] == "j"] == ["jb"]


@pytest.mark.parametrize(("tick_count", "reported_force_N", "tension", "is_reported"), [
    (400, 25.2, 20.0, True), (400, 14.8, 20.0, True), (400, 24.8, 20.0, False), (38, 60.0, 20.0, False),
    (39, 60.0, 20.0, False), (40, 60.0, 20.0, True), (400, 26.0, 2.5, False), (400, 26.0, 2.6, True),
])  # fmt: skip
def test_constant_load_cell_is_stuck_while_the_torque_moves(
    tick_count, reported_force_N, tension, is_reported
):
    chance = np.random.default_rng(1)
    monitor, _ = run_ticks(100, tension=lambda k: tension + 0.1 * chance.standard_normal())
    run_ticks(1, monitor, tension=tension)
    _, findings = run_ticks(tick_count, monitor, tension=tension, force=[reported_force_N, 20.0])
    assert list(findings.get("T05", {})) == (["a"] if is_reported else [])


@pytest.mark.parametrize("reply_late_ticks", [0, 1])
def test_steady_motion_over_skipped_ticks_is_neither_noise_nor_force(reply_late_ticks):
    """After a gap of missing readings, one reading contains the motion of five ticks.

    If the drive replies in time, the reading with the motion of five ticks arrives in the first
    tick after the missing readings. If the drive replies one tick late, the reading with the motion
    of five ticks arrives in the second tick.
    """

    def noise_and_balance_after_gap(missed_ticks):
        monitor, at, speed, noisy = run_ticks(5, speed=0.1, force=27.0)[0], 0.0, 0.1, False
        for k in range(20):
            at, speed = (at + 0.25, 0.14) if k == 10 + reply_late_ticks else (at + 0.05, speed)
            rows = measurements_at_rest(position=at, speed=speed, force=23.0 + 40.0 * speed)
            noisy |= "N07" in monitor.tick(rows, missed=missed_ticks if k == 10 else 0)
        return noisy, monitor.view("residual")[BALANCE]

    is_noise_reported, balance = noise_and_balance_after_gap(4)
    assert not is_noise_reported
    assert np.abs(balance).max() < 0.05
    is_noise_reported, balance = noise_and_balance_after_gap(0)
    assert is_noise_reported, "positive control"
    assert np.abs(balance).max() > 0.5


def position_jumps(
    monitor: SyntheticMonitor,
    motor_positions: list[float],
    joint_positions: list[float] | None,
    missed_ticks: int = 0,
) -> tuple[Any, Any]:
    """Check the positions of motors and joints for jumps, and return how far each position has jumped.

    ``joint_positions`` is None if no joint was read.
    """
    read = {"joint_fresh": joint_positions is not None, "joint_angle": joint_positions or 0.0}
    monitor.observe_readings(
        {"answered": 1, "position": motor_positions, "missed": missed_ticks, **read}
    )
    return monitor.field_values("jump"), monitor.field_values("joint_jump")


def test_positions_are_checked_separately():
    monitor = make_monitor()
    assert position_jumps(monitor, [0.0, 0.0], [0.0, 0.0]) == ([0.0, 0.0], [0.0, 0.0])
    assert position_jumps(monitor, [0.11, 0.19], [0.29, 0.41]) == ([0.11, 0.0], [0.0, 0.41])
    assert position_jumps(monitor, [0.05, 0.19], None) == ([0.0, 0.0], [0.0, 0.0])
    assert monitor.field_values("joint_gap") == [1.0, 2.0]
    assert monitor.field_values("accepted") == [0.05, 0.19]
    assert monitor.field_values("dropped") == [0.0, 0.0]
    assert monitor.field_values("joint_dropped") == [0.0, 1.0]


def test_missed_ticks_increase_the_allowed_step_of_motors_and_joints():
    def monitor_at_zero() -> SyntheticMonitor:
        monitor = make_monitor()
        position_jumps(monitor, [0.0, 0.0], [0.0, 0.0])
        return monitor

    motor, joint = [0.29, 0.61], [0.91, 1.19]
    assert position_jumps(monitor_at_zero(), motor, joint) == (motor, joint)
    monitor = monitor_at_zero()
    jumped, twisted = position_jumps(monitor, motor, joint, 2)
    assert jumped == [0.0, 0.61], "three times 0.1 and 0.2"
    assert twisted == [0.91, 0.0], "three times 0.3 and 0.4"
    monitor = monitor_at_zero()
    position_jumps(monitor, motor, None, 2)
    assert monitor.field_values("joint_gap") == [3.0, 3.0]


def state_with_reply_ages(**age_by_node: int) -> dict[str, Any]:
    """Return the state fields with the arrival times of the last frames [ns], for given ages of the frames [ticks].

    The keyword ``ma`` is the age of the last frame from the motor of tendon a [ticks]. The keyword
    ``a`` is the age of the last frame from the load cell of tendon a [ticks].
    """
    last_frame_ns_by_node = {
        name: NOW_NS - age_by_node.get(name, 0) * PERIOD_NS for name in ("ma", "mb", "a", "b")
    }
    return {
        "feedback_ns": [last_frame_ns_by_node["ma"], last_frame_ns_by_node["mb"]],
        "group_ns": {0: last_frame_ns_by_node["a"], 1: last_frame_ns_by_node["b"]},
    }


def test_without_lost_replies_no_count_grows():
    monitor = make_monitor()
    assert monitor.tick() == {}
    assert not monitor.view("lost").any()


@pytest.mark.parametrize(("value_by_field", "expected_lost"), [
    (state_with_reply_ages(mb=1), [0, 1, 0]), (state_with_reply_ages(b=1), [0, 0, 1]),
    (state_with_reply_ages(ma=3), [1, 0, 0]),
    (state_with_reply_ages(ma=1, mb=1) | {"missed": 1}, [0, 0, 0]),
    (state_with_reply_ages(ma=1, mb=1) | {"mode": int(HandMode.READY)}, [0, 0, 0]),
])  # fmt: skip
def test_lost_replies_are_recorded_per_node(value_by_field, expected_lost):
    monitor = make_monitor()
    monitor.tick(value_by_field)
    assert monitor.field_values("lost") == [expected_lost, [0, 0, 0]]


def test_malformed_frames_are_reported_with_sender_and_recent_count():
    monitor = make_monitor()
    for k in range(3):
        findings = monitor.tick(misread_now=[1, k == 0, 0])
    assert findings["B09"] == {"ma": 3.0}
    assert monitor.tick(misread_now=[0, 0, 1])["B09"] == {"load cells": 1.0}


def test_a_node_that_replies_in_every_second_tick_is_reported():
    monitor = make_monitor()
    for k in range(20):
        findings = monitor.tick(state_with_reply_ages(mb=k % 2))
        assert list(findings.get("N15", {})) == (["mb"] if k >= 13 else []), k


def test_count_of_unknown_frames_decays():
    monitor = make_monitor()
    monitor.tick(strange=5)
    assert monitor.view("unknown").item() == 5.0
    monitor.tick(strange=0)
    assert monitor.view("unknown").item() == pytest.approx(5.0 * (1.0 - PERIOD_S))


def test_refused_goals_are_reported_in_their_tick():
    monitor = make_monitor()
    assert monitor.tick(refused=2, refused_now=2)["I07a"] == {"goal": 2.0}
    assert monitor.tick(refused=3, refused_now=1)["I07b"] == {"goal": 3.0}
    assert not {"I07a", "I07b"} & set(monitor.tick(refused=3, refused_now=0))


def test_thresholds_follow_from_the_hand():
    assert safety_thresholds.POSITION_STEP_FACTOR == 1.5
    assert residuals.TORQUE_CONSTANT_TOLERANCE == 0.1
    assert RESIDUAL_TIME_CONSTANTS_S == (0.2, 0.2, 0.08, 0.02, 0.02, 0.3, 0.1, 5.0, 0.02)


def test_fast_residuals_start_at_the_first_reading():
    monitor = run_ticks(5)[0]
    for row in (TENSION, QUICK_FORCE):
        assert monitor.view("residual")[row] == pytest.approx([20.0, 20.0])
    run_ticks(1, monitor, tension=30.0, force=30.0)
    moved = 10.0 * -np.expm1(-PERIOD_S / 0.02)
    for row in (TENSION, QUICK_FORCE):
        assert monitor.view("residual")[row] == pytest.approx([20.0 + moved, 20.0 + moved])
