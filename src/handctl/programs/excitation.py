"""Program that moves a hand for the identification of its parameters.

One digit moves at a time, and the motors of all other digits make no torque.

Load cells drift, and the tendons of a digit can be slack for several minutes while other digits
move. If the load cell of a slack tendon drifted by 4 N, its reading would look like a broken wire
(fault T06). Therefore the load cells of slack tendons are tared again before each digit moves.

The identification chooses the steps of the excitation. In the log, the name of each phase consists
of the digit and the step, so that every tick of the log can be assigned to a step.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import ChirpTrajectory, MinimumJerk
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.document import Document
from handctl.programs.program import ProgramProgress, ProgressAndEvents, coordinates_from_excursion

TAUT_TIMEOUT_S = 4.0
"""Longest time in which an intact tendon becomes taut [s]."""
TARE_STEP_NAME = "tare"
"""Name of the step in which the load cells of slack tendons are tared again."""
TARE_DURATION_S = 0.5
"""Duration of the step ``tare`` [s]."""
MIN_SLACK_FRACTION = 0.5
"""Smallest fraction of the step ``tare`` in which a tendon must be slack, so that its load cell is tared again."""
MAX_TARE_CHANGE_N = 4.0
"""Largest change of a load cell's tare during an excitation [N].

A load cell that drifts farther is defective.
"""


class ExciteStep(Document):
    """Step of the excitation, in which one digit moves.

    - `limp`: no torque.
    - `taut`: take up the slack of the tendons, with the tension `target` [N].
    - `move`: move to `target` [rad] in the time `duration_s`.
    - `chirp`: oscillate about `target` [rad] with `amplitude` [rad], at a frequency from `low_Hz`
      to `high_Hz`.
    - `tension`: change the tension to `target` [N] at `rate` [N/s].

    The field `target` applies to all coordinates or tendons of the digit. The field `targets`
    contains one target for each coordinate or tendon.
    """

    digit: str
    name: str
    """Name of the step, which is part of the name of the phase."""
    kind: Literal["limp", "taut", "move", "chirp", "tension"]
    duration_s: float = Field(gt=0, le=60)
    target: float = 0.0
    targets: tuple[float, ...] = ()
    """Target of each coordinate [rad] or tendon [N] of the digit.

    If `targets` is empty, `target` applies to all coordinates or tendons.
    """
    held: bool = False
    """True if an obstacle stops the digit during the step. The filter treats a stopped digit as blocked."""
    rate: float = Field(100.0, gt=0, le=5000)
    amplitude: float = Field(0.0, ge=0, le=1)
    amplitudes: tuple[float, ...] = ()
    """Amplitude of each coordinate [rad]. If `amplitudes` is empty, `amplitude` applies to all coordinates."""
    low_Hz: float = Field(0.5, gt=0, le=100)
    high_Hz: float = Field(5.0, gt=0, le=100)


@dataclass(frozen=True, slots=True)
class SwingTrajectory:
    """Oscillation of a digit, in which all coordinates move in phase.

    Each coordinate oscillates about its own mean angle.

    Attributes:
        centre: (n,) mean angle of each coordinate [rad].
        amplitude: (n,) amplitude of each coordinate [rad].
        chirp: oscillation of a single coordinate about 0 with amplitude 1.
    """

    centre: Vector
    amplitude: Vector
    chirp: ChirpTrajectory

    @property
    def duration(self) -> float:
        """Return the duration of the oscillation [s]."""
        return self.chirp.duration

    def motion_at(self, t: float) -> Vector:
        """Return position, velocity and acceleration at time t, (3, n), see ``Trajectory.motion_at``."""
        motion = self.chirp.motion_at(t) * self.amplitude
        motion[0] += self.centre
        return motion


@dataclass(frozen=True, slots=True)
class ExciteProgram:
    """Program that carries out the steps of an excitation in order.

    Attributes:
        steps: steps of the excitation for all digits.
    """

    steps: tuple[ExciteStep, ...]

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        """Return the progress before the first step. Before the first step, the motors make no torque."""
        return replace(ProgramProgress.initial(len(model.digits), "start"), step=-1)

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        """Advance the excitation by one tick. The interface `Program` explains the arguments."""
        if progress.finished:
            return progress, ()
        if progress.step < 0:
            return self._enter_step(model, progress, estimate, t, 0)
        step = self.steps[progress.step]
        elapsed = t - progress.since
        tendons = model.digit_tendons[model.hand.digit_names.index(step.digit)]
        if step.kind == "taut" and bool(np.any(estimate.is_slack[tendons])):
            if elapsed < TAUT_TIMEOUT_S:
                return progress, ()
            text = f"not taut after {TAUT_TIMEOUT_S:g} s"
            zero_torque_goals = (DigitGoal(),) * len(progress.goals)
            progress_after_failure = replace(
                progress, finished=True, failure=f"{step.digit}: {text}", goals=zero_torque_goals
            )
            return progress_after_failure, (TickEvent("error", "identify", step.digit, text),)
        if step.name == TARE_STEP_NAME:
            progress = _with_slack_readings(model, progress, estimate, measurements, tendons)
        if elapsed < step.duration_s:
            return progress, ()
        if step.name == TARE_STEP_NAME:
            progress = _with_renewed_tare(model, progress, step.duration_s)
        return self._enter_step(model, progress, estimate, t, progress.step + 1)

    def _enter_step(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        t: float,
        step_index: int,
    ) -> ProgressAndEvents:
        """Begin a step of the excitation. After the last step, the method ends the program."""
        goals = [DigitGoal()] * len(model.digits)
        if step_index == len(self.steps):
            finished_progress = replace(
                progress,
                finished=True,
                phase="end",
                goals=tuple(goals),
                contact=(False,) * len(goals),
            )
            return finished_progress, (TickEvent("info", "phase", "", "excitation complete"),)
        step = self.steps[step_index]
        d = model.hand.digit_names.index(step.digit)
        goals[d] = _digit_goal(model, d, step, estimate, t)
        phase = f"{step.digit} {step.name}"
        is_same_phase = phase == progress.phase
        contact = tuple(i == d and step.held for i in range(len(goals)))
        progress = replace(
            progress, step=step_index, since=t, phase=phase, goals=tuple(goals), contact=contact
        )
        # Consecutive steps with the same name are a single phase in the log.
        return progress, () if is_same_phase else (TickEvent("info", "phase", step.digit, phase),)


def _with_slack_readings(
    model: HandModel,
    progress: ProgramProgress,
    estimate: HandEstimate,
    measurements: TickMeasurements,
    excited_tendons: slice,
) -> ProgramProgress:
    """Add the load-cell readings of slack tendons in this tick to the record. Return the new progress.

    The record is a table (2, N). The first row contains the sum of the load-cell readings of each
    tendon [N]. The second row contains the number of readings in each sum. The readings of the
    excited digit are not used, because the identification determines the offsets of these load
    cells.
    """
    table = np.array(progress.record or (0.0,) * (2 * model.tendon_count)).reshape(2, -1)
    is_usable = estimate.is_slack & ~np.isnan(measurements.tension)
    is_usable[excited_tendons] = False
    table[0, is_usable] += measurements.tension[is_usable]
    table[1, is_usable] += 1.0
    return replace(progress, record=tuple(table.ravel().tolist()))


def _with_renewed_tare(
    model: HandModel, progress: ProgramProgress, duration_s: float
) -> ProgramProgress:
    """Return the progress of the program with new tares of the load cells, and without the recorded readings.

    A load cell is tared again if its tendon was slack during most of the step ``tare``, and if the
    absolute value of the new tare is at most ``MAX_TARE_CHANGE_N``.

    Args:
        model: model of the hand.
        progress: progress at the end of the step ``tare``.
        duration_s: duration of the step [s].
    """
    sums, counts = np.array(progress.record).reshape(2, -1)
    tare = np.array(progress.tare or (0.0,) * model.tendon_count)
    new_tare = tare + sums / np.maximum(counts, 1.0)
    is_renewed = (counts * model.period >= MIN_SLACK_FRACTION * duration_s) & (
        np.abs(new_tare) <= MAX_TARE_CHANGE_N
    )
    return replace(progress, record=(), tare=tuple(np.where(is_renewed, new_tare, tare).tolist()))


def _digit_goal(
    model: HandModel, d: int, step: ExciteStep, estimate: HandEstimate, t: float
) -> DigitGoal:
    """Return the goal of digit d in a step of the excitation."""
    digit = model.digits[d]
    tendons = model.digit_tendons[d]
    coordinates = coordinates_from_excursion(digit, estimate)
    targets = np.array(step.targets) if step.targets else None
    if step.kind == "move":
        path = MinimumJerk(
            coordinates,
            np.full_like(coordinates, step.target) if targets is None else targets,
            step.duration_s,
        )
        return DigitGoal(GoalKind.MOTION, path, since=t)
    if step.kind == "chirp":
        amplitudes = step.amplitudes or (step.amplitude,) * len(coordinates)
        chirp = ChirpTrajectory(0.0, 1.0, step.low_Hz, step.high_Hz, step.duration_s, 1)
        swing_trajectory = SwingTrajectory(
            np.full_like(coordinates, step.target) if targets is None else targets,
            np.array(amplitudes),
            chirp,
        )
        return DigitGoal(GoalKind.MOTION, swing_trajectory, since=t)
    if step.kind == "limp":
        return DigitGoal()
    tension = np.full(tendons.stop - tendons.start, step.target) if targets is None else targets
    return DigitGoal(GoalKind.TENSION, tension=tension, rate=step.rate)
