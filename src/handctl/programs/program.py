"""A program decides the goals of all digits, tick after tick: a task, a commissioning, a live session."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import MinimumJerk
from handctl.core.model import HandModel
from handctl.core.types import Event, Vector
from handctl.hand.dynamics import DigitModel
from handctl.programs.grip import Grip


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a program stands; the same for all programs, so that the state's hash covers it.

    Attributes:
        step: index of the present step.
        since: when it began [s].
        goals: per digit.
        contact: per digit, whether it touches.
        touching: per digit, consecutive ticks that spoke for contact; before that, what a program counts.
        phase: name of the present step, for people and logs.
        finished: True when nothing more is to come.
        failure: why the program gave up; empty if it did not.
        record: numbers that the program keeps for its result.
        closing: per digit, whether it closes until it touches; empty otherwise.
        grip: of a hold; None otherwise.
        tare: what every load cell is to read less from now on [N]; empty for what the controller knows anyway.
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
    grip: Grip | None = None

    @staticmethod
    def begin(digits: int, phase: str) -> "Progress":
        """Limp and untouched."""
        return Progress(0, 0.0, (DigitGoal(),) * digits, (False,) * digits, (0,) * digits, phase)


class Program(Protocol):
    """What the tick asks of a program; immutable, all change is in ``Progress``."""

    def begin(self, model: HandModel) -> Progress:
        """Progress before the hand is armed."""
        ...

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Progress one tick on, while the hand is active; t [s]."""
        ...


TARE_PHASE = "tare"
"""Name of the step of commissioning before whose end no load cell's zero is known."""
TIGHTEN_MARGIN_N = 1.5
"""Tension above the floor to which slack is taken up; still below what moves a finger against its springs."""
TIGHTEN_S = 0.3
"""The hand is ready when no tendon was loose for so much longer than one was."""
TIGHTEN_TIMEOUT_S = 4.0


def tighten(model: HandModel) -> tuple[DigitGoal, ...]:
    """Goals that take up the slack of every tendon."""
    return tuple(
        DigitGoal(Kind.TENSION, tension=model.floor[tendons] + TIGHTEN_MARGIN_N, rate=40.0)
        for tendons in model.digit_tendons
    )


def loose(model: HandModel, estimate: Estimate) -> list[str]:
    """Names of the tendons that do not carry at least half of the floor."""
    taut = ~np.asarray(estimate.slack, dtype=bool) & (estimate.tension > 0.5 * model.floor)
    return [name for name, ok in zip(model.hand.tendon_names, taut, strict=True) if not ok]


def coordinates(digit: DigitModel, estimate: Estimate) -> Vector:
    """Present coordinates (n_c,) of a digit, those of its excursions [rad]; contact turns its joints besides."""
    return np.asarray(digit.joints_to_coordinates @ digit.excursion_to_joints @ estimate.excursion[digit.tendons])


def motion_to(digit: DigitModel, estimate: Estimate, angle: float | Vector, duration: float, t: float) -> DigitGoal:
    """Goal that moves the coordinates of a digit from where they are to an angle, or one each [rad], in a time [s]."""
    start = coordinates(digit, estimate)
    return DigitGoal(Kind.MOTION, MinimumJerk(start, np.full_like(start, angle), duration), since=t)
