"""Program that moves the hand for a comparison of controller gains.

The program executes the same moves and tensions with each set of gains, so that the errors of
position and tension can be compared.
"""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.programs.clear_range import highest_clear_angle
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
MOVE_DURATIONS_S = (0.6, 0.25)
"""Durations of the moves in a turn [s]. Each duration has a closing move and an opening move."""
AMPLITUDE_STEP = 0.05
"""Step to which the largest amplitude of a hand is rounded down."""
SIDEWAYS_FRACTION = 0.3
"""Angle by which a joint moves its digit sideways in a move, as a fraction of the angle of the other joints.

Neighbouring fingers are close together.
"""
MIN_COMMON_AMPLITUDE = 0.5
"""Largest amplitude of a hand below which its digits move in turns, so that they can move farther."""
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
    """Stage of the exercise. In a stage, all moved digits have the same target angle or the same target tension.

    Attributes:
        name: name of the phase in the log: `settle`, `turn`, `move`, `close` or `hold`. Only the
            errors in `move` and `hold` are evaluated. A round of the exercise begins with `settle`.
        duration: duration of the stage, including the time of rest [s].
        angle: target angle of a move [rad], or NaN if the stage sets a tension. For a prismatic
            joint, 1 rad stands for 10 mm.
        tension: tension target of the stage [N].
        rest: time of rest at the end of a move [s].
        tension_rate: largest rate of the tension goals [N/s]. The gains can contain a smaller
            limit.
        digits: names of the moved digits. All other digits stay open. If the tuple is empty, all
            digits move.
        sideways_fraction: target angle of the joints that move a digit sideways, as a fraction of
            ``angle``.
    """

    name: str
    duration: float
    angle: float = math.nan
    tension: float = 0.0
    rest: float = REST_DURATION_S
    tension_rate: float = math.inf
    digits: tuple[str, ...] = ()
    sideways_fraction: float = SIDEWAYS_FRACTION


def move_amplitude(angle: float) -> float:
    """Return the amplitude of the exercise that moves the joints to a given angle [rad].

    At an amplitude of 1, the joints move by ``FULL_MOVE_RAD``.
    """
    return (angle - HOME_ANGLE_RAD) / FULL_MOVE_RAD


def _gentle_rise(stage: ExerciseStage) -> ExerciseStage:
    """Return a copy of a stage in which the tension rises slowly. Digits without springs need a slow rise."""
    return replace(stage, duration=GENTLE_RISE_DURATION_S, tension_rate=GENTLE_TENSION_RATE_N_PER_S)


def exercise_stages(
    amplitude: float = 1.0, turns: tuple[tuple[str, ...], ...] = ()
) -> tuple[ExerciseStage, ...]:
    """Return the stages of the exercise at a given amplitude.

    Args:
        amplitude: fraction of the full angles and tensions.
        turns: names of the digits that move together, see ``ExerciseProgram.turns``.
    """
    target = HOME_ANGLE_RAD + amplitude * FULL_MOVE_RAD
    hold = 30.0 + 25.0 * amplitude
    moves = [
        stage
        for i, digits in enumerate(turns or ((),))
        for stage in (
            ExerciseStage("turn" if i else "settle", 0.6, HOME_ANGLE_RAD, digits=digits),
            *(
                ExerciseStage("move", duration + REST_DURATION_S, angle, digits=digits)
                for duration in MOVE_DURATIONS_S
                for angle in (target, HOME_ANGLE_RAD)
            ),
        )
    ]
    hold_stages = [
        ExerciseStage("close", 0.8, tension=30.0),
        ExerciseStage("hold", 0.5, tension=hold),
        ExerciseStage("hold", 0.5, tension=30.0),
    ]
    return (*moves, *hold_stages)


@dataclass(frozen=True, slots=True)
class ExerciseProgram:
    """Program that takes up the slack of the tendons and executes the exercise.

    The program executes the exercise once for each amplitude.

    Attributes:
        amplitudes: fractions of the full angles and tensions, in the order of execution.
        turns: names of the digits that move together, for each turn. In a turn, all other digits
            stay open. If the tuple is empty, all digits move together.
    """

    amplitudes: tuple[float, ...] = (1.0,)
    turns: tuple[tuple[str, ...], ...] = ()

    @staticmethod
    def for_hand(hand: Hand) -> "ExerciseProgram":
        """Return the exercise with the largest amplitude at which the digits of a hand do not touch each other.

        The two fingers of a gripper touch each other at a small angle if both close. The digits of
        such a hand move in turns.
        """
        amplitude, turns = largest_exercise(hand)
        return ExerciseProgram((amplitude,), turns)

    @property
    def stages(self) -> tuple[ExerciseStage, ...]:
        """Return the stages of all amplitudes, in the order of execution."""
        return tuple(
            stage
            for amplitude in self.amplitudes
            for stage in exercise_stages(amplitude, self.turns)
        )

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


def largest_exercise(hand: Hand) -> tuple[float, tuple[tuple[str, ...], ...]]:
    """Return the largest amplitude at which the digits do not touch, and the digits that move in each turn.

    If all digits move together, there are no turns. If the digits touch each other at every
    amplitude, the function returns the full amplitude. The tracking errors of touching digits are
    not evaluated.
    """
    digit_names = tuple(name for name in hand.digit_names if name not in hand.carrier_digits)
    common_amplitude = _clear_amplitude(hand, digit_names)
    if common_amplitude >= MIN_COMMON_AMPLITUDE:
        return common_amplitude, ()
    amplitude = min(_clear_amplitude(hand, (name,)) for name in digit_names)
    if amplitude <= common_amplitude:
        return common_amplitude or 1.0, ()
    turns: list[tuple[str, ...]] = []
    for name in digit_names:
        for i, turn in enumerate(turns):
            if _clear_amplitude(hand, (*turn, name)) >= amplitude:
                turns[i] = (*turn, name)
                break
        else:
            turns.append((name,))
    return amplitude, tuple(turns)


def _clear_amplitude(hand: Hand, digit_names: tuple[str, ...]) -> float:
    """Return the largest amplitude at which the named digits, moving together, touch no digit.

    The amplitude is a multiple of ``AMPLITUDE_STEP``. The amplitude is 0 if the digits touch at all
    amplitudes.
    """
    scales = {name: _coordinate_scales(DigitModel.from_hand(hand, name)) for name in digit_names}
    clear_angle = highest_clear_angle(hand, scales, HOME_ANGLE_RAD, HOME_ANGLE_RAD + FULL_MOVE_RAD)
    # The small addition prevents that a multiple of the step is rounded down because of rounding
    # errors.
    steps = math.floor(move_amplitude(clear_angle) / AMPLITUDE_STEP + 1e-9)
    return round(steps * AMPLITUDE_STEP, 2)


def _coordinate_scales(digit: DigitModel, sideways_fraction: float = SIDEWAYS_FRACTION) -> Vector:
    """Return the ratio (n_c,) between the target of each coordinate and the angle of a move.

    For a prismatic joint, 1 rad stands for 10 mm.

    Args:
        digit: model of the digit.
        sideways_fraction: ratio for the joints that move the digit sideways.
    """
    return np.asarray(
        digit.coordinate_units.scale * np.where(digit.sideways_coordinates, sideways_fraction, 1.0)
    )


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
    name = model.hand.digit_names[d]
    if stage.digits and name not in stage.digits and name not in model.hand.carrier_digits:
        return _goal_of_open_digit(model, d, stage, estimate, t)
    if not math.isnan(stage.angle):
        digit = model.digits[d]
        goal_coordinate = stage.angle * _coordinate_scales(digit, stage.sideways_fraction)
        return goal_to_move_to_angle(
            digit, estimate, goal_coordinate, stage.duration - stage.rest, t
        )
    tension = pull_tensions(model, d, stage.tension, estimate)
    rate = min(stage.tension_rate, model.gains.tension.rate_N_per_s)
    return tension_goal(model, d, tension, rate, estimate)


def _goal_of_open_digit(
    model: HandModel, d: int, stage: ExerciseStage, estimate: HandEstimate, t: float
) -> DigitGoal:
    """Return the goal with which digit d opens and stays open while other digits move.

    Springs open the digit while its tendons keep the smallest allowed tension. A digit without
    springs is moved to the angle 0.
    """
    digit = model.digits[d]
    if any(digit.spring_stiffness):
        floor = model.floor[model.digit_tendons[d]]
        return tension_goal(model, d, floor, model.gains.tension.rate_N_per_s, estimate)
    return goal_to_move_to_angle(digit, estimate, 0.0, stage.duration - stage.rest, t)
