"""Program that moves the hand for a comparison of controller gains.

The program executes the same moves and tensions with each set of gains, so that the errors of
position and tension can be compared.
"""

import functools
import math
from dataclasses import dataclass, replace

from handctl.core.control_law.digit_goal import DigitGoal
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent
from handctl.programs.live_session import LiveProgram
from handctl.programs.program import (
    ProgramProgress,
    ProgressAndEvents,
    goal_to_move_to_angle,
    pull_tensions,
    tension_goal,
)

REST_DURATION_S = 0.15
"""Time at the end of every move in which the digit is allowed to oscillate [s]."""
HOME_ANGLE_RAD = math.radians(5.0)
"""Angle between the stop of the open digit and the first position of a move [rad].

For a digit that rests on its stop, the position error would be too small for the comparison.
"""
FULL_MOVE_RAD = math.radians(30.0)
"""Angle of a move at full amplitude [rad]."""
GENTLE_CLOSE_TENSION_N = 7.0
"""Net tension with which digits without springs close [N].

From 8 N on, a digit without springs that closes freely looks like a digit with a torn tendon (fault
T01). In both cases, the spools wind fast, and the tension is small.
"""
GENTLE_CLOSE_DURATION_S = 1.5
"""Time in which digits without springs close [s]."""
GENTLE_TENSION_RATE_N_PER_S = 20.0
"""Rate at which the tension of digits without springs rises after they have closed [N/s].

Friction or another digit could have stopped a digit before its end stop. With a slow rise of the
tension, a stopped digit starts to move with little excess tension, and reaches its end stop early.
With 40 N/s or more, the spool of the digit winds so fast that the tendon looks torn (fault T01).
"""
GENTLE_RISE_DURATION_S = 1.3
"""Time in which the tension of digits without springs rises from 7 N to 30 N [s]."""


@dataclass(frozen=True, slots=True)
class ExerciseStage:
    """Stage of the exercise. In a stage, all digits have the same target angle or the same target tension.

    Attributes:
        name: name of the phase in the log: `settle`, `move`, `close` or `hold`. Only the errors in
            `move` and `hold` are evaluated.
        duration: duration of the stage, including the time of rest [s].
        angle: target angle of a move [rad], or NaN if the stage sets a tension. For a prismatic
            joint, 1 rad stands for 10 mm.
        tension: tension target of the stage [N].
        rest: time of rest at the end of a move [s].
        tension_rate: largest rate of the tension goals [N/s]. The gains can contain a smaller
            limit.
    """

    name: str
    duration: float
    angle: float = math.nan
    tension: float = 0.0
    rest: float = REST_DURATION_S
    tension_rate: float = math.inf


def move_amplitude(angle: float) -> float:
    """Return the amplitude of the exercise that moves the joints to a given angle.

    The angle is in rad. An amplitude of 1 is a full move.
    """
    return (angle - HOME_ANGLE_RAD) / FULL_MOVE_RAD


def _gentle_rise(stage: ExerciseStage) -> ExerciseStage:
    """Return a copy of a stage in which the tension rises slowly. Digits without springs need a slow rise."""
    return replace(stage, duration=GENTLE_RISE_DURATION_S, tension_rate=GENTLE_TENSION_RATE_N_PER_S)


def exercise_stages(
    amplitude: float = 1.0, shortest_duration_s: float = 0.25
) -> tuple[ExerciseStage, ...]:
    """Return the stages of the exercise at a given amplitude.

    Args:
        amplitude: fraction of the full angles and tensions.
        shortest_duration_s: duration of the fastest move [s].
    """
    target = HOME_ANGLE_RAD + amplitude * FULL_MOVE_RAD
    hold = 30.0 + 25.0 * amplitude
    moves = [
        ExerciseStage("move", duration + REST_DURATION_S, angle)
        for duration in (0.6, shortest_duration_s)
        for angle in (target, HOME_ANGLE_RAD)
    ]
    hold_stages = [
        ExerciseStage("close", 0.8, tension=30.0),
        ExerciseStage("hold", 0.5, tension=hold),
        ExerciseStage("hold", 0.5, tension=30.0),
    ]
    return (ExerciseStage("settle", 0.6, HOME_ANGLE_RAD), *moves, *hold_stages)


@dataclass(frozen=True, slots=True)
class ExerciseProgram:
    """Program that takes up the slack of the tendons and executes the exercise.

    The program executes the exercise once for each amplitude.

    Attributes:
        amplitudes: fractions of the full angles and tensions, in the order of execution.
    """

    amplitudes: tuple[float, ...] = (1.0,)

    @property
    def stages(self) -> tuple[ExerciseStage, ...]:
        """Return the stages of all amplitudes, in the order of execution."""
        return tuple(stage for amplitude in self.amplitudes for stage in exercise_stages(amplitude))

    def stages_for_hand(self, model: HandModel) -> tuple[ExerciseStage, ...]:
        """Return all stages for a hand. A digit without springs closes gently before its tension rises."""
        return _stages_of_program(self, model.hand.has_springs)

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
        """Advance the exercise by one tick. The interface `Program` explains the arguments."""
        if progress.phase in ("start", "tighten"):
            progress, events = LiveProgram().advance(model, progress, estimate, measurements, t)
            return (
                self._enter_stage(model, progress, estimate, 0, t)
                if progress.phase == "live"
                else (progress, events)
            )
        stages = self.stages_for_hand(model)
        if t - progress.since < stages[progress.step].duration:
            return progress, ()
        if progress.step + 1 == len(stages):
            return replace(progress, finished=True, phase="end"), (
                TickEvent("info", "phase", "", "exercise complete"),
            )
        return self._enter_stage(model, progress, estimate, progress.step + 1, t)

    def _enter_stage(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        stage_index: int,
        t: float,
    ) -> ProgressAndEvents:
        """Begin a stage of the exercise."""
        stages = self.stages_for_hand(model)
        stage = stages[stage_index]
        carriers = [name in model.hand.carrier_digits for name in model.hand.digit_names]
        # A digit that carries other digits keeps the angle of the first stage. A carrying digit
        # cannot follow the fast moves. With a constant tension, a carrying digit would fall under
        # its load. The moves of the carried digits disturb the carrying digit.
        goals = tuple(
            previous_goal
            if is_carrier and stage_index
            else _digit_goal(model, d, stage, estimate, t)
            for d, (previous_goal, is_carrier) in enumerate(
                zip(progress.goals, carriers, strict=True)
            )
        )
        event = TickEvent("info", "phase", "", f"{stage.name} {stage_index + 1} of {len(stages)}")
        # In the stage `hold`, every digit that holds a tension is pressed against its closed joint
        # limit.
        is_blocked = tuple(stage.name == "hold" and not carries for carries in carriers)
        return replace(
            progress, step=stage_index, since=t, phase=stage.name, goals=goals, contact=is_blocked
        ), (event,)


# The stages are cached, because every tick needs them, and a search for gains has thousands of
# ticks per trial.
@functools.lru_cache(maxsize=8)
def _stages_of_program(program: ExerciseProgram, has_springs: bool) -> tuple[ExerciseStage, ...]:
    """Return the stages for a hand with or without springs, see ``ExerciseProgram.stages_for_hand``."""
    if has_springs:
        return program.stages
    gentle_close_stage = ExerciseStage(
        "close", GENTLE_CLOSE_DURATION_S, tension=GENTLE_CLOSE_TENSION_N
    )
    return tuple(
        stage_or_gentle_rise
        for stage in program.stages
        for stage_or_gentle_rise in (
            (gentle_close_stage, _gentle_rise(stage)) if stage.name == "close" else (stage,)
        )
    )


def _digit_goal(
    model: HandModel, d: int, stage: ExerciseStage, estimate: HandEstimate, t: float
) -> DigitGoal:
    """Return the goal of digit d in a stage of the exercise."""
    if not math.isnan(stage.angle):
        digit = model.digits[d]
        goal_coordinate = stage.angle * digit.coordinate_units.scale
        return goal_to_move_to_angle(
            digit, estimate, goal_coordinate, stage.duration - stage.rest, t
        )
    tension = pull_tensions(model, d, stage.tension, estimate)
    rate = min(stage.tension_rate, model.gains.tension.rate_N_per_s)
    return tension_goal(model, d, tension, rate, estimate)
