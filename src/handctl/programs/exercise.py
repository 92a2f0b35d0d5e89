"""The exercise by which gains are judged: the same moves and the same tensions for everybody."""

import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.model import HandModel
from handctl.core.types import Event
from handctl.programs.live import LiveProgram
from handctl.programs.program import Progress, motion_to

REST_S = 0.15
"""At the end of every move, for what rings on."""
HOME_RAD = math.radians(5.0)
"""Off the open stop, where the error of a digit that rests on it would be flattered."""


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the exercise, for all digits alike.

    Attributes:
        name: phase in the log: ``settle``, ``move``, ``close`` or ``hold``; the second and the last are judged.
        duration: [s], rest included.
        angle: goal of a move [rad]; NaN for a tension.
        tension: goal of a tension [N].
        rest: at the end of a move [s].
    """

    name: str
    duration: float
    angle: float = math.nan
    tension: float = 0.0
    rest: float = REST_S


def stages(amplitude: float = 1.0, fastest_s: float = 0.25) -> tuple[Stage, ...]:
    """The exercise.

    Args:
        amplitude: share of the full angles and tensions.
        fastest_s: duration of the fastest move [s].
    """
    far, hold = HOME_RAD + amplitude * math.radians(30.0), 30.0 + 25.0 * amplitude
    moves = [Stage("move", duration + REST_S, angle) for duration in (0.6, fastest_s) for angle in (far, HOME_RAD)]
    holds = [Stage("close", 0.8, tension=30.0), Stage("hold", 0.5, tension=hold), Stage("hold", 0.5, tension=30.0)]
    return (Stage("settle", 0.6, HOME_RAD), *moves, *holds)


@dataclass(frozen=True, slots=True)
class Exercise:
    """Tightens, then does the exercise once for each amplitude.

    Attributes:
        amplitudes: shares of the full angles and tensions, in order.
    """

    amplitudes: tuple[float, ...] = (1.0,)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All parts, in order."""
        return tuple(stage for amplitude in self.amplitudes for stage in stages(amplitude))

    def begin(self, model: HandModel) -> Progress:
        """Limp until the hand is armed."""
        return LiveProgram().begin(model)

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick; see ``Program``."""
        if progress.phase in ("start", "tighten"):
            progress, events = LiveProgram().advance(model, progress, estimate, measured, t)
            return self._enter(model, progress, estimate, 0, t) if progress.phase == "live" else (progress, events)
        own = self.stages
        if t - progress.since < own[progress.step].duration:
            return progress, ()
        if progress.step + 1 == len(own):
            return replace(progress, finished=True, phase="end"), (Event("info", "phase", "", "exercise complete"),)
        return self._enter(model, progress, estimate, progress.step + 1, t)

    def _enter(
        self, model: HandModel, progress: Progress, estimate: Estimate, step: int, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        stage = self.stages[step]
        goals = tuple(_goal(model, d, stage, estimate, t) for d in range(len(model.digits)))
        told = Event("info", "phase", "", f"{stage.name} {step + 1} of {len(self.stages)}")
        blocked = (stage.name == "hold",) * len(goals)  # by then every digit rests on its closed stop
        return replace(progress, step=step, since=t, phase=stage.name, goals=goals, contact=blocked), (told,)


def _goal(model: HandModel, d: int, stage: Stage, estimate: Estimate, t: float) -> DigitGoal:
    if not math.isnan(stage.angle):
        return motion_to(model.digits[d], estimate, stage.angle, stage.duration - stage.rest, t)
    tendons = model.digit_tendons[d]
    tension = np.full(tendons.stop - tendons.start, stage.tension)
    return DigitGoal(Kind.TENSION, tension=tension, rate=model.gains.tension.rate_N_per_s)
