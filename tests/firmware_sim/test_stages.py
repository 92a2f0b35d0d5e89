"""Test the stages of a scene.

At a time that the scene file defines, a stage of the scene turns the hand, pushes the object, or
changes the friction.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.plant.plant import Plant
from firmware_sim.scene.scene import load_scene
from firmware_sim.scene.stage_sequence import StageSequence, read_stage

UPRIGHT_GRAVITY_M_S2 = (0.0, 0.0, -9.81)
SIDEWAYS_STAGE = {"down": [3.0, 0.0, 0.0], "turn_s": 0.5, "last_s": 2.0}
TWO_STAGE_SCENE = """
name = "two stages"
[object]
shape = "cylinder"
diameter_m = 0.042
length_m = 0.093
mass_kg = 0.1
friction = 0.5
position_m = [0.022, 0.0, 0.0]
[support]
drop_when = "grasped"
drop_hold_s = 0.0
drop_force_N = 0.0
drop_digits = 2
drop_opposed = false
[[stage]]
down = [0.0, -1.0, 0.0]
turn_s = 0.01
last_s = 0.02
push_N = [0.0, 3.0, 0.0]
push_s = 0.01
friction = 0.1
"""


def test_gravity_turns_and_keeps_its_new_direction() -> None:
    stage_sequence = StageSequence(
        (read_stage(SIDEWAYS_STAGE), read_stage({"last_s": 1.0})), UPRIGHT_GRAVITY_M_S2
    )
    assert stage_sequence.duration == 3.5
    assert stage_sequence.state_at(0.0).gravity == UPRIGHT_GRAVITY_M_S2
    gravity_at_half_turn = stage_sequence.state_at(0.25).gravity
    assert gravity_at_half_turn == pytest.approx(
        (9.81 / math.sqrt(2), 0.0, -9.81 / math.sqrt(2))
    ), "the magnitude does not change during the turn"
    for time in (0.5, 2.4, 2.6, 100.0):
        assert stage_sequence.state_at(time).gravity == pytest.approx((9.81, 0.0, 0.0))
    assert [stage_sequence.state_at(time).stage for time in (0.0, 2.4, 2.6, 100.0)] == [0, 0, 1, 1]


def test_duration_of_a_push_and_lasting_friction() -> None:
    stage = {
        "turn_s": 1.0,
        "last_s": 3.0,
        "push_N": [0.0, 1.0, 0.0],
        "push_at_s": 0.5,
        "push_s": 1.0,
        "friction": 0.2,
    }
    stage_sequence = StageSequence(
        (read_stage(stage), read_stage({"last_s": 1.0})), UPRIGHT_GRAVITY_M_S2
    )
    push_forces = [stage_sequence.state_at(time).push[1] for time in (0.5, 1.4, 1.5, 2.4, 2.6, 4.5)]
    assert push_forces == [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]
    assert [stage_sequence.state_at(time).friction for time in (0.9, 1.1, 4.5)] == [None, 0.2, 0.2]


def test_the_plant_applies_the_stage(tmp_path: Path) -> None:
    """The first contact of the hand starts the stage_sequence of a scene.

    In this test, a stage turns gravity towards the thumb, and changes the friction of all contacts.
    """
    path = tmp_path / "stages.toml"
    path.write_text(TWO_STAGE_SCENE)
    plant = Plant(load_hand("jamia"), load_scene(str(path)), homed=True)
    plant.engine.set_joints([0.1] * 11, [0.0] * 11)
    while plant.stage < 0:
        plant.step()
        assert plant.steps < 100
    for _ in range(100):
        plant.step()
    model = plant.engine._model
    assert model.opt.gravity == pytest.approx([0.0, -9.81, 0.0])
    assert set(model.geom_friction[:, 0]) == {0.1}
    assert not np.any(plant.engine._data.xfrc_applied), "the push is over"


@pytest.mark.parametrize(
    ("stage_change", "expected_message"),
    [
        ({"last_s": 0.0, "turn_s": 0.0}, "last_s"),
        ({"down": [0.0, 0.0, 0.0]}, "down"),
        ({"down": [1.0, 0.0]}, "three"),
        ({"push_N": [math.nan, 0.0, 0.0]}, "push_N"),
        ({"friction": -1.0}, "friction"),
        ({"colour": 1}, "colour"),
    ],
)
def test_wrong_stages_are_refused(stage_change: dict[str, object], expected_message: str) -> None:
    with pytest.raises(ValueError, match=expected_message):
        read_stage(SIDEWAYS_STAGE | stage_change)


@pytest.mark.parametrize(
    "stage_change",
    [
        ('"grasped"', '"never"'),
        ("[[stage]]", "[load]\ndirection=[1,0,0]\nstart_s=0\nrate_N_per_s=1\n[[stage]]"),
    ],
)
def test_stages_need_a_table_that_sinks_and_no_load(
    stage_change: tuple[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(TWO_STAGE_SCENE.replace(*stage_change))
    with pytest.raises(SimulatorError, match="stage") as caught:
        load_scene(str(path))
    assert "\n" not in str(caught.value)
