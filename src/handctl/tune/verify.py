"""New gains on the hand: the old ones first, then the new at rising amplitude, and back when a limit is met.

The watch sees each tick's numbers and asks through the controller's request socket like anybody else, so what it did is
in the log and the run can be executed again.
"""

import json
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import t as student

from handctl.core.gains.bounds import LIVE, flat
from handctl.core.gains.gains import Gains
from handctl.core.types import Mode, TickIn, TickOut
from handctl.hand.description import Hand
from handctl.log.read.moments import phase_of_each
from handctl.log.read.reader import RunLog
from handctl.report.summary import mean_angles
from handctl.report.truth import Truth
from handctl.safety.action import Action
from handctl.tune.trial import Reality, Score, score

OLD_ROUNDS = 2
AMPLITUDES = (0.3, 1.0, 0.3, 0.6, 1.0)
"""The old gains, then the new ones, rising; like them the old ones have a round before the one that counts."""
WINDOW_S = 0.1
"""Over which ringing is judged: two periods of a drive on a blocked rope."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What the new gains must not pass.

    Attributes:
        tracking_rad: error of any joint's estimate while moving.
        tension_share: of the tendon's trip.
        ringing: rate of the motor torques, rms over a window, as a multiple of the most that the old gains needed.
        ringing_floor_Nm_per_s: below which nothing counts as ringing.
    """

    tracking_rad: float = 0.35
    tension_share: float = 0.9
    ringing: float = 1.5
    ringing_floor_Nm_per_s: float = 60.0


@dataclass(frozen=True, slots=True)
class Return:
    """The way back to the old gains.

    Attributes:
        t_s: when it was asked for.
        k: in which tick.
        amplitude: of the exercise then.
        why: which limit, with value and bound.
    """

    t_s: float
    k: int
    amplitude: float
    why: str


@dataclass
class Watch:
    """Who asks for the new gains, watches, and asks for the old ones.

    Attributes:
        hand: that runs.
        old, new: gains; they differ in what a running controller takes.
        limits: to keep.
        amplitudes: of the rounds of the exercise.
        old_rounds: how many of them are for the old gains.
        returned: set when it went back.
    """

    hand: Hand
    old: Gains
    new: Gains
    limits: Limits = Limits()
    amplitudes: tuple[float, ...] = AMPLITUDES
    old_rounds: int = OLD_ROUNDS
    returned: Return | None = None
    _round: int = 0
    _phase: str = ""
    _asks: list[str] = field(default_factory=list)
    _torque: "np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None" = None
    _rates: deque[float] = field(default_factory=deque)
    _most: float = 0.0

    def take(self) -> tuple[str, ...]:
        """See ``Attendant``."""
        asked, self._asks = tuple(self._asks), []
        return asked

    def see(self, entry: TickIn, out: TickOut) -> None:
        """See ``Attendant``."""
        if out.phase == "settle" and self._phase != "settle":
            self._round += 1
            if self._round == self.old_rounds + 1:
                self._ask(self.new)
        self._phase = out.phase
        ringing = self._ringing(entry, out)
        if self._round <= self.old_rounds:
            self._most = max(self._most, ringing)
        elif self.returned is None and (why := self._passed(out, ringing)):
            amplitude = self.amplitudes[self._round - 1]
            self.returned = Return(entry.t_ns / 1e9, entry.k, amplitude, why)
            self._ask(self.old)

    def _ask(self, gains: Gains) -> None:
        values = {key: value for key, value in flat(gains).items() if key.partition(".")[0] in LIVE}
        self._asks.append(json.dumps({"do": "gains", "set": values}))

    def _ringing(self, entry: TickIn, out: TickOut) -> float:
        """Rate of the motor torques, rms over a window [N m/s]."""
        torque, before = out.telemetry.motor_torque_goal, self._torque
        self._torque = torque
        if before is None or out.mode != Mode.ACTIVE:
            return 0.0
        period = entry.t_ns / max(entry.k, 1) / 1e9
        self._rates.append(float(np.square(torque - before).mean()) / period**2)
        while len(self._rates) > WINDOW_S / period:
            self._rates.popleft()
        return float(np.sqrt(sum(self._rates) / len(self._rates)))

    def _passed(self, out: TickOut, ringing: float) -> str:
        """Which limit is passed, in words; empty if none."""
        if out.action >= Action.HOLD:
            return f"safety: {out.action.name}"
        if out.mode != Mode.ACTIVE:
            return ""
        limits, numbers = self.limits, out.telemetry
        error = np.abs(numbers.q_goal - numbers.q)
        worst = float(np.nanmax(error, initial=0.0)) if out.phase == "move" else 0.0
        if worst > limits.tracking_rad:
            return f"tracking error {np.degrees(worst):.1f} deg, limit {np.degrees(limits.tracking_rad):.1f}"
        for tendon, tension in zip(self.hand.tendon, numbers.tension.tolist(), strict=True):
            if tension > limits.tension_share * tendon.tension_trip_N:
                bound = limits.tension_share * tendon.tension_trip_N
                return f"tension of {tendon.name} {tension:.0f} N, limit {bound:.0f}"
        most = max(limits.ringing * self._most, limits.ringing_floor_Nm_per_s)
        return f"motor torques ring with {ringing:.1f} N m/s, limit {most:.1f}" if ringing > most else ""


COLUMNS = {
    "tracking_deg": ("tracking", "deg"),
    "tension_N": ("tension", "N"),
    "effort_Nm_per_s": ("effort", "N m/s"),
    "peak_tension_N": ("peak tension", "N"),
}
ONE_RUN = 0.1
"""Spread of a column of which there is one run, as a share of its value: an assumption."""
LEAST_SPREAD = 0.02
"""Difference that counts, at least, as a share of the old value."""


@dataclass(frozen=True, slots=True)
class Column:
    """One measure at full amplitude, old gains against new.

    Attributes:
        name, unit: of the measure.
        old, new: means over the runs.
        spread: half of the 95 % interval of the difference; assumed where there is one run.
        verdict: "better", "worse" or "same".
    """

    name: str
    unit: str
    old: float
    new: float
    spread: float
    verdict: str


def compare(runs: list[list[Score]]) -> list[Column]:
    """Judge the new gains' round at full amplitude against the old gains', run by run.

    Args:
        runs: scores of the rounds of each run.
    """
    found = []
    for key, (name, unit) in COLUMNS.items():
        old = np.array([getattr(rounds[OLD_ROUNDS - 1], key) for rounds in runs])
        new = np.array([getattr(rounds[-1], key) for rounds in runs])
        n, mean, change = len(runs), float(old.mean()), float((new - old).mean())
        spread = ONE_RUN * mean if n == 1 else float(student.ppf(0.975, n - 1) * (new - old).std(ddof=1) / n**0.5)
        counts = abs(change) > max(spread, LEAST_SPREAD * mean)
        verdict = ("worse" if change > 0.0 else "better") if counts else "same"
        found.append(Column(name, unit, mean, float(new.mean()), spread, verdict))
    return found


def scores(log: RunLog, hand: Hand, truth: Truth | None, offset_ns: int) -> list[Score]:
    """A score of each round of the exercise, of the old gains first.

    Args:
        log: of the verification.
        hand: that ran.
        truth: of the simulator; None on hardware, where the estimates judge.
        offset_ns: the run's t = 0 on the simulator's clock [ns].
    """
    begins = [change.k for change in log.phases if change.name == "settle"]
    phase = phase_of_each(log.phases, log.k)
    angle = mean_angles(hand, log.field("q_goal"))
    if truth is None:
        real = Reality(mean_angles(hand, log.field("q")), log.field("tension"))
    else:
        real = Reality.of(truth, hand, log.t_ns + offset_ns)
    found = []
    for begin, end in zip(begins, [*begins[1:], int(log.k[-1]) + 1], strict=True):
        part = (log.k >= begin) & (log.k < end) & (log.mode == int(Mode.ACTIVE))
        own = Reality(real.angle[part], real.tension[part])
        tension, torque = log.field("tension_goal")[part], log.field("motor_torque_goal")[part]
        found.append(score(log.t_ns[part], phase[part], angle[part], tension, torque, own))
    return found
