"""Test the verification of gains.

If the control loops of a run oscillate with new gains, the run uses the old gains again. The log
records that the run has returned to the old gains.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.cli.tuning.tune_verify import _gains_label, _print_rounds, rollback_text
from handctl.core.gains.gains import Gains, MotionGains, TensionGains
from handctl.core.tick_types import HandMode, PackedTelemetry, TelemetrySlices, TickOut
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.gains_exercise import ExerciseProgram
from handctl.replay.log_execution import execute_log
from handctl.safety.safety_action import SafetyAction
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import make_controller, run_lockstep
from handctl.session.run_plan import RunPlan, default_control_rate
from handctl.tune.gains_verification import (
    VerifyLimits,
    VerifyObserver,
    round_amplitudes,
    scores_by_round,
)
from handctl.tune.scoring import GroundTruth, digit_angles, score_ticks

GAINS_WITHOUT_RINGING = Gains(
    motion=MotionGains(force_N=12.0, disturbance_rejection=0.5), tension=TensionGains(force_N=2.7)
)
UNSTABLE_GAINS = Gains(motion=MotionGains(force_N=450.0), tension=TensionGains(force_N=300.0))


def _verify_gains(
    new_gains: Gains, log_path: Path, hand: Hand | None = None, motion_amplitude: float = 0.2
) -> VerifyObserver:
    hand = hand or load_hand("jamia")
    rate = default_control_rate(hand)
    plan = RunPlan(hand, GAINS_WITHOUT_RINGING, rate, (0.5,))
    amplitudes = (motion_amplitude, motion_amplitude)
    observer = VerifyObserver(
        hand, GAINS_WITHOUT_RINGING, new_gains, amplitudes=amplitudes, rounds_with_old_gains=1
    )
    with SimulatorSettings(hand, homed=True).lockstep_clock(plan.period_ns) as clock:
        run_lockstep(
            plan,
            make_controller(plan, ExerciseProgram(amplitudes), None, True),
            log_path,
            clock,
            observer,
        )
    return observer


@pytest.mark.parametrize(
    ("new_gains", "is_rolled_back"),
    [pytest.param(GAINS_WITHOUT_RINGING, False, marks=pytest.mark.nightly), (UNSTABLE_GAINS, True)],
)
def test_ringing_gains_are_rolled_back(
    new_gains: Gains, is_rolled_back: bool, tmp_path: Path
) -> None:
    observer = _verify_gains(new_gains, tmp_path / "run.mcap")
    assert (observer.rollback is not None) == is_rolled_back
    with RunLog(tmp_path / "run.mcap") as log:
        requests = [event for event in log.events if event.event.text == "asked: gains"]
        assert len(requests) == 1 + is_rolled_back
        assert len(scores_by_round(log, observer.hand, None, 0)) == 2
        assert execute_log(log).differing_ticks == 0
    if observer.rollback:
        assert "oscillate" in observer.rollback.why
        assert observer.rollback.k < requests[1].k <= observer.rollback.k + 2


TOUCHING_DIGIT_CASES = [("1", "40,30", "each"), ("1", "24,16", "each"), ("1", "60,40", "each")]


@pytest.mark.parametrize(
    ("finger_count", "link_lengths_mm", "tendon_choice"),
    [
        pytest.param(*words, marks=pytest.mark.nightly if i else ())
        for i, words in enumerate(TOUCHING_DIGIT_CASES)
    ],
)
def test_digits_that_meet_are_named_and_not_blamed_on_the_gains(
    tmp_path: Path, finger_count: str, link_lengths_mm: str, tendon_choice: str
) -> None:
    """Reproduce a defect: when two digits blocked each other, handctl reported only a tracking error.

    The digits met near 17 deg, and the reported tracking error was 20 deg.
    """
    hand_path = tmp_path / "mine.toml"
    words = [
        "--fingers",
        finger_count,
        "--opposed",
        "1",
        "--links",
        link_lengths_mm,
        "--tendons",
        tendon_choice,
    ]
    assert main(["config", "init", "--yes", *words, "--output", str(hand_path)]) == 0
    hand = load_hand(str(hand_path))
    observer = _verify_gains(GAINS_WITHOUT_RINGING, tmp_path / "wide.mcap", hand, 1.0)
    assert observer.rollback is None
    blocked = observer.blocked
    assert blocked is not None
    assert {blocked.digit, *blocked.by} == {"index", "thumb"}
    assert "the amplitude is too large for this hand" in str(blocked)
    with RunLog(tmp_path / "wide.mcap") as log:
        scores = scores_by_round(log, hand, None, 0)
    limit_deg = math.degrees(VerifyLimits().max_tracking_error_rad)
    assert all(score.tracking_deg < limit_deg / 4 for score in scores)
    # With the amplitude that ``tune verify`` proposes, the digits do not touch each other.
    assert 0.05 <= blocked.proposed_amplitude < 1.0
    run_with_proposed_amplitude = _verify_gains(
        GAINS_WITHOUT_RINGING, tmp_path / "free.mcap", hand, blocked.proposed_amplitude
    )
    assert run_with_proposed_amplitude.blocked is None
    assert run_with_proposed_amplitude.rollback is None


GRIPPER_FOLDER = Path(__file__).parents[1] / "hand"


@pytest.mark.parametrize(
    ("hand_file", "joint_index", "lag_rad_or_m", "expected_reason"),
    [
        ("parallel_gripper.toml", 1, 0.0034, ""),
        ("parallel_gripper.toml", 1, 0.0036, "tracking error 3.6 mm, limit 3.5"),
        ("mixed_gripper.toml", 0, 0.0036, "tracking error 3.6 mm, limit 3.5"),
        ("mixed_gripper.toml", -1, 0.34, ""),
        ("mixed_gripper.toml", -1, -0.36, "tracking error 20.6 deg, limit 20.1"),
    ],
)
def test_the_tracking_limit_holds_for_prismatic_joints(
    hand_file: str, joint_index: int, lag_rad_or_m: float, expected_reason: str
) -> None:
    """Reproduce a defect: handctl accepted every lag of a prismatic joint, however large the lag was.

    The lag of a prismatic joint is a length in metres, but handctl compared this length with 0.35
    rad.
    """
    hand = load_hand(GRIPPER_FOLDER / hand_file)
    observer = VerifyObserver(hand, GAINS_WITHOUT_RINGING, GAINS_WITHOUT_RINGING)
    telemetry_values = np.zeros(len(hand.joints) * 2 + len(hand.digit) + len(hand.tendon))
    telemetry_slices, first_element = TelemetrySlices(), 0
    for name, size in (
        ("q", len(hand.joints)), ("q_goal", len(hand.joints)), ("contact", len(hand.digit)),
        ("tension", len(hand.tendon)),
    ):  # fmt: skip
        telemetry_slices[name] = slice(first_element, first_element + size)
        first_element += size
    telemetry = PackedTelemetry(telemetry_values, telemetry_slices)
    telemetry.q_goal[joint_index] = lag_rad_or_m
    out = TickOut((), HandMode.ACTIVE, "move", SafetyAction.PASS, telemetry, (), bytes(8))
    assert observer._violated_limit(out, 0.0) == expected_reason
    telemetry.q_goal[:] = np.nan
    assert observer._violated_limit(out, 0.0) == "", "a hand that holds tensions has no goals"


@pytest.mark.parametrize(
    ("hand_file", "lag_by_joint", "tracking_deg"),
    [
        ("parallel_gripper.toml", [0.001, 0.001], math.degrees(0.1)),
        ("mixed_gripper.toml", [0.001, 0.0, 0.0], math.degrees(0.1) / math.sqrt(2.0)),
    ],
)
def test_a_lag_of_a_prismatic_joint_counts_like_an_angle(
    hand_file: str, lag_by_joint: list[float], tracking_deg: float
) -> None:
    """Reproduce a defect: the score of a run treated the lag of a prismatic joint [m] as an angle [rad].

    Because of the wrong unit, a lag of 1 mm counted as 0.06 deg. In the score, a lag of 1 mm must
    count as much as a lag of 0.1 rad.
    """
    hand = load_hand(GRIPPER_FOLDER / hand_file)
    goal = np.zeros((2, len(hand.joints)))
    reached_angles = goal - np.array(lag_by_joint)
    zeros = np.zeros((2, len(hand.tendon)))
    score = score_ticks(
        np.array([0, 1_000_000]),
        np.array(["move", "move"]),
        digit_angles(hand, goal),
        zeros,
        zeros,
        GroundTruth(digit_angles(hand, reached_angles), zeros),
    )
    assert score.tracking_deg == pytest.approx(tracking_deg)


def test_the_proposed_command_has_quoted_names(capsys: pytest.CaptureFixture[str]) -> None:
    """Reproduce a defect: in the command that handctl proposed, the shell split a file name that contained a space."""
    result = {
        "judged_by": "truth", "returned": None, "amplitudes": (), "log": "a.mcap", "picture": "a.png",
        "verified": True,
    }  # fmt: skip
    _print_rounds(result, [], argparse.Namespace(candidate=Path("new gains.toml"), hand="jamia"))
    line = capsys.readouterr().out.splitlines()[-1]
    assert line == "verified; to use them: handctl gains apply 'new gains.toml' --hand jamia"


def test_a_report_names_the_gains_of_each_round() -> None:
    amplitudes = round_amplitudes(0.4)
    labels = [_gains_label(i, None, amplitudes) for i in range(5)]
    assert labels == ["old", "old", "new", "new", "new"]
    assert [_gains_label(i, {"amplitude": amplitudes[3]}, amplitudes) for i in range(5)] == [
        "old",
        "old",
        "new",
        "new, then old",
        "old again",
    ]


def test_the_page_about_tuning_quotes_the_report() -> None:
    page = Path(__file__).parents[2] / "docs" / "how-to" / "tuning.md"
    text = " ".join(page.read_text(encoding="utf-8").split())
    rollback_reason = "motor torques oscillate by 60.9 N m/s, limit 60.0"
    quoted_text = rollback_text(
        {"t_s": 13.298, "k": 6649, "amplitude": 0.3, "why": rollback_reason}
    )
    assert f'"{quoted_text}"' in text
    amplitudes = round_amplitudes(1.0)
    later_round_labels = {
        _gains_label(i, {"amplitude": amplitudes[2]}, amplitudes) for i in range(2, 5)
    }
    assert all(f'"{label}"' in text for label in later_round_labels)
