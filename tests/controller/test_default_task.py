"""Test the default task of a hand.

The default task opens the hand, closes the hand, holds an object, and releases the object. The
default task works with any number and kind of digits.
"""

from pathlib import Path

import numpy as np
import pytest

from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand, packaged_hands
from handctl.hand.readiness_checks import displayed_range
from handctl.programs.default_task import default_scene, default_task, grasp_warnings
from handctl.programs.task import ClosePhase, HoldPhase, load_task
from handctl.programs.task_checks import check_task_for_hand
from handctl.session.task_loading import load_task_for_hand
from tests.hand.random_chains import RANDOM_CHAIN_SEEDS, build_random_hand_tree


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_default_task_suits_every_hand_and_reads_back_from_text(
    hand_name: str, tmp_path: Path
) -> None:
    hand = load_hand(hand_name)
    task, text = default_task(hand)
    check_task_for_hand(task, hand, "default task")
    (tmp_path / "task.toml").write_text(text)
    assert load_task(tmp_path / "task.toml") == task
    assert [phase.kind for phase in task.phase] == ["move", "close", "hold", "release", "move"]
    for digit in (
        digit_of_hand
        for digit_of_hand in hand.digit
        if digit_of_hand.name not in hand.carrier_digits
    ):
        _, high = displayed_range(digit)
        close, hold = task.phase[1], task.phase[2]
        assert isinstance(close, ClosePhase)
        assert isinstance(hold, HoldPhase)
        assert isinstance(close.angle_deg, dict)
        assert isinstance(hold.tension_N, dict)
        angle = np.array(close.angle_deg[digit.name])
        is_sideways = DigitModel.from_hand(hand, digit.name).sideways_coordinates
        assert (is_sideways | ((angle > 0.5 * np.minimum(high, 120.0)) & (angle < high))).all()
        assert (angle[is_sideways] == 0.0).all()
        limits = [tendon.tension_max_N for tendon in hand.tendon[hand.digit_tendons[digit.name]]]
        assert (np.array(hold.tension_N[digit.name]) <= 0.7 * np.array(limits) + 0.1).all()


def test_the_default_task_keeps_spreading_joints_centred_and_extensors_taut() -> None:
    content = hand_content("jamia11")
    thumb = content["digit"][3]
    thumb["joint_min_deg"], thumb["joint_max_deg"] = [-20.0, 0.0], [20.0, 100.0]
    motor = {**content["motor"][-1], "name": "thumb_m3", "node_id": 12}
    arms = {"thumb_j1": -0.003, "thumb_j2": -0.003}
    content["motor"].append(motor)
    content["tendon"].append(
        {**content["tendon"][-1], "name": "thumb_ext", "motor": "thumb_m3", "moment_arm_m": arms}
    )
    task, _ = default_task(hand_from_content(content, "an extensor"))
    close, hold = task.phase[1], task.phase[2]
    assert isinstance(close, ClosePhase)
    assert isinstance(hold, HoldPhase)
    assert isinstance(close.angle_deg, dict)
    assert isinstance(hold.tension_N, dict)
    assert close.angle_deg["thumb"] == (0.0, 85.0)
    assert hold.tension_N["thumb"] == (66.0, 66.0, 4.5)
    assert hold.tension_N["index"] == (22.0, 22.0, 22.0)


def test_without_a_name_a_jamia_takes_its_grasp_and_another_hand_the_default() -> None:
    assert load_task_for_hand(None, load_hand("jamia"))[0].name == "power grasp"
    task, text = load_task_for_hand(None, load_hand("t42"))
    assert task.name == "close, hold, open"
    assert b"t42" in text


def test_a_digit_that_carries_others_keeps_its_angle() -> None:
    for seed in RANDOM_CHAIN_SEEDS:
        hand = build_random_hand_tree(seed)
        task, _ = default_task(hand)
        _, close, hold, _, opened = task.phase
        closing_digits = set(hand.digit_names) - hand.carrier_digits
        assert set(close.angle_deg) == set(hold.tension_N) == closing_digits  # type: ignore[union-attr, arg-type]
        assert set(opened.angle_deg) == set(hand.digit_names)  # type: ignore[union-attr, arg-type]


def hand_with_fingers_on_circle() -> Hand:
    """Return a hand with three equal fingers of jamia around a circle, and without a thumb."""
    content = hand_content("jamia")
    for section in ("digit", "tendon", "motor"):
        content[section] = content[section][:3]
    content["sensor_node"]["tendons"] = content["sensor_node"]["tendons"][:3]
    for number, digit in enumerate(content["digit"]):
        angle = 2.0 * np.pi * number / 3.0
        digit["mount_position_m"] = [0.0, 0.04 * np.cos(angle), 0.04 * np.sin(angle)]
        digit["mount_rpy_deg"] = [180.0 + np.degrees(angle) - 360.0 * (number > 1), 0.0, 0.0]
    return hand_from_content(content, "around a circle")


def test_fingers_around_a_circle_press_alike_and_take_a_ball() -> None:
    hand = hand_with_fingers_on_circle()
    hold = default_task(hand)[0].phase[2]
    assert isinstance(hold, HoldPhase)
    assert isinstance(hold.tension_N, dict)
    assert len(set(hold.tension_N.values())) == 1
    assert grasp_warnings(hand) == ()
    assert default_scene(hand) == "sphere:41"


def test_a_hand_with_digits_on_one_side_gets_a_warning_that_it_lifts_nothing() -> None:
    content = hand_content("t42")
    content["digit"][1]["mount_rpy_deg"] = [180.0, 0.0, 0.0]
    assert (
        "no digit closes against another"
        in grasp_warnings(hand_from_content(content, "one-sided"))[0]
    )


def test_a_hand_that_holds_with_its_palm_takes_the_small_cylinder() -> None:
    hand = load_hand("orca_like")
    assert default_scene(hand) == "cylinder"
    hold = default_task(hand)[0].phase[2]
    assert isinstance(hold, HoldPhase)
    assert isinstance(hold.tension_N, dict)
    assert hold.tension_N["thumb"] > hold.tension_N["index"]
