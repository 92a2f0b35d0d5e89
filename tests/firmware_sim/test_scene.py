"""Test scenes of the simulator: packaged scenes, short names of scenes, scene files, and errors in scene files."""

from pathlib import Path

import numpy as np
import pytest

from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.plant.plant import Plant
from firmware_sim.scene.scene import load_scene, packaged_scenes

GOOD_SCENE = """
name = "good"
[object]
shape = "sphere"
diameter_m = 0.03
mass_kg = 0.1
friction = 0.5
position_m = [0.02, 0.0, 0.0]
[support]
drop_when = "never"
"""


def test_the_cylinder_is_the_one_of_the_demonstration() -> None:
    scene = load_scene("cylinder")
    assert scene.grasp_object is not None
    assert scene.support is not None
    assert scene.grasp_object.size == (0.035, 0.035, 0.093)
    assert (scene.grasp_object.mass, scene.grasp_object.friction) == (0.15, 0.5)
    assert scene.grasp_object.position == pytest.approx((0.035 / 2 + 0.002, 0.0, 0.0))
    assert (scene.support.drop_when, scene.support.drop_force, scene.support.drop_hold) == (
        "grasped",
        1.0,
        1.5,
    )


@pytest.mark.parametrize("diameter_mm", [30.0, 35.0, 40.0])
def test_shorthand_keeps_the_gap_to_the_palm(diameter_mm: float) -> None:
    grasp_object = load_scene(f"cylinder:{diameter_mm:g}").grasp_object
    assert grasp_object is not None
    assert grasp_object.size == pytest.approx((diameter_mm * 1e-3, diameter_mm * 1e-3, 0.093))
    assert grasp_object.position[0] == pytest.approx(diameter_mm * 0.5e-3 + 0.002)


def test_no_scene_is_a_free_hand() -> None:
    assert load_scene(None).grasp_object is None
    assert load_scene("none").grasp_object is None


@pytest.mark.parametrize("scene_name", packaged_scenes())
def test_objects_rest_on_their_table_until_grasped(scene_name: str) -> None:
    plant = Plant(load_hand("jamia"), load_scene(scene_name))
    object_pose_before = plant.engine.object_pose()
    for _ in range(1000):
        plant.step()
    assert np.abs(np.subtract(plant.engine.object_pose(), object_pose_before)).max() < 2e-4
    assert plant.contact_forces() == [0.0] * 12
    assert plant.table is None or plant.table.depth == 0.0


@pytest.mark.parametrize(("scene_name", "is_touching"), [("none", True), ("no_palm", False)])
def test_bent_fingers_touch_the_palm_only_if_the_scene_has_one(
    scene_name: str, is_touching: bool
) -> None:
    plant = Plant(load_hand("jamia"), load_scene(scene_name))
    angles = [0.0] * 11
    angles[:3] = [np.radians(60.0)] * 3  # bend only the index finger
    plant.engine.set_joints(angles, [0.0] * 11)
    assert any(plant.contact_forces()) == is_touching


@pytest.mark.parametrize(
    ("original_text", "replacement_text"),
    [
        ('shape = "sphere"', 'shape = "cone"'),
        ("mass_kg = 0.1", "mass_kg = -0.1"),
        ("mass_kg = 0.1", ""),
        ("position_m = [0.02, 0.0, 0.0]", "position_m = [0.02, 0.0]"),
        ('drop_when = "never"', 'drop_when = "often"'),
        ('drop_when = "never"', 'drop_when = "never"\ncolour = 1'),
        ("[object]", "[object"),
        ("diameter_m = 0.03", 'diameter_m = "wide"'),
        ("friction = 0.5", "friction = -0.5"),
        ("friction = 0.5", "friction = nan"),
        ('name = "good"', 'name = "good"\npalm_contact = 0'),
    ],
)
def test_wrong_scenes_are_refused_in_one_line(
    original_text: str, replacement_text: str, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(GOOD_SCENE.replace(original_text, replacement_text))
    with pytest.raises(SimulatorError, match=r"wrong\.toml") as caught:
        load_scene(str(path))
    assert "\n" not in str(caught.value)


def test_a_valid_scene_file_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "good.toml"
    path.write_text(GOOD_SCENE)
    scene = load_scene(str(path))
    assert scene.name == "good"
    assert scene.grasp_object is not None
    assert scene.grasp_object.size == (0.03, 0.03, 0.03)
