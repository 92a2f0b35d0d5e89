"""Scores of gains. A score comes from runs of the whole controller on simulated plants.

A score is calculated from the differences between the goals of an exercise and the true values of
the simulator.
"""

import functools
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, PackedTelemetry, TickIn, TickOut
from handctl.document import validate_content
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content
from handctl.programs.commission import CommissionProgram
from handctl.programs.gains_exercise import ExerciseProgram
from handctl.programs.program import Program
from handctl.report.run_summary import mean_angles, root_mean_square
from handctl.report.truth_record import TruthRecord, read_truth
from handctl.session.lockstep_simulation import (
    SimulatorSettings,
    homed_controller,
    simulate_controller,
)
from handctl.tune.loops.gain_design import linear_factors, worst_margins

Array = NDArray[np.float64]

TOUCH_FORCE_N = 0.05
"""True contact force above which a digit is blocked, for example by another digit [N].

The tracking error of a blocked digit says nothing about the gains.
"""
MAX_HELD_S = 2.0
"""Time for which faults are allowed to hold the hand in a run of an exercise, in total [s]."""
OBJECTIVE_OF_FAILED_RUN = 1e3
"""Value of each objective for gains with which the exercise did not finish."""


@dataclass(frozen=True, slots=True)
class GainScore:
    """Score of a set of gains: the root mean square of each error over all plants, and the worst values.

    Attributes:
        tracking_deg: difference between the goal and the true mean joint angle while digits move
            [deg].
        tension_N: difference between the goal and the true tension while tensions are held [N].
        effort_Nm_per_s: rate of change of the commanded motor torque, a measure of wear and noise
            [N m/s].
        peak_tension_N: largest true tension of any tendon on any of the plants [N].
        shortfall: required margin minus the margin on the worst plant, as a fraction of the
            required margin. The shortfall is 0 or less if all margins are large enough.
        failure: reason why a run ended early or has no score, or an empty text.
        blocked: names of the digits that an obstacle or a digit blocked during a move, separated by
            commas. While a digit is blocked, its tracking error is not part of the score.
    """

    tracking_deg: float
    tension_N: float
    effort_Nm_per_s: float
    peak_tension_N: float
    shortfall: float
    failure: str = ""
    blocked: str = ""

    @property
    def objectives(self) -> tuple[float, float, float]:
        """Return the three numbers that a search minimises: errors of tracking and tension, and effort."""
        return self.tracking_deg, self.tension_N, self.effort_Nm_per_s

    def relative_cost(self, scale: "GainScore") -> float:
        """Return the cost of this score as a single number, relative to a reference score.

        The weight of the effort is a tenth of the weight of each error. Therefore the effort
        decides mainly between sets of gains with similar errors of tracking and tension.
        """
        # The weights of tracking, tension and effort are 1, 1 and 0.1. The weights are divided by
        # their sum 2.1, so that the cost of the reference score is 1.
        relative_objectives = [
            objective / max(scale_objective, 1e-9)
            for objective, scale_objective in zip(self.objectives, scale.objectives, strict=True)
        ]
        return (
            relative_objectives[0] + relative_objectives[1] + 0.1 * relative_objectives[2]
        ) / 2.1


def evaluate_job(score_job: Mapping[str, Any]) -> dict[str, Any]:
    """Calculate the score of the gains in a job.

    The job and the result consist of plain values, so that any process can evaluate a job.

    Args:
        score_job: table with the keys hand (text of the hand file), rate_hz, gains (table), plants
            (tables of factors) and seed. If the optional key must_keep_margins is True, gains
            without sufficient margins are not simulated.

    Returns:
        The `GainScore`, as a table.
    """
    hand, model = _job_hand_and_model(score_job)
    plants = score_job["plants"]
    shortfall = worst_margins(model, tuple(linear_factors(factors) for factors in plants)).shortfall
    if shortfall > 0.0 and score_job.get("must_keep_margins", False):
        return _score_table(_failed_score(0.0, "margins", shortfall))
    program = _exercise_of_hand(score_job["hand"])
    runs = []
    for i, factors in enumerate(plants):
        ticks_and_truth = simulate_program(
            hand, model, program, factors, int(score_job["seed"]) + i
        )
        runs.append(score_run(hand, *ticks_and_truth))
        if runs[-1].failure:
            return _score_table(replace(runs[-1], shortfall=shortfall))
    # In a root mean square over plants, the worst plants have the largest weight.
    tracking, tension, effort = np.sqrt(
        np.mean([np.square(run.objectives) for run in runs], axis=0)
    ).tolist()
    peak = max(run.peak_tension_N for run in runs)
    blocked_names = max((run.blocked for run in runs), key=len)
    return _score_table(
        GainScore(tracking, tension, effort, peak, shortfall, blocked=blocked_names)
    )


def commissioning_failure(score_job: Mapping[str, Any]) -> str:
    """Commission every simulated plant of a job, and return the reason of the first failure.

    With gains that are too low for the friction of the hand, a pull of a tendon ends before the
    tendon has the tension of the pull. Such a hand cannot be commissioned. If all plants can be
    commissioned, the reason is an empty text.

    Args:
        score_job: table with the same keys as in ``evaluate_job``.
    """
    hand, model = _job_hand_and_model(score_job)
    for i, factors in enumerate(score_job["plants"]):
        *_, failure_text = simulate_program(
            hand, model, CommissionProgram(), factors, int(score_job["seed"]) + i
        )
        if failure_text:
            return failure_text
    return ""


def _job_hand_and_model(score_job: Mapping[str, Any]) -> tuple[Hand, HandModel]:
    """Return the hand of a job, and the model of this hand with the gains of the job."""
    hand = _parsed_hand(score_job["hand"])
    # A job from another process contains lists in place of tuples.
    gains = validate_content(score_job["gains"], Gains, "the gains of the search")
    return hand, HandModel.from_hand(hand, gains, float(score_job["rate_hz"]))


# All jobs of a search have the same hand, so the results of the next two functions are cached.
@functools.lru_cache(maxsize=4)
def _parsed_hand(hand_text: str) -> Hand:
    """Return the hand that the text of a hand file describes."""
    return hand_from_content(tomllib.loads(hand_text), "the hand of the search")


@functools.lru_cache(maxsize=4)
def _exercise_of_hand(hand_text: str) -> ExerciseProgram:
    """Return the exercise for the hand that the text of a hand file describes."""
    return ExerciseProgram.for_hand(_parsed_hand(hand_text))


def _score_table(score: GainScore) -> dict[str, Any]:
    return {name: getattr(score, name) for name in GainScore.__dataclass_fields__}


def score_exercise(
    hand: Hand, model: HandModel, plant_factors: Mapping[str, float], seed: int
) -> GainScore:
    """Calculate the score of one run of the exercise on a simulated plant. The score does not include the margins.

    Args:
        hand: description of the hand.
        model: model of the hand, with its gains.
        plant_factors: factors by which the parameters of the plant differ from the description.
        seed: seed of the simulated noise.
    """
    program = ExerciseProgram.for_hand(hand)
    return score_run(hand, *simulate_program(hand, model, program, plant_factors, seed))


TickRecords = list[tuple[TickIn, TickOut]]


def simulate_program(
    hand: Hand, model: HandModel, program: Program, plant_factors: Mapping[str, float], seed: int
) -> tuple[TickRecords, TruthRecord, str]:
    """Execute a program on a simulated plant in lockstep.

    Args:
        hand: description of the hand.
        model: model of the hand with its gains.
        program: program to run.
        plant_factors: factors by which the plant's parameters differ from the description.
        seed: seed of the simulated noise.

    Returns:
        The ticks, the true values from the simulator, and the reason why the run ended early. If
        the run did not end early, the reason is an empty text. A run also ends early if faults hold
        the hand for `MAX_HELD_S` in total, because the time of the program stops while the hand is
        held.
    """
    ticks: TickRecords = []
    with tempfile.TemporaryDirectory(prefix="handctl-") as folder:
        file = Path(folder) / "truth"
        simulator = SimulatorSettings(
            hand,
            seed=seed,
            perturb=plant_factors,
            homed=True,
            truth=file,
            is_truth_once_per_tick=True,
        )
        state = simulate_controller(
            homed_controller(model, program, hand),
            simulator,
            lambda entry, out: ticks.append((entry, out)),
            max_held_s=MAX_HELD_S,
        )
        is_done = state.mode == HandMode.DONE
        failure = state.failure if is_done else f"held for {MAX_HELD_S:g} s by {_last_fault(ticks)}"
        return ticks, read_truth(file), failure


def _last_fault(ticks: TickRecords) -> str:
    """Return the text of the last fault in a run that contains a fault."""
    return next(
        event.text
        for _, tick_output in reversed(ticks)
        for event in tick_output.events
        if event.name == "fault"
    )


def score_run(
    hand: Hand, ticks: Sequence[tuple[TickIn, TickOut]], truth: TruthRecord, failure_text: str
) -> GainScore:
    """Return the score of a run, computed from the true values of the simulator.

    Args:
        hand: description of the hand of the run.
        ticks: ticks of the run.
        truth: true values of the plant.
        failure_text: reason why the run ended early, or an empty text.
    """
    active = [
        (entry.t_ns, tick_output)
        for entry, tick_output in ticks
        if tick_output.mode == HandMode.ACTIVE
    ]
    tension = truth.values[
        :, [truth.columns.index(f"tension/{name}") for name in hand.tendon_names]
    ]
    peak = float(tension.max(initial=0.0))
    if failure_text or not active:
        return _failed_score(peak, failure_text or "never active")
    t_ns = np.array([t for t, _ in active])
    # A controller packs the telemetry of each tick into one array, with the same layout in all ticks.
    telemetry = [cast(PackedTelemetry, tick_output.telemetry) for _, tick_output in active]
    numbers = np.array([packed.numbers for packed in telemetry])
    goal, tension_goal, torque = (
        numbers[:, telemetry[0].slices[name]]
        for name in ("q_goal", "tension_goal", "motor_torque_goal")
    )
    ground_truth = GroundTruth.from_record(truth, hand, t_ns)
    phase = np.array([out.phase for _, out in active])
    is_touching = _true_touch_mask(hand, truth, t_ns)
    angle = np.where(is_touching, np.nan, digit_angles(hand, goal))
    score = score_ticks(t_ns, phase, angle, tension_goal, torque, ground_truth)
    is_touching_in_move = is_touching[phase == "move"].any(axis=0).tolist()
    blocked_names = ", ".join(compress(hand.digit_names, is_touching_in_move))
    if np.isnan(score.tracking_deg):
        reason = f"no move to score: {blocked_names} blocked in all moves"
        return replace(_failed_score(peak, reason), blocked=blocked_names)
    return replace(score, blocked=blocked_names)


def _true_touch_mask(hand: Hand, truth: TruthRecord, t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask (ticks, D), True where a digit truly touches another digit or an object."""
    force = [
        truth.interpolated_columns([f"contact_force/{name}/{axis}" for axis in "xyz"], t_ns)
        for name in hand.digit_names
    ]
    return np.asarray(np.linalg.norm(force, axis=-1).T > TOUCH_FORCE_N)


def _failed_score(peak_tension_N: float, failure_text: str, shortfall: float = 0.0) -> GainScore:
    """Return the score of gains without a valid result of the exercise. All objectives have the worst value."""
    return GainScore(
        OBJECTIVE_OF_FAILED_RUN,
        OBJECTIVE_OF_FAILED_RUN,
        OBJECTIVE_OF_FAILED_RUN,
        peak_tension_N,
        shortfall,
        failure_text,
    )


def digit_angles(hand: Hand, q: Array) -> Array:
    """Return the mean joint angle of each digit (ticks, D) [rad].

    For a prismatic joint, 10 mm count as 1 rad.

    Args:
        hand: description of the hand.
        q: (ticks, J) joint angles [rad, or m of prismatic joints].
    """
    unit_scales = [hand.mean_position_units(name).scale[0] for name in hand.digit_names]
    angles: Array = mean_angles(hand, q) / np.array(unit_scales)
    return angles


class GroundTruth(NamedTuple):
    """Values with which a score compares the goals: the true values from the simulator.

    On hardware, the estimates of the controller replace the true values.

    Attributes:
        angle: (ticks, D) mean joint angle of each digit [rad], see ``digit_angles``.
        tension: (ticks, N) tension of each tendon [N].
    """

    angle: Array
    tension: Array

    @staticmethod
    def from_record(truth: TruthRecord, hand: Hand, t_ns: NDArray[np.int64]) -> "GroundTruth":
        """Return the true values at times on the clock of the simulator [ns]."""
        return GroundTruth(
            digit_angles(
                hand, truth.interpolated_columns([f"q/{joint}" for joint in hand.joints], t_ns)
            ),
            truth.interpolated_columns([f"tension/{name}" for name in hand.tendon_names], t_ns),
        )


def score_ticks(
    t_ns: NDArray[np.int64],
    phase_of_tick: NDArray[Any],
    angle: Array,
    tension: Array,
    torque: Array,
    truth: GroundTruth,
) -> GainScore:
    """Return the score of the given ticks of an exercise. The score does not include the margins.

    Args:
        t_ns: (ticks,) times of the ticks [ns].
        phase_of_tick: (ticks,) name of the phase in each tick.
        angle: (ticks, D) goals of the mean joint angle [rad].
        tension: (ticks, N) tension goals [N].
        torque: (ticks, M) commanded motor torques [N m].
        truth: true values at the times of the ticks.
    """
    rate = np.diff(torque, axis=0) / (np.diff(t_ns)[:, None] / 1e9)
    return GainScore(
        tracking_deg=float(
            np.degrees(root_mean_square((angle - truth.angle)[phase_of_tick == "move"]))
        ),
        tension_N=root_mean_square((tension - truth.tension)[phase_of_tick == "hold"]),
        effort_Nm_per_s=root_mean_square(rate[np.isin(phase_of_tick[1:], ("move", "hold"))]),
        peak_tension_N=float(truth.tension.max(initial=0.0)),
        shortfall=0.0,
    )
