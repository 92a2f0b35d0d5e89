"""Program that executes a task file: move, close until contact, hold, release."""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.tension_allocation import tensions_for_torque
from handctl.core.control_law.trajectory import CurveTrajectory, minimum_jerk_duration
from handctl.core.estimation.tip_force import joint_lever, reduced_tip_lever
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.hand.digit import DigitModel
from handctl.programs.grip import GripPlan, GripState, advance_grip
from handctl.programs.program import (
    TAUT_DURATION_S,
    TIGHTEN_TIMEOUT_S,
    ProgramProgress,
    ProgressAndEvents,
    coordinates_from_excursion,
    goal_to_move_to_angle,
    pull_tensions,
    released_tensions,
    slack_tendons,
    tension_goal,
    tightening_goals,
)
from handctl.programs.task import (
    SHORTEST_MOVE_S,
    ClosePhase,
    FollowPhase,
    HoldPhase,
    MovePhase,
    ReleasePhase,
    Task,
    end_angles,
    interpolating_curve,
    joint_values,
    value_for_digit,
)

MAX_CURVE_START_DISTANCE_DEG = 4.0
"""Largest accepted distance of a digit from the start of a curve [deg]."""
SETTLE_AFTER_CLOSE_S = 0.3
"""Time after a close phase in which a digit without contact comes to rest before the next phase [s]."""
MAX_TENSION_ABOVE_RELEASE_N = 2.0
"""Largest difference between the tension of a released tendon and the tension of the release phase [N]."""
RELEASE_TIMEOUT_S = 10.0
"""Longest allowed duration of a release phase [s]."""
REFERENCE_JOINT_COUNT = 2
"""Number of joints of a digit to which the contact threshold applies without a correction.

Each further joint adds its friction to the estimated tip force. On fingers of three joints that
touch no object, the estimated force is 0.33 N. Fingers of three joints still detect a contact at a
tip force far below 1 N.
"""
ARRIVAL_DURATION_S = 0.15
"""Time after the end of a trajectory at which a digit counts as arrived at its target [s]."""
CONTACT_THRESHOLD_FACTOR_AFTER_ARRIVAL = 2.0
"""Factor that multiplies the contact threshold of a digit that has arrived at its target.

A digit at rest touches no new object, and creeping friction can resemble a contact.
"""


@dataclass(frozen=True, slots=True)
class TaskProgram:
    """Program that executes the phases of a task.

    Step 0 of the program takes up the slack of the tendons. Each later step n executes phase n - 1
    of the task.
    """

    task: Task

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
        """Advance the task by one tick. The interface `Program` explains the arguments."""
        if progress.finished:
            return progress, ()
        if progress.phase == "start":
            progress = replace(progress, since=t, phase="tighten", goals=tightening_goals(model))
            return progress, (TickEvent("info", "phase", "", "tighten: taking up slack"),)
        if progress.phase == "tighten" and progress.step == 0:
            return self._wait_until_taut(model, progress, estimate, t)
        return self._advance_phase(model, progress, estimate, t)

    def begin_first_phase(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate, t: float
    ) -> ProgressAndEvents:
        """Begin the first phase of the task. The tendons of the hand must already be taut."""
        zero_contact_ticks = (0,) * len(model.digits)
        return self._enter_phase(
            model, replace(progress, step=0, touching=zero_contact_ticks), estimate, t
        )

    def _advance_phase(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate, t: float
    ) -> ProgressAndEvents:
        """Advance the present phase of the task by one tick."""
        phase = self.task.phase[progress.step - 1]
        events: tuple[TickEvent, ...] = ()
        if isinstance(phase, HoldPhase):
            if progress.grip is not None:
                progress, events = self._advance_hold(model, phase, progress, estimate, t)
        elif isinstance(phase, ClosePhase):
            progress, events = self._detect_contact(model, phase, progress, estimate, t)
        if self._is_phase_over(model, progress, estimate, t):
            events += self._release_warnings(model, progress, estimate)
            progress, entered = self._enter_phase(model, progress, estimate, t)
            events += entered
        return progress, events

    def _wait_until_taut(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate, t: float
    ) -> ProgressAndEvents:
        """Wait until all tendons have been taut for some time.

        The program has a counter. Each tick in which all tendons are taut increases the counter by
        one. Each tick with a slack tendon decreases the counter by one. Tension noise therefore
        delays the start of the task, but does not reset the counter to 0.
        """
        slack = slack_tendons(model, estimate)
        ticks = max(0, progress.touching[0] + (-1 if slack else 1))
        progress = progress.with_touching((ticks, *progress.touching[1:]))
        if ticks * model.period >= TAUT_DURATION_S:
            return self._enter_phase(
                model, replace(progress, touching=(0,) * len(model.digits)), estimate, t
            )
        if t - progress.since > TIGHTEN_TIMEOUT_S:
            text = f"not taut after {TIGHTEN_TIMEOUT_S:g} s: {', '.join(slack) or 'now one tendon, now another'}"
            return replace(progress, finished=True, failure=text), (
                TickEvent("error", "tighten", "", text),
            )
        return progress, ()

    def _enter_phase(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate, t: float
    ) -> ProgressAndEvents:
        """Begin the next phase of the task. After the last phase, the method ends the task."""
        step = progress.step + 1
        if step > len(self.task.phase):
            return replace(progress, finished=True, phase="end"), (
                TickEvent("info", "phase", "", "task complete"),
            )
        phase = self.task.phase[step - 1]
        # A phase that moves the hand and a phase after a release begin without contact.
        is_free_motion = isinstance(phase, MovePhase | FollowPhase) or (
            step > 1 and isinstance(self.task.phase[step - 2], ReleasePhase)
        )
        contact = (False,) * len(model.digits) if is_free_motion else progress.contact
        progress = replace(progress, step=step, since=t, phase=phase.name, contact=contact)
        names = model.hand.digit_names
        if isinstance(phase, FollowPhase) and (
            error := _curve_start_problem(model, phase, estimate)
        ):
            return replace(progress, finished=True, failure=error), (
                TickEvent("error", "phase", "", error),
            )
        goals = tuple(
            self._digit_goal(model, progress, d, names[d], estimate, t) for d in range(len(names))
        )
        events = [TickEvent("info", "phase", "", phase.name)]
        if isinstance(phase, HoldPhase) and not any(contact):
            events.append(TickEvent("warn", "phase", "", f"{phase.name}: no digit is in contact"))
        grip = (
            GripState.at_start_of_hold(model, goals, estimate, t)
            if isinstance(phase, HoldPhase) and any(contact)
            else None
        )
        zero_contact_ticks = (0,) * len(names)
        progress = replace(progress, goals=goals, touching=zero_contact_ticks, grip=grip)
        return replace(progress, closing=_closing_digits(phase, progress)), tuple(events)

    def _digit_goal(
        self,
        model: HandModel,
        progress: ProgramProgress,
        d: int,
        name: str,
        estimate: HandEstimate,
        t: float,
    ) -> DigitGoal:
        """Return the goal of digit d at the beginning of the present phase."""
        phase = self.task.phase[progress.step - 1]
        previous_goal = progress.goals[d]
        digit = model.digits[d]
        units = digit.coordinate_units
        if isinstance(phase, MovePhase):
            angle = end_angles(
                phase.angle_deg,
                digit,
                units.to_display_units(coordinates_from_excursion(digit, estimate)),
            )
            return (
                previous_goal
                if angle is None
                else goal_to_move_to_angle(
                    digit, estimate, units.to_si_units(angle), phase.duration_s, t
                )
            )
        if isinstance(phase, FollowPhase):
            curve = _curve_of_digit(phase, digit, estimate)
            return previous_goal if curve is None else DigitGoal(GoalKind.MOTION, curve, since=t)
        if isinstance(phase, ClosePhase):
            angle = end_angles(
                phase.angle_deg,
                digit,
                units.to_display_units(coordinates_from_excursion(digit, estimate)),
            )
            if angle is None or progress.contact[d]:
                return previous_goal
            # The same number is the speed of hinges in deg/s and of prismatic joints in mm/s.
            travel_to_goal = units.to_si_units(angle) - coordinates_from_excursion(digit, estimate)
            travel = float(np.abs(units.as_equivalent_angles(travel_to_goal)).max())
            duration = minimum_jerk_duration(
                travel, math.radians(phase.speed_deg_s), SHORTEST_MOVE_S
            )
            return goal_to_move_to_angle(digit, estimate, units.to_si_units(angle), duration, t)
        if not progress.contact[d]:
            return previous_goal
        if isinstance(phase, ReleasePhase):
            target = released_tensions(model, d, phase.tension_N)
            return tension_goal(model, d, target, phase.rate_N_per_s, estimate)
        tension = self._hold_tension(model, phase, d, name, estimate)
        return (
            previous_goal
            if tension is None
            else tension_goal(model, d, tension, phase.rate_N_per_s, estimate)
        )

    def _hold_tension(
        self, model: HandModel, phase: HoldPhase, d: int, name: str, estimate: HandEstimate
    ) -> Vector | None:
        """Return the tension targets (n_t,) [N] of a digit in a hold phase.

        The targets are computed from the tension or the tip force that the phase contains. Return
        None if the digit keeps its goal.
        """
        digit = model.digits[d]
        tendons = model.digit_tendons[d]
        if phase.tension_N is not None:
            tension = value_for_digit(phase.tension_N, name)
            return None if tension is None else pull_tensions(model, d, tension, estimate)
        assert phase.tip_force_N is not None
        force = value_for_digit(phase.tip_force_N, name)
        if force is None:
            return None
        q = estimate.q[digit.joints]
        # In the coordinates of the digit, the torque is the sum of spring torque, gravity torque,
        # and tip force times lever.
        torque = digit.coupling.T @ model.link_tree.static_torque(estimate.q)[
            digit.joints
        ] + force * reduced_tip_lever(digit, q)
        arms = digit.with_moment_arms_at(q).reduced_moment_arms
        return tensions_for_torque(arms, torque, model.floor[tendons], model.ceiling[tendons])[0]

    def _advance_hold(
        self,
        model: HandModel,
        phase: HoldPhase,
        progress: ProgramProgress,
        estimate: HandEstimate,
        t: float,
    ) -> ProgressAndEvents:
        """Update the grip during a hold phase, and raise the tensions of the grip after slip."""
        assert progress.grip is not None
        limit = phase.slip_limit_N
        plan = _grip_plan(
            model,
            phase.stiffness_N_per_mm,
            tuple(limit.items()) if isinstance(limit, dict) else limit,
        )
        grip, goals, events = advance_grip(model, progress.grip, plan, progress.goals, estimate, t)
        if grip is progress.grip and goals is progress.goals:
            return progress, events
        return replace(progress, grip=grip, goals=goals), events

    def _detect_contact(
        self,
        model: HandModel,
        phase: ClosePhase,
        progress: ProgramProgress,
        estimate: HandEstimate,
        t: float,
    ) -> ProgressAndEvents:
        """Detect the contact of closing digits, and make these digits hold their tension.

        For a digit that carries other digits, such as a wrist, the estimated tip force has no
        meaning. A digit that carries other digits continues its motion.
        """
        gains = model.gains.contact
        forces = estimate.contact_force.tolist()
        thresholds_in_motion = contact_thresholds_in_motion(model)
        if max(forces) <= min(thresholds_in_motion) and not any(progress.touching):
            return progress, ()  # most ticks of a close phase end here
        goals = list(progress.goals)
        contact = list(progress.contact)
        contact_ticks = [0] * len(goals)
        events: list[TickEvent] = []
        names = model.hand.digit_names
        for d, is_closing in enumerate(progress.closing):
            name = names[d]
            if not is_closing or name in model.hand.carrier_digits:
                continue
            threshold = contact_threshold(
                goals[d], thresholds_in_motion[d], t
            ) + contact_margin_without_cells(model, d)
            if not forces[d] > threshold:  # also if the force is NaN
                continue
            contact_ticks[d] = progress.touching[d] + 1
            if contact_ticks[d] >= gains.ticks:
                tendons = model.digit_tendons[d]
                contact[d] = True
                # If the tension of a digit already exceeds the contact tension, the digit keeps its
                # present tension.
                start = pull_tensions(model, d, phase.contact_tension_N, estimate)
                side = model.redundancy.closing_sign[tendons]
                pulling_tension = np.maximum(side * estimate.tension[tendons], side * start)
                is_closing_tendon = np.where(model.is_pair[tendons], side != 0.0, side > 0.0)
                start = np.where(is_closing_tendon, side * pulling_tension, start)
                goals[d] = tension_goal(model, d, start, model.gains.tension.rate_N_per_s, estimate)
                events.append(
                    TickEvent(
                        "info", "contact", name, f"{name} touches, {forces[d]:.2f} N at its tip"
                    )
                )
        if not events and tuple(contact_ticks) == progress.touching:
            return progress, ()
        changed_progress = replace(
            progress, goals=tuple(goals), contact=tuple(contact), touching=tuple(contact_ticks)
        )
        return replace(changed_progress, closing=_closing_digits(phase, changed_progress)), tuple(
            events
        )

    def _is_phase_over(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate, t: float
    ) -> bool:
        """Return True if the present phase of the task has ended."""
        phase = self.task.phase[progress.step - 1]
        elapsed = t - progress.since
        if isinstance(phase, (HoldPhase, MovePhase)):
            return elapsed >= phase.duration_s
        if isinstance(phase, FollowPhase):
            return elapsed >= phase.time_s[-1]
        if isinstance(phase, ClosePhase):
            return elapsed >= min(_time_to_close(progress.goals), phase.timeout_s)
        is_late = elapsed > RELEASE_TIMEOUT_S
        return elapsed >= phase.settle_s and (
            is_late or not _tensioned_digits(model, progress, phase, estimate)
        )

    def _release_warnings(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate
    ) -> tuple[TickEvent, ...]:
        """Return warnings for digits that still have too much tension at the end of a release."""
        phase = self.task.phase[progress.step - 1]
        if not isinstance(phase, ReleasePhase):
            return ()
        waiting_time_s = max(phase.settle_s, RELEASE_TIMEOUT_S)
        text = f"{phase.name}: above {phase.tension_N:g} N after {waiting_time_s:g} s, and going on"
        return tuple(
            [
                TickEvent("warn", "phase", name, text)
                for name in _tensioned_digits(model, progress, phase, estimate)
            ]
        )


@functools.lru_cache(maxsize=16)
def _time_to_close(goals: tuple[DigitGoal, ...]) -> float:
    """Return the time after which digits that have met no object have closed [s].

    If no digit moves, the result is 0.
    """
    durations = [
        goal.trajectory.duration
        for goal in goals
        if goal.kind == GoalKind.MOTION and goal.trajectory is not None
    ]
    return max(durations) + SETTLE_AFTER_CLOSE_S if durations else 0.0


def _closing_digits(
    phase: MovePhase | FollowPhase | ClosePhase | HoldPhase | ReleasePhase,
    progress: ProgramProgress,
) -> tuple[bool, ...]:
    """Return, for each digit, True if the digit is still closing and has no contact yet.

    The tuple is empty in a phase that is not a close phase.
    """
    if not isinstance(phase, ClosePhase):
        return ()
    rows = zip(progress.goals, progress.contact, strict=True)
    return tuple([goal.kind == GoalKind.MOTION and not in_contact for goal, in_contact in rows])


def _tensioned_digits(
    model: HandModel, progress: ProgramProgress, phase: ReleasePhase, estimate: HandEstimate
) -> list[str]:
    """Return the names of digits whose tension is still above the tension of the release phase.

    The function checks only digits under tension control.
    """
    limit = (
        np.maximum(phase.tension_N, model.redundancy.balance_tension) + MAX_TENSION_ABOVE_RELEASE_N
    )
    rows = zip(model.hand.digit_names, progress.goals, model.digit_tendons, strict=True)
    return [
        name
        for name, goal, tendons in rows
        if goal.kind == GoalKind.TENSION and (estimate.tension >= limit)[tendons].any()
    ]


@functools.lru_cache(maxsize=8)
def _grip_plan(
    model: HandModel,
    stiffness_N_per_mm: float,
    slip_limit: float | tuple[tuple[str, float], ...] | None,
) -> GripPlan:
    """Return the grip plan of a hold phase, which contains stiffness and slip limits.

    The grip plan has one slip limit for each tendon.

    Args:
        model: model of the hand.
        stiffness_N_per_mm: stiffness of the grip [N/mm].
        slip_limit: largest tension after slip [N], as one number or by the name of the digit, or
            None for no increase.
    """
    limit = np.full(model.tendon_count, np.nan)
    if slip_limit is not None:
        limit_by_digit = dict(slip_limit) if isinstance(slip_limit, tuple) else slip_limit
        for name, tendons in zip(model.hand.digit_names, model.digit_tendons, strict=True):
            value = value_for_digit(limit_by_digit, name)
            limit[tendons] = math.nan if value is None else value
    return GripPlan(1e3 * stiffness_N_per_mm, limit)


def _curve_start_problem(model: HandModel, phase: FollowPhase, estimate: HandEstimate) -> str:
    """Return a message if a digit is too far from the first point of its curve.

    Return an empty text if all digits are near the first points of their curves.
    """
    for digit in model.digits:
        angle = digit.coordinate_units.to_display_units(coordinates_from_excursion(digit, estimate))
        joints = digit.coupling @ angle
        angle_and_unit_by_name = {
            digit.joint_names[j]: (joints[j : j + 1], digit.joint_units.names[j])
            for j in joint_values(phase.angle_deg, digit)
        }
        if digit.name in phase.angle_deg:
            angle_and_unit_by_name[digit.name] = angle, digit.coordinate_units.names[0]
        for name, (present_angle, unit) in angle_and_unit_by_name.items():
            first_angle = phase.angle_deg[name][0]
            if np.abs(present_angle - first_angle).max() > MAX_CURVE_START_DISTANCE_DEG:
                start = f"the trajectory begins at {first_angle:g} {unit}: move there first"
                return f"{name} is at {present_angle.mean():.1f} {unit}, but {start}"
    return ""


def _curve_of_digit(
    phase: FollowPhase, digit: DigitModel, estimate: HandEstimate
) -> CurveTrajectory | None:
    """Return the curve that a digit follows in a phase.

    Return None if the phase contains no angles for the digit. Joints for which the phase contains
    no angles keep their positions.
    """
    count = digit.coupling.shape[1]
    if digit.name in phase.angle_deg:
        si_factor = digit.coordinate_units.si_factor.tolist()
        rows = phase.angle_deg[digit.name]
        if len(set(si_factor)) > 1:
            return CurveTrajectory.curve_through_points(
                phase.time_s, np.outer(rows, si_factor), count
            )
        angles = tuple(si_factor[0] * angle for angle in rows)
        return replace(interpolating_curve(phase.time_s, angles), coordinates=count)
    goal_angles = joint_values(phase.angle_deg, digit)
    if not goal_angles:
        return None
    present_coordinates = coordinates_from_excursion(digit, estimate)
    si_factor = digit.joint_units.si_factor[list(goal_angles)]
    points = [
        digit.with_joint_angles(
            dict(zip(goal_angles, si_factor * row, strict=True)), present_coordinates
        )
        for row in zip(*goal_angles.values(), strict=True)
    ]
    return CurveTrajectory.curve_through_points(phase.time_s, np.array(points), count)


@functools.lru_cache(maxsize=64)
def contact_margin_without_cells(model: HandModel, d: int) -> float:
    """Return the force [N] that tendons without load cells add to the contact threshold of digit d.

    The result is 0 if all tendons of the digit have load cells.
    """
    digit = model.digits[d]
    margin = float(model.margin_without_cell[digit.tendons].mean())
    if margin == 0.0:
        return 0.0
    # The array ``tension_per_tip_force`` refers to the open digit. The estimated tip force is the
    # least-squares fit of ``tension_per_tip_force`` to the estimated tensions.
    tension_per_tip_force = digit.torque_to_tension @ joint_lever(digit, digit.joint_min)
    return margin / float(np.linalg.norm(tension_per_tip_force))


@functools.lru_cache(maxsize=64)
def contact_thresholds_in_motion(model: HandModel) -> tuple[float, ...]:
    """Return the smallest tip force [N] that counts as contact, for each digit while it moves."""
    threshold = model.gains.contact.threshold_N
    return tuple(
        [threshold * (digit.joint_count / REFERENCE_JOINT_COUNT) for digit in model.digits]
    )


def contact_threshold(goal: DigitGoal, moving_threshold_N: float, t: float) -> float:
    """Return the smallest tip force [N] that counts as contact.

    Args:
        goal: goal of the digit.
        moving_threshold_N: threshold of the digit while it moves [N].
        t: time [s].
    """
    is_moving = (
        goal.trajectory is not None
        and t - goal.since < goal.trajectory.duration + ARRIVAL_DURATION_S
    )
    return (
        moving_threshold_N
        if is_moving
        else CONTACT_THRESHOLD_FACTOR_AFTER_ARRIVAL * moving_threshold_N
    )
