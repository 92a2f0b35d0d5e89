"""Interface of all programs of the controller.

A program sets the goals of all digits in every tick. The progress of a program contains the state
of the program.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import MinimumJerk
from handctl.core.estimation.tip_force import joint_lever
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.hand.dynamics import DigitModel
from handctl.programs.grip import GripState
from handctl.programs.task import Task


@dataclass(frozen=True, slots=True)
class ProgramProgress:
    """State of a program during a run. All programs store their state in the fields of this class.

    The hash of the controller's state includes the progress of the program.

    Attributes:
        step: index of the present step of the program.
        since: time at which the present step began [s].
        goals: goal of each digit.
        contact: for each digit, True if it is in contact.
        touching: for each digit, number of consecutive ticks with evidence of contact. Before the
            first close phase, programs use ``touching`` as a counter for other purposes.
        phase: name of the present step, for events and logs.
        finished: True if the program has ended.
        failure: reason why the program has failed, or an empty text.
        record: numbers from which the result of the program is computed.
        tare: new tares of the load cells [N], empty if the tares in the calibration are used.
        closing: for each digit, True if the digit closes until contact. The tuple is empty in
            phases without closing digits.
        grip: grip during a hold, or None in other phases.
        task: task that a live session executes, or None.
    """

    step: int
    since: float
    goals: tuple[DigitGoal, ...]
    contact: tuple[bool, ...]
    touching: tuple[int, ...]
    phase: str
    finished: bool = False
    failure: str = ""
    record: tuple[float, ...] = ()
    tare: tuple[float, ...] = ()
    closing: tuple[bool, ...] = ()
    grip: GripState | None = None
    task: Task | None = None

    def with_touching(self, touching: tuple[int, ...]) -> "ProgramProgress":
        """Return a copy with other counters ``touching``.

        While a program waits, the counters change in every tick. The constructor takes a third of the
        time of ``dataclasses.replace``.
        """
        return ProgramProgress(
            self.step, self.since, self.goals, self.contact, touching, self.phase, self.finished, self.failure,
            self.record, self.tare, self.closing, self.grip, self.task,
        )  # fmt: skip

    @staticmethod
    def initial(digits: int, phase: str) -> "ProgramProgress":
        """Return the progress before the first step, without torque and without contact."""
        return ProgramProgress(
            0, 0.0, (DigitGoal(),) * digits, (False,) * digits, (0,) * digits, phase
        )


ProgressAndEvents = tuple[ProgramProgress, tuple[TickEvent, ...]]
"""Progress of a program after a tick, and the events of the tick."""


class Program(Protocol):
    """Interface of a program that the controller executes.

    A program object never changes. Only the `ProgramProgress` changes from tick to tick.
    """

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        """Return the progress at the start of the program, when the hand is not armed yet."""
        ...

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Advance the program by one tick while the hand is active.

        Args:
            model: model of the hand.
            progress: progress of the program after the last tick.
            estimate: estimated state of the hand in the present tick.
            measurements: sensor values and drive values measured for the present tick.
            t: time [s].

        Returns:
            The new progress of the program, and the events of the present tick.
        """
        ...


TARE_PHASE = "tare"
"""Phase of commissioning that measures the tares.

Before the end of the phase `tare`, the zeros of the load cells are unknown.
"""
TIGHTEN_MARGIN_N = 1.5
"""Difference between the tension that takes up the slack and the tension floor [N].

The difference is too small to move a finger against its springs.
"""
TAUT_DURATION_S = 0.3
"""Time for which all tendons must be taut before the hand is ready [s]."""
TIGHTEN_TIMEOUT_S = 4.0
"""Longest allowed time for taking up the slack [s]."""


def tightening_goals(model: HandModel) -> tuple[DigitGoal, ...]:
    """Return the goals with which all tendons become taut."""
    return tuple(
        DigitGoal(GoalKind.TENSION, tension=_tightening_tension(model, tendons), rate=40.0)
        for tendons in model.digit_tendons
    )


def _tightening_tension(model: HandModel, tendons: slice) -> Vector:
    """Return the tensions (n_t,) [N] with which the tendons of a digit become taut.

    If a digit has more tendons than coordinates, the tensions balance each other and make no
    torque.
    """
    balance = model.redundancy.balance_tension[tendons]
    min_tension = model.floor[tendons] + TIGHTEN_MARGIN_N
    # The pretension of a spool pair keeps its tendons taut.
    min_tension = np.where(model.is_pair[tendons], 0.0, min_tension)
    return np.asarray(balance * (min_tension / balance).max() if balance.all() else min_tension)


def pull_tensions(
    model: HandModel, d: int, tension: float | tuple[float, ...], estimate: HandEstimate
) -> Vector:
    """Return the tensions (n_t,) [N] for digit d under tension control.

    If a single tension is given, the closing tendons get the given tension, and their antagonists
    get the tensions that balance the digit. A digit with spool pairs presses with its tip. The
    largest net tension of its spool pairs is the given tension. If a tension is given for each
    tendon, the function returns the given tensions.
    """
    if isinstance(tension, tuple):
        return np.array(tension)
    tendons = model.digit_tendons[d]
    if model.is_pair[tendons].any():
        digit = model.digits[d]
        tension_ratios = digit.torque_to_tension @ joint_lever(digit, estimate.q[digit.joints])
        return np.asarray(tension / np.abs(tension_ratios).max() * tension_ratios)
    is_antagonist = model.redundancy.has_surplus[tendons] & (
        model.redundancy.closing_sign[tendons] < 0.0
    )
    return np.where(is_antagonist, model.redundancy.balance_tension[tendons], tension)


def tension_goal(
    model: HandModel, d: int, tension: Vector, rate: float, estimate: HandEstimate
) -> DigitGoal:
    """Return the goal with which the tensions of digit d approach given tensions (n_t,) [N] at a given rate [N/s].

    Some spool pairs move a digit sideways. The joints of these spool pairs stay at their present
    angles.
    """
    if model.redundancy.closing_sign[model.digit_tendons[d]].all():
        return DigitGoal(GoalKind.TENSION, tension=tension, rate=rate)
    coordinates = coordinates_from_excursion(model.digits[d], estimate)
    return DigitGoal(
        GoalKind.TENSION,
        MinimumJerk(coordinates, coordinates, HOLD_STILL_DURATION_S),
        tension=tension,
        rate=rate,
    )


def released_tensions(model: HandModel, d: int, tension: float) -> Vector:
    """Return the tensions (n_t,) [N] of digit d after a release.

    In a digit with antagonistic tendons, the returned tensions balance each other. In a digit
    without antagonistic tendons, each returned tension is the argument ``tension``. The net tension
    of a released spool pair is zero.
    """
    tendons = model.digit_tendons[d]
    balance = model.redundancy.balance_tension[tendons]
    return balance if balance.all() else np.where(model.is_pair[tendons], 0.0, tension)


HOLD_STILL_DURATION_S = 1.0
"""Duration of the trajectory that keeps the sideways joints of a digit at their angles [s].

Any duration is possible, because the sideways joints do not move.
"""


def slack_tendons(model: HandModel, estimate: HandEstimate) -> list[str]:
    """Return the names of the tendons that are slack or have a tension below half of the tension floor."""
    tendons = zip(
        model.hand.tendon_names, estimate.is_slack.tolist(), estimate.tension.tolist(),
        model.floor.tolist(), strict=True,
    )  # fmt: skip
    return [
        name
        for name, is_slack, tension, floor in tendons
        if is_slack or not tension > 0.5 * floor  # also if the tension is NaN
    ]


def coordinates_from_excursion(digit: DigitModel, estimate: HandEstimate) -> Vector:
    """Return the coordinates (n_c,) [rad] of a digit, computed from the excursions of its tendons.

    During contact, the true joint angles can be larger than the angles that follow from the
    excursions.
    """
    return digit.coordinates_of_excursion(estimate.excursion[digit.tendons])


def goal_to_move_to_angle(
    digit: DigitModel, estimate: HandEstimate, angle: float | Vector, duration: float, t: float
) -> DigitGoal:
    """Return a goal that moves all coordinates of a digit in a given time [s].

    The target is one angle for all coordinates, or one angle for each coordinate [rad].
    """
    start = coordinates_from_excursion(digit, estimate)
    return DigitGoal(
        GoalKind.MOTION, MinimumJerk(start, np.full_like(start, angle), duration), since=t
    )
