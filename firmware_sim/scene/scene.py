"""Scenes of a grasp, read from small TOML files: an object, its support, a load and stages."""

import importlib.resources
import math
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.scene.stage_sequence import SceneStage, read_stage

OBJECT_SHAPES = ("cylinder", "sphere", "box")
"""Possible shapes of an object."""


@dataclass(frozen=True, slots=True)
class GraspObject:
    """The object that the hand grasps.

    Attributes:
        shape: shape of the object: cylinder (axis z), sphere or box.
        size: full lengths of the object along the axes x, y and z [m].
        mass: mass of the object [kg].
        friction: coefficient of sliding friction between the object and digits, palm and table.
        position: centre of the object in the palm frame [m].
    """

    shape: str
    size: tuple[float, float, float]
    mass: float
    friction: float
    position: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SinkingTable:
    """The table under the object.

    Attributes:
        drop_when: ``grasped`` if the table sinks after the hand has grasped the object, or
            ``never``.
        drop_force: smallest contact force with which a digit counts as holding the object [N].
        drop_hold: time for which the digits must hold the object without a break before the table
            sinks [s].
        drop_digits: number of digits that must hold the object. If the hand has fewer digits than
            this number, all digits of the hand must hold the object.
        drop_opposed: True if at least one digit must press from the side of the thumb, and at least
            one other digit from the opposite side.
        sink_speed: speed of the sinking table [m/s].
        sink_depth: distance below the initial position at which the table stops [m].
    """

    drop_when: str = "never"
    drop_force: float = 1.0
    drop_hold: float = 1.5
    drop_digits: int = 3
    drop_opposed: bool = True
    sink_speed: float = 0.05
    sink_depth: float = 0.2


@dataclass(frozen=True, slots=True)
class GrowingLoad:
    """A force on the centre of the object. The force grows until the hand loses the object.

    Attributes:
        direction: unit vector of the force in the palm frame.
        start: time from power-up to the start of the force [s].
        rate: increase of the force per second [N/s].
    """

    direction: tuple[float, float, float]
    start: float
    rate: float

    def force_at(self, time: float) -> float:
        """Return the force on the object [N] at a given time after power-up [s]."""
        return max(0.0, self.rate * (time - self.start))


@dataclass(frozen=True, slots=True)
class Scene:
    """The surroundings of a hand: an object, its support, a load on the object, and the stages after the grasp.

    A scene without an object has no support, no load and no stages. If ``palm_contact`` is False,
    the digits pass through the palm.
    """

    name: str
    grasp_object: GraspObject | None = None
    support: SinkingTable | None = None
    load: GrowingLoad | None = None
    stages: tuple[SceneStage, ...] = ()
    palm_contact: bool = True


def packaged_scenes() -> list[str]:
    """List the names of the scenes packaged with the simulator."""
    folder = importlib.resources.files("firmware_sim") / "scenes"
    return sorted(
        file.name.removesuffix(".toml") for file in folder.iterdir() if file.name.endswith(".toml")
    )


def load_scene(text: str | None) -> Scene:
    """Load a scene by name or path.

    Args:
        text: name of a packaged scene, path of a .toml file, or NAME:DIAMETER_mm such as
            ``cylinder:40``. None for a hand without an object.

    Raises:
        SimulatorError: the scene does not exist, or the file of the scene is incomplete.
    """
    if text is None:
        return Scene("none")
    if text.endswith(".toml"):
        return _read_scene(Path(text), text)
    name, _, diameter = text.partition(":")
    if name not in packaged_scenes():
        packaged_names = ", ".join(packaged_scenes())
        raise SimulatorError(
            f"no such scene: {text}; expected {packaged_names}, NAME:MILLIMETRES or a .toml file"
        )
    scene = _read_scene(importlib.resources.files("firmware_sim") / "scenes" / f"{name}.toml", name)
    return _resized_scene(scene, diameter, text) if diameter else scene


def _resized_scene(scene: Scene, diameter_text: str, text: str) -> Scene:
    """Return the scene with another diameter of the object.

    The gap between the object and the palm does not change with the diameter.
    """
    try:
        diameter = float(diameter_text) * 1e-3
    except ValueError:
        diameter = math.nan
    if scene.grasp_object is None or not 0.0 < diameter < 1.0:
        raise SimulatorError(f"scene {text}: expected a diameter in millimetres, as in cylinder:35")
    old_object = scene.grasp_object
    height = diameter if old_object.shape == "sphere" else old_object.size[2]
    # The front face of the palm lies in the plane x = 0.
    palm_gap = old_object.position[0] - old_object.size[0] / 2.0
    position = (diameter / 2.0 + palm_gap, old_object.position[1], old_object.position[2])
    return replace(
        scene,
        name=text,
        grasp_object=replace(old_object, size=(diameter, diameter, height), position=position),
    )


def _read_scene(path: Any, location: str) -> Scene:
    """Read a scene file, and check that its sections are consistent with each other."""
    try:
        if not path.is_file():
            raise ValueError("no such file")
        scene_content = tomllib.loads(path.read_text("utf-8"))
        grasp_object = _parse_object(scene_content.get("object"))
        support = _parse_support(scene_content.get("support"))
        load = _growing_load(scene_content.get("load"))
        scene = Scene(
            scene_content["name"],
            grasp_object,
            support,
            load,
            tuple(read_stage(stage) for stage in scene_content.get("stage", ())),
            _parse_palm_contact(scene_content.get("palm_contact", True)),
        )
    except KeyError as error:
        raise SimulatorError(f"scene {location}: missing or unknown key {error}") from error
    except (OSError, RecursionError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise SimulatorError(f"scene {location}: {error}") from error
    if scene.support and not scene.grasp_object:
        raise SimulatorError(f"scene {location}: a support without an object")
    if scene.load and not scene.grasp_object:
        raise SimulatorError(f"scene {location}: a load without an object")
    if scene.stages and (scene.support is None or scene.support.drop_when != "grasped"):
        raise SimulatorError(
            f"scene {location}: a stage without a support that sinks when the object is grasped"
        )
    if scene.stages and scene.load:
        raise SimulatorError(
            f"scene {location}: stages and load both push the object; expected one of them"
        )
    return scene


def _parse_palm_contact(value: object) -> bool:
    """Check the value of the key ``palm_contact``. The value is true if the digits can touch the palm."""
    if not isinstance(value, bool):
        raise ValueError(f"palm_contact {value!r}: expected true or false")
    return value


def _parse_object(object_section: dict[str, Any] | None) -> GraspObject | None:
    """Build the object from its section in the scene file."""
    if object_section is None:
        return None
    shape = object_section["shape"]
    if shape not in OBJECT_SHAPES:
        raise ValueError(f"object.shape {shape!r}: expected {', '.join(OBJECT_SHAPES)}")
    if shape == "box":
        size = tuple(float(value) for value in object_section["size_m"])
    else:
        diameter = float(object_section["diameter_m"])
        size = (
            diameter,
            diameter,
            diameter if shape == "sphere" else float(object_section["length_m"]),
        )
    position = tuple(float(value) for value in object_section["position_m"])
    if (
        len(size) != 3
        or len(position) != 3
        or not all(0 < value < 1 for value in (*size, object_section["mass_kg"] / 100))
    ):
        raise ValueError(
            "object: expected three positive extents, a positive mass and three coordinates"
        )
    friction = float(object_section["friction"])
    if not (0.0 <= friction <= 10.0 and all(map(math.isfinite, position))):
        raise ValueError(
            f"object: friction {friction}, position {position}: expected finite, friction 0 to 10"
        )
    return GraspObject(shape, size, float(object_section["mass_kg"]), friction, position)


def _parse_support(support_section: dict[str, Any] | None) -> SinkingTable | None:
    """Build the support from its section in the scene file."""
    if support_section is None:
        return None
    if support_section["drop_when"] not in ("grasped", "never"):
        raise ValueError(
            f"support.drop_when {support_section['drop_when']!r}: expected grasped or never"
        )
    keys = {"drop_when": "drop_when", "drop_force_N": "drop_force", "drop_hold_s": "drop_hold",
            "drop_digits": "drop_digits", "drop_opposed": "drop_opposed",
            "sink_speed_m_s": "sink_speed", "sink_depth_m": "sink_depth"}  # fmt: skip
    return SinkingTable(**{keys[key]: value for key, value in support_section.items()})


def _growing_load(load_section: dict[str, Any] | None) -> GrowingLoad | None:
    """Build the load from its section in the scene file.

    The direction of the load is scaled to a unit vector.
    """
    if load_section is None:
        return None
    x, y, z = (float(value) for value in load_section["direction"])
    length = math.hypot(x, y, z)
    start = float(load_section["start_s"])
    rate = float(load_section["rate_N_per_s"])
    if (
        not (0.0 < length < math.inf and 0.0 <= start < math.inf and 0.0 < rate < math.inf)
        or len(load_section) != 3
    ):
        raise ValueError("load: expected direction (not zero), start_s and a positive rate_N_per_s")
    return GrowingLoad((x / length, y / length, z / length), start, rate)
