"""Test the fault campaign, which injects faults into simulated hands that run in lockstep with the controller.

Each injected fault has an effect, and all reactions of the controller are in time. No tension
exceeds the bound that follows from the force limits of the drives and the momentum of the rotors.
"""

import contextlib
import math
import os
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from handctl.campaign import campaign
from handctl.campaign.fault_matrix import (
    ALL_PROTOCOLS,
    ARMING_STAGE,
    FAULT_MATRIX,
    FREE_MOTION_STAGE,
    GRASP_STAGE,
    TEST_PLACE_BY_UNTESTED_FAULT,
    FaultMatrixRow,
    FaultScenario,
    fault_pairs,
    fault_texts_for_hand,
    scenarios_of_hand,
)
from handctl.campaign.run_stages import (
    FREE_MOTION_STAGE_DELAY_S,
    MIN_CONTROL_RATE_HZ,
    advance_to_stage,
    hand_with_drives,
    hand_with_protocol,
    homed_run,
    run_in_forked_processes,
)
from handctl.campaign.scenario_run import ScenarioResult, run_scenario
from handctl.core.tick_types import HandMode, TickEvent
from handctl.hand.hand_loading import hand_from_content, load_hand, packaged_hands
from handctl.safety.faults.tendon import RELAXING_TIME_S
from handctl.safety.missing_sensors import sensing_warnings
from handctl.safety.safety_action import SafetyAction
from handctl.safety.safety_limits import MAX_STALL_S, MIN_STALLED_TICKS, tick_count_for_time
from handctl.session.lockstep_simulation import SimulatedRun
from handctl.session.run_plan import default_control_rate
from tests.hand.hand_on_wrist import mount_on_wrist

RATE_HZ = 500.0
SAMPLED_FAULT_IDS = ("N08", "H13")


@pytest.fixture(scope="module")
def campaign_report():
    """Return the report of a short fault campaign: a few faults with MIT drives, and one second without a fault."""
    return campaign.run_campaign(
        "jamia", ["mit"], lambda hand: RATE_HZ, jobs=2, is_quick=False, fault_free_s=1.0,
        on_progress=lambda protocol, done, total: None, on_failure=lambda simulation, result: None,
        row_ids=SAMPLED_FAULT_IDS,
    )  # fmt: skip


def test_only_existing_load_cells_fail():
    """Reproduce a defect: the campaign ended with a traceback for a hand with spool pairs.

    The campaign tried to saturate the load cell of a spool pair (two tendons on one spool), but a
    spool pair has no load cell.
    """
    for hand in (mount_on_wrist("jamia"), load_hand("orca_like")):
        cells = set(hand.sensor_node.tendons)
        scenarios = [*scenarios_of_hand(hand, "mit", 2.5), *fault_pairs(hand, "mit", 2.5)]
        texts = [
            text
            for result in scenarios
            for text in (result.fault, result.second_fault)
            if "cell=" in text
        ]
        assert bool(texts) == bool(cells)
        assert {text.partition("cell=")[2].split()[0] for text in texts} <= cells


def test_every_scenario_takes_effect_and_is_answered_in_time(campaign_report):
    failed_results = [
        (result.scenario, result.problem) for result in campaign_report.all_results if not result.ok
    ]
    assert failed_results == []
    assert {result.id for result in campaign_report.all_results} == set(SAMPLED_FAULT_IDS)
    assert all(result.effect_count for result in campaign_report.all_results)


def test_the_report_has_its_sections(campaign_report):
    figures = campaign_report.as_json()
    assert figures["scenarios"] == len(campaign_report.all_results) == 12
    assert (figures["late"], figures["not_felt"], figures["false_alarms"]) == (0, 0, 0)
    assert 0 < figures["worst_ticks"] <= 6


def test_fault_free_run_alone_continues_its_seeds():
    """A campaign that simulates only runs without faults can begin with any seed.

    If each campaign begins with the seed after the last seed of the previous campaign, several
    short campaigns can replace one long campaign.
    """
    seeds = []

    def record_run(hand, rate_hz, seconds, seed):
        seeds.append((round(rate_hz), seconds, seed))
        return []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "simulate_without_faults", record_run)
        report = campaign.run_campaign(
            "jamia", ["mit"], lambda hand: RATE_HZ, jobs=1, is_quick=False, fault_free_s=30.0,
            fault_free_only=True, seed=76,
            on_progress=lambda protocol, done, total: None, on_failure=lambda simulation, result: None,
        )  # fmt: skip
    assert (seeds, report.all_results, report.simulated_s) == ([(500, 30.0, 76)], [], 30.0)


def alarms_of_run(phase, *event_texts):
    """Return the false alarms of a run without injected faults.

    The run stays in the given phase for eight seconds. Once per second, the run reports
    every fault in ``event_texts``.
    """
    events = tuple(TickEvent("warn", "fault", "", text) for text in event_texts)
    out = SimpleNamespace(mode=HandMode.ACTIVE, phase=phase, events=events)

    @contextlib.contextmanager
    def fake_homed_run(hand, rate_hz, seed, perturb):
        simulation = SimulatedRun(
            None, SimpleNamespace(inject=lambda text: None), 10**9, SimpleNamespace(failure="")
        )

        def tick():
            simulation.k += 1
            simulation.last_output = out
            return out

        simulation.run_tick = tick
        yield simulation

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "homed_run", fake_homed_run)
        return campaign.simulate_without_faults(
            hand_with_protocol("jamia", "mit"), 1.0, 9.0, seed=5
        )


def test_a_reaction_or_a_missing_grasp_without_fault_is_a_false_alarm():
    assert alarms_of_run("hold") == []
    assert alarms_of_run("hold", "B01 lost: index_motor (1): WARN") == []
    assert (
        alarms_of_run("hold", "N07 noise: index_motor (1): HOLD")
        == ["N07 noise: index_motor (1): HOLD"] * 9
    )
    assert alarms_of_run("ready") == ["seed 5 did not reach a grasp: ready"]


@pytest.mark.parametrize("seed", range(3))
def test_exchanged_drives_are_found_soon_after_the_fingers_touch_an_object(seed: int) -> None:
    """Reproduce a defect: the controller detected the exchange of two drives only after 2.3 s.

    Each of the two drives reported the encoder and the current of the other drive. The fault N17
    compares the changes of the commanded torque with the changes of the reported torque. At the
    contact with the object, the torques changed strongly. These changes hid the differences between
    commanded and reported torque that the exchange of the drives caused.
    """
    hand = hand_with_protocol("t42", "mit")
    with homed_run(hand, RATE_HZ, seed) as simulation:
        advance_to_stage(simulation, GRASP_STAGE)
        simulation.simulated_hand.inject("swap node=left_motor with=right_motor")
        assert simulation.run_until(lambda out: out.mode == HandMode.RELAX, 0.6)
        assert {mark.id for mark in simulation.state.latched_faults} == {"N17"}


@pytest.mark.parametrize("hand", packaged_hands())
@pytest.mark.parametrize("protocol", ALL_PROTOCOLS)
def test_every_hand_with_every_protocol_has_a_rate_at_which_faults_are_found_in_time(
    hand: str, protocol: str
) -> None:
    """With eleven moteus, ODrive or RobStride drives, one bus allows a control rate of only 100 Hz.

    In this test, hands with eleven moteus, ODrive or RobStride drives have two buses.
    """
    changed_hand = hand_with_protocol(hand, protocol)
    assert default_control_rate(changed_hand) >= MIN_CONTROL_RATE_HZ
    assert {motor.bus for motor in changed_hand.motor} <= set(changed_hand.bus_names)
    # The hand file that `demo --protocol` writes must describe the same hand as ``changed_hand``.
    assert hand_from_content(tomllib.loads(changed_hand.to_toml()), "hand") == changed_hand


@pytest.mark.timeout(120)
def test_at_100_hz_noise_prevents_no_grasp():
    """In the run of this test, the noise of the load cells is three times as large as usual.

    Without countermeasures, the tripled noise would make one of eleven taut tendons look slack in
    every fifth tick.
    """
    assert (
        campaign.simulate_without_faults(
            hand_with_protocol("jamia11", "odrive"), 100.0, 8.0, seed=80111
        )
        == []
    )


def test_a_missing_reaction_counts_as_late(tmp_path):
    """The campaign must report that a scenario failed if the fault has no effect, or is detected too late.

    One fault of this test has no effect, and the other fault cannot be detected in time.
    """
    hand = hand_with_protocol("jamia", "mit")
    row_without_reaction = FaultMatrixRow(
        "B01", "drop node=index_motor p=0", SafetyAction.WARN, 3, accepted_faults=("B01",)
    )
    row_detected_too_late = FaultMatrixRow(
        "T04", "drift cell=index_tendon size=1", SafetyAction.RELAX, 3, accepted_faults=("T04",)
    )
    results = []
    stored_log = tmp_path / "kept"
    with homed_run(hand, RATE_HZ, 0) as simulation:
        simulation.run_tick()
        scenarios = [
            FaultScenario(row, row.fault, GRASP_STAGE)
            for row in (row_without_reaction, row_detected_too_late)
        ]
        run_in_forked_processes(
            simulation,
            scenarios,
            2,
            lambda simulation, scenario: run_scenario(simulation, scenario, "mit"),
            results.append,
            lambda simulation, result: stored_log.touch(),
        )
    assert sorted(result.problem for result in results) == [
        "no reaction; torque remains",
        "the disturbance had no effect",
    ]
    assert stored_log.exists(), "the log of a failure is stored"


def test_a_reaction_to_another_fault_does_not_count():
    """A run that ends because of a drive error does not show that a stuck load cell (T05) is detected."""
    row = FaultMatrixRow(
        "T05", "error node=index_motor", SafetyAction.RELAX, 3, accepted_faults=("T05",)
    )
    with homed_run(hand_with_protocol("jamia", "mit"), RATE_HZ, 0) as simulation:
        advance_to_stage(simulation, ARMING_STAGE)
        advance_to_stage(simulation, FREE_MOTION_STAGE)
        result = run_scenario(simulation, FaultScenario(row, row.fault, FREE_MOTION_STAGE), "mit")
    assert "T05" in result.problem
    assert not result.ok


@pytest.mark.parametrize(("fault_name", "rate_hz"), [("jamia", RATE_HZ), ("jamia11", 200.0)])
def test_a_free_motion_is_disturbed_while_it_moves(fault_name, rate_hz):
    with homed_run(hand_with_protocol(fault_name, "mit"), rate_hz, 0) as simulation:
        advance_to_stage(simulation, ARMING_STAGE)
        advance_to_stage(simulation, FREE_MOTION_STAGE)
        free_motion_outputs = [out for _, out in simulation.recorded_ticks if out.phase == "free"]
        assert len(free_motion_outputs) * simulation.period_ns == pytest.approx(
            FREE_MOTION_STAGE_DELAY_S * 1e9, abs=2 * simulation.period_ns
        )
        speed = free_motion_outputs[-1].telemetry.dq_goal
        assert np.degrees(speed).max() > 10.0


def test_the_offset_of_a_load_cell_exceeds_the_limits_of_its_tendon():
    hand = hand_with_protocol("jamia", "mit")
    thumb = hand.tendon[-1].model_copy(update={"tension_trip_N": 90.0, "drive_limit_N": 95.5})
    other_hand = hand.model_copy(update={"tendon": (*hand.tendon[:-1], thumb)})
    texts = {
        scenario.fault
        for scenario in scenarios_of_hand(other_hand, "mit", 2.0)
        if scenario.row.id == "T03"
    }
    assert {"offset cell=thumb_tendon size=90", "offset cell=thumb_tendon size=95.5"} <= texts
    assert {"offset cell=index_tendon size=140", "offset cell=index_tendon size=160"} <= texts


@pytest.mark.parametrize("joint", ["index_j1", "thumb_j2"])
def test_silent_joint_encoders_are_detected(joint):
    """Four successive missing frames of a joint encoder cause the fault N02b (the joint encoders are silent).

    Three successive missing frames cause no fault, not even N06 (encoder drift or slip) or T08 (a
    tendon left its pulley).
    """
    joint_decimation = hand_with_protocol("jamia11", "mit").sensor_node.joint_decimation
    for frames, detected_fault in ((3, ""), (4, f"N02b {joint}")):
        fault = f"mute joint={joint} for={5 * joint_decimation * frames}ms"
        row = FaultMatrixRow(
            "N02", fault, SafetyAction.RELAX, 4 * joint_decimation, accepted_faults=("N02",)
        )
        with homed_run(hand_with_protocol("jamia11", "mit"), 200.0, 0) as simulation:
            advance_to_stage(simulation, ARMING_STAGE)
            advance_to_stage(simulation, FREE_MOTION_STAGE)
            result = run_scenario(simulation, FaultScenario(row, fault, FREE_MOTION_STAGE), "mit")
        assert (result.effect_count, result.detected_by) == (frames, detected_fault)
        assert result.ok == bool(detected_fault), result.problem


def results_of_hand(
    hand_name: str, seed: int, faults_by_stage: dict[str, tuple[str, ...]], protocol: str = "mit"
) -> dict[str, ScenarioResult]:
    """Run the fault scenarios of a hand, and return their results by scenario name.

    ``faults_by_stage`` contains the faults that are injected in each stage of the campaign.
    """
    hand = hand_with_protocol(hand_name, protocol)
    rate = default_control_rate(hand)
    results: list[ScenarioResult] = []
    with homed_run(hand, rate, seed) as simulation:
        for stage, rows in faults_by_stage.items():
            advance_to_stage(simulation, stage)
            scenarios = [
                scenario
                for scenario in scenarios_of_hand(hand, protocol, 1e3 / rate)
                if scenario.stage == stage and scenario.row.fault.startswith(rows)
            ]
            run_in_forked_processes(
                simulation,
                scenarios,
                1,
                lambda simulation, case: run_scenario(simulation, case, protocol),
                results.append,
                lambda simulation, result: None,
            )
    return {result.scenario: result for result in results}


def assert_no_scenario_failed(results: dict[str, ScenarioResult]) -> None:
    """Fail the test with the name and the problem of the first failed scenario."""
    for result in results.values():
        assert result.ok, result.scenario + result.problem


@pytest.mark.parametrize("seed", range(6))
def test_exchanged_power_stages_without_torque_feedback_are_found_at_a_small_tension(seed: int):
    """Reproduce a defect: when two drives had exchanged power stages, the controller detected the exchange too late.

    A tension reached 100 to 114 N, because the difference between tension and motor force was
    filtered with a time constant of 200 ms.
    """
    (result,) = results_of_hand("t42", seed, {FREE_MOTION_STAGE: ("cross",)}, "odrive").values()
    assert result.ok, result.problem
    assert result.detected_by.startswith("T04b")
    assert result.tension < 30.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_drive_without_torque_feedback_that_switches_off_is_reported_by_its_own_error(seed: int):
    """Within 20 ms, the detector of T04b (a load cell is wrong) finds only tensions that are too high.

    If a drive switches off, the tension becomes too low, and the detector does not find a wrong
    load cell. The controller therefore reports only the error of the drive.
    """
    faults = ("voltage", "error", "watchdog")
    for result in results_of_hand("t42", seed, {GRASP_STAGE: faults}, "odrive").values():
        assert result.ok, result.problem


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_hands_without_load_cells_stop_soon_after_exchanged_or_late_drives(seed):
    """Check that tensions stay below 40 N if drives of a hand without load cells are exchanged or react late.

    Earlier defect: when drives of the thumb were exchanged or reacted late, the speed of the
    thumb's spools grew without limit, and the tensions reached 208 to 230 N.
    """
    results = results_of_hand("orca_like", seed, {FREE_MOTION_STAGE: ("swap", "cross", "late")})
    assert len(results) == 6
    assert_no_scenario_failed(results)
    for result in results.values():
        assert result.tension < 40.0, result.scenario


def test_faults_of_a_hand_without_load_cells_are_found_in_a_grasp():
    """A tendon that tears while it pulls is detected within 75 ms.

    A drive that makes no torque is detected within 22 ticks. Earlier defect: the controller was too
    late to detect a torn tendon or a drive without torque. Earlier defect: the controller did not
    report a drive that kept its torque after it was disabled.
    """
    results = results_of_hand(
        "orca_like", 1, {GRASP_STAGE: ("snap", "slack", "disobey", "ripple", "hold_on", "reorder")}
    )
    assert len(results) == 11
    assert_no_scenario_failed(results)
    thumb = results["T01 snap tendon=thumb_dip, grasp"]
    assert (thumb.detected_by, thumb.ticks <= 30) == ("T08 thumb_dip", True)
    assert results["N14 disobey node=thumb_dip size=0, grasp"].ticks <= 22


def test_a_torn_tendon_without_load_cell_is_reported_in_free_motion():
    """The campaign also accepts the fault T08 (a tendon left its pulley) as the detection of a torn tendon.

    Reproduce a defect: the controller reported the torn tendon as T08 after 190 ms, but the
    campaign did not accept T08.
    """
    results = results_of_hand(
        "orca_like", 1, {FREE_MOTION_STAGE: ("snap", "stuck encoder", "reorder")}
    )
    assert len(results) == 5
    assert_no_scenario_failed(results)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_faults_of_an_extensor_with_a_small_tension_are_found_in_time(seed):
    """The extensor of the thumb pulls with 9 N in a grasp.

    Reproduce two defects. Earlier defect: a torn extensor was reported only after 11 ticks, because
    the tension loop damps the spool. Earlier defect: the campaign began to count the reaction time
    for a stuck load cell too early. A stuck load cell can be detected only after the motor force
    has changed.
    """
    results = results_of_hand("n_plus_1", seed, {GRASP_STAGE: ("snap", "slack", "stuck cell")})
    assert len(results) == 6
    assert_no_scenario_failed(results)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_noisy_encoder_is_reported_as_such(seed):
    """Reproduce a defect: a noisy encoder was first reported as T04b (a load cell is wrong).

    The noise of the encoder looked like an acceleration of the spool.
    """
    results = results_of_hand("jamia11", seed, {FREE_MOTION_STAGE: ("noise encoder",)})
    assert len(results) == 2
    assert_no_scenario_failed(results)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_odrive_that_does_not_release_is_found_although_it_reports_rarely(seed):
    """Reproduce a defect: the fault N16 (a drive does not release) was not detected.

    A high speed of a spool shows that the drive has released its tendon. Between two rare reports
    of an ODrive, the estimated speed is only a prediction. If the predicted speed was high, the
    controller wrongly concluded that the drive had released its tendon.
    """
    results = results_of_hand("t42", seed, {GRASP_STAGE: ("hold_on",)}, "odrive")
    assert len(results) == 2
    assert_no_scenario_failed(results)


def test_only_missing_sensors_extend_a_time_limit():
    """Only for a hand without load cells, the campaign adds ticks to the time limits of the fault matrix."""
    for name, some in (
        ("jamia", False),
        ("jamia11", False),
        ("n_plus_1", False),
        ("orca_like", True),
    ):
        hand = hand_with_protocol(name, "mit")
        scenarios = [*scenarios_of_hand(hand, "mit", 2.0), *fault_pairs(hand, "mit", 2.0)]
        assert any(scenario.missing_sensor_ticks for scenario in scenarios) == some


@pytest.mark.parametrize(("protocol", "is_judged"), [("mit", True), ("odrive", False)])
def test_torque_after_a_cut_needs_a_load_cell_or_torque_in_each_reply(protocol, is_judged):
    """Either the campaign tests the fault N16 (a drive does not release), or `config check` warns about N16.

    An ODrive sends its torque in a separate frame. After the action CUT, an ODrive sends no more
    torque frames.
    """
    hand = hand_with_drives(load_hand("orca_like"), protocol)
    rows = {scenario.row.id for scenario in scenarios_of_hand(hand, protocol, 5.0)}
    assert ("N16" in rows) == is_judged
    assert any("N16" in line for line in sensing_warnings(hand)) != is_judged


def test_a_stall_of_the_host_is_a_stall_at_every_control_rate():
    """Check that the scenario of the fault H03 (the host stalled) misses more ticks at a faster control rate.

    Reproduce a defect: in the scenario of the stalled host, the host missed 14 ticks at every
    control rate. At 1 kHz, 14 missed ticks last 14 ms, which is too short to count as a stall of
    the host. At 200 Hz, 14 missed ticks last 70 ms, which is longer than the watchdog time of the
    drives.
    """
    hand = hand_with_protocol("t42", "mit")
    watchdog_s = min(motor.watchdog_ms for motor in hand.motor) * 1e-3
    row = next(row for row in FAULT_MATRIX if row.id == "H03")
    for rate_hz in (200.0, 250.0, 400.0, 500.0, 1000.0):
        (text,) = fault_texts_for_hand(hand, row.fault, 1e3 / rate_hz)
        missed_ticks = int(text.split()[-1])
        assert missed_ticks > tick_count_for_time(MAX_STALL_S, 1.0 / rate_hz, MIN_STALLED_TICKS)
        assert missed_ticks / rate_hz < watchdog_s


def test_a_time_limit_of_a_filter_stays_the_same_time_at_a_fast_control_rate():
    """At control rates up to 500 Hz, the time limit for the reaction to a fault is ``max_ticks`` ticks.

    At 1 kHz, the time limit is ``2 * max_ticks`` ticks for a fault whose row has
    ``scales_with_period=True``. For a fault with ``scales_with_period=False``, the time limit at 1
    kHz is ``max_ticks`` ticks.
    """
    for row in FAULT_MATRIX:
        row_without_extra_time = row._replace(
            max_extra_ms=0.0, extra_ms_by_protocol={}, extra_ticks={}
        )
        limits_up_to_500_hz = [
            row_without_extra_time.reaction_limit_ticks("mit", period_ms)
            for period_ms in (5.0, 2.5, 2.0)
        ]
        assert limits_up_to_500_hz == 3 * [row.max_ticks]
        limit_at_1_khz = 2 * row.max_ticks if row.scales_with_period else row.max_ticks
        assert row_without_extra_time.reaction_limit_ticks("mit", 1.0) == limit_at_1_khz
    assert {row.id for row in FAULT_MATRIX if row.scales_with_period} == {"B04", "N14"}


@pytest.mark.parametrize("seed", [0, 2])
def test_faults_of_a_hand_at_1_khz_are_found_in_the_time_of_500_hz(seed):
    """Reproduce a defect: at 1 kHz, the controller needed more ticks to detect two faults than at 500 Hz.

    The detection of N14 (a command is not obeyed) was late because of the low-pass filter of the
    detector. The fault B04 (a delayed frame) is detected only when the frame arrives, which takes
    more ticks at 1 kHz.
    """
    assert default_control_rate(hand_with_protocol("t42", "cia402")) == 1000.0
    faults = {FREE_MOTION_STAGE: ("host skip", "delay"), GRASP_STAGE: ("disobey", "delay")}
    results = results_of_hand("t42", seed, faults, "cia402")
    assert len(results) == 6
    assert_no_scenario_failed(results)


@pytest.mark.parametrize("protocol", ["mit", "cia402"])
def test_a_drive_of_a_weak_hand_that_does_not_obey_is_found_as_soon_as_one_of_a_strong_hand(
    protocol,
):
    """A hand whose drives pull with at most 110 N needs lower fault thresholds than a hand with 160 N.

    Reproduce two defects in which a weak hand had the fault threshold of a strong hand. The
    controller detected after 23 ticks that a drive made no torque, but the time limit is 22 ticks.
    At 1 kHz, the controller detected a runaway drive after 11 ticks, but the time limit is 10
    ticks.
    """
    faults = {FREE_MOTION_STAGE: ("runaway",), GRASP_STAGE: ("disobey",)}
    for seed in (0, 12):
        results = results_of_hand("t42", seed, faults, protocol)
        assert len(results) == 4
        assert_no_scenario_failed(results)


@pytest.mark.parametrize("seed", [6, 13])
def test_a_slack_tendon_of_a_drive_that_forgot_its_limits_counts_as_found(seed):
    """Reproduce a defect: the campaign did not accept the fault T01 (a tendon snapped) as a detection.

    The controller correctly relaxed the hand after 26 ticks because of the fault T01 (a tendon
    snapped), but the campaign accepted only other faults.
    """
    results = results_of_hand("t42", seed, {GRASP_STAGE: ("forget",)}, "moteus")
    assert len(results) == 2
    assert_no_scenario_failed(results)


def test_a_node_that_answers_every_second_tick_does_not_make_the_hand_swing():
    """Reproduce a defect: with steady-state filter gains, the tension rose to 171 N although 7 N were commanded."""
    row = next(row for row in FAULT_MATRIX if row.id == "N15" and "cia402" in row.protocols)
    with homed_run(hand_with_protocol("jamia11", "cia402"), 200.0, 0) as simulation:
        advance_to_stage(simulation, ARMING_STAGE)
        advance_to_stage(simulation, FREE_MOTION_STAGE)
        result = run_scenario(
            simulation, FaultScenario(row, "slow node=index_m1 size=2", FREE_MOTION_STAGE), "cia402"
        )
    assert result.ok, result.problem
    assert result.tension < 30.0


def test_runaway_drive_stays_below_the_tension_of_its_limit_and_momentum():
    """If a drive runs away against a grasped object, the tension has an upper bound.

    The bound of the tension follows from the force limit and the momentum of the drive. Without
    friction, the tension rises to F + sqrt((F - T)^2 + k m v^2), with these values of the tendon
    and its drive:

    - F: force limit of the runaway drive [N]
    - T: initial tension [N]
    - k: stiffness of the tendon [N/m]
    - m: inertia of the rotor, converted to a mass at the tendon [kg]
    - v: initial speed of the rotor, converted to the tendon [m/s]

    The bound ignores the reaction of the controller, which can only lower the tension.
    """
    hand = hand_with_protocol("jamia", "mit")
    with homed_run(hand, RATE_HZ, 0) as simulation:
        advance_to_stage(simulation, GRASP_STAGE)
        tendon_constants = simulation.controller.model.tendon_constants
        start_tension = simulation.simulated_hand.truth()["tension"][0]
        v = (
            abs(
                float(simulation.last_output.telemetry.motor_velocity[0])
                * float(tendon_constants.spool_radius[0])
            )
            + 0.01
        )
        row = next(row for row in FAULT_MATRIX if row.fault == "runaway node={node} size=1 seed=1")
        scenario = FaultScenario(row, row.fault.replace("{node}", hand.motor[0].name), GRASP_STAGE)
        result = run_scenario(simulation, scenario, "mit")
    limit = hand.tendon[0].drive_limit_N
    k = float(tendon_constants.stiffness[0])
    m = float(tendon_constants.motor_mass[0])
    bound = limit + math.sqrt((limit - start_tension) ** 2 + k * m * v**2)
    assert result.ok, result.problem
    assert start_tension < result.tension <= bound, f"{result.tension:.0f} N, bound {bound:.0f} N"


def test_a_drive_that_does_not_relax_is_cut_although_its_load_cell_is_saturated():
    """The drive in this test is an ODrive without torque feedback.

    The load cell of the tendon saturates below the tension at which the controller would
    immediately disable all drives.
    """
    hand = hand_with_protocol("jamia_bench", "odrive")
    row = next(row for row in FAULT_MATRIX if row.fault == "runaway node={node} size=1 seed=1")
    with homed_run(hand, 400.0, 0) as simulation:
        advance_to_stage(simulation, GRASP_STAGE)
        result = run_scenario(
            simulation,
            FaultScenario(row, row.fault.replace("{node}", "thumb_motor"), GRASP_STAGE),
            "odrive",
        )
    assert result.ok, result.problem
    assert result.safe_ticks <= 400.0 * RELAXING_TIME_S + row.max_ticks + 5


def test_instances_are_the_first_and_the_last():
    hand = hand_with_protocol("jamia", "mit")
    texts = [
        scenario.fault
        for scenario in scenarios_of_hand(hand, "mit", 2.0)
        if scenario.row.id == "B17" and scenario.stage == GRASP_STAGE
    ]
    assert {text.rpartition("=")[2] for text in texts} == {"index_motor", "thumb_motor"}
    assert len(fault_pairs(hand, "mit", 2.0)) == 66


def test_every_row_is_in_the_matrix_or_tested_elsewhere():
    assert not {row.id for row in FAULT_MATRIX} & TEST_PLACE_BY_UNTESTED_FAULT.keys()
    counts = {
        protocol: len(scenarios_of_hand(hand_with_protocol("jamia", protocol), protocol, 2.0))
        for protocol in ALL_PROTOCOLS
    }
    assert sum(counts.values()) + 3 * 66 >= 250, counts


def test_quick_samples_of_consecutive_seeds_are_the_whole_campaign():
    hand = hand_with_protocol("jamia11", "mit")
    quick_samples = [
        campaign.campaign_scenarios(hand, "mit", 200.0, is_quick=True, seed=seed)
        for seed in range(campaign.QUICK_SCENARIO_STEP)
    ]
    all_scenarios = campaign.campaign_scenarios(hand, "mit", 200.0, is_quick=False)
    assert sorted(scenario.name for sample in quick_samples for scenario in sample) == sorted(
        scenario.name for scenario in all_scenarios
    )


KNOWN_FAILURES = {
    ("t42", "odrive"): {
        "N17 swap node=left_motor with=right_motor, free motion",
    }
}
"""Scenarios that fail, by hand and drive protocol, as listed in docs/evidence/campaign.md under "Known failures"."""


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("hand", ["jamia", "jamia11", "jamia_bench", "t42"])
def test_the_quick_sample_passes_with_every_seed(hand: str, seed: int):
    protocol = ALL_PROTOCOLS[seed % len(ALL_PROTOCOLS)]
    report = campaign.run_campaign(
        hand, [protocol], default_control_rate, jobs=2, is_quick=True, fault_free_s=4.0, seed=seed,
        on_progress=lambda protocol, done, total: None, on_failure=lambda simulation, result: None,
    )  # fmt: skip
    failed_checks = {
        result.scenario: result.problem for result in report.all_results if not result.ok
    }
    known_failures = KNOWN_FAILURES.get((hand, protocol), set())
    assert {name: why for name, why in failed_checks.items() if name not in known_failures} == {}
    # If a scenario in ``KNOWN_FAILURES`` passes, it must be removed from the list.
    assert (
        known_failures & {result.scenario for result in report.all_results} <= failed_checks.keys()
    )
    assert report.false_alarms == {protocol: []}


@pytest.mark.nightly
@pytest.mark.skipif(
    "HANDCTL_NIGHTLY" not in os.environ, reason="runs with HANDCTL_NIGHTLY=1 (make nightly)"
)
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
@pytest.mark.parametrize("protocol", ALL_PROTOCOLS)
def test_every_scenario_of_the_matrix_is_detected_in_time(hand: str, protocol: str):
    failed_results: list[ScenarioResult] = []
    report = campaign.run_campaign(
        hand, [protocol], default_control_rate, jobs=2, is_quick=False, fault_free_s=600.0,
        on_progress=lambda protocol, done, total: None,
        on_failure=lambda simulation, result: failed_results.append(result),
    )  # fmt: skip
    assert [
        (result.scenario, result.problem) for result in report.all_results if not result.ok
    ] == []
    assert report.false_alarms == {protocol: []}
