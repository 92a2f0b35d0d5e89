"""Tasks that ask for angles which the joints do not have."""

import json
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.controller.reach import check_reach
from handctl.controller.task import Task
from handctl.errors import ConfigError
from handctl.hand.description import load_hand
from handctl.hand.digit import DigitModel

JAMIA, ELEVEN = load_hand("jamia"), load_hand("jamia11")


def task(kind: str, angle: object, **more: object) -> Task:
    phase = {"kind": kind, "angle_deg": angle, **more}
    return Task.model_validate_json(json.dumps({"schema": 1, "name": "t", "phase": [phase]}))


@pytest.mark.parametrize(
    ("hand", "kind", "angle", "said"),
    [
        (JAMIA, "move", 100.5, "100.5 deg for index; expected 0 to 100 deg"),
        (JAMIA, "move", {"thumb": -1.0}, "-1 deg for thumb; expected 0 to 100 deg"),
        (JAMIA, "close", 101.0, "101 deg for index; expected 0 to 100 deg"),
        (ELEVEN, "move", {"ring": (10.0, 20.0, 120.0)}, "120 deg for ring; expected 0 to 100 deg"),
    ],
)
def test_what_no_joint_reaches_is_refused(hand, kind, angle, said):
    with pytest.raises(ConfigError) as told:
        check_reach(task(kind, angle), hand, "t.toml")
    assert str(told.value) == f"t.toml: phase[0].angle_deg: {said}"


def test_so_is_a_point_of_a_curve():
    curve = {"index": (0.0, 50.0, 100.1)}
    with pytest.raises(ConfigError, match=r"100\.1 deg for index"):
        check_reach(task("follow", curve, time_s=(0.0, 1.0, 2.0)), JAMIA, "t.toml")


@pytest.mark.parametrize("angle", [0.0, 100.0, {"index": 50.0}, {"thumb": 100.0}])
def test_the_ends_of_the_range_are_within_it(angle):
    check_reach(task("move", angle), JAMIA, "t.toml")
    check_reach(task("close", angle), ELEVEN, "t.toml")


def test_reach_is_that_of_the_mean_angle_where_one_tendon_moves_three_joints():
    low, high = DigitModel.of(JAMIA, "index").reach
    assert np.degrees(low) == pytest.approx([0.0], abs=1e-9)
    assert np.degrees(high) == pytest.approx([100.0])
    assert DigitModel.of(ELEVEN, "index").reach[1].shape == (3,)


def test_a_run_is_refused_before_its_bus_is_opened(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "far.toml"
    path.write_text('schema = 1\nname = "far"\n[[phase]]\nkind = "move"\nangle_deg = 120.0\n')
    assert main(["run", "--bus", "local:nobody", "--task", str(path)]) == 2
    assert capsys.readouterr().err.endswith("phase[0].angle_deg: 120 deg for index; expected 0 to 100 deg\n")
