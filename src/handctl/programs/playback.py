"""Program that repeats the motion of a recorded run with the recorded timing.

The program repeats either the recorded joint trajectories or the recorded tensions.
"""

import base64
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import MinimumJerk, SampledTrajectory
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector
from handctl.programs.live_session import LiveProgram
from handctl.programs.program import ProgramProgress, ProgressAndEvents, coordinates_from_excursion

APPROACH_DURATION_S = 2.0
"""Duration of the slow move to the first pose of the recording [s]."""
APPROACH_RATE_N_PER_S = 20.0
"""Rate at which the tension approaches the first recorded tension [N/s]."""
FOLLOW_RATE_N_PER_S = 5000.0
"""Largest rate of the tension while the program follows the recording [N/s].

The recorded tension setpoints already have a limited rate.
"""


@dataclass(frozen=True, slots=True)
class RecordedGoals:
    """Goals of all digits over time, taken from a recorded run.

    The arrays have one row for each tick of the controller that repeats the run.

    Attributes:
        q: (ticks, J) joint goals [rad], with NaN where the digit held a tension instead.
        dq: (ticks, J) rates of the joint goals [rad/s].
        ddq: (ticks, J) accelerations of the joint goals [rad/s^2].
        tension: (ticks, N) tension goals at the load cells [N].
    """

    q: Vector
    dq: Vector
    ddq: Vector
    tension: Vector

    def to_text(self) -> str:
        """Return the recording as text.

        The text contains the exact numbers, so that ``from_text`` returns an equal recording.
        """
        table = np.hstack([self.q, self.dq, self.ddq, self.tension])
        # The numbers are little-endian float64, so that the text is the same on every machine.
        return base64.b64encode(table.astype("<f8").tobytes()).decode()

    @staticmethod
    def from_text(text: str, joints: int, tendons: int) -> "RecordedGoals":
        """Return the recorded goals that a text from ``to_text`` contains.

        Raises:
            ValueError: the text is not a table with the columns for the joints and tendons.
        """
        table = np.frombuffer(base64.b64decode(text, validate=True), "<f8").reshape(
            -1, 3 * joints + tendons
        )
        q, dq, ddq, tension = np.split(table, [joints, 2 * joints, 3 * joints], axis=1)
        return RecordedGoals(q, dq, ddq, tension)


@dataclass(frozen=True, slots=True, eq=False)
class PlaybackProgram:
    """Program that repeats the motion in a recording.

    The program first takes up the slack of the tendons, then moves slowly to the first pose of the
    recording, and then follows the recording.

    Attributes:
        recording: recording to follow.
        raw: True to follow the recorded tensions. The speed of the recorded trajectories is used as
            a feedforward, but no control loop corrects errors of the joint angles. A tension error
            of one newton moves a free finger by 12 degrees against its springs.
    """

    recording: RecordedGoals
    raw: bool = False

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
        """Advance the playback by one tick. The interface `Program` explains the arguments."""
        if progress.finished:
            return progress, ()
        if progress.phase in ("start", "tighten"):
            progress, events = LiveProgram().advance(model, progress, estimate, measurements, t)
            return (
                (self._start_approach(model, progress, estimate, t))
                if progress.phase == "live"
                else (progress, events)
            )
        if progress.phase == "approach" and t - progress.since < APPROACH_DURATION_S:
            return progress, ()
        if progress.phase == "approach":
            progress = replace(progress, phase="playback", since=t, step=0)
            return self._follow_recording(model, progress), (
                TickEvent("info", "phase", "", "playback"),
            )
        if progress.step + 1 >= len(self.recording.q):
            return replace(progress, finished=True, phase="end"), (
                TickEvent("info", "phase", "", "recording complete"),
            )
        return self._follow_recording(model, replace(progress, step=progress.step + 1)), ()

    def _start_approach(
        self, model: HandModel, progress: ProgramProgress, estimate: HandEstimate, t: float
    ) -> ProgressAndEvents:
        """Start the slow move to the first pose of the recording."""
        goals = []
        for d, digit in enumerate(model.digits):
            tendons = model.digit_tendons[d]
            first_angles = self.recording.q[0, digit.joints]
            if np.isnan(first_angles).any():
                tension = self.recording.tension[0, tendons]
                goals.append(
                    DigitGoal(GoalKind.TENSION, tension=tension, rate=APPROACH_RATE_N_PER_S)
                )
            else:
                end = np.asarray(digit.joints_to_coordinates @ first_angles)
                path = MinimumJerk(
                    coordinates_from_excursion(digit, estimate), end, APPROACH_DURATION_S
                )
                goals.append(DigitGoal(GoalKind.MOTION, path, since=t))
        progress = replace(progress, goals=tuple(goals), phase="approach", since=t)
        return progress, (TickEvent("info", "phase", "", "approach: slowly to the first pose"),)

    def _follow_recording(self, model: HandModel, progress: ProgramProgress) -> ProgramProgress:
        """Set the goals of the present tick to the values in the corresponding row of the recording."""
        i = progress.step
        rows = self.recording
        goals = []
        contact = []
        for d, digit in enumerate(model.digits):
            # Joint goals are NaN where the digit held a tension in the recorded run.
            is_holding = bool(np.isnan(rows.q[i, digit.joints]).any())
            contact.append(is_holding)
            q, dq, ddq = (
                np.asarray(digit.joints_to_coordinates @ signal[i, digit.joints])
                for signal in (rows.q, rows.dq, rows.ddq)
            )
            reference = None if is_holding else SampledTrajectory(q, dq, ddq)
            if reference is not None and not self.raw:
                goals.append(DigitGoal(GoalKind.MOTION, reference))
                continue
            tension = rows.tension[i, model.digit_tendons[d]]
            goals.append(
                DigitGoal(GoalKind.TENSION, reference, tension=tension, rate=FOLLOW_RATE_N_PER_S)
            )
        return replace(progress, goals=tuple(goals), contact=tuple(contact))
