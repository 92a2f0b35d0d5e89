"""The program that does a recorded run again, at the recorded times: its trajectories, or its tensions."""

import base64
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import MinimumJerk, Sample
from handctl.core.model import HandModel
from handctl.core.types import Event, Vector
from handctl.programs.live import LiveProgram
from handctl.programs.program import Progress, coordinates

APPROACH_S = 2.0
"""Slow move to the first pose of the recording."""
APPROACH_RATE_N_PER_S = 20.0
FOLLOW_RATE_N_PER_S = 5000.0
"""Recorded set-points have had their rate limited already."""


@dataclass(frozen=True, slots=True)
class Recording:
    """What is to be done again, one row a tick of the present controller.

    Attributes:
        q, dq, ddq: (ticks, J) joint goals [rad], [rad/s], [rad/s^2]; NaN where the digit held a tension.
        tension: (ticks, N) tension goals at the load cells [N].
    """

    q: Vector
    dq: Vector
    ddq: Vector
    tension: Vector

    def text(self) -> str:
        """As text that reads back bit for bit."""
        table = np.hstack([self.q, self.dq, self.ddq, self.tension])
        return base64.b64encode(table.astype("<f8").tobytes()).decode()

    @staticmethod
    def read(text: str, joints: int, tendons: int) -> "Recording":
        """Inverse of ``text``.

        Raises:
            ValueError: the text is no table of this width.
        """
        table = np.frombuffer(base64.b64decode(text, validate=True), "<f8").reshape(-1, 3 * joints + tendons)
        q, dq, ddq, tension = np.split(table, [joints, 2 * joints, 3 * joints], axis=1)
        return Recording(q, dq, ddq, tension)


@dataclass(frozen=True, slots=True, eq=False)
class PlaybackProgram:
    """Tightens, moves slowly to the first pose, then follows the recording.

    Attributes:
        recording: what to follow.
        raw: follow its tensions and leave the joints to themselves: the speed of its trajectories is fed forward, but
            no angle is corrected, and a newton too much is 12 degrees of a free finger's springs.
    """

    recording: Recording
    raw: bool = False

    def begin(self, model: HandModel) -> Progress:
        """Limp until the hand is armed."""
        return LiveProgram().begin(model)

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick; see ``Program``."""
        if progress.finished:
            return progress, ()
        if progress.phase in ("start", "tighten"):
            progress, events = LiveProgram().advance(model, progress, estimate, measured, t)
            return (self._approach(model, progress, estimate, t)) if progress.phase == "live" else (progress, events)
        if progress.phase == "approach" and t - progress.since < APPROACH_S:
            return progress, ()
        if progress.phase == "approach":
            progress = replace(progress, phase="playback", since=t, step=0)
            return self._follow(model, progress), (Event("info", "phase", "", "playback"),)
        if progress.step + 1 >= len(self.recording.q):
            return replace(progress, finished=True, phase="end"), (Event("info", "phase", "", "recording complete"),)
        return self._follow(model, replace(progress, step=progress.step + 1)), ()

    def _approach(
        self, model: HandModel, progress: Progress, estimate: Estimate, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Slowly to where the recording begins."""
        goals = []
        for d, digit in enumerate(model.digits):
            tendons, first = model.digit_tendons[d], self.recording.q[0, digit.joints]
            if np.isnan(first).any():
                tension = self.recording.tension[0, tendons]
                goals.append(DigitGoal(Kind.TENSION, tension=tension, rate=APPROACH_RATE_N_PER_S))
            else:
                end = np.asarray(digit.joints_to_coordinates @ first)
                path = MinimumJerk(coordinates(digit, estimate), end, APPROACH_S)
                goals.append(DigitGoal(Kind.MOTION, path, since=t))
        progress = replace(progress, goals=tuple(goals), phase="approach", since=t)
        return progress, (Event("info", "phase", "", "approach: slowly to the first pose"),)

    def _follow(self, model: HandModel, progress: Progress) -> Progress:
        """Goals of the present row."""
        i, rows, goals, contact = progress.step, self.recording, [], []
        for d, digit in enumerate(model.digits):
            held = bool(np.isnan(rows.q[i, digit.joints]).any())
            contact.append(held)
            q, dq, ddq = (
                np.asarray(digit.joints_to_coordinates @ part[i, digit.joints]) for part in (rows.q, rows.dq, rows.ddq)
            )
            way = None if held else Sample(q, dq, ddq)
            if way is not None and not self.raw:
                goals.append(DigitGoal(Kind.MOTION, way))
                continue
            tension = rows.tension[i, model.digit_tendons[d]]
            goals.append(DigitGoal(Kind.TENSION, way, tension=tension, rate=FOLLOW_RATE_N_PER_S))
        return replace(progress, goals=tuple(goals), contact=tuple(contact))
