"""Define the objects of the grasp benchmark, with their positions and disturbances.

The objects were fixed before any grasp was tuned.

The size of the hand determines the sizes of the objects. An object of 42 mm fits between the
straight fingers and the thumb. A fingertip can touch the thumb at a distance of about 25 mm from
the palm. Each object is shifted at random by up to 1 mm along x and 2 mm along y. The seed of the
run determines how far the object is shifted.
"""

import random
from dataclasses import dataclass

TURN_DURATION_S = 0.5
STAGE_DURATION_S = 5.0
PUSH_FORCE_N = 1.0
PUSH_START_S = 2.0
PUSH_DURATION_S = 1.0
MAX_OBJECT_MOTION_M = 2e-3
"""Largest permitted motion of a held object within a stage of the scene [m].

If the object moves farther than this limit, the grasp has failed.
"""
GRAVITY_DIRECTIONS = {
    "power": ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
    "pinch": ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
    "hook": ((1, 0, 0), (0, -1, 0), (0, 1, 0)),
}
"""Directions of gravity in the stages of the scene, for each kind of grasp.

In a power grasp and a pinch, gravity acts along the joint axes, out of the palm, and towards the
thumb. In a hook grasp, gravity acts across the bar that the hand holds.
"""
PLACEMENT_SHIFT_M = (1e-3, 2e-3)


@dataclass(frozen=True)
class GraspCase:
    """An object, and the kind of grasp with which the hand holds the object.

    The fields are: kind of grasp, shape, full width [m], friction, mass [kg], and x and y of the
    object's centre [m].
    """

    grasp: str
    shape: str
    width: float
    friction: float
    mass: float
    place: tuple[float, float]

    @property
    def name(self) -> str:
        """Return a name such as ``cylinder 35 mm, friction 0.5``."""
        return f"{self.shape} {1e3 * self.width:g} mm, friction {self.friction:g}"

    def scene_text(self, seed: int, includes_stages: bool = True) -> str:
        """Return the text of the scene file. Seed 0 places the object at its nominal position."""
        chance = random.Random(f"{self} {seed}")
        x, y = (
            v + (chance.uniform(-s, s) if seed else 0.0)
            for v, s in zip(self.place, PLACEMENT_SHIFT_M, strict=True)
        )
        digits, opposed = (
            (2, "false") if self.grasp == "hook" else (2 if self.grasp == "pinch" else 3, "true")
        )
        lines = [
            'name = "benchmark"',
            "[object]",
            f'shape = "{self.shape}"',
            f"mass_kg = {self.mass}",
        ]
        if self.shape == "box":
            lines += [f"size_m = [{self.width}, {self.width}, 0.093]"]
        else:
            lines += [f"diameter_m = {self.width}", "length_m = 0.093"]
        lines += [
            f"friction = {self.friction}",
            f"position_m = [{x:.6f}, {y:.6f}, 0.0]",
            "[support]",
        ]
        lines += ['drop_when = "grasped"', "drop_hold_s = 1.0", "sink_speed_m_s = 0.1"]
        lines += [f"drop_digits = {digits}", f"drop_opposed = {opposed}"]
        for gravity_direction in GRAVITY_DIRECTIONS[self.grasp] if includes_stages else ():
            push = [PUSH_FORCE_N * v for v in gravity_direction]
            lines += [
                "[[stage]]",
                f"down = {list(gravity_direction)}",
                f"turn_s = {TURN_DURATION_S}",
                f"last_s = {STAGE_DURATION_S}",
            ]
            lines += [
                f"push_N = {push}",
                f"push_at_s = {PUSH_START_S}",
                f"push_s = {PUSH_DURATION_S}",
            ]
        return "\n".join(lines) + "\n"


def _power_grasp_case(
    object_shape: str, width_mm: float, friction: float, mass_kg: float
) -> GraspCase:
    """Return an object for a power grasp.

    The object is 2 mm in front of the palm, and midway between fingers and thumb.
    """
    return GraspCase(
        "power", object_shape, width_mm * 1e-3, friction, mass_kg, (width_mm * 0.5e-3 + 2e-3, 0.0)
    )


GRASP_CASES = (
    _power_grasp_case("cylinder", 30, 0.5, 0.15),
    _power_grasp_case("cylinder", 35, 0.5, 0.15),
    _power_grasp_case("cylinder", 40, 0.5, 0.15),
    _power_grasp_case("cylinder", 35, 0.3, 0.15),
    _power_grasp_case("cylinder", 35, 0.8, 0.15),
    _power_grasp_case("sphere", 36, 0.5, 0.05),
    _power_grasp_case("sphere", 40, 0.5, 0.05),
    _power_grasp_case("box", 30, 0.5, 0.15),
    _power_grasp_case("box", 34, 0.5, 0.15),
    _power_grasp_case("box", 38, 0.5, 0.15),
    GraspCase("pinch", "cylinder", 0.020, 0.5, 0.05, (0.025, 0.0)),
    GraspCase("pinch", "cylinder", 0.025, 0.8, 0.05, (0.025, 0.0)),
    GraspCase("pinch", "sphere", 0.025, 0.5, 0.02, (0.025, 0.0)),
    GraspCase("pinch", "box", 0.020, 0.5, 0.05, (0.025, 0.0)),
    GraspCase("pinch", "box", 0.024, 0.8, 0.05, (0.025, 0.0)),
    GraspCase("hook", "cylinder", 0.012, 0.5, 0.3, (0.012, 0.010)),
    GraspCase("hook", "cylinder", 0.016, 0.5, 0.3, (0.013, 0.008)),
    GraspCase("hook", "box", 0.012, 0.3, 0.3, (0.012, 0.010)),
)
