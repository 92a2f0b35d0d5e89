"""What happens to an object once it is held: the hand is turned, the object pushed, its skin gets slippery."""

import math
from dataclasses import dataclass
from typing import Any

GRAVITY_M_S2 = 9.81
KEYS = {"down", "turn_s", "last_s", "push_N", "push_at_s", "push_s", "friction"}

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Stage:
    """One stretch of time; the first begins when the table begins to sink, each other after the one before.

    Attributes:
        down: unit vector along which gravity acts in the palm frame; None: as before.
        turn: how long the turn takes [s].
        last: how long the stage lasts after the turn [s].
        push: force at the object's centre [N]. push_at: when it begins, after the turn [s]. push_for: how long [s].
        friction: sliding coefficient from the turn on; None: as before.
    """

    down: Vector | None
    turn: float
    last: float
    push: Vector
    push_at: float
    push_for: float
    friction: float | None


def read_stage(raw: dict[str, Any]) -> Stage:
    """Return a stage of a scene file.

    Raises:
        ValueError: a key or a value is wrong.
    """
    if unknown := raw.keys() - KEYS:
        raise ValueError(f"stage.{sorted(unknown)[0]}: expected {', '.join(sorted(KEYS))}")
    down = _vector(raw["down"], "stage.down") if "down" in raw else None
    if down is not None:
        length = math.hypot(*down)
        if not length > 0.0:
            raise ValueError("stage.down: expected a direction, not zero")
        down = (down[0] / length, down[1] / length, down[2] / length)
    push = _vector(raw.get("push_N", (0.0, 0.0, 0.0)), "stage.push_N")
    times = [float(raw.get(key, 0.0)) for key in ("turn_s", "last_s", "push_at_s", "push_s")]
    if not all(0.0 <= time <= 3600.0 for time in times) or times[0] + times[1] <= 0.0:
        raise ValueError("stage: expected times from 0 to 3600 s, and last_s above 0")
    friction = float(raw["friction"]) if "friction" in raw else None
    if friction is not None and not 0.0 <= friction <= 10.0:
        raise ValueError(f"stage.friction {friction}: expected 0 to 10")
    return Stage(down, times[0], times[1], push, times[2], times[3], friction)


def _vector(raw: Any, where: str) -> Vector:
    values = tuple(float(value) for value in raw)
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"{where}: expected three finite numbers")
    return values[0], values[1], values[2]


@dataclass(frozen=True, slots=True)
class Now:
    """What acts at an instant: gravity [m/s2], push [N], friction (None: the scene's); which stage; -1 before all."""

    stage: int
    gravity: Vector
    push: Vector
    friction: float | None


class Stages:
    """Follows the stages of a scene through time.

    Attributes:
        duration: of all of them [s].
    """

    def __init__(self, stages: tuple[Stage, ...], gravity: Vector) -> None:
        """Args: the scene's stages; gravity before them [m/s2]."""
        self._stages, self._gravity = stages, gravity
        self.duration = sum(stage.turn + stage.last for stage in stages)

    def at(self, time: float) -> Now:
        """Return what acts at a time since the table began to sink [s]; after the last stage its end goes on."""
        begin, gravity, friction = 0.0, self._gravity, None
        for i, stage in enumerate(self._stages):
            since = time - begin
            target = gravity if stage.down is None else _scaled(stage.down, GRAVITY_M_S2)
            friction = stage.friction if stage.friction is not None and since >= stage.turn else friction
            if since < stage.turn + stage.last or i == len(self._stages) - 1:
                pushing = stage.push_at <= since - stage.turn < stage.push_at + stage.push_for
                share = min(since / stage.turn, 1.0) if stage.turn > 0.0 else 1.0
                return Now(i, _turned(gravity, target, share), stage.push if pushing else (0.0, 0.0, 0.0), friction)
            begin, gravity = begin + stage.turn + stage.last, target
        return Now(-1, self._gravity, (0.0, 0.0, 0.0), None)


def _scaled(v: Vector, factor: float) -> Vector:
    return v[0] * factor, v[1] * factor, v[2] * factor


def _turned(start: Vector, end: Vector, share: float) -> Vector:
    """Return the vector on the way from one to another, along the great circle; opposite ones through the middle."""
    mixed = tuple(a + (b - a) * share for a, b in zip(start, end, strict=True))
    length, wanted = math.hypot(*mixed), math.hypot(*end)
    if length < 1e-9 or wanted == 0.0:
        return mixed[0], mixed[1], mixed[2]
    return _scaled((mixed[0], mixed[1], mixed[2]), wanted / length)
