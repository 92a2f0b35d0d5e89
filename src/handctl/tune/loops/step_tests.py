"""Step tests of gains by a simulation in lockstep.

Each test checks whether the hand comes to rest under the control of the whole controller.

The linear models of the loops neglect friction, limits, quantisation, the drives and the other
digits. Therefore gains are accepted only if they pass a test on the simulated plant. In a test, the
hand must come to rest after a step of the joint angles and after a step of the tensions.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.programs.gains_exercise import HOME_ANGLE_RAD, ExerciseProgram, ExerciseStage
from handctl.report.truth_record import TruthRecord
from handctl.tune.loops.gain_design import distinct_tendons, linear_factors, weakest_plant
from handctl.tune.loops.linear_models import LoopKind, Matrix, PlantFactors, open_loop
from handctl.tune.scoring import GroundTruth, simulate_program
from handctl.tune.search.ensemble import MIN_FACTOR_SPREAD

ANGLE_STEP_RAD = 0.15
"""Step of the joint angles [rad]."""
HOLD_TENSION_N = 30.0
"""Tension of the tendons before the tension step [N]."""
TENSION_STEP_N = 10.0
"""Step of the tensions [N]."""
OSCILLATION_ANGLE_RAD = 1e-3
"""Angle of an eigenvalue above which the eigenvalue counts as oscillating [rad per tick].

At a control rate of 500 Hz, an angle of 0.001 rad per tick corresponds to an oscillation of 0.08
Hz.
"""
REST_DURATION_S = 0.5
"""Time for which the goals stay constant after a step [s]."""
EVALUATED_DURATION_S = 0.25
"""Time at the end of `REST_DURATION_S` in which oscillations are measured [s]."""
MAX_ANGLE_SWING_RAD = 0.01
"""Largest oscillation of a mean joint angle at which a digit counts as at rest, peak to peak [rad]."""
MAX_FREE_SWING_N = 1.0
"""Largest oscillation of a tension after the angle step at which a digit counts as at rest, peak to peak [N]."""
MAX_HOLD_SWING_N = 2.0
"""Largest oscillation of a held tension at which a tendon counts as at rest, peak to peak [N].

With margins of 6 dB and 45 degrees, quantisation, noise and stick-slip cause oscillations of at
most 0.0004 rad, 0.1 N (free tension) and 1.2 N (held tension). With a gain margin of 2 dB or less,
or an unstable loop, a held tension oscillates by 2.9 N or more, or the run ends with a fault.
"""
EARLY_PASS_FRACTION = 0.4
"""Fraction of the oscillation limits: if a run stays below, no further run is necessary to pass the test."""
DESIGN_LIMIT_FRACTION = 0.7
"""Fraction of the oscillation limits that the oscillations with designed gains are allowed to reach.

The fraction is below 1, so that the hand comes to rest with other noise as well.
"""
MEDIAN_RUN_COUNT = 5
"""Number of runs whose median oscillation is compared with the limits."""
SEED_INCREMENT = 1000
"""Difference between the seeds of two successive runs of the same plant."""
MAX_LOOP_AMPLIFICATION = 2.0
"""Factor by which a loop is allowed to amplify the oscillation of the plant.

A loop with a gain margin of 6 dB amplifies disturbances by up to 1 / (1 - 10^(-6/20)) = 2.
"""


class StepExercise(ExerciseProgram):
    """Exercise: tighten the tendons, step the angles in free motion, then step the tensions of closed digits."""

    @property
    def stages(self) -> tuple[ExerciseStage, ...]:
        """Return all stages of the exercise in order."""
        # The angles are so small that no fingers touch each other if they also move sideways.
        return (
            ExerciseStage("settle", 0.5, HOME_ANGLE_RAD, sideways_fraction=1.0),
            ExerciseStage(
                "move",
                0.1 + REST_DURATION_S,
                HOME_ANGLE_RAD + ANGLE_STEP_RAD,
                rest=REST_DURATION_S,
                sideways_fraction=1.0,
            ),
            ExerciseStage("close", 0.8, tension=HOLD_TENSION_N),
            ExerciseStage("hold", REST_DURATION_S, tension=HOLD_TENSION_N + TENSION_STEP_N),
        )


@dataclass(frozen=True, slots=True)
class StepOscillation:
    """Largest oscillations of digits and tendons after the steps.

    Attributes:
        angle_rad: largest oscillation of a digit's mean joint angle after the step of the angles,
            peak to peak [rad].
        free_tension_N: largest oscillation of a true tension after the step of the angles, peak to
            peak [N].
        hold_swings_N: (N,) oscillation of each tendon's true tension after the step of the
            tensions, peak to peak [N].
        failure: reason why the run ended early, or an empty text.
    """

    angle_rad: float
    free_tension_N: float
    hold_swings_N: tuple[float, ...]
    failure: str = ""

    @property
    def largest_hold_swing(self) -> float:
        """Return the largest oscillation of a tension after the step of the tensions [N]."""
        return max(self.hold_swings_N)

    @property
    def is_at_rest(self) -> bool:
        """Return True if all oscillations are small enough for a hand at rest."""
        return self.is_within_limits(1.0)

    def is_within_limits(self, allowed_fraction: float) -> bool:
        """Return True if the run did not fail and no oscillation is larger than the given fraction of its limit."""
        is_small = (
            self.angle_rad <= allowed_fraction * MAX_ANGLE_SWING_RAD
            and self.free_tension_N <= allowed_fraction * MAX_FREE_SWING_N
            and self.largest_hold_swing <= allowed_fraction * MAX_HOLD_SWING_N
        )
        return is_small and not self.failure

    def subtract_plant_swings(self, plant_swings_N: tuple[float, ...]) -> "StepOscillation":
        """Subtract the oscillation that the plant itself causes from the oscillation of the held tensions [N].

        A loop with sufficient margins amplifies the oscillation of the plant by up to
        `MAX_LOOP_AMPLIFICATION`. Therefore the oscillation of the plant is multiplied by
        `MAX_LOOP_AMPLIFICATION` before the subtraction.
        """
        remaining = (
            max(0.0, hold_swing - MAX_LOOP_AMPLIFICATION * plant_swing)
            for hold_swing, plant_swing in zip(self.hold_swings_N, plant_swings_N, strict=True)
        )
        return replace(self, hold_swings_N=tuple(remaining))

    def __str__(self) -> str:
        """Return the oscillations and their limits as text."""
        if self.failure:
            return self.failure
        angle = np.degrees(self.angle_rad)
        limits = (
            f"limits {np.degrees(MAX_ANGLE_SWING_RAD):.2f} deg, "
            f"{MAX_FREE_SWING_N:g} N and {MAX_HOLD_SWING_N:g} N"
        )
        return (
            f"swings by {angle:.2f} deg, {self.free_tension_N:.1f} N free and "
            f"{self.largest_hold_swing:.1f} N held ({limits})"
        )


def simulate_swing(
    hand: Hand, model: HandModel, plant_factors: Mapping[str, float], seed: int
) -> StepOscillation:
    """Simulate a step of the joint angles and a step of the tensions, and return the oscillations after both steps.

    Args:
        hand: description of the simulated hand.
        model: model of the hand, with its gains.
        plant_factors: factors by which the parameters of the plant differ from the description.
        seed: seed of the simulated noise.
    """
    ticks, truth, failure = simulate_program(hand, model, StepExercise(), plant_factors, seed)
    active = [
        (entry.t_ns, tick_output.phase)
        for entry, tick_output in ticks
        if tick_output.mode == HandMode.ACTIVE
    ]
    phase_ends = {
        name: max((t for t, phase in active if phase == name), default=None)
        for name in ("move", "hold")
    }
    if failure or phase_ends["hold"] is None or phase_ends["move"] is None:
        return StepOscillation(
            np.inf, np.inf, (np.inf,) * model.tendon_count, failure or "never active"
        )
    angle, free_deviation = _measure_swing(hand, truth, model, phase_ends["move"])
    _, hold = _measure_swing(hand, truth, model, phase_ends["hold"])
    return StepOscillation(float(angle.max()), float(free_deviation.max()), tuple(hold.tolist()))


def swings_with_other_noise(
    hand: Hand, model: HandModel, plant_factors: Mapping[str, float], seed: int
) -> Iterator[StepOscillation]:
    """Yield the oscillations of `MEDIAN_RUN_COUNT` runs of a plant, each with different noise.

    `median_swing` explains the arguments.
    """
    for i in range(MEDIAN_RUN_COUNT):
        yield simulate_swing(hand, model, plant_factors, seed + i * SEED_INCREMENT)


def median_swing(
    hand: Hand, model: HandModel, plant_factors: Mapping[str, float], seed: int
) -> StepOscillation:
    """Return the median oscillations of runs with different noise, or the first failure of a run.

    If a digit slips on a stop in one of the runs, the oscillation of this run has a single peak.
    The median of the runs ignores a single peak. One run is enough if its oscillations are far
    below the limits.

    Args:
        hand: description of the simulated hand.
        model: model of the hand, with its gains.
        plant_factors: factors by which the parameters of the plant differ from the description.
        seed: seed of the simulated noise of the first run.
    """
    runs = list[StepOscillation]()
    for run in swings_with_other_noise(hand, model, plant_factors, seed):
        if run.failure or (not runs and run.is_within_limits(EARLY_PASS_FRACTION)):
            return run
        runs.append(run)
    return StepOscillation(
        float(np.median([run.angle_rad for run in runs])),
        float(np.median([run.free_tension_N for run in runs])),
        tuple(np.median([run.hold_swings_N for run in runs], axis=0).tolist()),
    )


def _measure_swing(
    hand: Hand, truth: TruthRecord, model: HandModel, end_ns: int
) -> tuple[Matrix, Matrix]:
    """Return the oscillations of the angles and the tensions in the last `EVALUATED_DURATION_S` before `end_ns`."""
    times = np.arange(
        end_ns - round(EVALUATED_DURATION_S * 1e9),
        end_ns,
        round(model.period * 1e9),
        dtype=np.int64,
    )
    ground_truth = GroundTruth.from_record(truth, hand, times)
    return _peak_to_peak(ground_truth.angle), _peak_to_peak(ground_truth.tension)


def _peak_to_peak(values: Matrix) -> Matrix:
    """Subtract a parabola from each column, and return the difference between largest and smallest value.

    The parabola removes slow creep, because creep is not an oscillation.
    """
    t = np.linspace(-1.0, 1.0, len(values))
    # The columns of the matrix below are t^2, t and 1.
    vandermonde_matrix = np.vander(t, 3)
    # The oscillation is the difference between the values and the least-squares parabola.
    return np.asarray(
        np.ptp(
            values
            - vandermonde_matrix @ np.linalg.lstsq(vandermonde_matrix, values, rcond=None)[0],
            axis=0,
        )
    )


def is_loop_ringing(model: HandModel, factors: PlantFactors) -> bool:
    """Return True if a linear tension loop oscillates too long after a step.

    The measurement of the oscillations begins at the time `REST_DURATION_S - EVALUATED_DURATION_S`
    after the step. At this time, the oscillation of the loop must be below `MAX_HOLD_SWING_N`.
    Below a tension called the knee, the stiffness of a tendon is constant. Therefore the result is
    valid at every tension below the knee.

    Args:
        model: model of the hand with its gains.
        factors: factors for the linear parameters of the plant.
    """
    ticks = (REST_DURATION_S - EVALUATED_DURATION_S) / model.period
    for i in distinct_tendons(model):
        system = open_loop(model, i, LoopKind.TENSION, factors)
        poles = np.linalg.eigvals(system.A - system.B @ system.C)
        size = float(
            np.abs(poles[np.abs(np.angle(poles)) > OSCILLATION_ANGLE_RAD]).max(initial=0.0)
        )
        if not size < 1.0 or TENSION_STEP_N * size**ticks > MAX_HOLD_SWING_N:
            return True
    return False


GAINS_WITHOUT_FEEDBACK = {
    "motion": {"disturbance_rejection": 0.0},
    "tension": {
        "force_N": 0.2,
        "tension_error_N": 100.0,
        "speed_error_m_s": 10.0,
        "integral_per_s": 0.0,
    },
}
"""Gains with almost no feedback while a tension is held."""
LOWEST_FRICTION_FACTORS = {"friction": 1.0 - MIN_FACTOR_SPREAD["friction"]}
"""Factors of a plant with the lowest friction of any ensemble.

All other parameters of the plant are nominal.
"""


@dataclass
class RestTest:
    """Test of gains in a lockstep simulation. The hand must come to rest with the tested gains.

    The test simulates up to three plants of the ensemble: the nominal plant, the plant with the
    smallest margins, and the plant with the highest friction. The test also simulates a nominal
    plant with the lowest friction that an ensemble can contain. A simulation is necessary because
    the linear models neglect friction.

    The links of a digit that presses on an object can chatter even at constant motor torque. The
    chatter is a property of the plant. First, the test measures the oscillation of the same plant
    without feedback. Then the test multiplies the oscillation without feedback by
    `MAX_LOOP_AMPLIFICATION`, and subtracts the product from the oscillation with feedback, for each
    tendon. If the eigenvalues of a linear tension loop show that the loop itself oscillates, the
    test uses the oscillation with feedback without a subtraction.

    The chatter of pressed links varies by a factor of two between seeds of the noise. The test
    therefore uses the median of several runs, see `median_swing`.

    Attributes:
        hand: description of the simulated hand.
        factors: factors of the plants of the ensemble. The nominal plant comes first.
        plants: linear factors of the plants.
        seed: seed of the simulated noise.
        fraction: fraction of the limits that the oscillations are allowed to reach.
        reason: reason why the hand did not come to rest with the gains that were tested last. The
            text is empty if the hand came to rest.
    """

    hand: Hand
    factors: tuple[dict[str, float], ...]
    plants: tuple[PlantFactors, ...]
    seed: int
    fraction: float = 1.0
    reason: str = ""
    _reason_by_gains: dict[str, str] = field(default_factory=dict)
    _plant_swings_by_name: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def with_limit_fraction(self, fraction: float) -> "RestTest":
        """Return a copy of the test that allows oscillations up to ``fraction`` of the limits.

        The copy and this test share the measurements of the plant without feedback.
        """
        return replace(self, fraction=fraction, reason="", _reason_by_gains={})

    def __call__(self, model: HandModel) -> bool:
        """Return True if the hand comes to rest with the gains of a model."""
        gains = model.gains.model_dump_json()
        if gains not in self._reason_by_gains:
            self._reason_by_gains[gains] = self._simulate(model)
        self.reason = self._reason_by_gains[gains]
        return not self.reason

    def _simulate(self, model: HandModel) -> str:
        """Simulate the plants. If the hand does not come to rest, return the reason.

        If the hand comes to rest, return an empty text.
        """
        friction = [factors.get("friction", 1.0) for factors in self.factors]
        indices = sorted({0, weakest_plant(model, self.plants), friction.index(max(friction))})
        cases = {
            f"plant {i + 1} of {len(self.plants)}": (self.factors[i], self.seed + i)
            for i in indices
        }
        cases[f"the plant with {LOWEST_FRICTION_FACTORS['friction']:g} of the friction"] = (
            LOWEST_FRICTION_FACTORS,
            self.seed,
        )
        for name, (factors, seed) in cases.items():
            result = median_swing(self.hand, model, factors, seed)
            if result.is_within_limits(self.fraction):
                continue
            # A simulation without feedback shows how much the plant itself oscillates.
            is_ringing = is_loop_ringing(model, linear_factors(factors))
            if (
                result.failure
                or is_ringing
                or not result.subtract_plant_swings(
                    self._plant_swing(model, name, factors, seed)
                ).is_within_limits(self.fraction)
            ):
                return f": {name} {result}{' of a loop that oscillates' if is_ringing else ''}"
        return ""

    def _plant_swing(
        self, model: HandModel, name: str, factors: Mapping[str, float], seed: int
    ) -> tuple[float, ...]:
        """Return the median oscillation of each held tension without feedback [N].

        If a run without feedback fails, its oscillations count as zero.
        """
        if name not in self._plant_swings_by_name:
            model_without_feedback = HandModel.from_hand(
                model.hand, Gains.model_validate(GAINS_WITHOUT_FEEDBACK), 1.0 / model.period
            )
            zero_swings = (0.0,) * model.tendon_count
            swings = [
                zero_swings if run.failure else run.hold_swings_N
                for run in swings_with_other_noise(self.hand, model_without_feedback, factors, seed)
            ]
            self._plant_swings_by_name[name] = tuple(np.median(swings, axis=0).tolist())
        return self._plant_swings_by_name[name]
