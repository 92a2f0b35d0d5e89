"""Test tasks whose angles are outside the ranges of the joints."""

import json
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.errors import ConfigError
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.programs.task import Task
from handctl.programs.task_checks import check_joint_range, check_tip_force

JAMIA, JAMIA11 = load_hand("jamia"), load_hand("jamia11")


def task_with_phase(phase_kind: str, angle_deg: object, **other_fields: object) -> Task:
    phase = {"kind": phase_kind, "angle_deg": angle_deg, **other_fields}
    return Task.model_validate_json(json.dumps({"schema": 1, "name": "t", "phase": [phase]}))


@pytest.mark.parametrize(
    ("hand", "phase_kind", "angle_deg", "expected_message"),
    [
        (JAMIA, "move", 100.5, "100.5 deg for index; expected 0 to 100 deg"),
        (JAMIA, "move", {"thumb": -1.0}, "-1 deg for thumb; expected 0 to 100 deg"),
        (JAMIA, "close", 101.0, "101 deg for index; expected 0 to 100 deg"),
        (JAMIA11, "move", {"ring": (10.0, 20.0, 120.0)}, "120 deg for ring; expected 0 to 100 deg"),
    ],
)
def test_angle_beyond_the_joint_range_is_refused(hand, phase_kind, angle_deg, expected_message):
    with pytest.raises(ConfigError) as refused:
        check_joint_range(
            task_with_phase(phase_kind, angle_deg),
            hand,
            "t.toml",
            DigitModel.digit_models_of_hand(hand),
        )
    assert str(refused.value) == f"t.toml: phase[0].angle_deg: {expected_message}"


def test_curve_point_beyond_the_joint_range_is_refused():
    curve = {"index": (0.0, 50.0, 100.1)}
    with pytest.raises(ConfigError, match=r"100\.1 deg for index"):
        check_joint_range(
            task_with_phase("follow", curve, time_s=(0.0, 1.0, 2.0)),
            JAMIA,
            "t.toml",
            DigitModel.digit_models_of_hand(JAMIA),
        )


@pytest.mark.parametrize("angle_deg", [0.0, 100.0, {"index": 50.0}, {"thumb": 100.0}])
def test_the_ends_of_the_range_are_within_it(angle_deg):
    check_joint_range(
        task_with_phase("move", angle_deg), JAMIA, "t.toml", DigitModel.digit_models_of_hand(JAMIA)
    )
    check_joint_range(
        task_with_phase("close", angle_deg),
        JAMIA11,
        "t.toml",
        DigitModel.digit_models_of_hand(JAMIA11),
    )


def test_reach_is_that_of_the_mean_angle_where_one_tendon_moves_three_joints():
    low, high = DigitModel.from_hand(JAMIA, "index").coordinate_limits
    assert np.degrees(low) == pytest.approx([0.0], abs=1e-9)
    assert np.degrees(high) == pytest.approx([100.0])
    assert DigitModel.from_hand(JAMIA11, "index").coordinate_limits[1].shape == (3,)


def test_a_run_is_refused_before_its_bus_is_opened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "far.toml"
    path.write_text('schema = 1\nname = "far"\n[[phase]]\nkind = "move"\nangle_deg = 120.0\n')
    assert main(["run", "--bus", "local:nobody", "--task", str(path)]) == 2
    assert capsys.readouterr().err.endswith(
        "phase[0].angle_deg: 120 deg for index; expected 0 to 100 deg\n"
    )


def hold_task(force_N: object) -> Task:
    phase = {"kind": "hold", "tip_force_N": force_N}
    return Task.model_validate_json(json.dumps({"schema": 1, "name": "t", "phase": [phase]}))


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_only_a_digit_with_a_tendon_for_each_joint_takes_a_tip_force(hand_name):
    hand = load_hand(hand_name)
    for digit in hand.digit_names:
        tendons, joints = hand.digit_tendons[digit], hand.digit_joints[digit]
        if tendons.stop - tendons.start < joints.stop - joints.start:
            expected_message = (
                rf"t\.toml: phase\[0\]\.tip_force_N: {digit} has 1 tendon for "
                rf".*expected tension_N for {digit}"
            )
            with pytest.raises(ConfigError, match=expected_message):
                check_tip_force(hold_task({digit: 4.0}), hand, "t.toml")
        else:
            check_tip_force(hold_task({digit: 4.0}), hand, "t.toml")


def test_a_tip_force_for_all_digits_names_the_first_that_cannot_make_it():
    check_tip_force(hold_task(4.0), JAMIA11, "t.toml")
    with pytest.raises(ConfigError, match="index has 1 tendon for 3 joints"):
        check_tip_force(hold_task(4.0), JAMIA, "t.toml")


def test_a_tip_force_is_refused_before_the_bus_is_opened(tmp_path, capsys):
    """The command in this test names a bus that does not exist.

    If the command opened the bus before it checked the task, the error message would name the bus.
    """
    path = tmp_path / "tip.toml"
    path.write_text(
        'schema = 1\nname = "t"\n[[phase]]\nkind = "close"\n[[phase]]\nkind = "hold"\ntip_force_N = 4.0\n'
    )
    for words in (
        ["config", "check", "--task", str(path)],
        ["run", "--bus", "local:nobody", "--task", str(path)],
    ):
        assert main([*words, "--hand", "jamia"]) == 2
        error_lines = capsys.readouterr().err.splitlines()
        assert len(error_lines) == 1
        assert "phase[1].tip_force_N: index has 1 tendon for 3 joints" in error_lines[0]
