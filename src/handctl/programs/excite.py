"""The program that makes a hand show what it is: one digit after the other, step by step, all other digits limp.

What the steps are is decided by whoever wants to know; this program only carries them out, and names every phase
``DIGIT STEP`` so that the log says what each tick was good for.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import Chirp, MinimumJerk
from handctl.core.model import HandModel
from handctl.core.types import Event
from handctl.document import Document
from handctl.programs.program import Progress, coordinates

TAUT_TIMEOUT_S = 4.0
"""A tendon that has not become taut by then is loose or broken."""


class ExciteStep(Document):
    """One thing that one digit does.

    ``limp``: no torque; ``taut``: take up slack, to ``target`` [N]; ``move``: to ``target`` [rad] in
    ``duration_s``; ``chirp``: swing by ``amplitude`` [rad] about ``target`` [rad], from ``low_Hz`` to ``high_Hz``;
    ``tension``: to ``target`` [N] at ``rate`` [N/s].
    """

    digit: str
    name: str
    """Of the phase."""
    kind: Literal["limp", "taut", "move", "chirp", "tension"]
    duration_s: float = Field(gt=0, le=60)
    target: float = 0.0
    held: bool = False
    """Something stops the digit: the filter is not to believe that it moves."""
    rate: float = Field(100.0, gt=0, le=5000)
    amplitude: float = Field(0.0, ge=0, le=1)
    low_Hz: float = Field(0.5, gt=0, le=100)
    high_Hz: float = Field(5.0, gt=0, le=100)


@dataclass(frozen=True, slots=True)
class ExciteProgram:
    """Carries out steps in order.

    Attributes:
        steps: of all digits.
    """

    steps: tuple[ExciteStep, ...]

    def begin(self, model: HandModel) -> Progress:
        """Limp, before the first step."""
        return replace(Progress.begin(len(model.digits), "start"), step=-1)

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick; see ``Program``."""
        if progress.finished:
            return progress, ()
        if progress.step < 0:
            return self._enter(model, progress, estimate, t, 0)
        step = self.steps[progress.step]
        elapsed = t - progress.since
        tendons = model.digit_tendons[model.hand.digit_names.index(step.digit)]
        if step.kind == "taut" and bool(np.any(estimate.slack[tendons])):
            if elapsed < TAUT_TIMEOUT_S:
                return progress, ()
            text = f"not taut after {TAUT_TIMEOUT_S:g} s"
            limp = (DigitGoal(),) * len(progress.goals)
            failed = replace(progress, finished=True, failure=f"{step.digit}: {text}", goals=limp)
            return failed, (Event("error", "identify", step.digit, text),)
        if elapsed < step.duration_s:
            return progress, ()
        return self._enter(model, progress, estimate, t, progress.step + 1)

    def _enter(
        self, model: HandModel, progress: Progress, estimate: Estimate, t: float, index: int
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Begin a step, or the end."""
        limp = [DigitGoal()] * len(model.digits)
        if index == len(self.steps):
            done = replace(progress, finished=True, phase="end", goals=tuple(limp), contact=(False,) * len(limp))
            return done, (Event("info", "phase", "", "excitation complete"),)
        step = self.steps[index]
        d = model.hand.digit_names.index(step.digit)
        limp[d] = _goal(model, d, step, estimate, t)
        phase = f"{step.digit} {step.name}"
        known = phase == progress.phase
        contact = tuple(i == d and step.held for i in range(len(limp)))
        progress = replace(progress, step=index, since=t, phase=phase, goals=tuple(limp), contact=contact)
        return progress, () if known else (Event("info", "phase", step.digit, phase),)


def _goal(model: HandModel, d: int, step: ExciteStep, estimate: Estimate, t: float) -> DigitGoal:
    """What a step asks of its digit."""
    digit, tendons = model.digits[d], model.digit_tendons[d]
    here = coordinates(digit, estimate)
    if step.kind == "move":
        path = MinimumJerk(here, np.full_like(here, step.target), step.duration_s)
        return DigitGoal(Kind.MOTION, path, since=t)
    if step.kind == "chirp":
        swing = Chirp(step.target, step.amplitude, step.low_Hz, step.high_Hz, step.duration_s, len(here))
        return DigitGoal(Kind.MOTION, swing, since=t)
    if step.kind == "limp":
        return DigitGoal()
    return DigitGoal(Kind.TENSION, tension=np.full(tendons.stop - tendons.start, step.target), rate=step.rate)
