"""Checks whether a hand can execute a task: speeds of moves, joint ranges, tip forces, and slip limits."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from handctl.core.control_law.trajectory import minimum_jerk_duration
from handctl.core.tick_types import Vector
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.file.section_models import Digit
from handctl.hand.readiness_checks import displayed_range
from handctl.programs.task import (
    FOLLOW_SPEED_DEG_S,
    ClosePhase,
    FollowPhase,
    HoldPhase,
    MovePhase,
    Task,
    TaskPhase,
    check_task,
    end_angles,
    interpolating_curve,
    joint_values,
    phase_key,
    shapes_of_digits,
    value_for_digit,
)

CoordinateRange = tuple[Vector, Vector]
"""Lowest and highest value of the coordinates of a digit [deg or mm]."""


def check_task_for_hand(
    task: Task, hand: Hand, task_name: str, digits: Sequence[DigitModel] = ()
) -> None:
    """Check that a hand can execute a task, before the task begins.

    Args:
        task: task to check.
        hand: hand that shall execute the task.
        task_name: name of the task file, for error messages.
        digits: models of the hand's digits. If the models are not given, the function builds the
            models, which takes milliseconds.

    Raises:
        ConfigError: the task names an unknown digit, or gives a digit the wrong number of values.
            The error is also raised if a tension or an angle is out of range, a move is too fast, a
            tip force is for an underactuated digit, or a slip limit is below the tension.
    """
    check_task(
        task,
        hand.digit_names,
        min(tendon.tension_max_N for tendon in hand.tendon),
        task_name,
        shapes_of_digits(hand),
    )
    check_tip_force(task, hand, task_name)
    check_slip_limit(task, hand, task_name)
    digits = digits or DigitModel.digit_models_of_hand(hand)
    check_joint_range(task, hand, task_name, digits)
    check_speed(task, digits, task_name)


def check_speed(task: Task, models: Sequence[DigitModel], task_name: str) -> None:
    """Check that no move of a task exceeds the largest joint speed.

    The check considers all positions from which a move can start after the earlier phases.

    Args:
        task: task with the right number of values for each digit.
        models: models of the hand's digits.
        task_name: name of the task file, for error messages.

    Raises:
        ConfigError: the duration of a move is too short.
    """
    digits = {model.name: model for model in models}
    zero_coordinates = {name: np.zeros(model.coupling.shape[1]) for name, model in digits.items()}
    range_by_digit: dict[str, CoordinateRange] = {
        name: (zero, zero) for name, zero in zero_coordinates.items()
    }  # the digits of the hand are open when the hand is armed
    for i, phase in enumerate(task.phase):
        if isinstance(phase, FollowPhase):
            _check_curves(phase, models, f"{task_name}: {phase_key(i, phase)}.angle_deg")
        for digit, angle_range in range_by_digit.items():
            low, high = angle_range
            end_from_low = _coordinates_after_phase(phase, digits[digit], low)
            end_from_high = _coordinates_after_phase(phase, digits[digit], high)
            if end_from_low is None or end_from_high is None:
                continue
            if isinstance(phase, MovePhase):
                units = digits[digit].coordinate_units
                distances = np.maximum(np.abs(end_from_low - low), np.abs(high - end_from_high))
                worst_coordinate = int(np.argmax(distances / units.displayed_per_degree))
                # The speed limit of a prismatic joint corresponds to the speed limit of a hinge
                # with a usual moment arm.
                travel = float((distances / units.displayed_per_degree)[worst_coordinate])
                min_duration = (
                    math.ceil(100.0 * minimum_jerk_duration(travel, FOLLOW_SPEED_DEG_S, 0.0))
                    / 100.0
                )
                if phase.duration_s < min_duration:
                    unit = units.names[worst_coordinate]
                    limit = FOLLOW_SPEED_DEG_S * units.displayed_per_degree[worst_coordinate]
                    distance = f"{digit} may have {distances[worst_coordinate]:g} {unit} to go, at {limit:.4g} {unit}/s"
                    expected = f"at least {min_duration:g} s: {distance}"
                    raise ConfigError(
                        f"{phase.duration_s:g}",
                        f"{task_name}: {phase_key(i, phase)}.duration_s",
                        expected,
                    )
            is_close_phase = isinstance(phase, ClosePhase)  # a close phase can end at any angle
            end_angles_text = (
                (np.minimum(low, end_from_low), np.maximum(high, end_from_high))
                if is_close_phase
                else (end_from_low, end_from_high)
            )
            range_by_digit[digit] = end_angles_text


def _check_curves(phase: FollowPhase, models: Sequence[DigitModel], task_name: str) -> None:
    """Check that no prismatic joint moves too fast along the curve of a follow phase.

    A task file does not contain the joint types. The earlier check of the task file therefore
    treats all joints as hinges.
    """
    for model in models:
        for name in (model.name, *model.joint_names):
            angles = phase.angle_deg.get(name)
            units = model.coordinate_units if name == model.name else model.joint_units
            j = 0 if name == model.name else model.joint_names.index(name)
            if angles is None or not units.is_prismatic[j]:
                continue
            limit = FOLLOW_SPEED_DEG_S * units.displayed_per_degree[j]
            peak = interpolating_curve(phase.time_s, angles).peak_speed()
            if peak > limit:
                expected = f"at most {limit:.4g} mm/s on the way"
                raise ConfigError(f"{name} reaches {peak:.0f} mm/s", task_name, expected)


def _coordinates_after_phase(
    phase: TaskPhase, digit: DigitModel, present_angles: Vector
) -> Vector | None:
    """Return the coordinates [deg] that a digit has after a phase.

    The phase begins at ``present_angles``.

    Return None if the phase does not move the digit.
    """
    if isinstance(phase, FollowPhase):
        last_angles = {name: angles[-1] for name, angles in phase.angle_deg.items()}
        goal_angles = end_angles(last_angles, digit, present_angles)  # type: ignore[arg-type]  # a dict of numbers
    elif isinstance(phase, MovePhase | ClosePhase):
        goal_angles = end_angles(phase.angle_deg, digit, present_angles)
    else:
        return None
    return (
        None
        if goal_angles is None
        else np.broadcast_to(np.array(goal_angles, dtype=float), present_angles.shape)
    )


COUPLING_TOLERANCE_DEG = 0.5
"""Largest difference between a given joint angle and the nearest angle that the digit's coupling allows [deg]."""


ROUNDING_DEG = 1e-6
"""Largest possible rounding error of a sum of angles [deg]."""


def check_joint_range(task: Task, hand: Hand, task_name: str, digits: Sequence[DigitModel]) -> None:
    """Check that the angles of a task are within the range of each digit.

    A joint beyond its range would press against its stop.

    Args:
        task: task that has passed ``check_task``.
        hand: hand that shall execute the task.
        task_name: name of the task file, for error messages.
        digits: models of the hand's digits.

    Raises:
        ConfigError: the joints of a digit cannot reach an angle of the task together.
    """
    range_and_units_by_digit = {
        digit.name: (
            digit.coordinate_units.to_display_units(digit.coordinate_limits),
            digit.coordinate_units.names,
        )
        for digit in digits
    }
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, MovePhase | ClosePhase | FollowPhase):
            continue
        for digit in digits:
            _check_joints(
                phase,
                digit,
                hand.digit_named(digit.name),
                f"{task_name}: {phase_key(i, phase)}.angle_deg",
            )
        for name, ((low, high), names) in range_and_units_by_digit.items():
            for row in _required_angles(phase, name):
                for angle, lower, upper, unit in zip(
                    *np.broadcast_arrays(row, low, high), names, strict=True
                ):
                    if not lower - ROUNDING_DEG <= angle <= upper + ROUNDING_DEG:
                        angle_key = f"{task_name}: {phase_key(i, phase)}.angle_deg"
                        raise ConfigError(
                            f"{angle:g} {unit} for {name}",
                            angle_key,
                            f"{lower:g} to {upper:g} {unit}",
                        )


def _check_joints(
    phase: MovePhase | ClosePhase | FollowPhase,
    digit: DigitModel,
    digit_description: Digit,
    phase_path: str,
) -> None:
    """Check that joint angles are within their limits.

    The function also checks that coupled joints can have the given angles at the same time.
    """
    angles = joint_values(phase.angle_deg, digit)
    if not angles:
        return
    low, high = digit.joint_units.to_display_units(digit.joint_limits)
    if digit.coupling.shape[1] == 1:
        # All joints of a digit with one tendon turn together until one of the joints reaches its
        # limit.
        coordinate_range = np.sort(
            digit.coupling @ np.array(displayed_range(digit_description)).T, axis=1
        )
        low, high = (
            np.maximum(low, coordinate_range[:, 0]),
            np.minimum(high, coordinate_range[:, 1]),
        )
    # A curve has one row of angles for each of its times.
    for row in np.atleast_2d(np.array(list(angles.values()), dtype=float).T):
        for j, angle in zip(angles, row, strict=True):
            if not low[j] - ROUNDING_DEG <= angle <= high[j] + ROUNDING_DEG:
                unit = digit.joint_units.names[j]
                raise ConfigError(
                    f"{angle:g} {unit} for {digit.joint_names[j]}",
                    phase_path,
                    f"{low[j]:g} to {high[j]:g} {unit}",
                )
        end = digit.with_joint_angles(
            dict(zip(angles, row.tolist(), strict=True)), np.zeros(digit.coupling.shape[1])
        )
        if np.abs((digit.coupling @ end)[list(angles)] - row).max() > COUPLING_TOLERANCE_DEG:
            names = ", ".join(digit.joint_names[j] for j in angles)
            raise ConfigError(
                f"{names} are coupled", phase_path, f"{digit.name}, one angle for all of them"
            )


def check_tip_force(task: Task, hand: Hand, task_name: str) -> None:
    """Check that a task requires no tip force from digits with fewer tendons than joints.

    In a digit with fewer tendons than joints, the tensions determine only combinations of joint
    torques, but not the force at the tip. In a test, fingers of the hand `jamia` had to press on a
    wall with 4 N. The fingers curled up and pressed with 23 to 56 N.

    Args:
        task: task that has passed ``check_task``.
        hand: hand that shall execute the task.
        task_name: name of the task file, for error messages.

    Raises:
        ConfigError: a hold phase gives `tip_force_N` to a digit with fewer tendons than joints.
    """
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, HoldPhase) or phase.tip_force_N is None:
            continue
        for name in hand.digit_names:
            tendons = hand.digit_tendons[name]
            joints = hand.digit_joints[name]
            joint_count = joints.stop - joints.start
            tendon_count = tendons.stop - tendons.start
            if tendon_count < joint_count and value_for_digit(phase.tip_force_N, name) is not None:
                tendons_text = f"{tendon_count} tendon{'s' * (tendon_count > 1)}"
                problem = f"{name} has {tendons_text} for {joint_count} joints: no force at its tip can be made"
                raise ConfigError(
                    problem,
                    f"{task_name}: {phase_key(i, phase)}.tip_force_N",
                    f"tension_N for {name}",
                )


def check_slip_limit(task: Task, hand: Hand, task_name: str) -> None:
    """Check that no slip limit is below the tension of the hold phase.

    If the slip limit were below the hold tension, the tension could not rise after slip.

    Args:
        task: task that has passed ``check_task``.
        hand: hand that shall execute the task.
        task_name: name of the task file, for error messages.

    Raises:
        ConfigError: a hold phase has a `slip_limit_N` below its `tension_N`.
    """
    for i, phase in enumerate(task.phase):
        if (
            not isinstance(phase, HoldPhase)
            or phase.slip_limit_N is None
            or phase.tension_N is None
        ):
            continue
        for name in hand.digit_names:
            limit = value_for_digit(phase.slip_limit_N, name)
            tension = value_for_digit(phase.tension_N, name)
            if limit is not None and tension is not None and np.max(limit) < np.max(tension):
                expected = f"at least tension_N of {name}, {np.max(tension):g}"
                raise ConfigError(
                    f"{np.max(limit):g}",
                    f"{task_name}: {phase_key(i, phase)}.slip_limit_N",
                    expected,
                )


def _required_angles(
    phase: MovePhase | ClosePhase | FollowPhase, name: str
) -> Iterable[float | tuple[float, ...]]:
    """Return the angles [deg] that a digit must reach in a phase.

    An entry of the result is one angle for all coordinates, or a tuple with one angle for each
    coordinate.
    """
    if isinstance(phase, FollowPhase):
        angles = phase.angle_deg.get(name)
        return (min(angles), max(angles)) if angles else ()
    angle = value_for_digit(phase.angle_deg, name)
    return () if angle is None else (angle,)
