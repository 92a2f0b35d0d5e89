"""Gains on trial: the whole controller does the exercise on simulated plants in lockstep, and the truth judges it."""

import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Mode, TickIn, TickOut
from handctl.hand.description import Hand
from handctl.hand.load import hand_from
from handctl.programs.exercise import Exercise
from handctl.programs.program import Program
from handctl.report.summary import mean_angles, rms
from handctl.report.truth import Truth, read_truth
from handctl.session.simulate import Simulator, homed_controller, simulate
from handctl.tune.loops.design import linear_factors, worst_of

Array = NDArray[np.float64]

FAILED = 1e3
"""Objective of gains that did not get through the exercise."""


@dataclass(frozen=True, slots=True)
class Score:
    """What gains are worth, the root mean square over the plants.

    Attributes:
        tracking_deg: error of the mean joint angle while moving, against the truth.
        tension_N: error of the true tension against its set-point while holding.
        effort_Nm_per_s: rate of the commanded motor torque, which is what wears and what is heard.
        peak_tension_N: largest true tension on any plant.
        shortfall: of the margins on the worst plant, as a share; 0 or less is enough.
        failure: why the exercise ended early; empty if it did not.
    """

    tracking_deg: float
    tension_N: float
    effort_Nm_per_s: float
    peak_tension_N: float
    shortfall: float
    failure: str = ""

    @property
    def objectives(self) -> tuple[float, float, float]:
        """What a search makes small."""
        return self.tracking_deg, self.tension_N, self.effort_Nm_per_s

    def cost(self, scale: "Score") -> float:
        """One number: each objective as a multiple of another score's, effort at a tenth.

        What is measured first is tracking and tension; effort decides between gains that are alike in these.
        """
        parts = [own / max(other, 1e-9) for own, other in zip(self.objectives, scale.objectives, strict=True)]
        return (parts[0] + parts[1] + 0.1 * parts[2]) / 2.1


def evaluate(job: Mapping[str, Any]) -> dict[str, Any]:
    """Score gains; a plain function of plain data, for whoever computes.

    Args:
        job: hand (text of its file), rate_hz, gains (table), plants (factor tables), seed, and optionally
            must_keep_margins: do not simulate gains that fall short of them.

    Returns:
        a ``Score`` as a table.
    """
    hand = hand_from(tomllib.loads(job["hand"]), "the hand on trial")
    gains = Gains.model_validate(job["gains"])
    model = HandModel.of(hand, gains, float(job["rate_hz"]))
    plants = job["plants"]
    shortfall = worst_of(model, tuple(linear_factors(factors) for factors in plants)).shortfall
    if shortfall > 0.0 and job.get("must_keep_margins", False):
        return _table(Score(FAILED, FAILED, FAILED, 0.0, shortfall, "margins"))
    runs = []
    for i, factors in enumerate(plants):
        runs.append(exercise(hand, model, factors, int(job["seed"]) + i))
        if runs[-1].failure:
            return _table(Score(FAILED, FAILED, FAILED, runs[-1].peak_tension_N, shortfall, runs[-1].failure))
    tracking, tension, effort = np.sqrt(np.mean([np.square(run.objectives) for run in runs], axis=0)).tolist()
    return _table(Score(tracking, tension, effort, max(run.peak_tension_N for run in runs), shortfall))


def _table(score: Score) -> dict[str, Any]:
    return {name: getattr(score, name) for name in Score.__dataclass_fields__}


def exercise(hand: Hand, model: HandModel, factors: Mapping[str, float], seed: int) -> Score:
    """One run of the exercise on one plant, with nothing said of margins.

    Args:
        hand: description.
        model: the hand with the gains.
        factors: of the plant, on what the hand's description says.
        seed: of its noise.
    """
    return judge(hand, *simulated(hand, model, Exercise(), factors, seed))


Ticks = list[tuple[TickIn, TickOut]]


def simulated(
    hand: Hand, model: HandModel, program: Program, factors: Mapping[str, float], seed: int
) -> tuple[Ticks, Truth, str]:
    """Run a program on one simulated plant in lockstep.

    Args:
        hand: description.
        model: the hand with the gains.
        program: to run.
        factors: of the plant, on what the hand's description says.
        seed: of its noise.

    Returns:
        ticks, the simulator's truth, and why it ended early (empty if it did not).
    """
    ticks: Ticks = []
    with tempfile.TemporaryDirectory(prefix="handctl-") as folder:
        file = Path(folder) / "truth"
        twin = Simulator(hand, seed=seed, perturb=factors, homed=True, truth=file)
        state = simulate(homed_controller(model, program, hand), twin, lambda entry, out: ticks.append((entry, out)))
        return ticks, read_truth(file), state.failure


def judge(hand: Hand, ticks: Sequence[tuple[TickIn, TickOut]], truth: Truth, failure: str) -> Score:
    """Score of one run by the simulator's truth.

    Args:
        hand: that ran.
        ticks: of the run.
        truth: of the plant.
        failure: why it ended early, or empty.
    """
    kept = [(entry.t_ns, out) for entry, out in ticks if out.mode == Mode.ACTIVE]
    tension = truth.values[:, [truth.columns.index(f"tension/{name}") for name in hand.tendon_names]]
    peak = float(tension.max(initial=0.0))
    if failure or not kept:
        return Score(FAILED, FAILED, FAILED, peak, 0.0, failure or "never active")
    t_ns = np.array([t for t, _ in kept])
    goal, pull, torque = (
        np.array([getattr(out.telemetry, name) for _, out in kept])
        for name in ("q_goal", "tension_goal", "motor_torque_goal")
    )
    real = Reality.of(truth, hand, t_ns)
    phase = np.array([out.phase for _, out in kept])
    return score(t_ns, phase, mean_angles(hand, goal), pull, torque, real)


class Reality(NamedTuple):
    """What a run is judged by: the simulator's truth, or on hardware the estimates.

    Attributes:
        angle: (ticks, D) mean joint angle [rad].
        tension: (ticks, N) [N].
    """

    angle: Array
    tension: Array

    @staticmethod
    def of(truth: Truth, hand: Hand, t_ns: NDArray[np.int64]) -> "Reality":
        """The truth at times [ns on the simulator's clock]."""
        return Reality(
            mean_angles(hand, truth.table([f"q/{joint}" for joint in hand.joints], t_ns)),
            truth.table([f"tension/{name}" for name in hand.tendon_names], t_ns),
        )


def score(
    t_ns: NDArray[np.int64], phase: NDArray[Any], angle: Array, tension: Array, torque: Array, real: Reality
) -> Score:
    """Score of ticks of an exercise, with nothing said of margins.

    Args:
        t_ns: (ticks,) [ns].
        phase: (ticks,) names.
        angle: (ticks, D) goals of the mean joint angle [rad].
        tension: (ticks, N) goals [N].
        torque: (ticks, M) commanded [N m].
        real: what really was.
    """
    rate = np.diff(torque, axis=0) / (np.diff(t_ns)[:, None] / 1e9)
    return Score(
        tracking_deg=float(np.degrees(rms((angle - real.angle)[phase == "move"]))),
        tension_N=rms((tension - real.tension)[phase == "hold"]),
        effort_Nm_per_s=rms(rate[np.isin(phase[1:], ("move", "hold"))]),
        peak_tension_N=float(real.tension.max(initial=0.0)),
        shortfall=0.0,
    )
