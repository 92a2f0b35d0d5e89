"""Stages of a scene after the grasp.

In a stage, the scene turns the hand, pushes the object, or changes the friction.
"""

import math
from dataclasses import dataclass
from typing import Any

GRAVITY_M_S2 = 9.81
"""Standard gravity [m/s2]."""
STAGE_KEYS = {"down", "turn_s", "last_s", "push_N", "push_at_s", "push_s", "friction"}
"""Keys that a stage can have in a scene file."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SceneStage:
    """One stage of a scene.

    The first stage of a scene starts when the table starts to sink. Each later stage starts when
    the previous stage ends.

    Attributes:
        gravity_direction: unit vector of gravity in the palm frame after the turn of the hand. If
            None, the direction of gravity stays the same.
        turn: duration of the turn of gravity to the new direction [s].
        duration: time from the end of the turn to the end of the stage [s].
        push: force at the centre of the object in the palm frame [N].
        push_start: time from the end of the turn to the start of the push [s].
        push_duration: duration of the push [s].
        friction: sliding friction coefficient after the turn. If None, the coefficient of the
            previous stage stays in effect.
    """

    gravity_direction: Vector | None
    turn: float
    duration: float
    push: Vector
    push_start: float
    push_duration: float
    friction: float | None


def read_stage(stage_section: dict[str, Any]) -> SceneStage:
    """Read one stage of a scene file.

    Raises:
        ValueError: a key or a value of the stage is wrong.
    """
    if unknown_keys := stage_section.keys() - STAGE_KEYS:
        raise ValueError(
            f"stage.{sorted(unknown_keys)[0]}: expected {', '.join(sorted(STAGE_KEYS))}"
        )
    down_direction = (
        _parse_vector(stage_section["down"], "stage.down") if "down" in stage_section else None
    )
    if down_direction is not None:
        length = math.hypot(*down_direction)
        if not length > 0.0:
            raise ValueError("stage.down: expected a direction, not zero")
        down_direction = (
            down_direction[0] / length,
            down_direction[1] / length,
            down_direction[2] / length,
        )
    push = _parse_vector(stage_section.get("push_N", (0.0, 0.0, 0.0)), "stage.push_N")
    times = [
        float(stage_section.get(key, 0.0)) for key in ("turn_s", "last_s", "push_at_s", "push_s")
    ]
    if not all(0.0 <= time <= 3600.0 for time in times) or times[0] + times[1] <= 0.0:
        raise ValueError("stage: expected times from 0 to 3600 s, and last_s above 0")
    friction = float(stage_section["friction"]) if "friction" in stage_section else None
    if friction is not None and not 0.0 <= friction <= 10.0:
        raise ValueError(f"stage.friction {friction}: expected 0 to 10")
    return SceneStage(down_direction, times[0], times[1], push, times[2], times[3], friction)


def _parse_vector(raw_vector: Any, key_path: str) -> Vector:
    values = tuple(float(value) for value in raw_vector)
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"{key_path}: expected three finite numbers")
    return values[0], values[1], values[2]


@dataclass(frozen=True, slots=True)
class SceneState:
    """State of a scene at a given time: stage, gravity, push and friction.

    Attributes:
        stage: index of the present stage, or -1 in a scene without stages.
        gravity: acceleration of gravity in the palm frame [m/s2].
        push: force at the centre of the object in the palm frame [N].
        friction: sliding friction coefficient. If None, the coefficient of the scene file
            applies.
    """

    stage: int
    gravity: Vector
    push: Vector
    friction: float | None


class StageSequence:
    """The stages of a scene, one after the other. The method ``state_at`` returns the scene's state at a given time.

    Attributes:
        duration: total duration of all stages [s].
    """

    def __init__(self, stages: tuple[SceneStage, ...], gravity: Vector) -> None:
        """Store the stages of a scene.

        Args:
            stages: stages of the scene.
            gravity: acceleration of gravity before the first stage [m/s2].
        """
        self._stages = stages
        self._gravity = gravity
        self.duration = sum(stage.turn + stage.duration for stage in stages)

    def state_at(self, time: float) -> SceneState:
        """Return the state of the scene at a given time.

        The argument ``time`` is the time since the table started to sink [s]. After the last
        stage, the state of the scene no longer changes.
        """
        start = 0.0
        gravity = self._gravity
        friction = None
        for i, stage in enumerate(self._stages):
            time_in_stage = time - start
            target = (
                gravity
                if stage.gravity_direction is None
                else _scaled_vector(stage.gravity_direction, GRAVITY_M_S2)
            )
            friction = (
                stage.friction
                if stage.friction is not None and time_in_stage >= stage.turn
                else friction
            )
            if time_in_stage < stage.turn + stage.duration or i == len(self._stages) - 1:
                is_pushing = (
                    stage.push_start
                    <= time_in_stage - stage.turn
                    < stage.push_start + stage.push_duration
                )
                fraction = min(time_in_stage / stage.turn, 1.0) if stage.turn > 0.0 else 1.0
                return SceneState(
                    i,
                    _rotated_vector(gravity, target, fraction),
                    stage.push if is_pushing else (0.0, 0.0, 0.0),
                    friction,
                )
            start = start + stage.turn + stage.duration
            gravity = target
        return SceneState(-1, self._gravity, (0.0, 0.0, 0.0), None)


def _scaled_vector(vector: Vector, factor: float) -> Vector:
    """Multiply a vector by a factor."""
    return vector[0] * factor, vector[1] * factor, vector[2] * factor


def _rotated_vector(start: Vector, end: Vector, fraction: float) -> Vector:
    """Interpolate between two vectors along a great circle.

    If the two vectors have opposite directions, the result first has the direction of ``start``.
    When the linear interpolation between the two vectors has passed zero, the result has the
    direction of ``end``.

    Args:
        start: vector at fraction 0.
        end: vector at fraction 1. The result has the length of ``end``.
        fraction: fraction of the way from ``start`` to ``end``, from 0 to 1.
    """
    interpolated_vector = tuple(a + (b - a) * fraction for a, b in zip(start, end, strict=True))
    length = math.hypot(*interpolated_vector)
    magnitude_of_end = math.hypot(*end)
    # Halfway between opposite vectors, the direction is not defined, because many great circles
    # pass through both vectors.
    if length < 1e-9 or magnitude_of_end == 0.0:
        return interpolated_vector[0], interpolated_vector[1], interpolated_vector[2]
    return _scaled_vector(
        (interpolated_vector[0], interpolated_vector[1], interpolated_vector[2]),
        magnitude_of_end / length,
    )
