"""Test the state that the safety monitor keeps between ticks.

The tested values are exactly at the limits of faults, to the last bit.
"""

import math
from typing import Any

import numpy as np
import pytest

from handctl.core.detectors import stuck_sensors, tendon_slip
from handctl.core.detectors.residuals import QUICK_FORCE, TENSION
from handctl.core.detectors.tendon_slip import DEG_PER_RAD, MIN_TAUT_DURATION_S
from handctl.safety.faults.node import (
    STUCK_SENSOR_GOAL_CHANGE_M,
    STUCK_SENSOR_JOINT_CHANGE_DEG,
    STUCK_SENSOR_TENSION_CHANGE_N,
    STUCK_SENSOR_TIME_S,
)
from handctl.safety.faults.tendon import (
    DERAILED_TENDON_DEG,
    DERAILED_TENDON_WITHOUT_CELL_DEG,
    SLACK_TENSION_N,
    STUCK_CELL_FORCE_RANGE_N,
    STUCK_CELL_READINGS,
    TAUT_TENSION_N,
)
from tests.safety.synthetic_monitor import PERIOD_S, SyntheticMonitor, call_interpreted
from tests.safety.test_monitor_state import make_monitor, measurements_at_rest

SOFT_STIFFNESS = 5e3
"""Low stiffness of a tendon [N/m]. With the low stiffness, 20 N stretch the tendon by 4 mm."""
ZERO_JOINT_READINGS = {"excursion": 0.0, "joints": 0.0, "read": True}
"""Readings of joint encoders whose angle is zero."""


@pytest.fixture
def monitor() -> SyntheticMonitor:
    """Return the safety monitor of two tendons.

    A test sets the filtered tensions and forces of the two tendons.
    """
    monitor = make_monitor(SOFT_STIFFNESS)
    monitor.set_constants(residual_fraction=0.0)
    monitor.set_state_values({"filtered": 1, "residual": {TENSION: 20.0, QUICK_FORCE: 20.0}})
    return monitor


def joint_rotations_from_spools(
    monitor: SyntheticMonitor, **changed_measurements: Any
) -> list[float]:
    monitor.set_state_values(measurements_at_rest(**changed_measurements) | {"bears": 1})
    return [
        call_interpreted(
            stuck_sensors.joint_angle_by_spools, monitor.state_tables, monitor.hand_tables, j
        )
        for j in (0, 1)
    ]


def test_tendon_stretch_is_not_counted_as_joint_motion(monitor: SyntheticMonitor) -> None:
    """When the tension rises, the spool winds up the length by which the tendon stretches.

    The joint does not move when the spool winds up the stretch of the tendon.
    """
    np.testing.assert_allclose(
        joint_rotations_from_spools(monitor, travel=20.0 / SOFT_STIFFNESS, **ZERO_JOINT_READINGS),
        0.0,
        atol=1e-12,
    )
    wound = joint_rotations_from_spools(
        monitor, travel=[20.0 / SOFT_STIFFNESS + 1e-3, 20.0 / SOFT_STIFFNESS], **ZERO_JOINT_READINGS
    )
    np.testing.assert_allclose(wound, [0.05, 0.0], atol=1e-12)
    monitor.set_state_values({"bears": [0, 1]})
    angle = call_interpreted(
        stuck_sensors.joint_angle_by_spools, monitor.state_tables, monitor.hand_tables, 0
    )
    assert math.isnan(angle), "it says nothing"


@pytest.mark.parametrize(("tension_N", "expected_taut_time"), [
    (SLACK_TENSION_N, 1.0), (SLACK_TENSION_N - 1e-9, 0.0), (TAUT_TENSION_N, 1.0),
                                               (TAUT_TENSION_N + 1e-9, 1.0 + PERIOD_S)])  # fmt: skip
def test_the_taut_time_does_not_change_between_slack_and_taut(
    monitor: SyntheticMonitor, tension_N: float, expected_taut_time: float
) -> None:
    monitor.tick(measurements_at_rest(tension=tension_N, **ZERO_JOINT_READINGS), taut_s=1.0)
    assert monitor.field_values("taut_s") == [expected_taut_time, expected_taut_time]


def test_joint_and_spool_are_not_compared_before_the_tendon_has_settled(
    monitor: SyntheticMonitor,
) -> None:
    for since, settled in (
        (MIN_TAUT_DURATION_S, False),
        (np.nextafter(MIN_TAUT_DURATION_S, 1.0), True),
    ):
        now = measurements_at_rest(
            **ZERO_JOINT_READINGS | {"tension": 2.2, "excursion": [0.0, 1e-3]}
        )
        monitor.tick(now, taut_s=[float(since), 1.0], slip_from=0.0)
        begin, slipped = monitor.field_values("slip_from"), monitor.field_values("slip")
        assert np.isnan(begin[0]) != settled
        assert np.isnan(slipped[0]) != settled
        assert slipped[1] == pytest.approx((-2.2 / SOFT_STIFFNESS - 1e-3) / 0.01 * DEG_PER_RAD)


def stuck_sensor_names(
    monitor: SyntheticMonitor,
    equal_readings: int,
    cell_tension: float,
    changed_state: dict[str, list[float]],
) -> dict[str, list[str]]:
    """Return the names of the sensors that count as stuck after one more equal reading.

    ``changed_state`` contains the changes of signals that move together with the readings of a
    healthy sensor.
    """
    zero = [0.0, 0.0]
    findings = monitor.tick(
        measurements_at_rest(tension=cell_tension, **ZERO_JOINT_READINGS), motor_stuck=equal_readings,
        cell_stuck=equal_readings,
        joint_stuck=equal_readings, motor_value=0.0, cell_value=cell_tension, joint_value=0.0,
        followed=changed_state.get("goal", zero),
        motor_anchor=[zero, 20.0 - np.array(changed_state.get("tension", zero))],
        cell_anchor=[20.0 - np.array(changed_state.get("pushed", zero)), [20.0, 20.0]],
        joint_anchor=np.array(changed_state.get("turned", zero)) - 20.0 / SOFT_STIFFNESS * np.array([50.0, 100.0]),
    )  # fmt: skip
    stuck_findings = findings.get("N04", {})
    return {
        "motor": [name for name in stuck_findings if name[0] == "m"],
        "joint": [name for name in stuck_findings if name[0] == "j"],
        "cell": list(findings.get("T05", {})),
    }  # fmt: skip


def test_a_stuck_sensor_is_reported_above_its_limits_and_not_at_them(
    monitor: SyntheticMonitor,
) -> None:
    stuck_ticks = int(STUCK_SENSOR_TIME_S / PERIOD_S)
    assert not any(stuck_sensor_names(monitor, 9999, 20.0, {}).values())
    at = {"goal": [STUCK_SENSOR_GOAL_CHANGE_M, 0.0], "tension": [0.0, STUCK_SENSOR_TENSION_CHANGE_N],
          "pushed": [STUCK_CELL_FORCE_RANGE_N, 9.0],
          "turned": [STUCK_SENSOR_JOINT_CHANGE_DEG / DEG_PER_RAD * (1.0 - 1e-12), 0.1]}  # fmt: skip
    assert stuck_sensor_names(monitor, 9999, 20.0, at) == {"motor": [], "joint": [], "cell": ["b"]}
    pairs_beyond_limits = {name: [value * 1.01 for value in pair] for name, pair in at.items()}
    all_names = {"motor": ["ma", "mb"], "joint": ["ja"], "cell": ["a", "b"]}
    assert stuck_sensor_names(monitor, stuck_ticks, 20.0, pairs_beyond_limits) == all_names
    assert stuck_sensor_names(monitor, stuck_ticks - 1, 20.0, pairs_beyond_limits) == all_names | {
        "motor": [],
        "joint": [],
    }


def test_a_load_cell_may_repeat_a_reading_for_one_tick_less_than_the_limit(
    monitor: SyntheticMonitor,
) -> None:
    changed_state = {"pushed": [9.0, 9.0]}
    assert stuck_sensor_names(monitor, STUCK_CELL_READINGS - 1, 20.0, changed_state)["cell"] == [
        "a",
        "b",
    ]
    assert stuck_sensor_names(monitor, STUCK_CELL_READINGS - 2, 20.0, changed_state)["cell"] == []
    assert (
        stuck_sensor_names(monitor, STUCK_CELL_READINGS - 1, TAUT_TENSION_N, changed_state)["cell"]
        == []
    ), "a slack tendon's cell may rest"


def test_a_repeating_load_cell_is_reported_in_the_same_tick() -> None:
    monitor = make_monitor(SOFT_STIFFNESS)
    monitor.set_state_values({"asked": 20.0, "wanted": 20.0, "followed": 0.0})
    for k in range(STUCK_CELL_READINGS + 2):
        findings = monitor.tick(measurements_at_rest(force=20.0 if k == 0 else 60.0, tension=20.0))
        assert ("T05" in findings) == (
            monitor.field_values("cell_stuck")[0] >= STUCK_CELL_READINGS
        ), k
    assert monitor.field_values("cell_stuck")[0] > STUCK_CELL_READINGS


def test_a_motor_force_that_rises_and_then_falls_shows_a_stuck_load_cell() -> None:
    """The motor force rises by 4 N, falls to 4 N below its first value, and returns to its first value.

    Reproduce a defect: the detector used only the difference between the present motor force and
    its start value. The stuck load cell of an extensor in the hand ``n_plus_1`` was therefore
    reported only after 5 s.
    """
    monitor = make_monitor(SOFT_STIFFNESS)
    monitor.set_state_values({"asked": 20.0, "wanted": 20.0, "followed": 0.0})
    is_reported_at_force = []
    for force in (20.0, 24.0, 16.0, 20.0):
        for _ in range(STUCK_CELL_READINGS):
            findings = monitor.tick(measurements_at_rest(force=force, tension=20.0))
        is_reported_at_force.append("T05" in findings)
    assert is_reported_at_force == [False, False, True, True]
    assert findings["T05"]["a"] == pytest.approx(8.0, rel=0.05)


@pytest.mark.parametrize(
    ("cell_group", "pulley_limit"),
    [([0, 1], DERAILED_TENDON_DEG), ([-1, -1], DERAILED_TENDON_WITHOUT_CELL_DEG)],
)
def test_a_joint_is_off_its_pulley_beyond_the_limit_and_not_at_it(
    monitor: SyntheticMonitor, cell_group: list[int], pulley_limit: float
) -> None:
    """The test uses excursions that differ from the limit only in the last four bits.

    The test runs the detector as Python code, without compilation. For a tendon without a load
    cell, a smaller limit applies to the difference between the measured angle of the joint and its
    angle according to the spool.
    """
    monitor.set_constants(cell_group=cell_group)

    def slip_and_derailed_ticks(excursion_difference: float) -> tuple[float, float]:
        monitor.set_state_values(
            measurements_at_rest(
                **ZERO_JOINT_READINGS | {"tension": 0.0, "excursion": -excursion_difference}
            )
        )
        monitor.set_state_values(
            {
                "taut_s": 9.0,
                "slip_from": 0.0,
                "derailed": 0.0,
                "measured_tension": TAUT_TENSION_N,
                "tension": TAUT_TENSION_N,
                "measured_travel": TAUT_TENSION_N / SOFT_STIFFNESS,
            }
        )
        call_interpreted(
            tendon_slip.update_tendon_slip, monitor.state_tables, monitor.hand_tables, True
        )
        return abs(monitor.field_values("slip")[0]), monitor.field_values("derailed")[0]

    limit_difference_m = pulley_limit / DEG_PER_RAD * 0.02
    results_near_limit = [
        slip_and_derailed_ticks(limit_difference_m * (1.0 + i * 2.0**-52)) for i in range(-4, 5)
    ]
    assert (
        min(angle for angle, _ in results_near_limit)
        <= pulley_limit
        < max(angle for angle, _ in results_near_limit)
    )
    assert all(count == float(angle > pulley_limit) for angle, count in results_near_limit)


@pytest.mark.parametrize(
    ("cell_group", "commanded_force_N", "is_checked"),
    [([-1, -1], 20.0, True), ([-1, -1], np.nan, False), ([0, 1], np.nan, True)],
)
def test_a_pulley_is_not_checked_without_load_cell_and_torque(
    monitor: SyntheticMonitor, cell_group: list[int], commanded_force_N: float, is_checked: bool
) -> None:
    """Reproduce a defect: a commissioning without springs and load cells ended with T08 (a tendon left its pulley).

    The rotor of a released tendon turned back by 1.6 mm. While the rotor turned back, the detector
    still interpreted the friction of the motor as tension.
    """
    monitor.set_constants(cell_group=cell_group)
    monitor.set_state_values(
        measurements_at_rest(**ZERO_JOINT_READINGS | {"tension": 0.0, "excursion": -0.02})
    )
    monitor.set_state_values(
        {
            "wanted": commanded_force_N,
            "taut_s": 9.0,
            "slip_from": 0.0,
            "measured_tension": TAUT_TENSION_N,
            "tension": TAUT_TENSION_N,
        }
    )
    call_interpreted(
        tendon_slip.update_tendon_slip, monitor.state_tables, monitor.hand_tables, True
    )
    assert np.isnan(monitor.field_values("slip")[0]) != is_checked
    assert (monitor.field_values("taut_s")[0] == 0.0) != is_checked
