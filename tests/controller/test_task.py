"""Task files: the packaged one is good for every hand, and what is wrong is named with its key."""

from pathlib import Path

import pytest

from handctl.controller.task import Close, Hold, Move, Release, check_task, for_digit, load_task
from handctl.errors import ConfigError
from handctl.hand.description import load_hand, packaged_hands

GOOD = """schema = 1
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
    """The line that refuses a task's text."""

    def refuse(text: str, digits: tuple[str, ...] = ("index", "thumb"), ceiling: float = 110.0) -> str:
        path = tmp_path / "t.toml"
        path.write_text(text)
        with pytest.raises(ConfigError) as caught:
            check_task(load_task(path), digits, ceiling, str(path))
        line = str(caught.value)
        assert "\n" not in line
        assert line.startswith(str(path))
        return line

    return refuse


def test_packaged_tasks_suit_every_packaged_hand() -> None:
    import handctl

    paths = list((Path(handctl.__file__).parent / "tasks").glob("*.toml"))
    assert paths
    for path in paths:
        task = load_task(path)
        for name in packaged_hands():
            hand = load_hand(name)
            check_task(task, hand.digit_names, min(tendon.tension_max_N for tendon in hand.tendon), path.name)


def test_phases_are_what_their_kind_says(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(GOOD + '[[phase]]\nkind = "close"\n[[phase]]\nkind = "release"\n')
    assert [type(phase) for phase in load_task(path).phase] == [Move, Hold, Close, Release]


@pytest.mark.parametrize(
    ("change", "where", "said"),
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
        (('name = "t"', ""), "name", "this key"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(refusal, change: tuple[str, str], where: str, said: str) -> None:  # type: ignore[no-untyped-def]
    line = refusal(GOOD.replace(*change))
    assert where in line
    assert said in line


def test_no_phases_is_no_task(refusal) -> None:  # type: ignore[no-untyped-def]
    assert "phase" in refusal('schema = 1\nname = "t"\nphase = []\n')


def test_a_contact_tension_or_a_release_above_the_ceiling_is_refused(refusal) -> None:  # type: ignore[no-untyped-def]
    for kind, key in (("close", "contact_tension_N"), ("release", "tension_N")):
        line = refusal(f'schema = 1\nname = "t"\n[[phase]]\nkind = "{kind}"\n{key} = 300.0\n')
        assert f"phase[0].{key}" in line
        assert "110" in line


def test_values_for_one_or_all_digits() -> None:
    assert for_digit(3, "index") == 3.0
    assert for_digit({"index": 4.0}, "index") == 4.0
    assert for_digit({"index": 4.0}, "thumb") is None
