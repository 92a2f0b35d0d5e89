"""Test the goals of each digit in each stage of the exercise program."""

import pytest

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.gains.gains import packaged_gains
from handctl.core.hand_model import HandModel
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.programs.gains_exercise import (
    FULL_MOVE_RAD,
    GENTLE_TENSION_RATE_N_PER_S,
    HOME_ANGLE_RAD,
    ExerciseProgram,
    _coordinate_scales,
)
from handctl.tune.scoring import score_exercise
from tests.controller.synthetic_states import empty_readings, estimate_under_tension
from tests.hand.hand_on_wrist import mount_on_wrist
from tests.hand.link_contacts import LinkContacts

FULL_EXERCISE = ExerciseProgram()
StageRecord = tuple[str, tuple[DigitGoal, ...], tuple[bool, ...]]
"""Name of a stage, the goals of all digits, and flags of the digits that rest on a stop or on an object."""


def exercise_stages(
    model: HandModel, program: ExerciseProgram = FULL_EXERCISE
) -> list[StageRecord]:
    """Return the stages of an exercise program in the order of execution.

    The function runs the exercise program with the estimate of a hand that is at rest and has taut
    tendons.
    """
    t = 0.0
    progress = program.initial_progress(model)
    taut, readings = estimate_under_tension(model, 5.0), empty_readings(model)
    records: list[StageRecord] = []
    while not progress.finished:
        t += model.period
        progress_before = progress
        progress, _ = program.advance(model, progress, taut, readings, t)
        if (
            progress.phase not in ("start", "tighten", "end")
            and progress.since != progress_before.since
        ):
            records.append((progress.phase, progress.goals, progress.contact))
    return records


@pytest.mark.parametrize("hand_name", ["jamia", "jamia11", "orca_like"])
def test_a_wrist_keeps_its_angle_while_the_other_digits_exercise(hand_name: str) -> None:
    """Reproduce a defect: the exercise moved the wrist fast, and then pulled its tendon with a constant tension.

    The heavy wrist moved by 9 deg in 0.1 s. The fast motion of the wrist ended the step test of
    `tune design` with the fault T01 (a tendon snapped).
    """
    hand = load_hand(hand_name) if hand_name == "orca_like" else mount_on_wrist(hand_name)
    model = HandModel.from_hand(hand, packaged_gains(hand_name), 400.0)
    records = exercise_stages(model)
    wrist = model.hand.digit_names.index("wrist")
    assert {"settle", "move", "close", "hold"} == {stage for stage, _, _ in records}
    assert len(records) >= 8
    first_goals = records[0][1]
    assert first_goals[wrist].kind == GoalKind.MOTION
    for stage, goals, contact in records:
        assert goals[wrist] is first_goals[wrist], stage
        assert not contact[wrist], stage
        kind = GoalKind.TENSION if stage in ("close", "hold") else GoalKind.MOTION
        for d in range(len(goals)):
            if d != wrist:
                assert goals[d].kind == kind, stage
                assert contact[d] == (stage == "hold"), stage


@pytest.mark.parametrize("hand_name", ["orca_like", "n_plus_1", "jamia"])
def test_only_digits_without_springs_close_with_a_slow_rise(hand_name: str) -> None:
    """Reproduce a defect: the tension of closed digits without springs rose to 30 N at 200 N/s.

    When the tension rose, a digit that friction had stopped early closed so fast that the fault T01
    (a tendon snapped) ended the run. During a hold of the exercise program, tensions change at the
    default rate of change.
    """
    model = HandModel.from_hand(load_hand(hand_name), packaged_gains(hand_name), 400.0)
    default_rate = model.gains.tension.rate_N_per_s
    moving = [d for d, digit in enumerate(model.hand.digit_names) if digit != "wrist"]
    rates = [
        (stage, {goals[d].rate for d in moving})
        for stage, goals, _ in exercise_stages(model)
        if stage in ("close", "hold")
    ]
    stage_before_hold = rates[[stage for stage, _ in rates].index("hold") - 1]
    assert stage_before_hold == (
        "close",
        {default_rate if hand_name == "jamia" else GENTLE_TENSION_RATE_N_PER_S},
    )
    assert all(
        rates_of_stage == {default_rate} for stage, rates_of_stage in rates if stage == "hold"
    )


def test_fingers_that_would_touch_each_other_exercise_in_turns() -> None:
    """Reproduce a defect: both fingers of the hand t42 closed at once, and blocked each other at 6 deg.

    `tune verify` therefore always failed, and `tune search` had no tracking error to compare.
    """
    hand = load_hand("t42")
    program = ExerciseProgram.for_hand(hand)
    assert program.turns == (("left",), ("right",))
    model = HandModel.from_hand(hand, packaged_gains("t42"), 500.0)
    score = score_exercise(hand, model, {}, 0)
    assert not score.failure
    assert not score.blocked
    moved_digits = [
        {
            name
            for name, goal in zip(hand.digit_names, goals, strict=True)
            if goal.kind == GoalKind.MOTION
        }
        for stage, goals, _ in exercise_stages(model, program)
        if stage == "move"
    ]
    assert moved_digits == [{"left"}] * 4 + [{"right"}] * 4


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_digits_of_a_hand_exercise_without_a_contact(hand_name: str) -> None:
    """In the moves of the exercise, the links of different digits do not touch in MuJoCo's model of the hand."""
    hand = load_hand(hand_name)
    program = ExerciseProgram.for_hand(hand)
    contacts = LinkContacts(hand)
    angle = HOME_ANGLE_RAD + program.amplitudes[0] * FULL_MOVE_RAD
    all_digits = tuple(name for name in hand.digit_names if name not in hand.carrier_digits)
    for turn in program.turns or (all_digits,):
        q = contacts.open_angles.copy()
        for name in turn:
            digit = DigitModel.from_hand(hand, name)
            q[digit.joints] = digit.coupling @ (angle * _coordinate_scales(digit))
        assert contacts.new_contacts(q) == set(), turn
