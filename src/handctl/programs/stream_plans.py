"""Streams of targets from a client, and the conversion of a target to goals of the digits."""

import functools
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.tension_allocation import tensions_for_torque
from handctl.core.control_law.trajectory import BlendTrajectory, MinimumJerk, StreamedTrajectory
from handctl.core.estimation.tip_force import reduced_tip_lever
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import Vector
from handctl.hand.digit import DigitModel
from handctl.hand.dynamics import static_torque
from handctl.programs.program import ProgramProgress
from handctl.programs.requests import OpenStreamRequest

MOTION_MARGIN_TICKS = 2
"""Number of control periods by which a motion to a target is prolonged.

If the next target is late by less than the prolongation, the motion does not stop.
"""
STOP_DURATION_S = 0.15
"""Duration of the motion with which a streamed digit comes to rest [s]."""
MIN_STREAM_PERIODS_BEFORE_HOLD = 2
"""Smallest number of stream periods without a target after which the hand holds its position.

With two periods, the loss of a single target does not cause a hold.
"""
MAX_TARGET_VALUES_BY_SPACE = {"joint": 720.0, "digit": 720.0, "tension": 5000.0, "tip_force": 500.0}
"""Largest value of a target [deg, N], for each meaning of targets (the ``space`` of the stream).

A larger value is a mistake of the client, and the controller refuses the target.
"""
TARGET_UNIT_BY_SPACE = {"joint": "deg", "digit": "deg", "tension": "N", "tip_force": "N"}
"""Unit of the values of a target, for each meaning of targets (the ``space`` of the stream)."""
MIN_STIFFNESS_FRACTION = 0.05
"""Smallest stiffness of a streamed digit, as a fraction of the digit's stiffness with the gains.

With less stiffness, friction would determine the position of a digit.
"""


@dataclass(frozen=True, slots=True)
class StreamPlan:
    """Settings of a stream of targets that a client sends.

    Attributes:
        name: name of the stream, which every target of the stream repeats.
        client: client that opened the stream.
        space: kind of values in a target, see ``requests.OpenStreamRequest``.
        names: names of the joints, digits or tendons to which the values of a target belong.
        interpolation: motion from one target to the next: "linear" or "minimum_jerk".
        period: time from one target to the next [s].
        horizon: time from the sending of a target until the time at which the hand should reach the
            target [s].
        joint_stiffness: stiffness of the streamed digits [N m/rad]. If ``joint_stiffness`` is None,
            the gains determine the stiffness.
        damping_ratio: damping ratio of the streamed digits, divided by the damping ratio with the
            gains.
    """

    name: str
    client: str
    space: str
    names: tuple[str, ...]
    interpolation: str
    period: float
    horizon: float
    joint_stiffness: float | None = None
    damping_ratio: float = 1.0

    @property
    def is_angle_stream(self) -> bool:
        """Return True for a stream of angles, and False for a stream of tensions or forces."""
        return TARGET_UNIT_BY_SPACE[self.space] == "deg"


class StreamStatus(NamedTuple):
    """State of a stream of targets after a tick.

    Attributes:
        number: number of the latest accepted target, or -1 before the first target.
        age_s: time since the latest accepted target was sent [s], or NaN before the first target.
        accepted: number of accepted targets of the stream.
        clipped: number of accepted targets that were clipped to the range of a joint.
        late: number of ignored targets, which were repeated, overtaken by a later target, or too
            old.
        refused: number of refused targets, with values that are not numbers, or a wrong number of
            values.
        limited: number of coordinates whose motion the limits of speed and acceleration reduce in
            the tick.
    """

    number: int = -1
    age_s: float = float("nan")
    accepted: int = 0
    clipped: int = 0
    late: int = 0
    refused: int = 0
    limited: int = 0


def target_horizon_s(rate_Hz: float, period: float) -> float:
    """Return the time [s] in which the hand should reach a target, counted from the sending of the target.

    Args:
        rate_Hz: rate of the stream [Hz].
        period: control period [s].
    """
    return 1.0 / rate_Hz + MOTION_MARGIN_TICKS * period


class TargetMapping(NamedTuple):
    """Linear map that converts the values of a streamed target to coordinates of the digits.

    Attributes:
        matrix: (C, V) coordinate [rad] per target value [deg], or coordinate [m] per target value
            [mm].
        is_streamed: (C,) True for each coordinate that the stream sets.
        digits: indices of the digits with a coordinate that the stream sets.
        digits_not_fully_holdable: indices of the streamed digits whose tendons cannot hold every posture, see
            ``nearest_holdable_posture``.
    """

    matrix: Vector
    is_streamed: NDArray[np.bool_]
    digits: tuple[int, ...]
    digits_not_fully_holdable: tuple[int, ...]


@functools.lru_cache(maxsize=16)
def mapping_of_stream(
    model: HandModel, space: str, element_names: tuple[str, ...]
) -> TargetMapping:
    """Return the map that converts the values of a streamed target to coordinates of the digits."""
    hand = model.hand
    values = np.zeros((model.coordinate_count, len(element_names)))
    digits = list[int]()
    rows = zip(hand.digit_names, model.digits, model.digit_coordinates, strict=True)
    for d, (name, digit, coordinate_slice) in enumerate(rows):
        if space == "digit" and name in element_names:
            values[coordinate_slice, element_names.index(name)] = 1.0
            digits.append(d)
        driven_joints = (
            [j for j, joint in enumerate(hand.joints[digit.joints]) if joint in element_names]
            if space == "joint"
            else []
        )
        if driven_joints:
            # Joints that are coupled by springs turn together, so that the mapping returns the
            # coordinates that are nearest to the given angles.
            columns = [element_names.index(hand.joints[digit.joints][j]) for j in driven_joints]
            values[coordinate_slice, columns] = np.linalg.pinv(digit.coupling[driven_joints])
            digits.append(d)
    is_streamed = np.abs(values).max(axis=1) > 1e-12
    held_digits = tuple([d for d in digits if _is_held_by_each_tendon(model.digits[d])])
    si_factor = np.concatenate([digit.coordinate_units.si_factor for digit in model.digits])
    return TargetMapping(values * si_factor[:, None], is_streamed, tuple(digits), held_digits)


def stream_refusal_reason(model: HandModel, request: OpenStreamRequest) -> str:
    """Return the reason why a hand cannot follow a stream, or an empty text if it can."""
    hand = model.hand
    expected = {"joint": hand.joints, "tension": hand.tendon_names}.get(
        request.space, hand.digit_names
    )
    kind = {"joint": "joint", "tension": "tendon"}.get(request.space, "digit")
    for name in request.names:
        if name not in expected:
            return f"no {kind} {name!r}, expected some of {', '.join(expected)}"
    if len(set(request.names)) < len(request.names):
        return "a name is given twice, expected each once"
    if request.space == "tip_force":
        for name in request.names:
            tendons, joints = model.digits[hand.digit_names.index(name)].moment_arms.shape
            if tendons < joints:
                return f"{name} has {tendons} tendons for {joints} joints, expected a stream of tension"
    if request.stiffness_N_m_per_rad is not None and TARGET_UNIT_BY_SPACE[request.space] != "deg":
        return f"a stiffness in a stream of {request.space}, expected one of angles"
    return ""


def stream_plan_or_refusal(model: HandModel, request: OpenStreamRequest) -> StreamPlan | str:
    """Return the plan of the stream that a request opens, or the reason why the request is refused."""
    if reason := stream_refusal_reason(model, request):
        return reason
    min_rate_hz = MIN_STREAM_PERIODS_BEFORE_HOLD * 1e3 / model.hand.stream.hold_after_ms
    max_rate_hz = 1.0 / model.period
    if not min_rate_hz <= request.rate_Hz <= max_rate_hz:
        limits = "stream.hold_after_ms of the hand file, and the control rate"
        return f"{request.rate_Hz:g} Hz, expected {min_rate_hz:g} to {max_rate_hz:g} Hz ({limits})"
    return StreamPlan(
        request.stream, request.client, request.space, request.names, request.interpolation, 1.0 / request.rate_Hz,
        target_horizon_s(request.rate_Hz, model.period), request.stiffness_N_m_per_rad, request.damping_ratio,
    )  # fmt: skip


TENSION_FLOOR_MARGIN_N = 0.5
"""Smallest difference between the tensions and the tension floor in a posture that counts as holdable [N]."""
MAX_NEWTON_STEPS = 4
"""Largest number of Newton steps towards a holdable posture.

More than one Newton step can be necessary, because the slope does not include gravity.
"""


def nearest_holdable_posture(
    digit: DigitModel, coordinates: Vector, tension_floor: Vector
) -> Vector:
    """Return the nearest coordinates [rad] at which taut tendons can balance springs and gravity.

    A tendon that flexes the outer joints also flexes the inner joints. To bend only the outer
    joints, an inner tendon would have to push, and would become slack. A slack tendon would make
    the safety monitor report a fault.

    Args:
        digit: model of the digit.
        coordinates: (n_c,) coordinates of the target [rad].
        tension_floor: (n_t,) smallest allowed tensions [N].
    """
    if not _is_held_by_each_tendon(digit):
        return coordinates
    angles = coordinates.copy()
    for _ in range(MAX_NEWTON_STEPS):
        torque_to_tension = digit.with_moment_arms_at(digit.coupling @ angles).torque_to_tension
        slope = torque_to_tension @ np.diag(digit.spring_stiffness) @ digit.coupling
        tension = torque_to_tension @ np.asarray(static_torque(digit, digit.coupling @ angles))
        tension_deficit = tension_floor + TENSION_FLOOR_MARGIN_N - tension
        is_tension_too_low = tension_deficit > 1e-6
        if not is_tension_too_low.any():
            break
        angles += np.linalg.pinv(slope[is_tension_too_low]) @ tension_deficit[is_tension_too_low]
    return angles


def _is_held_by_each_tendon(digit: DigitModel) -> bool:
    """Return True for a digit with several coordinates and with as many tendons as coordinates.

    In a digit with as many tendons as coordinates, the posture determines the tension of every
    tendon.
    """
    tendons, count = digit.reduced_moment_arms.shape
    return bool(tendons == count and count > 1)


def streamed_digits(model: HandModel, stream: StreamPlan) -> tuple[int, ...]:
    """Return the indices of the digits that a stream commands."""
    if stream.is_angle_stream:
        return mapping_of_stream(model, stream.space, stream.names).digits
    hand = model.hand
    if stream.space == "tip_force":
        return tuple(sorted(hand.digit_names.index(name) for name in stream.names))
    return tuple(
        sorted({model.digit_of_tendon[hand.tendon_names.index(name)] for name in stream.names})
    )


def loop_fractions(model: HandModel, stream: StreamPlan) -> tuple[Vector, Vector]:
    """Return stiffness (N,) and damping (N,) of a stream's motion loop, as fractions of the values in the gains.

    The stiffness of a joint is the stiffness of the tendon's loop [N/m] times the square of the
    tendon's moment arm. If the damping is proportional to the square root of the stiffness, the
    damping ratio stays the same. The motion loop is stable with the stiffness and the damping in
    the gains. The returned fractions are therefore at most 1.
    """
    stiffness = np.ones(model.tendon_count)
    damping = np.ones(model.tendon_count)
    if stream.joint_stiffness is None:
        return stiffness, damping
    for d in streamed_digits(model, stream):
        digit = model.digits[d]
        # The conversion of the stiffness treats a prismatic joint like a motion on a circle whose
        # radius is the joint's scale.
        arms = ((digit.reduced_moment_arms * digit.coordinate_units.scale) ** 2).sum(axis=1)
        mass = (model.tendon_constants.motor_mass + model.tendon_constants.load_mass)[digit.tendons]
        full_stiffness = arms * mass * model.motion_design.stiffness[digit.tendons]
        stiffness[digit.tendons] = np.clip(
            stream.joint_stiffness / full_stiffness, MIN_STIFFNESS_FRACTION, 1.0
        )
        damping[digit.tendons] = np.minimum(
            stream.damping_ratio * np.sqrt(stiffness[digit.tendons]), 1.0
        )
    return stiffness, damping


def target_tensions(
    model: HandModel, stream: StreamPlan, values: Vector, present_tensions: Vector, q: Vector
) -> Vector:
    """Return the tensions (N,) [N] that a target requires, before the limits are applied.

    Args:
        model: model of the hand.
        stream: stream whose targets are tensions or forces.
        values: (V,) values of the target [N].
        present_tensions: (N,) present tension setpoints [N]. Tendons without a value in the target
            keep their present setpoints.
        q: (J,) joint angles [rad], for the levers of tip forces.
    """
    hand, tension = model.hand, present_tensions.copy()
    if stream.space == "tension":
        tension[[hand.tendon_names.index(name) for name in stream.names]] = values
        return tension
    for name, force in zip(stream.names, values.tolist(), strict=True):
        digit = model.digits[hand.digit_names.index(name)]
        angles, tendons = q[digit.joints], digit.tendons
        # In the coordinates of the digit, the torque is the sum of spring torque, gravity torque,
        # and tip force times lever.
        torque = digit.coupling.T @ np.asarray(static_torque(digit, angles))
        torque += max(force, 0.0) * reduced_tip_lever(digit, angles)
        arms = digit.with_moment_arms_at(angles).reduced_moment_arms
        tension[tendons] = tensions_for_torque(
            arms, torque, model.floor[tendons], model.ceiling[tendons]
        )[0]
    return tension


def streamed_goals(
    progress: ProgramProgress, digits: tuple[int, ...], tension: tuple[Vector, ...] | None
) -> ProgramProgress:
    """Return a copy of the progress, with new goals for the digits that follow a stream.

    Args:
        progress: progress with the present goals.
        digits: indices of the digits that follow the stream.
        tension: for each digit of the hand, the present tension setpoints [N] in a stream of
            tensions, or None for a stream of angles.
    """
    goals = list(progress.goals)
    contact = list(progress.contact)
    for d in digits:
        if tension is None:
            goals[d] = DigitGoal(GoalKind.MOTION, StreamedTrajectory())
            contact[d] = False
        else:
            goals[d] = DigitGoal(
                GoalKind.TENSION, tension=tension[d].copy(), rate=STREAMED_GOAL_RATE
            )
    return replace(progress, goals=tuple(goals), contact=tuple(contact))


STREAMED_GOAL_RATE = 0.0
"""Rate of the goal of a digit with streamed tensions [N/s].

The rate has no effect, because streamed targets contain the tension setpoints.
"""


def stop_moving_digits(
    progress: ProgramProgress,
    reference: tuple[Vector, ...],
    tension: tuple[Vector, ...],
    t: float,
    coordinate_bounds: tuple[tuple[Vector, Vector], ...],
    streamed_digits_only: bool,
) -> ProgramProgress:
    """Return a copy of the progress, with new goals that bring moving digits to rest.

    Args:
        progress: progress with the present goals.
        reference: (3, n) position, rate and acceleration of the present motion reference, for each
            digit.
        tension: for each digit, the present tension setpoints [N].
        t: time of the program [s].
        coordinate_bounds: lowest and highest coordinates of each digit [rad].
        streamed_digits_only: True to bring only the digits that follow a stream to rest.
    """
    goals = list(progress.goals)
    for d, goal in enumerate(goals):
        if goal.kind == GoalKind.TENSION and goal.rate == STREAMED_GOAL_RATE:
            goals[d] = DigitGoal(GoalKind.TENSION, tension=tension[d].copy())
        if goal.kind == GoalKind.MOTION and (
            isinstance(goal.trajectory, StreamedTrajectory) or not streamed_digits_only
        ):
            position, rate, _ = reference[d]
            end = np.clip(position + 0.5 * STOP_DURATION_S * rate, *coordinate_bounds[d])
            goals[d] = DigitGoal(
                GoalKind.MOTION,
                blended_move(reference[d], end, STOP_DURATION_S, coordinate_bounds[d]),
                since=t,
            )
    return replace(progress, goals=tuple(goals))


SHORTEST_BLEND_S = 0.05
"""Shortest time in which the speed of an earlier motion decreases to zero [s]."""
_CHECKED_FRACTIONS = np.linspace(0.0, 1.0, 33)[1:]
"""Instants at which the positions of a move are checked, as fractions of the move's fade-out time."""


def blended_move(
    reference: Vector, end: Vector, duration: float, coordinate_bounds: tuple[Vector, Vector]
) -> MinimumJerk:
    """Return a move that continues the motion of a reference and ends at rest.

    The move begins with the position, rate and acceleration of the reference. The initial rate and
    acceleration fade out during the first part of the move. If a fast motion faded out slowly, the
    joints would go far beyond the start and the end of the move. The function first tries a
    fade-out time that equals the duration of the move. The function halves the fade-out time of the
    initial motion until the joints stay within ``coordinate_bounds``. The shortest fade-out time is
    ``SHORTEST_BLEND_S``.

    Args:
        reference: (3, n) position, rate and acceleration at the start [rad, s].
        end: (n,) coordinates at the end [rad].
        duration: duration of the move [s].
        coordinate_bounds: lowest and highest coordinates [rad].
    """
    position, rate, acceleration = (row.copy() for row in reference)
    if not rate.any() and not acceleration.any():
        return MinimumJerk(position, end, duration)
    blend = duration
    while True:
        move = MinimumJerk(position, end, duration, BlendTrajectory(rate, acceleration, blend))
        sampled_positions = np.array(
            [move.motion_at(share * blend)[0] for share in _CHECKED_FRACTIONS]
        )
        is_inside = (sampled_positions >= np.minimum(coordinate_bounds[0], position)).all() and (
            sampled_positions <= np.maximum(coordinate_bounds[1], position)
        ).all()
        if is_inside or blend <= SHORTEST_BLEND_S:
            return move
        blend = max(0.5 * blend, SHORTEST_BLEND_S)


def is_target_plausible(stream: StreamPlan, values: tuple[float, ...]) -> bool:
    """Return True if a target has the right number of values, and every value is finite and plausible."""
    outlier = MAX_TARGET_VALUES_BY_SPACE[stream.space]
    return len(values) == len(stream.names) and all(abs(value) <= outlier for value in values)
