"""Task files, in which a user describes the phases of a grasp."""

import functools
import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import Field, model_validator

from handctl.core.control_law.trajectory import CurveTrajectory
from handctl.core.tick_types import Vector
from handctl.document import Document, load_document, validate_content
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import read_toml

# The import is only for type checks, because the imported module imports numba, and reading a task
# does not need numba.
if TYPE_CHECKING:
    from handctl.hand.digit import DigitModel

AngleDeg = Annotated[float, Field(ge=-30, le=150)]
TensionN = Annotated[float, Field(ge=0, le=1000)]
ForceN = Annotated[float, Field(ge=0, le=200)]
DigitAnglesDeg = AngleDeg | Annotated[tuple[AngleDeg, ...], Field(min_length=1)]
"""Angles of a digit: one angle for all its joints, or one angle for each of its coordinates."""
DigitTensionsN = TensionN | Annotated[tuple[TensionN, ...], Field(min_length=1)]
"""Tensions of a digit: one tension for all its tendons, or one tension for each tendon."""
DurationS = Annotated[float, Field(gt=0, le=3600)]


FOLLOW_SPEED_DEG_S = 700.0
"""Largest joint speed of a motion [deg/s].

If a rotor stops at once, it adds tension in proportion to the speed of the rotor.
"""
SHORTEST_MOVE_S = 0.05
"""Shortest duration of a move [s].

A shorter move would be a step of the position, and the square of its duration can underflow.
"""
RESERVED_NAMES = ("start", "tare")
"""Phase names that a task file must not contain.

The controller uses the reserved names for the start of a program and for load cells without a tare.
"""


class MovePhase(Document):
    """Move to joint angles along a minimum-jerk path.

    Digits for which the phase gives no angle keep their positions.
    """

    kind: Literal["move"]
    name: str = "move"
    angle_deg: AngleDeg | dict[str, DigitAnglesDeg]
    """One angle for all joints, or one angle for each digit or joint (``index``, ``index_j1``).

    The angle of a digit with one tendon is its mean joint angle. A digit with a tendon for each
    joint also accepts a list of angles, from the palm outwards. Joints without an angle keep their
    positions.
    """
    duration_s: float = Field(1.0, ge=SHORTEST_MOVE_S, le=3600)


class ClosePhase(Document):
    """Close until contact. A digit in contact holds its tension while the other digits continue."""

    kind: Literal["close"]
    name: str = "close"
    angle_deg: AngleDeg | dict[str, DigitAnglesDeg] = 90.0
    """Angle at which a digit or joint without contact stops."""
    speed_deg_s: float = Field(60.0, gt=0, le=FOLLOW_SPEED_DEG_S)
    contact_tension_N: TensionN = 8.0
    """Smallest tension of a digit in contact."""
    timeout_s: DurationS = 10.0


class HoldPhase(Document):
    """Hold a tension or a tip force in the digits that are in contact.

    Digits without contact keep their present positions.
    """

    kind: Literal["hold"]
    name: str = "hold"
    tension_N: TensionN | dict[str, DigitTensionsN] | None = None
    tip_force_N: ForceN | dict[str, ForceN] | None = None
    slip_limit_N: TensionN | dict[str, TensionN] | None = None
    """Tension up to which slip raises the tensions. Without this limit, slip is only reported."""
    stiffness_N_per_mm: float = Field(0.0, ge=0, le=50)
    """Additional tension per millimetre that a tendon is pulled out after the grip has settled.

    With 0, the tension is constant.
    """
    rate_N_per_s: float = Field(60.0, gt=0, le=5000)
    duration_s: DurationS = 3.0

    @model_validator(mode="after")
    def _require_one_target(self) -> "HoldPhase":
        if (self.tension_N is None) == (self.tip_force_N is None):
            neither_or_both = "neither" if self.tension_N is None else "both"
            raise ValueError(
                f"{neither_or_both} of tension_N and tip_force_N; expected either tension_N or tip_force_N"
            )
        return self


class ReleasePhase(Document):
    """Lower the tensions.

    After the release, all digits count as digits without contact. A hold phase after the release
    acts only on digits that have made contact again.
    """

    kind: Literal["release"]
    name: str = "release"
    tension_N: TensionN = 8.0
    rate_N_per_s: float = Field(100.0, gt=0, le=5000)
    settle_s: float = Field(0.3, ge=0, le=60)


class FollowPhase(Document):
    """Follow a curve through given angles, from rest to rest.

    When the phase begins, the digits must already be at the first point of the curve.
    """

    kind: Literal["follow"]
    name: str = "follow"
    time_s: tuple[Annotated[float, Field(ge=0, le=3600)], ...] = Field(
        min_length=2, max_length=100_000
    )
    """Times of the given angles, rising from 0."""
    angle_deg: dict[str, tuple[AngleDeg, ...]] = Field(min_length=1)
    """Angles of each digit or joint, one for each time.

    Digits and joints without angles keep their positions.
    """

    @model_validator(mode="after")
    def _require_rising_times(self) -> "FollowPhase":
        if self.time_s[0] != 0.0 or any(b <= a for a, b in pairwise(self.time_s)):
            raise ValueError("time_s does not rise; expected rising times, the first of them 0")
        for digit, angles in self.angle_deg.items():
            if len(angles) != len(self.time_s):
                raise ValueError(
                    f"angle_deg.{digit} has {len(angles)} angles; expected one for each of the "
                    f"{len(self.time_s)} values of time_s"
                )
            peak = math.degrees(_peak_speed(self.time_s, tuple(map(math.radians, angles))))
            # The comparison is negated, so that the check also refuses NaN.
            if not peak <= FOLLOW_SPEED_DEG_S:
                raise ValueError(
                    f"angle_deg.{digit} reaches {peak:.0f} deg/s; expected at most "
                    f"{FOLLOW_SPEED_DEG_S:g} deg/s between two values of time_s"
                )
        return self


def _peak_speed(times_s: tuple[float, ...], angles: tuple[float, ...]) -> float:
    """Return the largest speed of a curve [rad/s].

    The speed is inf or NaN if the times of the curve are too close together.
    """
    with np.errstate(all="ignore"):
        try:
            return interpolating_curve(times_s, angles).peak_speed()
        # The library scipy raises ValueError for slopes that are not finite.
        except ValueError:
            return math.inf


@functools.lru_cache(maxsize=32)
def interpolating_curve(times_s: tuple[float, ...], angles: tuple[float, ...]) -> CurveTrajectory:
    """Return the curve on which one coordinate has given angles [rad] at given times [s].

    The computation of a curve takes up to 1 ms. The check of a task computes all curves of the task
    and stores the curves in a cache. A phase takes its curves from this cache.
    """
    return CurveTrajectory.curve_through_points(times_s, angles, 1)


TaskPhase = Annotated[
    MovePhase | ClosePhase | HoldPhase | ReleasePhase | FollowPhase, Field(discriminator="kind")
]


class Task(Document):
    """A grasp as a list of phases.

    The hand arms before the first phase and relaxes after the last.
    """

    schema_: int = Field(alias="schema", ge=1, le=1)
    name: str
    description: str = ""
    phase: tuple[TaskPhase, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _require_distinct_names(self) -> "Task":
        for phase in self.phase:
            if phase.name in RESERVED_NAMES:
                raise ValueError(f"a phase must not be named {' or '.join(RESERVED_NAMES)}")
        return self


class TrajectoryFile(Document):
    """A motion that another program has computed, given as positions at times."""

    schema_: int = Field(alias="schema", ge=1, le=1)
    name: str
    time_s: tuple[float, ...]
    angle_deg: dict[str, tuple[float, ...]]


def load_trajectory(path: Path) -> Task:
    """Read a trajectory file as a task.

    The task first moves the hand slowly to the first pose of the trajectory, and then follows the
    trajectory.

    Raises:
        ConfigError: the file cannot be read, the times do not increase, or an angle or a speed is
            out of range.
    """
    return task_from_trajectory_file(read_toml(path), str(path))


def phase_key(index: int, phase: TaskPhase) -> str:
    """Return the location of a phase in error messages, for example ``phase[grasp]``.

    If a phase has no name, the location contains the number of the phase, counted from 0. Messages
    about the file format contain phase locations in the same form.
    """
    return f"phase[{phase.name if 'name' in phase.model_fields_set else index}]"


def task_from_trajectory_file(file_content: Mapping[str, Any], source_name: str) -> Task:
    """Make a task from the content of a trajectory file.

    Raises:
        ConfigError: The content is not a valid trajectory, see `load_trajectory`. The error message
            contains the source name.
    """
    file = validate_content(file_content, TrajectoryFile, source_name)
    # The phase is validated alone, so that an error message contains the key in the trajectory
    # file.
    follow_content = {"kind": "follow", "time_s": file.time_s, "angle_deg": file.angle_deg}
    follow_phase = validate_content(follow_content, FollowPhase, source_name)
    first_angles: dict[str, DigitAnglesDeg] = {
        digit: angles[0] for digit, angles in follow_phase.angle_deg.items()
    }
    move_phase = MovePhase(kind="move", name="to the start", angle_deg=first_angles, duration_s=1.5)
    return Task(schema_=1, name=file.name, phase=(move_phase, follow_phase))


def load_task(path: Path) -> Task:
    """Read a task file.

    Raises:
        ConfigError: The file cannot be read, or a key or a value is wrong.
    """
    return load_document(path, Task)


class DigitShape(NamedTuple):
    """Number of angles and number of tensions that a task may give for a digit, and the names of the digit's joints.

    Attributes:
        coordinates: number of coordinates of the digit, each with an angle.
        tendons: number of tendons of the digit, each with a tension. For example, a finger of n
            joints can have n + 1 tendons.
        joints: names of the joints.
    """

    coordinates: int
    tendons: int
    joints: tuple[str, ...] = ()


def shapes_of_digits(hand: Hand) -> dict[str, DigitShape]:
    """Return the number of values that a task may give for each digit, by the name of the digit."""
    counts = {
        name: tendon_slice.stop - tendon_slice.start
        for name, tendon_slice in hand.digit_tendons.items()
    }
    return {
        digit.name: DigitShape(
            len(digit.coupling[0]) if digit.coupling else len(digit.joints),
            counts[digit.name],
            digit.joints,
        )
        for digit in hand.digit
    }


def check_task(
    task: Task,
    digits: tuple[str, ...],
    tension_limit: float,
    task_name: str,
    digit_shapes: Mapping[str, DigitShape] | None = None,
) -> None:
    """Check that a hand has the digits and joints that a task names, and that the task's values are allowed.

    Args:
        task: task to check.
        digits: names of the hand's digits.
        tension_limit: smallest of the tension limits in the hand [N].
        task_name: name of the file, for messages.
        digit_shapes: allowed number of values for each digit, or None to skip this check.

    Raises:
        ConfigError: the task names an unknown digit, gives a digit the wrong number of values, or
            requests too much tension.
    """
    for i, phase in enumerate(task.phase):
        for key in ("angle_deg", "tension_N", "tip_force_N", "contact_tension_N", "slip_limit_N"):
            value = getattr(phase, key, None)
            key_path = f"{task_name}: {phase_key(i, phase)}.{key}"
            value_by_digit = value if isinstance(value, dict) else {}
            joints = _digit_of_joint(digit_shapes) if key == "angle_deg" else {}
            for name in sorted(value_by_digit.keys() - {*digits, *joints}):
                joint = f", or a joint such as {next(iter(joints))}" if joints else ""
                raise ConfigError(
                    f"no digit {name!r}", key_path, "one of " + ", ".join(digits) + joint
                )
            for name in sorted(value_by_digit.keys() & joints.keys()):
                if joints[name] in value_by_digit:
                    raise ConfigError(
                        f"{joints[name]} and {name}", key_path, "either the digit or its joints"
                    )
            if key.endswith("deg") and isinstance(phase, FollowPhase):
                continue
            for digit, setting in value_by_digit.items():
                _check_count(digit, setting, digit_shapes, key_path)
            values = value_by_digit.values() if isinstance(value, dict) else [value]
            numbers = [n for v in values for n in (v if isinstance(v, tuple) else (v,))]
            largest = max((n for n in numbers if n is not None), default=0.0)
            if (
                key in ("tension_N", "contact_tension_N", "slip_limit_N")
                and largest > tension_limit
            ):
                raise ConfigError(
                    f"{largest:g} N", key_path, f"at most tension_max_N = {tension_limit:g} N"
                )


def _check_count(
    digit: str, value: object, digit_shapes: Mapping[str, DigitShape] | None, key_path: str
) -> None:
    """Check the length of a list of values for a digit: one angle per coordinate, or one tension per tendon."""
    if digit_shapes is None or not isinstance(value, tuple):
        return
    if digit not in digit_shapes:
        raise ConfigError(
            f"{len(value)} numbers for {digit}", key_path, "one number: it is one joint"
        )
    shape = digit_shapes[digit]
    count = shape.coordinates if key_path.endswith("deg") else shape.tendons
    if len(value) == count:
        return
    value_name = "coordinate" if key_path.endswith("deg") else "tendon"
    expected = (
        f"one number, or {count}: it has {count} {value_name}s"
        if count > 1
        else f"one number: it has one {value_name}"
    )
    raise ConfigError(f"{len(value)} numbers for {digit}", key_path, expected)


def _digit_of_joint(digit_shapes: Mapping[str, DigitShape] | None) -> dict[str, str]:
    """Return, for the name of each joint, the name of the digit to which the joint belongs."""
    return {joint: name for name, shape in (digit_shapes or {}).items() for joint in shape.joints}


Value = TypeVar("Value")


def value_for_digit(value: float | dict[str, Value], digit: str) -> float | Value | None:
    """Select the value that a task phase gives for a digit.

    The phase gives one number for all digits, or a dictionary with a value for each named digit.
    Return None if the dictionary does not name the digit.
    """
    return value.get(digit) if isinstance(value, dict) else float(value)


def joint_values(value: float | Mapping[str, Value], digit: "DigitModel") -> dict[int, Value]:
    """Return the values that a phase gives for single joints of a digit, by the index of the joint in the digit."""
    if not isinstance(value, Mapping):
        return {}
    return {j: value[name] for j, name in enumerate(digit.joint_names) if name in value}


def end_angles(
    value: float | dict[str, DigitAnglesDeg], digit: "DigitModel", present_angles: Vector
) -> DigitAnglesDeg | Vector | None:
    """Return the coordinates [deg] of a digit at the end of a phase.

    Return None if the phase contains no angle for the digit.

    Args:
        value: angles in the phase [deg], by the name of the digit or joint.
        digit: model of the digit.
        present_angles: (n_c,) coordinates at the beginning of the phase [deg]. Joints without an
            angle keep their present angles.
    """
    angles = joint_values(value, digit)
    if not angles:
        return value_for_digit(value, digit.name)
    return digit.with_joint_angles(
        {j: float(np.mean(angle)) for j, angle in angles.items()}, present_angles
    )
