"""Test that handctl refuses a task if one of its moves turns a rotor too fast.

A sudden stop of a rotor that turns too fast would tear its tendon.
"""

from typing import Any

import pytest

from handctl.errors import ConfigError
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import Task
from handctl.programs.task_checks import check_speed

JAMIA11 = load_hand("jamia11")


def move_phase(angle_deg: object, duration_s: float) -> dict[str, Any]:
    return {"kind": "move", "angle_deg": angle_deg, "duration_s": duration_s}


def task_of_phases(*phase_fields: dict[str, Any]) -> Task:
    return Task.model_validate({"schema": 1, "name": "t", "phase": phase_fields})


CLOSE_PHASE = {"kind": "close", "angle_deg": 80.0}
FOLLOW_PHASE = {"kind": "follow", "time_s": (0.0, 1.0), "angle_deg": {"index": (0.0, 60.0)}}


@pytest.mark.parametrize(
    ("phase_list", "expected_message"),
    [
        ((move_phase(70.0, 0.1),),
         r"t: phase\[0\]\.duration_s: 0\.1; expected at least 0\.19 s: index may have 70 deg"),
        ((move_phase({"thumb": -30.0}, 0.08),), "thumb may have 30 deg"),
        ((move_phase({"index": (0.0, 10.0, 60.0)}, 1.0), move_phase({"index": (0.0, 10.0, 0.0)}, 0.16)),
         "index may have 60 deg"),
        ((CLOSE_PHASE, move_phase(0.0, 0.2)), r"phase\[1\].*at least 0\.22 s: index may have 80 deg"),
        ((FOLLOW_PHASE, move_phase(0.0, 0.1)), "index may have 60 deg"),
        ((move_phase({"index_j2": 70.0}, 0.1),), "index may have 70 deg"),
        ((move_phase({"index_j2": 70.0}, 1.0), move_phase({"index_j1": 10.0}, 1.0), move_phase(0.0, 0.1)),
         "index may have 70 deg"),
    ],
    ids=["from rest", "backwards", "by joint", "from somewhere in a close", "after a curve",
         "of one joint", "of a joint that stayed"],
)  # fmt: skip
def test_a_move_without_time_is_refused(
    phase_list: tuple[dict[str, Any], ...], expected_message: str
) -> None:
    with pytest.raises(ConfigError, match=expected_message):
        check_speed(task_of_phases(*phase_list), DigitModel.digit_models_of_hand(JAMIA11), "t")


def test_the_time_that_is_named_is_enough() -> None:
    short_moves = (
        {"kind": "release"},
        move_phase(60.0, 0.05),
        CLOSE_PHASE | {"angle_deg": 70.0},
        move_phase(65.0, 0.05),
    )
    check_speed(
        task_of_phases(move_phase(70.0, 0.19), move_phase(70.0, 0.05), *short_moves),
        DigitModel.digit_models_of_hand(JAMIA11),
        "t",
    )


def test_the_speed_of_a_close_phase_is_limited() -> None:
    with pytest.raises(ValueError, match="less than or equal to 700"):
        task_of_phases(CLOSE_PHASE | {"speed_deg_s": 701.0})
