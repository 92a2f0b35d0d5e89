"""Test task files.

Each packaged task is valid for all packaged hands that have the necessary digits and tendons. The
error line for a wrong task file names the wrong key.
"""

from pathlib import Path

import pytest

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand, packaged_hands
from handctl.programs.program import TARE_PHASE
from handctl.programs.task import (
    ClosePhase,
    DigitShape,
    HoldPhase,
    MovePhase,
    ReleasePhase,
    check_task,
    load_task,
    shapes_of_digits,
    value_for_digit,
)
from handctl.programs.task_checks import check_task_for_hand

VALID_TASK = """schema = 1
name = "t"
[[phase]]
kind = "move"
angle_deg = 10.0
[[phase]]
kind = "hold"
tension_N = { index = 20.0 }
"""


@pytest.fixture
def refusal(tmp_path: Path):  # type: ignore[no-untyped-def]
    """Return a function that writes a wrong task text to a file, loads the file, and returns the error line."""

    def refuse(
        text: str, digits: tuple[str, ...] = ("index", "thumb"), ceiling: float = 110.0
    ) -> str:
        path = tmp_path / "t.toml"
        path.write_text(text)
        with pytest.raises(ConfigError) as caught:
            check_task(load_task(path), digits, ceiling, str(path))
        line = str(caught.value)
        assert "\n" not in line
        assert line.startswith(str(path))
        return line

    return refuse


JAMIA_DIGITS = ("index", "middle", "ring", "thumb")


def test_packaged_tasks_suit_every_packaged_hand_that_can_follow_them() -> None:
    """Check the packaged tasks with every packaged hand whose digits have the names that the tasks contain.

    A task with targets for single joints needs a hand that has a tendon at each joint.
    """
    import handctl

    paths = {path.stem: path for path in (Path(handctl.__file__).parent / "tasks").glob("*.toml")}
    assert paths.keys() >= {"grasp", "pinch", "hook", "pinch-joints"}
    for stem, path in paths.items():
        task = load_task(path)
        for name in packaged_hands():
            hand = load_hand(name)
            if hand.digit_names != JAMIA_DIGITS:
                continue
            if stem.endswith("-joints") and {
                shape.tendons for shape in shapes_of_digits(hand).values()
            } == {1}:
                continue
            ceiling = min(tendon.tension_max_N for tendon in hand.tendon)
            check_task(task, hand.digit_names, ceiling, path.name, shapes_of_digits(hand))


def test_a_list_has_one_number_for_each_coordinate_of_the_digit(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(
        VALID_TASK.replace(
            "angle_deg = 10.0", "angle_deg = { index = [10.0, 5.0, 5.0], thumb = 3.0 }"
        )
    )
    task = load_task(path)
    check_task(
        task, ("index", "thumb"), 110.0, "t", {"index": DigitShape(3, 3), "thumb": DigitShape(2, 2)}
    )
    with pytest.raises(
        ConfigError, match=r"t: phase\[0\]\.angle_deg.*3 numbers for index.*one coordinate"
    ):
        check_task(
            task,
            ("index", "thumb"),
            110.0,
            "t",
            {"index": ONE_JOINT_DIGIT, "thumb": ONE_JOINT_DIGIT},
        )
    tension_task = load_task(
        _write_task_file(
            tmp_path, VALID_TASK.replace("{ index = 20.0 }", "{ index = [20.0, 120.0] }")
        )
    )
    with pytest.raises(ConfigError, match="120 N"):
        check_task(
            tension_task,
            ("index", "thumb"),
            110.0,
            "t",
            {"index": DigitShape(2, 2), "thumb": ONE_JOINT_DIGIT},
        )


def test_a_digit_with_a_tendon_more_than_joints_takes_an_angle_per_joint(tmp_path: Path) -> None:
    """For a digit with n joints and n + 1 tendons, a task gives n angles and n + 1 tensions."""
    hand = hand_with_an_extensor()
    assert shapes_of_digits(hand)["thumb"] == DigitShape(2, 3, ("thumb_j1", "thumb_j2"))
    for angles, tensions, expected_error in (
        ("[10.0, 20.0]", "[20.0, 20.0, 9.0]", ""),
        (
            "[10.0, 20.0, 5.0]",
            "[20.0, 20.0, 9.0]",
            r"phase\[0\]\.angle_deg: 3 numbers.*or 2: it has 2 coordinates",
        ),
        (
            "[10.0, 20.0]",
            "[20.0, 20.0]",
            r"phase\[1\]\.tension_N: 2 numbers.*or 3: it has 3 tendons",
        ),
    ):
        text = VALID_TASK.replace("angle_deg = 10.0", f"angle_deg = {{ thumb = {angles} }}")
        task = load_task(
            _write_task_file(
                tmp_path, text.replace("{ index = 20.0 }", f"{{ thumb = {tensions} }}")
            )
        )
        if not expected_error:
            check_task_for_hand(task, hand, "t")
            continue
        with pytest.raises(ConfigError, match=expected_error):
            check_task_for_hand(task, hand, "t")


def hand_with_an_extensor() -> Hand:
    """Return the hand jamia11 with a third tendon in its thumb.

    The third tendon of the thumb opens both joints of the thumb.
    """
    content = hand_content("jamia11")
    motor = {
        **content["motor"][-1],
        "name": "thumb_ext_motor",
        "node_id": content["motor"][-1]["node_id"] + 1,
    }
    arms = {"thumb_j1": -0.003, "thumb_j2": -0.003}
    tendon = {
        **content["tendon"][-1],
        "name": "thumb_ext",
        "motor": motor["name"],
        "moment_arm_m": arms,
    }
    content["motor"].append(motor)
    content["tendon"].append(tendon)
    content["sensor_node"]["tendons"].append("thumb_ext")
    return hand_from_content(content, "with an extensor")


ONE_JOINT_DIGIT = DigitShape(1, 1)


def _write_task_file(folder: Path, task_text: str) -> Path:
    (folder / "written.toml").write_text(task_text)
    return folder / "written.toml"


def test_phases_have_the_type_of_their_kind(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(VALID_TASK + '[[phase]]\nkind = "close"\n[[phase]]\nkind = "release"\n')
    assert [type(phase) for phase in load_task(path).phase] == [
        MovePhase,
        HoldPhase,
        ClosePhase,
        ReleasePhase,
    ]


@pytest.mark.parametrize(
    ("text_replacement", "key_path", "expected_message"),
    [
        (("schema = 1", "schema = 2"), "schema", "1"),
        (('kind = "move"', 'kind = "fly"'), "phase[0]", "move"),
        (("angle_deg = 10.0", "angle_deg = 1000.0"), "phase[0]", "150"),
        (("angle_deg = 10.0", "angle_deg = nan"), "phase[0]", ""),
        (("angle_deg = 10.0", "angel_deg = 10.0"), "phase[0].angel_deg", "angle_deg?"),
        (("tension_N = { index = 20.0 }", "tension_N = { pinky = 20.0 }"), "phase[1].tension_N", "index, thumb"),
        (("tension_N = { index = 20.0 }", "tension_N = { index = 111.0 }"), "phase[1].tension_N", "110"),
        (("tension_N = { index = 20.0 }", "tension_N = 111.0"), "phase[1].tension_N", "110"),
        (("tension_N = { index = 20.0 }", "duration_s = 1.0"), "phase[1]", "tension_N or tip_force_N"),
        (("tension_N = { index = 20.0 }", "tension_N = 5.0\ntip_force_N = 5.0"), "phase[1]", "either"),
        (("tension_N = { index = 20.0 }", "tension_N = 20.0\nslip_limit_N = 111.0"), "phase[1].slip_limit_N", "110"),
        (("tension_N = { index = 20.0 }", "tension_N = 20.0\nstiffness_N_per_mm = -1.0"), "stiffness_N_per_mm", "0"),
        (("angle_deg = 10.0", "angle_deg = { index = [] }"), "phase[0]", ""),
        (('name = "t"', ""), "name", "this key"),
    ],
)  # fmt: skip
def test_mistake_in_a_task_is_named(
    refusal, text_replacement: tuple[str, str], key_path: str, expected_message: str
) -> None:  # type: ignore[no-untyped-def]
    line = refusal(VALID_TASK.replace(*text_replacement))
    assert key_path in line
    assert expected_message in line


def test_a_task_without_phases_is_refused(refusal) -> None:  # type: ignore[no-untyped-def]
    assert "phase" in refusal('schema = 1\nname = "t"\nphase = []\n')


def test_a_contact_tension_or_a_release_above_the_ceiling_is_refused(refusal) -> None:  # type: ignore[no-untyped-def]
    for kind, key in (("close", "contact_tension_N"), ("release", "tension_N")):
        line = refusal(f'schema = 1\nname = "t"\n[[phase]]\nkind = "{kind}"\n{key} = 300.0\n')
        assert f"phase[0].{key}" in line
        assert "110" in line


def test_a_value_applies_to_one_digit_or_to_all_digits() -> None:
    assert value_for_digit(3, "index") == 3.0
    assert value_for_digit({"index": 4.0}, "index") == 4.0
    assert value_for_digit({"index": 4.0}, "thumb") is None


def test_an_empty_table_of_digits_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(VALID_TASK.replace("{ index = 20.0 }", "{}"))
    check_task(load_task(path), ("index", "thumb"), 110.0, "t")


@pytest.mark.parametrize("phase_name", [TARE_PHASE, "start"])
def test_a_phase_may_not_have_a_reserved_name(refusal, phase_name: str) -> None:  # type: ignore[no-untyped-def]
    """No phase of a task is allowed to have the name tare or start, because the controller uses these names itself."""
    assert "must not be named" in refusal(
        VALID_TASK.replace('kind = "hold"', f'kind = "hold"\nname = "{phase_name}"')
    )


def test_a_move_takes_its_time(refusal) -> None:  # type: ignore[no-untyped-def]
    assert "duration_s" in refusal(
        VALID_TASK.replace("angle_deg = 10.0", "angle_deg = 10.0\nduration_s = 1e-300")
    )
