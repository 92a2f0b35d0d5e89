"""Verification of new gains on the hand itself.

The hand first executes an exercise with the old gains. Then the hand executes the exercise with the
new gains, in rounds of rising amplitude.

If the hand violates a limit with the new gains, an observer of the run requests the old gains
again. The controller treats the requests of the observer like the requests of any client. Therefore
the log contains the requests of the observer, and the run can be executed again.
"""

import json
import math
from collections import deque
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from handctl.core.gains.gain_bounds import LIVE_GAIN_SECTIONS, changed_gain_values, values_by_key
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import HandMode, PackedTelemetry, Telemetry, TickIn, TickOut
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import phase_of_each_tick
from handctl.programs.gains_exercise import move_amplitude
from handctl.report.run_summary import mean_angles
from handctl.report.truth_record import TruthRecord
from handctl.safety.safety_action import SafetyAction
from handctl.tune.scoring import GainScore, GroundTruth, digit_angles, score_ticks

ROUNDS_WITH_OLD_GAINS = 2
"""Number of rounds of the exercise with the old gains.

The last round with the old gains is compared with the last round with the new gains.
"""
ROUND_AMPLITUDES = (0.3, 1.0, 0.3, 0.6, 1.0)
"""Amplitudes of the rounds of the exercise: first the rounds with the old gains, then those with the new gains.

For the old and for the new gains, at least one other round precedes the compared round.
"""
RINGING_WINDOW_S = 0.1
"""Duration of the window in which oscillations of the torques are measured [s].

The window contains two periods of the oscillation of a drive on a blocked tendon.
"""
BLOCKED_LAG_RAD = 0.1
"""Difference between command and estimated angle at which a digit in contact counts as blocked [rad].

A digit that only touches an obstacle still follows its command. With gains that keep the margins, a
free digit lags behind its command by less than a third of this angle.
"""
BLOCKED_DURATION_NS = 50_000_000
"""Time after which a digit in contact that lags behind its command counts as blocked [ns].

Within this duration, the controller detects the contact of both digits, if one digit blocks
another.
"""
PROPOSED_AMPLITUDE_FRACTION = 0.9
"""Amplitude that is proposed for a hand with blocked digits, as a fraction of the amplitude at the contact."""
AMPLITUDE_ROUNDING_STEP = 0.05
"""Step to which a proposed amplitude is rounded down."""


def round_amplitudes(max_amplitude: float = 1.0) -> tuple[float, ...]:
    """Return the amplitude of each round of the exercise, scaled to the given largest amplitude."""
    return tuple(max_amplitude * amplitude for amplitude in ROUND_AMPLITUDES)


@dataclass(frozen=True, slots=True)
class BlockedDigit:
    """Digit that an obstacle or another digit stopped during a move of the exercise.

    Attributes:
        digit: name of the digit.
        by: names of the other digits that were blocked at the same time.
        angle: mean joint angle of the blocked digit, as text with a unit.
        amplitude: amplitude of the round.
        proposed_amplitude: amplitude of the exercise at which the digit does not reach the contact.
            The value is 0 if there is no such amplitude.
    """

    digit: str
    by: tuple[str, ...]
    angle: str
    amplitude: float
    proposed_amplitude: float

    def __str__(self) -> str:
        """Return a text that says that the blocked digit makes the verification invalid."""
        by = f" by {' and '.join(self.by)}" if self.by else ""
        text = f"{self.digit} is blocked{by} at {self.angle}"
        text += ": the amplitude is too large for this hand"
        if self.proposed_amplitude:
            text += f"; try --amplitude {self.proposed_amplitude:g}"
        return text


@dataclass(frozen=True, slots=True)
class VerifyLimits:
    """Limits within which a run with the new gains must stay.

    Attributes:
        max_tracking_error_rad: largest difference between the goal and the estimated angle of any joint
            during a move [rad]. For a prismatic joint, 10 mm count as 1 rad.
        max_tension_fraction: largest allowed tension of a tendon, as a fraction of the tendon's
            ``tension_trip_N``.
        ringing_factor: largest allowed rate of change of the motor torques (RMS over a window),
            divided by the largest rate with the old gains.
        ringing_floor_Nm_per_s: rate of change of the torques that never counts as an oscillation [N
            m/s].
    """

    max_tracking_error_rad: float = 0.35
    max_tension_fraction: float = 0.9
    ringing_factor: float = 1.5
    ringing_floor_Nm_per_s: float = 60.0


@dataclass(frozen=True, slots=True)
class GainsRollback:
    """Record of an event in a verification: the observer requested the old gains again.

    Attributes:
        t_s: time at which the return was requested [s].
        k: number of the tick in which the observer requested the return.
        amplitude: amplitude of the exercise in the round in which the return was requested.
        why: text with the violated limit and the measured value.
    """

    t_s: float
    k: int
    amplitude: float
    why: str


@dataclass
class VerifyObserver:
    """Observer of a verification run, which requests the new gains.

    If the hand exceeds a limit, the observer requests the old gains again.

    Attributes:
        hand: description of the running hand.
        old_gains: gains with which the run starts.
        new_gains: gains to verify. The new gains are allowed to differ from the old gains only in
            gains that a running controller can change.
        limits: limits for the rounds with the new gains.
        amplitudes: amplitudes of the rounds of the exercise.
        rounds_with_old_gains: number of rounds with the old gains.
        rollback: record of the return to the old gains, or None if no return was necessary.
        blocked: first digit that was blocked in a move, or None if no digit was blocked. The limit
            of the tracking error does not apply to a blocked digit, because the error of a blocked
            digit says nothing about the gains.
    """

    hand: Hand
    old_gains: Gains
    new_gains: Gains
    limits: VerifyLimits = VerifyLimits()
    amplitudes: tuple[float, ...] = ROUND_AMPLITUDES
    rounds_with_old_gains: int = ROUNDS_WITH_OLD_GAINS
    rollback: GainsRollback | None = None
    blocked: BlockedDigit | None = None
    _round_number: int = 0
    _lag_start_ns: int = 0
    _last_phase: str = ""
    _requests: list[str] = field(default_factory=list)
    _last_torque: "np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None" = None
    _squared_torque_rates: deque[float] = field(default_factory=deque)
    _max_torque_rate: float = 0.0

    def poll_requests(self) -> tuple[str, ...]:
        """Return the requests of the observer for this tick, see `RunObserver`."""
        requests = tuple(self._requests)
        self._requests = []
        return requests

    def on_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Observe a tick, see `RunObserver`."""
        if tick_output.phase == "settle" and self._last_phase != "settle":
            self._round_number += 1
            # The gains are changed in the phase `settle`, while the hand is at rest.
            if self._round_number == self.rounds_with_old_gains + 1:
                self._request_gains(self.new_gains, self.old_gains)
        self._last_phase = tick_output.phase
        if tick_output.phase != "move":
            self._lag_start_ns = tick_input.t_ns
        elif self.blocked is None and tick_output.mode == HandMode.ACTIVE:
            names = self._blocked_names(tick_output)
            self._lag_start_ns = self._lag_start_ns if names else tick_input.t_ns
            if tick_input.t_ns - self._lag_start_ns >= BLOCKED_DURATION_NS:
                self.blocked = self._blocked_digit(tick_output, names)
        torque_rate = self._torque_rate(tick_input, tick_output)
        if self._round_number <= self.rounds_with_old_gains:
            self._max_torque_rate = max(self._max_torque_rate, torque_rate)
        elif self.rollback is None and (reason := self._violated_limit(tick_output, torque_rate)):
            amplitude = self.amplitudes[self._round_number - 1]
            self.rollback = GainsRollback(tick_input.t_ns / 1e9, tick_input.k, amplitude, reason)
            self._request_gains(self.old_gains, self.new_gains)

    def _blocked_names(self, tick_output: TickOut) -> tuple[str, ...]:
        """Return the names of all digits in contact, if one of the digits lags behind the goal.

        The digit with the largest lag comes first. If no digit in contact lags, the result is
        empty.
        """
        telemetry = tick_output.telemetry
        goal_deviation = np.abs(telemetry.q_goal - telemetry.q) / self.hand.display_units.scale
        lag_by_digit = {
            name: float(np.nanmax(goal_deviation[joints], initial=0.0))
            for (name, joints), contact_seconds in zip(
                self.hand.digit_joints.items(), telemetry.contact, strict=True
            )
            if contact_seconds > 0.0
        }
        if max(lag_by_digit.values(), default=0.0) <= BLOCKED_LAG_RAD:
            return ()
        return tuple(sorted(lag_by_digit, key=lag_by_digit.__getitem__, reverse=True))

    def _blocked_digit(self, tick_output: TickOut, digit_names: tuple[str, ...]) -> BlockedDigit:
        """Return the description of a blocked digit. The names come from `_blocked_names`."""
        digit, *other_digits = digit_names
        units = self.hand.mean_position_units(digit)
        column = self.hand.digit_names.index(digit)
        mean = float(mean_angles(self.hand, tick_output.telemetry.q[None])[0, column])
        amplitude = PROPOSED_AMPLITUDE_FRACTION * move_amplitude(mean / float(units.scale[0]))
        return BlockedDigit(
            digit,
            tuple(other_digits),
            f"{units.factor[0] * mean:.0f} {units.names[0]}",
            self.amplitudes[self._round_number - 1],
            max(
                0.0,
                round(math.floor(amplitude / AMPLITUDE_ROUNDING_STEP) * AMPLITUDE_ROUNDING_STEP, 2),
            ),
        )

    def _request_gains(self, gains: Gains, present_gains: Gains) -> None:
        """Send the controller a request that contains all gains which a running controller can change."""
        # The running controller keeps the present force of each tendon that the request does not
        # mention. Therefore the request must set the forces of all tendons.
        value_by_key = values_by_key(gains) | {
            key: new_value
            for key, (_, new_value) in changed_gain_values(present_gains, gains).items()
        }
        values = {
            key: value
            for key, value in value_by_key.items()
            if key.partition(".")[0] in LIVE_GAIN_SECTIONS
        }
        self._requests.append(json.dumps({"do": "gains", "set": values}))

    @cached_property
    def _joint_counts(self) -> list[int]:
        """Return the number of joints of each digit."""
        return [len(digit.joints) for digit in self.hand.digit]

    def _torque_rate(self, tick_input: TickIn, tick_output: TickOut) -> float:
        """Return the RMS of the motor torques' rate of change over the window up to this tick [N m/s]."""
        torque = tick_output.telemetry.motor_torque_goal
        torque_before = self._last_torque
        self._last_torque = torque
        if torque_before is None or tick_output.mode != HandMode.ACTIVE:
            return 0.0
        # The observer does not know the control rate. Therefore the observer uses the mean period
        # of the ticks so far.
        period = tick_input.t_ns / max(tick_input.k, 1) / 1e9
        self._squared_torque_rates.append(
            float(np.square(torque - torque_before).mean()) / period**2
        )
        while len(self._squared_torque_rates) > RINGING_WINDOW_S / period:
            self._squared_torque_rates.popleft()
        return float(np.sqrt(sum(self._squared_torque_rates) / len(self._squared_torque_rates)))

    def _tracking_violation(self, telemetry: Telemetry | PackedTelemetry) -> str:
        """Return a text about the joint that is farthest from its goal.

        If the farthest joint does not violate the limit, the text is empty.
        """
        units = self.hand.display_units
        is_touching = np.repeat(telemetry.contact > 0.0, self._joint_counts)
        goal_deviation = np.abs(telemetry.q_goal - telemetry.q) / units.scale
        error = np.where(is_touching | np.isnan(goal_deviation), 0.0, goal_deviation)
        joint = int(error.argmax())
        if error[joint] <= self.limits.max_tracking_error_rad:
            return ""
        displayed_factor = units.scale[joint] * units.factor[joint]
        largest_error, limit = (
            displayed_factor * error[joint],
            displayed_factor * self.limits.max_tracking_error_rad,
        )
        return f"tracking error {largest_error:.1f} {units.names[joint]}, limit {limit:.1f}"

    def _violated_limit(self, tick_output: TickOut, torque_rate_Nm_per_s: float) -> str:
        """Return a text about the limit that a tick violates.

        If the tick violates no limit, the text is empty.
        """
        if tick_output.action >= SafetyAction.HOLD:
            return f"safety: {tick_output.action.name}"
        if tick_output.mode != HandMode.ACTIVE:
            return ""
        limits = self.limits
        telemetry = tick_output.telemetry
        if tick_output.phase == "move" and (text := self._tracking_violation(telemetry)):
            return text
        for tendon, tension in zip(self.hand.tendon, telemetry.tension.tolist(), strict=True):
            if tension > limits.max_tension_fraction * tendon.tension_trip_N:
                bound = limits.max_tension_fraction * tendon.tension_trip_N
                return f"tension of {tendon.name} {tension:.0f} N, limit {bound:.0f}"
        limit = max(limits.ringing_factor * self._max_torque_rate, limits.ringing_floor_Nm_per_s)
        return (
            f"motor torques oscillate by {torque_rate_Nm_per_s:.1f} N m/s, limit {limit:.1f}"
            if torque_rate_Nm_per_s > limit
            else ""
        )


COMPARED_MEASURES = {
    "tracking_deg": ("tracking", "deg"),
    "tension_N": ("tension", "N"),
    "effort_Nm_per_s": ("effort", "N m/s"),
    "peak_tension_N": ("peak tension", "N"),
}
"""Name and unit of each compared measure of quality, by the field of `GainScore` with this measure."""
DEFAULT_RELATIVE_SPREAD = 0.1
"""Spread of a measure that is assumed if there is only one run, as a fraction of the value with the old gains."""
MAX_EQUAL_DIFFERENCE_FRACTION = 0.02
"""Largest difference between old and new value that is judged as "same", as a fraction of the old value."""


@dataclass(frozen=True, slots=True)
class MeasureComparison:
    """Comparison of the old and the new gains by one measure of quality.

    The comparison uses only the rounds with full amplitude.

    Attributes:
        name: name of the measure of quality.
        unit: unit of the measure.
        old: mean of the measure over the runs with the old gains.
        new: mean of the measure over the runs with the new gains.
        spread: half of the 95 % confidence interval of the difference between new and old value. If
            there is only one run, the spread is an assumption.
        verdict: "better", "worse" or "same".
    """

    name: str
    unit: str
    old: float
    new: float
    spread: float
    verdict: str


def compare_rounds(round_scores: list[list[GainScore]]) -> list[MeasureComparison]:
    """Compare the old and the new gains.

    In each run, the last round with the old gains and the last round with the new gains are
    compared. In both compared rounds, the exercise has the full amplitude.

    Args:
        round_scores: scores of the rounds of each run.
    """
    columns = []
    for key, (name, unit) in COMPARED_MEASURES.items():
        old_scores = np.array(
            [getattr(rounds[ROUNDS_WITH_OLD_GAINS - 1], key) for rounds in round_scores]
        )
        new_scores = np.array([getattr(rounds[-1], key) for rounds in round_scores])
        n = len(round_scores)
        mean = float(old_scores.mean())
        change = float((new_scores - old_scores).mean())
        spread = (
            DEFAULT_RELATIVE_SPREAD * mean
            if n == 1
            else float(student.ppf(0.975, n - 1) * (new_scores - old_scores).std(ddof=1) / n**0.5)
        )
        counts = abs(change) > max(spread, MAX_EQUAL_DIFFERENCE_FRACTION * mean)
        verdict = ("worse" if change > 0.0 else "better") if counts else "same"
        columns.append(
            MeasureComparison(name, unit, mean, float(new_scores.mean()), spread, verdict)
        )
    return columns


def scores_by_round(
    log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int
) -> list[GainScore]:
    """Calculate the score of each round of the exercise.

    In the result, the rounds with the old gains come before the rounds with the new gains.

    The tracking error does not include digits in contact, because a digit in contact cannot follow
    its commands.

    Args:
        log: log of the verification.
        hand: hand description of the run.
        truth: true values from the simulator, or None on hardware. On hardware, the estimates of
            the controller replace the true values.
        offset_ns: time on the clock of the simulator at which the time of the run was 0 [ns].
    """
    start_indices = [change.k for change in log.phases if change.name == "settle"]
    phase = phase_of_each_tick(log.phases, log.k)
    angle = np.where(log.field("contact") > 0.0, np.nan, digit_angles(hand, log.field("q_goal")))
    if truth is None:
        ground_truth = GroundTruth(digit_angles(hand, log.field("q")), log.field("tension"))
    else:
        ground_truth = GroundTruth.from_record(truth, hand, log.t_ns + offset_ns)
    results = []
    for start, end in zip(start_indices, [*start_indices[1:], int(log.k[-1]) + 1], strict=True):
        is_in_round = (log.k >= start) & (log.k < end) & (log.mode == int(HandMode.ACTIVE))
        truth_of_round = GroundTruth(
            ground_truth.angle[is_in_round], ground_truth.tension[is_in_round]
        )
        tension = log.field("tension_goal")[is_in_round]
        torque = log.field("motor_torque_goal")[is_in_round]
        results.append(
            score_ticks(
                log.t_ns[is_in_round],
                phase[is_in_round],
                angle[is_in_round],
                tension,
                torque,
                truth_of_round,
            )
        )
    return results
