"""A controller program with steps that start at fixed times, independently of contacts."""

import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent
from handctl.programs.live_session import LiveProgram
from handctl.programs.program import ProgramProgress, goal_to_move_to_angle


@dataclass(frozen=True)
class ScriptStep:
    """One step of a script, with the same motion or tension for all digits.

    Attributes:
        name: name of the phase in the log.
        step_duration_s: time until the next step [s].
        angle_deg: target angle of a move that lasts ``move_duration_s`` [deg], or None for a step without a
            move.
        move_duration_s: duration of the move [s].
        tension_N: tension of a hold, which replaces the move [N], or None for a step without a
            hold.
        rate_N_per_s: rate of change of the target tension [N/s].
    """

    name: str
    step_duration_s: float
    angle_deg: float | None = None
    move_duration_s: float = 1.0
    tension_N: float | None = None
    rate_N_per_s: float = 100.0


@dataclass(frozen=True)
class ScriptProgram:
    """Program that takes up the slack of the tendons and then runs the steps of a script."""

    steps: tuple[ScriptStep, ...]

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        """Return the initial progress of the script, see ``Program``."""
        return LiveProgram().initial_progress(model)

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> tuple[ProgramProgress, tuple[TickEvent, ...]]:
        """Advance the script to the step that belongs to the present time, see ``Program.advance``."""
        if progress.finished:
            return progress, ()
        if progress.phase in ("start", "tighten"):
            progress, events = LiveProgram().advance(model, progress, estimate, measurements, t)
            return (
                (replace(progress, step=-1), events)
                if progress.phase == "live"
                else (progress, events)
            )
        if (
            progress.step >= 0
            and t - progress.since < self.steps[progress.step].step_duration_s - 0.5 * model.period
        ):
            return progress, ()
        if progress.step + 1 >= len(self.steps):
            return replace(progress, finished=True), ()
        step = self.steps[progress.step + 1]
        goals = tuple(
            _digit_goal(model, d, step, progress.goals[d], estimate, t)
            for d in range(len(model.digits))
        )
        return replace(progress, step=progress.step + 1, since=t, phase=step.name, goals=goals), ()


def _digit_goal(
    model: HandModel,
    digit_index: int,
    step: ScriptStep,
    previous_goal: DigitGoal,
    estimate: HandEstimate,
    t: float,
) -> DigitGoal:
    if step.angle_deg is not None:
        return goal_to_move_to_angle(
            model.digits[digit_index],
            estimate,
            math.radians(step.angle_deg),
            step.move_duration_s,
            t,
        )
    if step.tension_N is None:
        return previous_goal
    tendons = model.digit_tendons[digit_index]
    tension = np.full(tendons.stop - tendons.start, step.tension_N)
    return DigitGoal(GoalKind.TENSION, tension=tension, rate=step.rate_N_per_s)
