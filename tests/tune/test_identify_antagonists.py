"""Test the identification of digits without springs.

A digit without springs has either n + 1 tendons for n joints, or pairs of tendons. The two tendons
of a pair share one motor and have no load cells.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.identify import PARAMETER_TOLERANCES, measure_digit, summarise_results
from handctl.cli.main import main
from handctl.core.identified_parameters import IdentifiedParameters, identified_hand
from handctl.core.tick_types import HandMode
from handctl.errors import DriveError
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import hand_path, load_hand
from handctl.hand.tendons import TendonElasticity
from handctl.log.read.reader import RunLog
from handctl.runtime.hold_timeout import HoldTimeout
from handctl.safety.safety_action import SafetyAction
from handctl.tune.identify.excitation import excitation_steps
from handctl.tune.identify.excitation_antagonists import (
    SPOOL_PAIR_MAX_TENSION_FRACTION,
    STRETCH_TENSION_FRACTION,
    sweep_range,
)
from handctl.tune.identify.fit_spool_pair import spool_pair_stretch, spool_pair_tension
from handctl.tune.identify.identifiability import unobservable_parameters
from handctl.tune.identify.identify import identify_tendons

SEED_RANGE = range(20)
TESTED_HANDS = ("n_plus_1", "orca_like")
MIN_COVERED_FRACTION = 0.9
"""At least this fraction of all true parameter values must lie inside the identified confidence intervals.

The expected fraction is 0.95.
"""
MIN_COVERED_FRACTION_PER_PARAMETER = 0.8
"""For each single parameter, at least this fraction of the true values must lie inside the confidence intervals.

The limit for a single parameter is lower, because a single parameter has only 40 to 70 values in
this test.
"""
COMMON_PAIR_PARAMETERS = {"motor_coulomb", "tendon_stiffness", "moment_arm"}
"""Parameters that must be identified for every tendon of a digit without springs."""


@pytest.mark.parametrize(
    ("hand_name", "digit_name", "unidentified_parameters"),
    [
        ("n_plus_1", "thumb", {"pretension", "spring_stiffness", "spring_preload"}),
        ("orca_like", "pinky", {"torque_gain", "spring_stiffness", "spring_preload"}),
    ],
)
def test_a_digit_returned_by_its_tendons_is_identified(
    tmp_path: Path, hand_name: str, digit_name: str, unidentified_parameters: set[str]
) -> None:
    row = measure_digit(1, digit_name, tmp_path, hand_name)
    hand = load_hand(hand_name)
    assert "failure" not in row
    assert row["refused"] == []
    tendons = hand.tendon_names[hand.digit_tendons[digit_name]]
    assert unobservable_parameters(hand, digit_name, tendons[0]).keys() == unidentified_parameters
    identified = [
        parameter_row for parameter_row in row["parameters"] if parameter_row["identified"]
    ]
    for name in COMMON_PAIR_PARAMETERS:
        assert {
            parameter_row["tendon"] for parameter_row in identified if parameter_row["name"] == name
        } == set(tendons)
    expected = PARAMETER_TOLERANCES.keys() - {"spring_stiffness"} - unidentified_parameters
    assert {parameter_row["name"] for parameter_row in row["parameters"]} == expected
    assert [
        parameter_row
        for parameter_row in identified
        if abs(parameter_row["error"]) > 2.0 * parameter_row["half_width"]
    ] == []


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("hand_name", TESTED_HANDS)
def test_intervals_cover_the_parameters_of_twenty_hands(tmp_path: Path, hand_name: str) -> None:
    digits = load_hand(hand_name).digit_names
    rows = [
        measure_digit(seed, digits[seed % len(digits)], tmp_path, hand_name) for seed in SEED_RANGE
    ]
    figures = summarise_results(rows)
    assert figures["failed"] == []
    assert figures["refused"] == []
    identified_rows = {
        name: row for name, row in figures["parameters"].items() if row["identified"]
    }
    covered_count_by_parameter = {name: row["covered"] for name, row in identified_rows.items()}
    identified_count_by_parameter = {
        name: row["identified"] for name, row in identified_rows.items()
    }
    assert [
        name
        for name in identified_rows
        if covered_count_by_parameter[name]
        < MIN_COVERED_FRACTION_PER_PARAMETER * identified_count_by_parameter[name]
    ] == []
    assert sum(covered_count_by_parameter.values()) >= MIN_COVERED_FRACTION * sum(
        identified_count_by_parameter.values()
    )


@pytest.mark.parametrize("hand_name", TESTED_HANDS)
def test_the_excitation_of_antagonists_keeps_within_the_limits(hand_name: str) -> None:
    hand = load_hand(hand_name)
    steps = excitation_steps(hand, hand.digit_names)
    for digit in map(DigitModel.from_hand, [hand] * len(hand.digit_names), hand.digit_names):
        digit_steps = [step for step in steps if step.digit == digit.name]
        assert sum(step.duration_s for step in digit_steps) < 35.0
        low, high = sweep_range(digit)
        lowest_angles, highest_angles = digit.coordinate_limits
        assert (lowest_angles < low).all()
        assert (low < high).all()
        assert (high < highest_angles).all()
        for step in digit_steps:
            if step.kind == "move":
                assert (np.array(step.targets) >= low - 1e-9).all()
                assert (np.array(step.targets) <= high + 1e-9).all()
            if step.kind == "tension":
                max_tensions = np.array(
                    [tendon.tension_max_N for tendon in hand.tendon[digit.tendons]]
                )
                is_pair = bool(hand.is_pair[digit.tendons].any())
                largest_tension = (
                    SPOOL_PAIR_MAX_TENSION_FRACTION if is_pair else STRETCH_TENSION_FRACTION
                ) * max_tensions
                assert (np.abs(step.targets) <= largest_tension + 1e-9).all()
                floor = np.array([tendon.tension_floor_N for tendon in hand.tendon[digit.tendons]])
                assert is_pair or (np.array(step.targets) >= floor).all()


def test_a_stretched_tendon_does_not_lift_its_digit_off_the_stops() -> None:
    """While the identification stretches a tendon, the net torque at each joint of the digit opens the joint."""
    hand = load_hand("n_plus_1")
    for step in excitation_steps(hand, hand.digit_names):
        if step.name == "stretch":
            digit = DigitModel.from_hand(hand, step.digit)
            assert (digit.reduced_moment_arms.T @ np.array(step.targets) < 0.0).all()


@pytest.mark.parametrize("passes_wrist", [0.8, 1.0, 1.25])
def test_both_tendons_of_a_pair_balance_its_joint(passes_wrist: float) -> None:
    """Two antagonistic tendons share one motor in this test.

    At the joint, friction lowers the tension of one tendon and raises the tension of the other
    tendon. The difference between the two tensions turns the joint.
    """
    net_tensions = np.linspace(-40.0, 40.0, 81)
    spool = spool_pair_tension(net_tensions, 10.0, np.full(81, passes_wrist))
    first_tension, second_tension = (
        np.maximum(np.maximum(10.0 + 0.5 * side * spool, side * spool), 0.0) for side in (1.0, -1.0)
    )
    np.testing.assert_allclose(
        first_tension * passes_wrist - second_tension / passes_wrist, net_tensions, atol=1e-9
    )


@pytest.mark.parametrize("knee_N", [200.0, 14.0, 6.0])
@pytest.mark.parametrize("factor", [0.8, 1.0, 1.3])
def test_the_stretch_of_a_pair_makes_its_net_tension(knee_N: float, factor: float) -> None:
    """Test that the net tension of a spool pair is the difference between the tensions of its two stretched tendons.

    The pretension stretches both tendons by s. If the pair is stretched by x, the tendons are
    stretched by s + x and s - x.

    If the stiffness is multiplied by a factor, all stretches are divided by this factor.
    """
    elasticity = TendonElasticity(5e4, 1.5 * 5e4, knee_N, 1e-4, 20.0)
    net_tensions = np.linspace(-50.0, 50.0, 101)
    stretch = factor * spool_pair_stretch(net_tensions, factor * 5e4, 10.0, elasticity)
    rest_stretch = elasticity.stretch(10.0)
    tensions = [
        [elasticity.elastic_tension(rest_stretch + side * x) for x in stretch.tolist()]
        for side in (1.0, -1.0)
    ]
    np.testing.assert_allclose(
        np.subtract(*tensions), net_tensions, atol=1e-9 if knee_N > 100.0 else 0.1
    )


def test_the_stiffness_of_a_tendon_is_that_below_its_knee(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect: the fit ignored the knee of a stiffness curve.

    In the hand file, the stiffness of a tendon changes at a certain tension (the knee). With the
    knee at 8 N, the fit computed a tendon stiffness that was 18 % too large.
    """
    monkeypatch.chdir(tmp_path)
    text = hand_path("n_plus_1").read_text()
    for line, new_line in (
        ("knee_N = 200.0", "knee_N = 8.0"),
        ("stiffness_beyond_ratio = 0.4", "stiffness_beyond_ratio = 1.4"),
        ("knee_width_m = 0.3e-3", "knee_width_m = 0.1e-3"),
    ):
        assert line in text
        text = text.replace(line, new_line)
    Path("knee.toml").write_text(text)
    words = ["identify", "--lockstep", "--hand", "knee.toml", "--digits", "thumb"]
    assert main([*words, "--log", "run.mcap"]) == 0
    hand = load_hand("knee.toml")
    with RunLog(Path("run.mcap")) as log:
        results = identify_tendons(log, hand)
    for name, result in results.items():
        stiffness = hand.tendon[hand.tendon_names.index(name)].stiffness_N_per_m
        error = result.fit.parameter_values["tendon_stiffness"] - stiffness
        assert abs(error) < 2.0 * result.fit.half_widths["tendon_stiffness"], name
        assert abs(error) < 0.08 * stiffness, name


def test_a_fault_that_holds_the_hand_ends_the_run() -> None:
    """Reproduce a defect.

    While a fault holds the hand, the identification makes no progress. The run had no time limit,
    so a run in which a fault held the hand never ended.
    """
    limit = HoldTimeout()

    def requests_between(action: SafetyAction, begin_s: float, end_s: float) -> list[str]:
        requests = []
        for t in np.arange(begin_s, end_s, 0.1):
            event = SimpleNamespace(name="fault", text="N07 a noisy encoder: HOLD")
            out = SimpleNamespace(mode=HandMode.ACTIVE, action=action, events=(event,))
            limit.on_tick(SimpleNamespace(t_ns=round(1e9 * t)), out)  # type: ignore[arg-type]
            requests += limit.poll_requests()
        return requests

    assert requests_between(SafetyAction.HOLD, 0.0, 4.0) == []
    assert requests_between(SafetyAction.WARN, 4.0, 9.0) == []
    limit.raise_if_stopped("a run")
    assert requests_between(SafetyAction.HOLD, 9.0, 20.0) == ['{"do": "stop"}']
    with pytest.raises(DriveError, match=r"held for 5 s by N07 a noisy encoder.*tune design"):
        limit.raise_if_stopped("a run")


def test_identified_moment_arms_and_pretensions_are_those_of_the_controller() -> None:
    hand = load_hand("orca_like")
    known_parameters = IdentifiedParameters(
        names=("moment_arm", "pretension"),
        values=(1.1, 8.0),
        half_widths=(0.01, 0.5),
        covariance=((1e-4, 0.0), (0.0, 0.1)),
    )
    controller_hand = identified_hand(hand, {"index_mcp": known_parameters})
    tendon_index = hand.tendon_names.index("index_mcp")
    np.testing.assert_allclose(
        controller_hand.moment_arms[tendon_index], 1.1 * hand.moment_arms[tendon_index]
    )
    assert controller_hand.tendon[tendon_index].pretension_N == 8.0
    is_other_tendon = np.arange(len(hand.tendon)) != tendon_index
    np.testing.assert_array_equal(
        controller_hand.moment_arms[is_other_tendon], hand.moment_arms[is_other_tendon]
    )
