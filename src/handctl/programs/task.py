"""Task files: the phases of a grasp as a person writes them."""

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import Field, model_validator

from handctl.core.law.trajectory import Curve
from handctl.document import Document, load_document, validated
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.load import read_toml

Angle = Annotated[float, Field(ge=-30, le=150)]
Tension = Annotated[float, Field(ge=0, le=1000)]
Force = Annotated[float, Field(ge=0, le=200)]
Angles = Angle | Annotated[tuple[Angle, ...], Field(min_length=1)]
"""Of a digit: one for all its joints, or one for each of its coordinates."""
Tensions = Tension | Annotated[tuple[Tension, ...], Field(min_length=1)]
"""Of a digit: one for all its tendons, or one for each."""
Duration = Annotated[float, Field(gt=0, le=3600)]


FOLLOW_SPEED_DEG_S = 700.0
"""Fastest joint speed of a motion: a rotor that is stopped dead adds tension in proportion to its speed."""
SHORTEST_MOVE_S = 0.05
"""What is shorter is no move but a step, and the square of its duration need not be a number."""
OURS = ("start", "tare")
"""Names by which the controller knows the beginning of a program and load cells that are not tared yet."""


class Move(Document):
    """Move to joint angles along a minimum-jerk path; digits not named stay where they are."""

    kind: Literal["move"]
    name: str = "move"
    angle_deg: Angle | dict[str, Angles]
    """One angle for all joints, or one per digit; of a one-tendon digit the mean joint angle. Of a digit with a tendon
    for each joint also a list, from the palm outwards."""
    duration_s: float = Field(1.0, ge=SHORTEST_MOVE_S, le=3600)


class Close(Document):
    """Close until contact: each digit that touches goes over to holding its tension, the others go on."""

    kind: Literal["close"]
    name: str = "close"
    angle_deg: Angle | dict[str, Angles] = 90.0
    """How far to close where there is nothing to touch."""
    speed_deg_s: float = Field(60.0, gt=0, le=FOLLOW_SPEED_DEG_S)
    contact_tension_N: Tension = 8.0
    """Tension that a digit holds from its contact on, if it is not more already."""
    timeout_s: Duration = 10.0


class Hold(Document):
    """Hold a tension, or a tip-equivalent force, with the digits that are in contact; the others stay."""

    kind: Literal["hold"]
    name: str = "hold"
    tension_N: Tension | dict[str, Tensions] | None = None
    tip_force_N: Force | dict[str, Force] | None = None
    slip_limit_N: Tension | dict[str, Tension] | None = None
    """Slip raises the tensions up to this; without it slip is told, not answered."""
    stiffness_N_per_mm: float = Field(0.0, ge=0, le=50)
    """Tension more for each millimetre that a tendon is pulled out once the grip has settled; 0: tension is kept."""
    rate_N_per_s: float = Field(60.0, gt=0, le=5000)
    duration_s: Duration = 3.0

    @model_validator(mode="after")
    def _one_of(self) -> "Hold":
        if (self.tension_N is None) == (self.tip_force_N is None):
            raise ValueError("give either tension_N or tip_force_N")
        return self


class Release(Document):
    """Let the tension go down; from the next phase on the digits count as free again, and must touch anew to hold."""

    kind: Literal["release"]
    name: str = "release"
    tension_N: Tension = 8.0
    rate_N_per_s: float = Field(100.0, gt=0, le=5000)
    settle_s: float = Field(0.3, ge=0, le=60)


class Follow(Document):
    """Follow a curve through given angles, from rest to rest; the digits must already be where it begins."""

    kind: Literal["follow"]
    name: str = "follow"
    time_s: tuple[Annotated[float, Field(ge=0, le=3600)], ...] = Field(min_length=2, max_length=100_000)
    """Rising from 0."""
    angle_deg: dict[str, tuple[Angle, ...]] = Field(min_length=1)
    """Per digit an angle for each time; digits not named stay where they are."""

    @model_validator(mode="after")
    def _rising(self) -> "Follow":
        if self.time_s[0] != 0.0 or any(b <= a for a, b in pairwise(self.time_s)):
            raise ValueError("time_s must rise from 0")
        for digit, angles in self.angle_deg.items():
            if len(angles) != len(self.time_s):
                raise ValueError(f"{digit} must have an angle for each of the {len(self.time_s)} times")
            peak = math.degrees(_peak_speed(self.time_s, tuple(map(math.radians, angles))))
            if not peak <= FOLLOW_SPEED_DEG_S:  # nor if it is no number
                raise ValueError(f"at most {FOLLOW_SPEED_DEG_S:g} deg/s on the way; {digit} reaches {peak:.0f}")
        return self


def _peak_speed(times: tuple[float, ...], angles: tuple[float, ...]) -> float:
    """Largest speed of a curve [rad/s]; inf or NaN if its times are too close together for numbers."""
    with np.errstate(all="ignore"):
        try:
            return Curve.through(times, angles, 1).peak_speed()
        except ValueError:  # scipy's, of slopes that are not finite
            return math.inf


Phase = Annotated[Move | Close | Hold | Release | Follow, Field(discriminator="kind")]


class Task(Document):
    """A grasp as a list of phases; the hand arms before the first and relaxes after the last."""

    schema_: int = Field(alias="schema", ge=1, le=1)
    name: str
    description: str = ""
    phase: tuple[Phase, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _named(self) -> "Task":
        for phase in self.phase:
            if phase.name in OURS:
                raise ValueError(f"a phase must not be named {' or '.join(OURS)}")
        return self


class TrajectoryFile(Document):
    """A motion as points in time, from another program."""

    schema_: int = Field(alias="schema", ge=1, le=1)
    name: str
    time_s: tuple[float, ...]
    angle_deg: dict[str, tuple[float, ...]]


def load_trajectory(path: Path) -> Task:
    """Read a trajectory file as a task: go slowly to its first pose, then follow it.

    Raises:
        ConfigError: it cannot be read, time does not rise, an angle or a speed is out of range.
    """
    return trajectory_from(read_toml(path), str(path))


def trajectory_from(content: Mapping[str, Any], source: str) -> Task:
    """Make a task of a trajectory file's content.

    Raises:
        ConfigError: as ``load_trajectory``; the line names the source.
    """
    file = validated(content, TrajectoryFile, source)
    begin = {digit: angles[0] for digit, angles in file.angle_deg.items() if angles}
    follow = {"kind": "follow", "time_s": file.time_s, "angle_deg": file.angle_deg}
    phases = [{"kind": "move", "name": "to the start", "angle_deg": begin, "duration_s": 1.5}, follow]
    return validated({"schema": 1, "name": file.name, "phase": phases}, Task, source)


def load_task(path: Path) -> Task:
    """Read a task file.

    Raises:
        ConfigError: it cannot be read, or a key or value is wrong.
    """
    return load_document(path, Task)


class Shape(NamedTuple):
    """How many numbers a digit takes.

    Attributes:
        coordinates: reduced coordinates, each with an angle.
        tendons: each with a tension. A finger of n joints may have n + 1.
    """

    coordinates: int
    tendons: int


def shapes(hand: Hand) -> dict[str, Shape]:
    """Return the shape of each digit by its name."""
    counts = {name: part.stop - part.start for name, part in hand.digit_tendons.items()}
    return {
        digit.name: Shape(len(digit.coupling[0]) if digit.coupling else len(digit.joints), counts[digit.name])
        for digit in hand.digit
    }


def check_task(
    task: Task, digits: tuple[str, ...], ceiling: float, where: str, digit_shapes: Mapping[str, Shape] | None = None
) -> None:
    """Check a task against a hand.

    Args:
        task: the task.
        digits: the hand's digit names.
        ceiling: the hand's smallest tension limit [N].
        where: the file's name, for the message.
        digit_shapes: of each digit; None: not checked.

    Raises:
        ConfigError: it names a digit that is not there, gives it too many numbers, or asks for too much tension.
    """
    for i, phase in enumerate(task.phase):
        for key in ("angle_deg", "tension_N", "tip_force_N", "contact_tension_N", "slip_limit_N"):
            value, place = getattr(phase, key, None), f"{where}: phase[{i}].{key}"
            per_digit = value if isinstance(value, dict) else {}
            for digit in per_digit.keys() - set(digits):
                raise ConfigError(f"no digit {digit!r}", place, "one of " + ", ".join(digits))
            if key.endswith("deg") and isinstance(phase, Follow):
                continue
            for digit, given in per_digit.items():
                _count(digit, given, digit_shapes, place)
            values = per_digit.values() if isinstance(value, dict) else [value]
            numbers = [n for v in values for n in (v if isinstance(v, tuple) else (v,))]
            largest = max((n for n in numbers if n is not None), default=0.0)
            if key in ("tension_N", "contact_tension_N", "slip_limit_N") and largest > ceiling:
                raise ConfigError(f"{largest:g} N", place, f"at most tension_max_N = {ceiling:g} N")


def _count(digit: str, given: object, digit_shapes: Mapping[str, Shape] | None, place: str) -> None:
    """Refuse a list that does not fit its digit: an angle per coordinate, a tension per tendon."""
    if digit_shapes is None or not isinstance(given, tuple):
        return
    shape = digit_shapes[digit]
    count = shape.coordinates if place.endswith("deg") else shape.tendons
    if len(given) == count:
        return
    noun = "coordinate" if place.endswith("deg") else "tendon"
    right = f"one number, or {count}: it has {count} {noun}s" if count > 1 else f"one number: it has one {noun}"
    raise ConfigError(f"{len(given)} numbers for {digit}", place, right)


Value = TypeVar("Value")


def for_digit(value: float | dict[str, Value], digit: str) -> float | Value | None:
    """The value that a phase gives a digit; None if it names others only."""
    return value.get(digit) if isinstance(value, dict) else float(value)
