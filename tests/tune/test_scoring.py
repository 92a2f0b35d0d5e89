"""Test the scores of gains.

The gains are scored with a simulated hand that differs from its hand file.

Even with very bad gains, the scored motion is simulated to its end.
"""

import json
from pathlib import Path

import pytest

from benchmarks.tuning import TRUE_PLANT_FACTORS, detuned_gains
from handctl.cli.main import main
from handctl.core.gains.gains import Gains, packaged_gains
from handctl.core.hand_model import HandModel
from handctl.hand.hand_loading import load_hand
from handctl.programs.gains_exercise import ExerciseProgram
from handctl.tune.loops.step_tests import StepExercise
from handctl.tune.scoring import (
    MAX_HELD_S,
    evaluate_job,
    score_exercise,
    score_run,
    simulate_program,
)
from handctl.tune.search.ensemble import sample_ensemble


@pytest.mark.parametrize("seed", [1000, 1002])
def test_motor_short_of_its_goal_is_no_stuck_encoder(seed: int) -> None:
    """Reproduce a defect: the controller reported the fault N04 (an encoder is stuck) although no encoder was stuck.

    A motor had stopped 0.4 mm before its travel goal, while the filtered goal continued to move.
    Because the goal moved without the motor, the controller reported N04 after 2.5 s.
    """
    hand = load_hand("jamia")
    score = score_exercise(
        hand, HandModel.from_hand(hand, detuned_gains(), 500.0), TRUE_PLANT_FACTORS, seed
    )
    assert score.failure == ""
    assert 1.0 < score.tracking_deg < 3.0, "the detuned gains track badly, without a fault"


@pytest.mark.parametrize("hand", ["jamia", "t42"])
def test_a_trial_may_cross_a_process_boundary(hand: str) -> None:
    """Reproduce a defect: every trial of `tune search --jobs 2` failed, because JSON converts tuples to lists."""
    job = {
        "hand": load_hand(hand).to_toml(),
        "rate_hz": 500.0,
        "gains": packaged_gains(hand).model_dump(by_alias=True),
        "plants": list(sample_ensemble(1, 0)),
        "seed": 1,
    }
    assert evaluate_job(json.loads(json.dumps(job))) == evaluate_job(job)


@pytest.mark.parametrize(
    ("link_lengths_mm", "seed"),
    [
        ("40,30", 1),
        pytest.param("40,30", 2, marks=pytest.mark.nightly),
        pytest.param("24,16", 1, marks=pytest.mark.nightly),
        pytest.param("60,40", 3, marks=pytest.mark.nightly),
    ],
)
def test_digits_that_touch_each_other_are_not_scored(
    tmp_path: Path, link_lengths_mm: str, seed: int
) -> None:
    """Reproduce a defect: when two digits blocked each other, the scoring reported only a tracking error.

    The tracking error of the blocked digits was 6 to 8 deg. With the exercise for this hand, the
    digits do not touch each other.
    """
    file = tmp_path / "mine.toml"
    words = ["--fingers", "1", "--opposed", "1", "--links", link_lengths_mm, "--tendons", "each"]
    assert main(["config", "init", "--yes", *words, "--output", str(file)]) == 0
    hand = load_hand(str(file))
    model = HandModel.from_hand(hand, Gains(), 400.0)
    assert score_exercise(hand, model, {}, seed).blocked == ""
    score = score_run(hand, *simulate_program(hand, model, ExerciseProgram(), {}, seed))
    assert score.failure == ""
    assert score.blocked == "index, thumb"
    assert score.tracking_deg < 2.0
    assert score.tension_N < 5.0


def test_digits_that_move_freely_are_all_scored() -> None:
    hand = load_hand("jamia")
    score = score_exercise(hand, HandModel.from_hand(hand, packaged_gains("jamia"), 500.0), {}, 1)
    assert score.blocked == ""


def test_a_run_that_faults_hold_ends_early() -> None:
    """Reproduce a defect: a run never ended.

    A fault held the simulated hand, and the time of a program does not advance during a hold.
    """
    hand = load_hand(Path(__file__).parents[1] / "hand" / "pairs_and_springs.toml")
    model = HandModel.from_hand(hand, Gains.model_validate({"motion": {"force_N": 5.0}}), 500.0)
    ticks, _, failure = simulate_program(hand, model, StepExercise(), {}, seed=0)
    assert failure.startswith(f"held for {MAX_HELD_S:g} s by N07")
    assert len(ticks) < 10.0 / model.period
