"""The program that commissions a hand: tare, zero, and the proof that each tendon pulls what it should.

One tendon after the other is pulled gently, all others limp, and only its own load cell may answer. The pull stays
below what moves a digit against its springs: it says nothing of joint encoders.

Load cells drift while many tendons are pulled one by one. Before each pull the hand is limp for a moment: the readings
then are what the answers of all load cells are judged against, and renew the tare of the tendon that is pulled next.
"""

from dataclasses import dataclass, replace

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.model import HandModel
from handctl.core.types import Event, Vector
from handctl.drives.sensors.node import TARE_LEAST_N, TARE_MOST_N
from handctl.programs.calibration import Calibration, TendonCalibration
from handctl.programs.program import TARE_PHASE, Progress

PULL_N = 3.0
PULL_FORCE_LIMIT_N = 12.0
"""Motor force that a pull may use, should its load cell not answer: pull, friction and a margin."""
TARE_S = 0.5
REST_SETTLE_S, REST_S = 0.3, 0.2
"""Time for which the hand is limp before each pull, and time for which load cells are read then."""
SETTLE_S = 0.7
TAKE_UP_TIMEOUT_S = 3.0
MEASURE_S = 0.3
ANSWER_SHARE = 0.6
"""A tendon's own load cell must answer with at least this share of the pull."""
CROSSTALK_SHARE = 0.3
"""No other load cell may answer with more."""

TARE, SAMPLES, ZERO, ANSWER, CROSSTALK, PULLED, REST, RESTED = range(8)
COLUMNS = 8
RESTING = -1
"""``Progress.touching[0]`` before a pull; 0 until its tendon is taut, then 1 more than the readings taken."""


@dataclass(frozen=True, slots=True)
class CommissionProgram:
    """Step 0 tares; step i + 1 pulls tendon i.

    ``Progress.record`` is a table of a row per tendon: sum of tare samples, their number, zero [rad], answer [N],
    crosstalk [N], the sum of its samples in the present pull, and the sum and number of those just before it.
    """

    def begin(self, model: HandModel) -> Progress:
        """Limp, and an empty table."""
        empty = (0.0,) * (COLUMNS * model.tendon_count)
        return replace(Progress.begin(len(model.digits), TARE_PHASE), since=-1.0, record=empty)

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick; see ``Program``."""
        if progress.finished:
            return progress, ()
        if progress.since < 0.0:
            return replace(progress, since=t), (Event("info", "phase", "", "tare: all motors limp"),)
        if progress.step == 0:
            return self._tare(model, progress, measured, t)
        if progress.touching[0] == RESTING:
            return self._rest(model, progress, measured, t)
        return self._pull(model, progress, estimate, measured, t)

    def _tare(
        self, model: HandModel, progress: Progress, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        table = _table(progress)
        if not np.isnan(measured.tension).any():
            table[:, TARE] += measured.tension
            table[:, SAMPLES] += 1.0
        progress = _with(progress, table)
        if t - progress.since < TARE_S:
            return progress, ()
        return self._tared(model, progress) or self._next(model, _renewed(progress), t)

    def _tared(self, model: HandModel, progress: Progress) -> tuple[Progress, tuple[Event, ...]] | None:
        """Refuse a tare that leaves no room to either end of the range; None if there is none."""
        tare = _tare(_table(progress))
        worst = int(np.maximum(tare - TARE_MOST_N, TARE_LEAST_N - tare).argmax())
        if TARE_LEAST_N <= tare[worst] <= TARE_MOST_N:
            return None
        read, bounds = f"{tare[worst]:.1f} N without tension", f"from {TARE_LEAST_N:g} to {TARE_MOST_N:g} N"
        return self._refuse(model, progress, worst, f"load cell reads {read}, which can be tared {bounds}")

    def _rest(
        self, model: HandModel, progress: Progress, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Read all load cells of the limp hand, renew the tare of the present tendon, then pull it.

        Only the present tendon's tare is renewed. It was never taut, whereas friction may hold tension in a tendon
        that was pulled before.
        """
        if t - progress.since < REST_SETTLE_S or np.isnan(measured.tension).any():
            return progress, ()
        i, table = progress.step - 1, _table(progress)
        table[:, REST] += measured.tension
        table[:, RESTED] += 1.0
        samples = table[i, RESTED]
        if samples * model.period < REST_S:
            return _with(progress, table), ()
        table[i, TARE] += table[i, REST] / samples * table[i, SAMPLES]
        table[i, REST] = 0.0
        progress = _renewed(_with(progress, table))
        goals = tuple(_pull_goal(tendons, i) for tendons in model.digit_tendons)
        name = model.hand.tendon_names[i]
        pulling = replace(progress, since=t, goals=goals, phase=f"pull {name}", touching=(0,) * len(goals))
        event = Event("info", "phase", name, f"pulling {name} with {PULL_N:g} N")
        return self._tared(model, progress) or (pulling, (event,))

    def _pull(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """Pull the present tendon: wait until it answers, let it settle, measure."""
        i = progress.step - 1
        waiting = progress.touching[0]
        if waiting == 0 and not estimate.slack[i]:
            progress = replace(progress, touching=(1, *progress.touching[1:]), since=t)
        if waiting == 0:
            late = t - progress.since > TAKE_UP_TIMEOUT_S
            return self._refuse(model, progress, i, _loose(model, measured)) if late else (progress, ())
        if t - progress.since < SETTLE_S or np.isnan(measured.tension).any() or np.isnan(measured.travel[i]):
            return progress, ()
        table = _table(progress)
        table[:, PULLED] += measured.tension
        table[i, ZERO] += measured.travel[i] / model.space.spool[i]
        samples = progress.touching[0]
        if samples * model.period >= MEASURE_S:
            return self._judge(model, _with(progress, _averaged(model, table, i, samples)), i, t)
        return replace(_with(progress, table), touching=(samples + 1, *progress.touching[1:])), ()

    def _judge(self, model: HandModel, progress: Progress, i: int, t: float) -> tuple[Progress, tuple[Event, ...]]:
        answer, crosstalk = _table(progress)[i, [ANSWER, CROSSTALK]]
        if answer < ANSWER_SHARE * PULL_N:
            return self._refuse(model, progress, i, f"load cell answers {answer:.2f} N to a pull of {PULL_N:g} N")
        if crosstalk > CROSSTALK_SHARE * PULL_N:
            text = f"another load cell answers {crosstalk:.2f} N: swapped, or two tendons touch"
            return self._refuse(model, progress, i, text)
        event = Event(
            "info", "commission", model.hand.tendon_names[i], f"answers {answer:.2f} N, others {crosstalk:.2f} N"
        )
        progress, entered = self._next(model, progress, t)
        return progress, (event, *entered)

    def _next(self, model: HandModel, progress: Progress, t: float) -> tuple[Progress, tuple[Event, ...]]:
        """Let go; rest before the next tendon is pulled, or finish."""
        step, limp = progress.step + 1, (DigitGoal(),) * len(model.digits)
        if step > model.tendon_count:
            finished = replace(progress, finished=True, phase="end", goals=limp)
            return finished, (Event("info", "phase", "", "commissioned"),)
        return replace(progress, step=step, since=t, goals=limp, phase="rest", touching=(RESTING,) * len(limp)), ()

    def _refuse(self, model: HandModel, progress: Progress, i: int, text: str) -> tuple[Progress, tuple[Event, ...]]:
        name = model.hand.tendon_names[i]
        failed = replace(progress, finished=True, failure=f"{name}: {text}", goals=(DigitGoal(),) * len(progress.goals))
        return failed, (Event("error", "commission", name, text),)


def _loose(model: HandModel, measured: Measured) -> str:
    """What is wrong with a tendon whose load cell does not answer at all: perhaps another one does."""
    answers = np.nan_to_num(measured.tension)
    other = int(answers.argmax())
    if answers[other] < ANSWER_SHARE * PULL_N:
        return "does not become taut"
    name = model.hand.tendon_names[other]
    return f"does not become taut, but the load cell of {name} reads {answers[other]:.1f} N: swapped?"


def _pull_goal(tendons: slice, i: int) -> DigitGoal:
    """Goal of a digit while tendon i is pulled; limp if it is another digit's."""
    if not tendons.start <= i < tendons.stop:
        return DigitGoal()
    tension = np.zeros(tendons.stop - tendons.start)
    tension[i - tendons.start] = PULL_N
    return DigitGoal(Kind.TENSION, tension=tension, rate=20.0, force_limit=PULL_FORCE_LIMIT_N)


def _table(progress: Progress) -> Vector:
    return np.array(progress.record).reshape(-1, COLUMNS)


def _with(progress: Progress, table: Vector) -> Progress:
    return replace(progress, record=tuple(table.ravel().tolist()))


def _tare(table: Vector) -> Vector:
    return np.asarray(table[:, TARE] / np.maximum(table[:, SAMPLES], 1.0))


def _renewed(progress: Progress) -> Progress:
    """Take the tares of the table off from the next reading on."""
    return replace(progress, tare=tuple(_tare(_table(progress)).tolist()))


def _averaged(model: HandModel, table: Vector, i: int, samples: int) -> Vector:
    """The table with the results of tendon i, and the sums of its pull gone."""
    rise = table[:, PULLED] / samples - table[:, REST] / table[i, RESTED]
    stretch = rise[i] / model.space.stiffness[i] / model.space.spool[i]
    table[i, ZERO] = table[i, ZERO] / samples - stretch
    table[i, ANSWER] = rise[i]
    table[i, CROSSTALK] = np.abs(np.delete(rise, i)).max(initial=0.0)
    table[:, [PULLED, REST, RESTED]] = 0.0
    return table


def result(model: HandModel, progress: Progress, made: str) -> Calibration:
    """The calibration that a finished commissioning found.

    Args:
        model: the hand.
        progress: finished, without failure.
        made: date and time, ISO 8601, UTC.
    """
    table = _table(progress)
    tare = _tare(table)
    rows = {
        name: TendonCalibration(
            tare_N=float(tare[i]),
            zero_rad=float(table[i, ZERO]),
            answer_N=float(table[i, ANSWER]),
            crosstalk_N=float(table[i, CROSSTALK]),
        )
        for i, name in enumerate(model.hand.tendon_names)
    }
    return Calibration(hand=model.hand.name, identity=model.hand.identity, made=made, tendon=rows)
