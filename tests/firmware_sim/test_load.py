"""Test a growing load on a grasped object, and the grip strength that is measured with the growing load."""

import math
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.plant.plant import Plant
from firmware_sim.scene.scene import load_scene
from firmware_sim.truth_file import read_truth

LOAD_SCENE = """
name = "loaded"
[object]
shape = "cylinder"
diameter_m = 0.035
length_m = 0.093
mass_kg = 0.2
friction = 0.5
position_m = [{x}, 0.0, 0.0]
{support}
[load]
direction = {direction}
start_s = {start}
rate_N_per_s = 10.0
"""
TABLE_SECTION = '[support]\ndrop_when = "never"'


def write_scene(
    scene_folder: Path,
    position_x_m: float = 0.0195,
    load_direction: str = "[0, 0, 2]",
    load_start: float = 0.1,
    support_section: str = "",
) -> str:
    path = scene_folder / "loaded.toml"
    path.write_text(
        LOAD_SCENE.format(
            x=position_x_m, direction=load_direction, start=load_start, support=support_section
        )
    )
    return str(path)


def test_a_free_object_gains_the_impulse_of_its_load_and_weight(tmp_path: Path) -> None:
    plant = Plant(
        load_hand("jamia"), load_scene(write_scene(tmp_path, position_x_m=0.5)), homed=True
    )
    for _ in range(800):
        plant.step()
    impulse = 0.5 * 10.0 * (0.4 - 0.1) ** 2 - 0.2 * 9.81 * 0.4
    assert plant.engine.object_speed() == pytest.approx(abs(impulse) / 0.2, rel=0.01)


def test_the_truth_file_has_the_load_from_its_start_time(tmp_path: Path) -> None:
    truth = tmp_path / "truth"
    rig = LockstepHand(
        "jamia",
        scene=write_scene(tmp_path, support_section=TABLE_SECTION),
        truth_path=str(truth),
        homed=True,
    )
    for k in range(100):
        rig.step(k * 2_000_000, [])
    rig.close()
    record = read_truth(truth)
    expected = 10.0 * np.maximum(0.0, record.t_ns * 1e-9 - 0.1)
    assert record.column("load") == pytest.approx(expected, abs=1e-9)
    assert {f"normal/{digit}" for digit in ("index", "middle", "ring", "thumb")} <= set(
        record.header["columns"]
    )


def test_normal_forces_carry_the_object_between_fingers_and_thumb(tmp_path: Path) -> None:
    hand = load_hand("jamia")
    plant = Plant(
        hand,
        load_scene(write_scene(tmp_path, load_start=100.0, support_section=TABLE_SECTION)),
        homed=True,
    )
    assert plant.measured_grip_forces() == [0.0] * 5
    for motor in plant.motors.values():
        motor.servo.limit, motor.servo.torque = 0.8, 0.17
    for _ in range(4000):
        plant.step()
    normals = plant.measured_grip_forces()[1:]
    force_vectors = np.reshape(plant.contact_forces(), (4, 3))
    assert min(normals) > 1.0
    for normal, force in zip(normals, force_vectors, strict=True):
        assert np.linalg.norm(force) <= normal * math.hypot(1.0, 0.5) * 1.01
    palm = force_vectors[:, 0].sum()
    assert palm > 1.0, "the digits press the object against the palm"
    assert abs(force_vectors[:, 1].sum()) <= 0.5 * (palm + 0.2 * 9.81), (
        "friction balances the rest of the force"
    )


@pytest.mark.parametrize("load_direction", ["[0, 0, 0]", "[0, 0]", '["x", 0, 0]', "[nan, 0, 1]"])
def test_wrong_loads_are_refused(load_direction: str, tmp_path: Path) -> None:
    with pytest.raises(SimulatorError, match=r"loaded\.toml"):
        load_scene(write_scene(tmp_path, load_direction=load_direction))


def test_a_load_needs_an_object(tmp_path: Path) -> None:
    path = tmp_path / "empty.toml"
    path.write_text(
        'name = "empty"\n[load]\ndirection = [0, 0, 1]\nstart_s = 0\nrate_N_per_s = 1\n'
    )
    with pytest.raises(SimulatorError, match="a load without an object"):
        load_scene(str(path))
