"""Compare the numbers in the summary of a run with numbers that were computed by hand."""

import json
import math

import numpy as np
import pytest

from handctl.core.tick_types import HandMode
from handctl.report.run_summary import (
    hold_phase_masks,
    mean_angles,
    measured_bus_load,
    root_mean_square,
    summarise_run,
)
from tests.report.generated_run import (
    JAMIA_HAND,
    PERIOD_NS,
    GeneratedRunLog,
    set_truth_column,
    zero_truth_record,
)


def log_without_faults() -> GeneratedRunLog:
    """Create a run of two seconds without events."""
    log = GeneratedRunLog(JAMIA_HAND, 200, {0: "home"})
    for name in ("tension", "tension_raw", "tip_force"):
        log.fields[name][:] = 0.0
    return log


def log_with_hold_phase(ramp_ticks: int = 20) -> GeneratedRunLog:
    """Create a run of four seconds with a hold phase.

    In the hold phase, the tension goal rises, and index finger and thumb are in contact.
    """
    log = GeneratedRunLog(JAMIA_HAND, 400, {0: "home", 100: "hold", 300: "release"})
    for name in ("tension", "tension_raw", "tip_force"):
        log.fields[name][:] = 0.0
    log.fields["contact"][100:, [0, 3]] = 1.0
    goal = log.fields["tension_goal"]
    goal[:100] = 5.0
    goal[100:300] = np.minimum(5.0 + np.arange(1, 201)[:, None], 5.0 + ramp_ticks)
    goal[300:] = 8.0
    return log


def test_ticks_misses_and_lateness() -> None:
    log = log_without_faults()
    log.k = np.concatenate((np.arange(100), np.arange(103, 203)))
    log.late_ns = np.arange(200) * 1000
    result = summarise_run(log, JAMIA_HAND, None, 0)
    assert (result["hand"], result["ticks"], result["missed"], result["rate_hz"]) == (
        "jamia",
        200,
        3,
        100.0,
    )
    assert result["late_us"] == pytest.approx({"p50": 99.5, "p99_9": 198.801, "max": 199.0})


def test_summary_without_truth_has_nan() -> None:
    result = summarise_run(log_with_hold_phase(), JAMIA_HAND, None, 0)
    for name in (
        "tracking_rmse_rad",
        "tension_rmse_n",
        "tension_raw_rmse_n",
        "tension_hold_error_n",
        "tension_hold_peak_error_n",
        "object_motion_mm",
    ):
        assert math.isnan(result[name]), name
    assert result["tip_equivalent_force_n"] == pytest.approx(
        dict.fromkeys(JAMIA_HAND.digit_names, 0.0)
    )


def test_summaries_with_and_without_truth_have_the_same_keys() -> None:
    log = log_with_hold_phase()
    summary_with_truth = summarise_run(log, JAMIA_HAND, zero_truth_record(JAMIA_HAND, 400), 0)
    assert summarise_run(log, JAMIA_HAND, None, 0).keys() == summary_with_truth.keys()


def test_a_truth_of_another_time_is_no_truth() -> None:
    """The summary of a run does not use the truth file of an earlier simulator on the same bus."""
    log = log_with_hold_phase()
    result = summarise_run(log, JAMIA_HAND, zero_truth_record(JAMIA_HAND, 400, offset_ns=10**15), 0)
    assert math.isnan(result["tracking_rmse_rad"])
    assert result["contact_force_n"] == {}


def test_the_mean_angle_weights_joints_by_their_moment_arms() -> None:
    q = np.zeros((2, len(JAMIA_HAND.joints)))
    q[:, :3] = [[0.3, 0.6, 0.9], [1.0, 0.0, 0.0]]
    arms = [JAMIA_HAND.tendon[0].moment_arm_m[joint] for joint in JAMIA_HAND.joints[:3]]
    expected = [np.dot(arms, row) / sum(arms) for row in q[:, :3]]
    np.testing.assert_allclose(mean_angles(JAMIA_HAND, q)[:, 0], expected)
    np.testing.assert_array_equal(mean_angles(JAMIA_HAND, q)[:, 1:], 0.0)


def test_tracking_error_is_computed_in_free_motion_only() -> None:
    log, truth = log_without_faults(), zero_truth_record(JAMIA_HAND, 200, 7)
    joints = slice(0, 3)  # joints of the index finger
    log.fields["q_goal"][:, joints] = 0.5
    for joint in JAMIA_HAND.joints[joints]:
        true_angles = np.full(200, 0.49)
        true_angles[100:120] = 0.2  # in these ticks, the controller detects contact
        true_angles[120:140] = 0.1  # in these ticks, only the true values show contact
        true_angles[140:160] = 0.0  # in these ticks, the hand is not active
        set_truth_column(truth, f"q/{joint}", true_angles)
    log.fields["contact"][100:120, 0] = 1.0
    force = np.zeros(200)
    force[120:140] = 0.2
    set_truth_column(truth, "contact_force/index/y", force)
    log.mode[140:160] = HandMode.RELAX
    result = summarise_run(log, JAMIA_HAND, truth, 7)
    assert result["tracking_rmse_rad"] == pytest.approx(0.01)
    assert result["tracking_rmse_deg"]["index"] == pytest.approx(math.degrees(0.01))
    assert math.isnan(result["tracking_rmse_deg"]["thumb"]), "the thumb had no goal"
    error_by_joint = result["tracking_rmse_joint_deg"]
    assert [error_by_joint[joint] for joint in JAMIA_HAND.joints[joints]] == pytest.approx(
        [math.degrees(0.01)] * 3
    )
    assert math.isnan(error_by_joint["thumb_j1"])


def test_tension_errors_are_computed_for_estimate_and_raw_load_cell() -> None:
    """The summary compares the tension estimate of a tick with the true tension at the time of the tick.

    A load cell is read one control period before the tick that receives the reading. The summary compares the load-cell
    reading with the true tension at the time of the reading.
    """
    log, truth = log_without_faults(), zero_truth_record(JAMIA_HAND, 200)
    true_tension = 20.0 + np.arange(200) * 0.1
    for name in JAMIA_HAND.tendon_names:
        set_truth_column(truth, f"tension/{name}", true_tension)
    log.fields["tension"][:] = true_tension[:, None] + 0.3
    log.fields["tension_raw"][1:] = (
        true_tension[:-1, None] + np.where(np.arange(199) % 2, 0.5, -0.5)[:, None]
    )
    log.fields["tension_raw"][0] = np.nan
    log.fields["tension_raw"][50] = np.nan
    result = summarise_run(log, JAMIA_HAND, truth, 0)
    assert result["tension_rmse_n"] == pytest.approx(0.3)
    assert result["tension_raw_rmse_n"] == pytest.approx(0.5)


def test_slack_tendons_do_not_count() -> None:
    log, truth = log_without_faults(), zero_truth_record(JAMIA_HAND, 200)
    log.fields["tension"][:] = 7.0
    assert math.isnan(summarise_run(log, JAMIA_HAND, truth, 0)["tension_rmse_n"])


def test_a_hold_is_judged_from_half_a_second_after_its_ramp_to_its_end() -> None:
    (window,) = hold_phase_masks(log_with_hold_phase(ramp_ticks=20), JAMIA_HAND)
    assert np.flatnonzero(window).tolist() == list(range(119 + 50, 300))
    empty_log = log_with_hold_phase()
    empty_log.fields["contact"][:] = 0.0
    assert not np.any(hold_phase_masks(empty_log, JAMIA_HAND)), (
        "without a hold there are no windows"
    )
    log_with_two_holds = GeneratedRunLog(
        JAMIA_HAND, 400, {0: "hold", 150: "move", 200: "hold firmly"}
    )
    log_with_two_holds.fields["contact"][:, 0] = 1.0
    log_with_two_holds.fields["tension_goal"][:] = 9.0
    ticks_of_holds = [
        np.flatnonzero(mask).tolist() for mask in hold_phase_masks(log_with_two_holds, JAMIA_HAND)
    ]
    assert ticks_of_holds == [list(range(50, 150)), list(range(250, 400))]


def test_a_hold_is_a_phase_of_that_kind_whatever_its_name() -> None:
    """Reproduce a defect: for a hold phase named "squeeze", the summary lacked tension error, tip forces and motion."""
    log = log_with_hold_phase()
    log.phases = [
        phase._replace(name={"hold": "squeeze"}.get(phase.name, phase.name)) for phase in log.phases
    ]
    phases = [
        {"kind": "move", "name": "hold open", "angle_deg": 0.0, "duration_s": 1.0},
        {"kind": "hold", "name": "squeeze", "tension_N": 25.0},
    ]
    lines = [
        "[[phase]]\n" + "\n".join(f"{key} = {json.dumps(value)}" for key, value in phase.items())
        for phase in phases
    ]
    assert not hold_phase_masks(log, JAMIA_HAND), "a log without its task"
    log.header.attachments["task.toml"] = "\n".join(['schema = 1\nname = "grip"', *lines]).encode()
    (window,) = hold_phase_masks(log, JAMIA_HAND)
    assert np.flatnonzero(window).tolist() == list(range(119 + 50, 300))
    truth = zero_truth_record(JAMIA_HAND, 400)
    set_truth_column(truth, f"tension/{JAMIA_HAND.tendon_names[0]}", 22.0)
    set_truth_column(truth, f"tension/{JAMIA_HAND.tendon_names[3]}", 25.0)
    assert summarise_run(log, JAMIA_HAND, truth, 0)["tension_hold_error_n"] == pytest.approx(3.0)
    log.phases = [log.phases[0]._replace(name="hold open"), *log.phases[1:]]
    assert len(hold_phase_masks(log, JAMIA_HAND)) == 1, "a move is no hold"
    log.header.attachments["task.toml"] = b"\xff = ["
    assert len(hold_phase_masks(log, JAMIA_HAND)) == 1, "the names alone, if the task is damaged"


def test_a_hold_with_a_stiffness_is_judged_although_its_goals_follow_every_angle() -> None:
    log = log_with_hold_phase(ramp_ticks=20)
    log.fields["tension_goal"][100:300] += np.where(np.arange(200) % 2, 0.1, -0.1)[:, None]
    (window,) = hold_phase_masks(log, JAMIA_HAND)
    assert np.flatnonzero(window).tolist()[-1] == 299
    assert 119 + 45 <= np.argmax(window) <= 119 + 50


def test_hold_error_is_the_worst_mean_of_a_tendon_that_holds() -> None:
    log, truth = log_with_hold_phase(), zero_truth_record(JAMIA_HAND, 400)
    index, middle, _, thumb = JAMIA_HAND.tendon_names
    alternating_error = np.where(np.arange(400) % 2, 1.5, -1.5)
    set_truth_column(truth, f"tension/{index}", 25.0 - 0.4 + alternating_error)
    set_truth_column(truth, f"tension/{thumb}", 25.0 + 0.7)
    set_truth_column(truth, f"tension/{middle}", 3.0)  # the middle tendon is taut without contact
    result = summarise_run(log, JAMIA_HAND, truth, 0)
    assert result["tension_hold_error_n"] == pytest.approx(0.7, abs=0.02)
    assert result["tension_hold_peak_error_n"] == pytest.approx(1.9, abs=0.02)


def test_contact_forces_and_tip_forces_are_means_over_the_hold() -> None:
    log, truth = log_with_hold_phase(), zero_truth_record(JAMIA_HAND, 400)
    log.fields["tip_force"][:, 0] = np.where(np.arange(400) < 169, 99.0, 3.0)
    set_truth_column(truth, "contact_force/index/x", np.where(np.arange(400) < 169, 50.0, 3.0))
    set_truth_column(truth, "contact_force/index/y", np.where(np.arange(400) < 169, 50.0, 4.0))
    result = summarise_run(log, JAMIA_HAND, truth, 0)
    assert result["tip_equivalent_force_n"]["index"] == pytest.approx(3.0)
    assert result["contact_force_n"]["index"] == pytest.approx(5.0)
    assert result["contact_force_n"]["thumb"] == 0.0


def test_object_motion_is_the_largest_distance_from_the_start_of_a_hold() -> None:
    log, truth = log_with_hold_phase(), zero_truth_record(JAMIA_HAND, 400)
    x = np.zeros(400)
    x[:169] = 0.050  # before the hold phase
    x[200], x[201] = 3e-4, -4e-4
    x[300:] = 0.080  # after the release
    set_truth_column(truth, "object/x", x)
    set_truth_column(truth, "object/z", np.where(np.arange(400) == 201, 3e-4, 0.0))
    assert summarise_run(log, JAMIA_HAND, truth, 0)["object_motion_mm"] == pytest.approx(0.5)
    log_with_two_holds = GeneratedRunLog(JAMIA_HAND, 400, {0: "hold", 150: "move", 200: "hold"})
    log_with_two_holds.fields["contact"][:, 0] = 1.0
    log_with_two_holds.fields["tension_goal"][:] = 9.0
    log_with_two_holds.fields["tip_force"][:] = 0.0
    log_with_two_holds.fields["tension"][:] = log_with_two_holds.fields["tension_raw"][:] = 9.0
    set_truth_column(truth, "object/x", np.where(np.arange(400) < 150, 0.0, 0.010))
    set_truth_column(truth, "object/z", 0.0)
    assert summarise_run(log_with_two_holds, JAMIA_HAND, truth, 0)[
        "object_motion_mm"
    ] == pytest.approx(0.0), "the object moved between two holds"


def test_rms_ignores_nan() -> None:
    assert root_mean_square(np.array([3.0, np.nan, -4.0])) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(root_mean_square(np.array([np.nan])))


def test_measured_load_equals_a_hand_calculation() -> None:
    """Compare the bus load of classical CAN frames of 8 bytes with a load that was computed by hand.

    In a frame with 8 bytes of data, stuff bits occur only in the first 98 bits: 19 bits of header,
    64 bits of data, and 15 bits of CRC. After the first bit, there is at most one stuff bit for
    every four bits. The last 13 bits of the frame get no stuff bits.
    """
    log = log_without_faults()
    frame_time_s = (98 + 97 // 4 + 13) / 1e6
    assert measured_bus_load(log, 1_000_000, None, [(8, False)] * 10) == pytest.approx(
        10 * frame_time_s / 1.99
    )


def test_an_empty_run_has_no_numbers_and_no_error() -> None:
    log = GeneratedRunLog(JAMIA_HAND, 0, {})
    result = summarise_run(log, JAMIA_HAND, zero_truth_record(JAMIA_HAND, 3), 0)
    assert result["ticks"] == 0
    assert math.isnan(result["late_us"]["p50"])
    assert 1e9 / result["rate_hz"] == PERIOD_NS
