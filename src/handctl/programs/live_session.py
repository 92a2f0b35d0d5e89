"""Programs that get their goals from requests.

`LiveProgram` is a live session for `jog` or a client. `JogProgram` keeps one goal for a limited
time.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import PEAK_SPEED_RATIO
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.errors import ConfigError
from handctl.programs.program import (
    TIGHTEN_TIMEOUT_S,
    ProgramProgress,
    ProgressAndEvents,
    coordinates_from_excursion,
    goal_to_move_to_angle,
    pull_tensions,
    slack_tendons,
    tension_goal,
    tightening_goals,
)
from handctl.programs.requests import HoldTensionRequest, MoveDigitsRequest
from handctl.programs.stream_plans import blended_move
from handctl.programs.task import (
    FOLLOW_SPEED_DEG_S,
    HoldPhase,
    MovePhase,
    Task,
    end_angles,
    joint_values,
)
from handctl.programs.task_checks import (
    COUPLING_TOLERANCE_DEG,
    ROUNDING_DEG,
    check_task_for_hand,
)
from handctl.programs.task_program import TaskProgram


def import_spline_functions() -> None:
    """Import the spline functions for the phase `follow` before a run.

    The import of ``scipy.interpolate`` takes 0.1 to 0.3 s. If the first phase `follow` of a client
    started the import, the tick would be so late that a real-time run would end.
    """
    import scipy.interpolate  # noqa: F401


@dataclass(frozen=True, slots=True)
class LiveProgram:
    """Program that tightens the tendons and waits for requests.

    The program waits for requests until it receives a stop request.
    """

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        """Return the progress at the start of the program, when the hand is not armed yet."""
        return ProgramProgress.initial(len(model.digits), "start")

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Advance the session by one tick. The interface `Program` explains the arguments."""
        if progress.task is not None:
            return _carry_out_task(model, progress, progress.task, estimate, measurements, t)
        if progress.phase == "start":
            progress = replace(progress, since=t, phase="tighten", goals=tightening_goals(model))
            return progress, (TickEvent("info", "phase", "", "tighten: taking up slack"),)
        if progress.phase == "tighten" and not slack_tendons(model, estimate):
            return replace(progress, phase="live"), (
                TickEvent("info", "phase", "", "live: waiting for requests"),
            )
        if progress.phase == "tighten" and t - progress.since > TIGHTEN_TIMEOUT_S:
            text = f"not taut after {TIGHTEN_TIMEOUT_S:g} s: {', '.join(slack_tendons(model, estimate))}"
            return replace(progress, finished=True, failure=text), (
                TickEvent("error", "tighten", "", text),
            )
        return progress, ()


LONGEST_HOLD_S = 3600.0
"""Duration of a task's hold that waits for ``release`` [s].

A task file does not allow a longer hold.
"""


def _carry_out_task(
    model: HandModel,
    progress: ProgramProgress,
    task: Task,
    estimate: HandEstimate,
    measurements: TickMeasurements,
    t: float,
) -> ProgressAndEvents:
    """Advance the task of a live session.

    After the task has ended or failed, the live session waits for requests again.
    """
    progress, events = TaskProgram(task).advance(model, progress, estimate, measurements, t)
    return (end_task(progress) if progress.finished else progress), events


def end_task(progress: ProgramProgress) -> ProgramProgress:
    """Return the progress of a live session after its task has been removed. The digits keep their goals."""
    return replace(
        progress, step=0, phase="live", finished=False, failure="", task=None, closing=(), grip=None,
        touching=(0,) * len(progress.touching),
    )  # fmt: skip


def begin_task(
    model: HandModel, progress: ProgramProgress, task: Task, estimate: HandEstimate, t: float
) -> ProgressAndEvents:
    """Begin a task.

    The first hold phase of the task ends when ``release_task`` is called, or after one hour.

    If the hand cannot execute the task, or if the first move of the task is too fast, the progress
    does not change.
    """
    try:
        check_task_for_hand(task, model.hand, "task", model.digits)
    except ConfigError as error:
        return progress, (TickEvent("warn", "request", "", f"refused: {error}"),)
    first_phase = task.phase[0]
    if isinstance(first_phase, MovePhase) and (
        refusal := _refusal_of_fast_first_move(model, first_phase, estimate)
    ):
        return progress, (refusal,)
    hold_index = next(
        (i for i, phase in enumerate(task.phase) if isinstance(phase, HoldPhase)), None
    )
    if hold_index is not None:
        hold_phase = task.phase[hold_index].model_copy(update={"duration_s": LONGEST_HOLD_S})
        task = task.model_copy(
            update={"phase": (*task.phase[:hold_index], hold_phase, *task.phase[hold_index + 1 :])}
        )
    progress, events = TaskProgram(task).begin_first_phase(
        model, replace(progress, task=task), estimate, t
    )
    if progress.finished:
        progress = end_task(progress)
    return progress, (TickEvent("info", "request", "", f"grasp {task.name}"), *events)


def _refusal_of_fast_first_move(
    model: HandModel, first_move: MovePhase, estimate: HandEstimate
) -> TickEvent | None:
    """Return a refusal event if the first move of a task would be too fast from the present angles.

    Return None if the first move is not too fast.
    """
    for d, name in enumerate(model.hand.digit_names):
        digit = model.digits[d]
        angle = end_angles(
            first_move.angle_deg,
            digit,
            digit.coordinate_units.to_display_units(coordinates_from_excursion(digit, estimate)),
        )
        if angle is None:
            continue
        end = np.broadcast_to(np.array(angle, dtype=float), (digit.coupling.shape[1],))
        if reason := _reach_problem(model, d, estimate, end, first_move.duration_s):
            return TickEvent("warn", "request", name, f"refused: {name} {reason}")
    return None


def release_task(progress: ProgramProgress) -> ProgressAndEvents:
    """End the hold phase of a task, so that the next phases of the task begin."""
    phase = progress.task.phase[progress.step - 1] if progress.task else None
    if not isinstance(phase, HoldPhase):
        return progress, (
            TickEvent("info", "request", "", "refused: no hold of a task, expected grasp first"),
        )
    event = TickEvent("info", "request", "", f"release after {phase.name}")
    return replace(progress, since=progress.since - LONGEST_HOLD_S), (event,)


@dataclass(frozen=True, slots=True)
class JogProgram:
    """Program that keeps one goal for a limited time.

    Attributes:
        request: request with the goal.
        duration: time for which the program keeps the goal [s].
    """

    request: MoveDigitsRequest | HoldTensionRequest
    duration: float

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        """Return the progress at the start of the program, when the hand is not armed yet."""
        return LiveProgram().initial_progress(model)

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Advance the jog by one tick. The interface `Program` explains the arguments."""
        progress, events = LiveProgram().advance(model, progress, estimate, measurements, t)
        if progress.phase == "live":
            goals = progress.goals
            progress, goal_events = apply_goal(model, progress, self.request, estimate, t)
            # If the program refuses the request, the goals do not change.
            if progress.goals is goals:
                return replace(
                    progress, finished=True, failure=goal_events[-1].text
                ), events + goal_events
            return replace(progress, phase="jog", since=t), events + goal_events
        if progress.phase == "jog" and t - progress.since >= self.duration:
            return replace(progress, finished=True), events
        return progress, events


def apply_goal(
    model: HandModel,
    progress: ProgramProgress,
    request: MoveDigitsRequest | HoldTensionRequest,
    estimate: HandEstimate,
    t: float,
    reference: tuple[Vector, ...] | None = None,
) -> ProgressAndEvents:
    """Apply the goals that a request contains.

    The goals do not change if the request names an unknown digit or joint, or if an angle, a speed
    or a tension is out of range.

    Args:
        model: model of the hand.
        progress: progress with the present goals.
        request: request of an operator or a client.
        estimate: estimated state of the hand in the present tick.
        t: time of the program [s].
        reference: for each digit, (3, n) position, rate and acceleration of the present reference.
            The move of a moving digit starts at its reference. The move of any other digit starts
            at the estimated angles. If ``reference`` is None, all moves start at the estimated
            angles.
    """
    names = model.hand.digit_names
    values = request.angle_deg if isinstance(request, MoveDigitsRequest) else request.tension_N
    expected = (*names, *model.hand.joints) if isinstance(request, MoveDigitsRequest) else names
    unknown_names = sorted(values.keys() - set(expected))
    if unknown_names or progress.phase in ("start", "tighten"):
        reason = (
            f"no digit {unknown_names[0]!r}, expected one of {', '.join(names)}"
            if unknown_names
            else "the hand is not ready yet"
        )
        return progress, (TickEvent("warn", "request", "", f"refused: {reason}"),)
    goals = list(progress.goals)
    contact = list(progress.contact)
    for d, name in enumerate(names):
        start = None if reference is None or goals[d].kind != GoalKind.MOTION else reference[d]
        if isinstance(request, MoveDigitsRequest):
            end = _end_coordinates_of_move(
                model, d, request.angle_deg, estimate if start is None else start[0]
            )
            if isinstance(end, str):
                return progress, (TickEvent("warn", "request", name, f"refused: {end}"),)
            if end is None:
                continue
            if reason := _reach_problem(model, d, estimate, end, request.duration_s):
                return progress, (TickEvent("warn", "request", name, f"refused: {name} {reason}"),)
            goal_coordinates = model.digits[d].coordinate_units.to_si_units(end)
            goals[d] = _move_goal(
                model, d, estimate, start, goal_coordinates, request.duration_s, t
            )
            contact[d] = False
        elif name in values:
            value, tendons = values[name], model.digit_tendons[d]
            limit = float(model.ceiling[tendons].min())
            if value > limit:
                text = f"refused: {value:g} N on {name}, expected at most {limit:g} N"
                return progress, (TickEvent("warn", "request", name, text),)
            target = pull_tensions(model, d, value, estimate)
            goals[d] = tension_goal(model, d, target, request.rate_N_per_s, estimate)
    text = f"{request.do} " + ", ".join(f"{name} {value:g}" for name, value in values.items())
    return replace(progress, goals=tuple(goals), contact=tuple(contact)), (
        TickEvent("info", "request", "", text),
    )


def _end_coordinates_of_move(
    model: HandModel, d: int, angle_of_digit: Mapping[str, float], start: HandEstimate | Vector
) -> Vector | str | None:
    """Return the coordinates [deg] at the end of a digit's move.

    Args:
        model: model of the hand.
        d: index of the digit.
        angle_of_digit: target angles [deg], by the name of the digit or joint.
        start: present coordinates [rad], or the estimate. Joints without a target angle keep their
            present angles.

    Returns:
        The coordinates, or None for a digit without a target angle. The result is a text with the
        reason if the digit cannot have the target angles at the same time.
    """
    digit, name = model.digits[d], model.hand.digit_names[d]
    count = digit.coupling.shape[1]
    joints = model.hand.joints[digit.joints]
    angles = joint_values(angle_of_digit, digit)
    if not angles:
        return np.full(count, angle_of_digit[name]) if name in angle_of_digit else None
    if name in angle_of_digit:
        return f"{name} and {joints[next(iter(angles))]}, expected either the digit or its joints"
    present_angles = digit.coordinate_units.to_display_units(
        np.clip(
            start if isinstance(start, np.ndarray) else coordinates_from_excursion(digit, start),
            *digit.coordinate_limits,
        )
    )
    end = digit.with_joint_angles(angles, present_angles)
    if (
        np.abs((digit.coupling @ end)[list(angles)] - list(angles.values())).max()
        > COUPLING_TOLERANCE_DEG
    ):
        return f"{', '.join(joints[j] for j in angles)} are coupled, expected {name}, one angle for all of them"
    return end


def _move_goal(
    model: HandModel,
    d: int,
    estimate: HandEstimate,
    start_coordinates: Vector | None,
    end_coordinates: Vector,
    duration: float,
    t: float,
) -> DigitGoal:
    """Return a move that begins at the digit's present motion reference (3, n): position, rate and acceleration.

    If the digit has no motion reference, the move begins at the estimated coordinates.
    """
    if start_coordinates is None:
        return goal_to_move_to_angle(model.digits[d], estimate, end_coordinates, duration, t)
    return DigitGoal(
        GoalKind.MOTION,
        blended_move(
            start_coordinates, end_coordinates, duration, model.digits[d].coordinate_limits
        ),
        since=t,
    )


def _reach_problem(
    model: HandModel, d: int, estimate: HandEstimate, end_coordinates: Vector, duration: float
) -> str:
    """Return the reason why a digit cannot move to given coordinates [deg] in a given time [s].

    Return an empty text if the digit can move to the coordinates.
    """
    digit = model.digits[d]
    units = digit.coordinate_units
    joint_min, joint_max = (units.to_display_units(bound) for bound in digit.coordinate_limits)
    for angle, low, high, unit in zip(
        end_coordinates, joint_min, joint_max, units.names, strict=True
    ):
        if not low - ROUNDING_DEG <= angle <= high + ROUNDING_DEG:
            return f"{angle:g} {unit}, expected from {low:g} to {high:g} {unit}"
    travel = np.abs(
        end_coordinates - units.to_display_units(coordinates_from_excursion(digit, estimate))
    )
    worst_coordinate = int(np.argmax(travel / units.displayed_per_degree))
    peak = PEAK_SPEED_RATIO * float(travel[worst_coordinate]) / duration
    unit, limit = (
        units.names[worst_coordinate],
        FOLLOW_SPEED_DEG_S * units.displayed_per_degree[worst_coordinate],
    )
    too_fast_text = (
        f"at up to {peak:.0f} {unit}/s, expected at most {limit:.4g} {unit}/s: give it more time"
    )
    return "" if peak <= limit else too_fast_text
