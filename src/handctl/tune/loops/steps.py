"""Steps of both loops in lockstep: does the whole controller come to rest as the linear loops predict?

The linear loops leave out friction, limits, quantisation, the drives and the other digits.
Therefore gains are accepted only after a test on the simulated plant. The running controller must
answer a step of the angle and a step of the tension, and come to rest after each of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.hand.description import Hand
from handctl.programs.exercise import HOME_RAD, Exercise, ExerciseStage
from handctl.report.truth import TruthRecord
from handctl.tune.loops.design import linear_factors, unlike_tendons, weakest
from handctl.tune.loops.linear import LoopKind, Matrix, PlantFactors, loop
from handctl.tune.scoring import GroundTruth, simulated
from handctl.tune.search.ensemble import MIN_SPREAD

STEP_RAD = 0.15
"""Step of the angle [rad]."""
HOLD_TENSION_N = 30.0
"""Tension before its step [N]."""
STEP_N = 10.0
"""Step of the tension [N]."""
OSCILLATING = 1e-3
"""Least angle of an oscillating eigenvalue [rad per tick], 0.08 Hz at 500 Hz."""
REST_S = 0.5
"""Duration of a step's rest [s]."""
EVALUATED_S = 0.25
"""Part at the end of the rest in which swings are measured [s]."""
MAX_ANGLE_SWING_RAD = 0.01
"""Largest swing of the angle at rest [rad]."""
MAX_FREE_SWING_N = 1.0
"""Largest swing of the tension at rest in free motion [N]."""
MAX_HOLD_SWING_N = 2.0
"""Largest swing of a held tension at rest [N].

Gains with 6 dB and 45 degrees swing by up to 0.0004 rad, 0.1 N and 1.2 N (quantisation, noise and
stick-slip). Gains with 2 dB or less, and unstable ones, swing by 2.9 N and more, or end with a
fault.
"""


class Steps(Exercise):
    """Exercise that tightens, then steps the angle in free motion and the tension against the closed stops."""

    @property
    def stages(self) -> tuple[ExerciseStage, ...]:
        """Return all stages in order."""
        return (
            ExerciseStage("settle", 0.5, HOME_RAD),
            ExerciseStage("move", 0.1 + REST_S, HOME_RAD + STEP_RAD, rest=REST_S),
            ExerciseStage("close", 0.8, tension=HOLD_TENSION_N),
            ExerciseStage("hold", REST_S, tension=HOLD_TENSION_N + STEP_N),
        )


@dataclass(frozen=True, slots=True)
class Swing:
    """Largest swing of any digit or tendon after the steps.

    Attributes:
        angle_rad: peak to peak of the mean joint angle after the motion step [rad].
        free_N: peak to peak of the true tension after the motion step [N].
        hold_swings_N: (N,) peak to peak of each tendon's true tension after the tension step
            [N].
        failure: reason of an early end, empty otherwise.
    """

    angle_rad: float
    free_N: float
    hold_swings_N: tuple[float, ...]
    failure: str = ""

    @property
    def largest_hold_swing(self) -> float:
        """Return the largest swing of a held tension [N]."""
        return max(self.hold_swings_N)

    @property
    def at_rest(self) -> bool:
        """Return True if all swings are those of a loop at rest."""
        small = (
            self.angle_rad <= MAX_ANGLE_SWING_RAD
            and self.free_N <= MAX_FREE_SWING_N
            and self.largest_hold_swing <= MAX_HOLD_SWING_N
        )
        return small and not self.failure

    def beside(self, plant_swings_N: tuple[float, ...]) -> "Swing":
        """Return the swing beyond that of the plant itself in the held tensions [N]."""
        remaining = (
            max(0.0, swing - plant_swing) for swing, plant_swing in zip(self.hold_swings_N, plant_swings_N, strict=True)
        )
        return replace(self, hold_swings_N=tuple(remaining))

    def __str__(self) -> str:
        """Return the swings as text."""
        if self.failure:
            return self.failure
        angle = np.degrees(self.angle_rad)
        return f"swings by {angle:.2f} deg, {self.free_N:.1f} N free and {self.largest_hold_swing:.1f} N held"


def swing(hand: Hand, model: HandModel, factors: Mapping[str, float], seed: int) -> Swing:
    """Step both loops on a simulated plant.

    Args:
        hand: description of the plant.
        model: model with the gains.
        factors: factors of the plant on the description.
        seed: seed of the noise.
    """
    ticks, truth, failure = simulated(hand, model, Steps(), factors, seed)
    active = [(entry.t_ns, out.phase) for entry, out in ticks if out.mode == Mode.ACTIVE]
    ends = {name: max((t for t, phase in active if phase == name), default=None) for name in ("move", "hold")}
    if failure or ends["hold"] is None or ends["move"] is None:
        return Swing(np.inf, np.inf, (np.inf,) * model.tendon_count, failure or "never active")
    angle, free = _swing(hand, truth, model, ends["move"])
    _, hold = _swing(hand, truth, model, ends["hold"])
    return Swing(float(angle.max()), float(free.max()), tuple(hold.tolist()))


def _swing(hand: Hand, truth: TruthRecord, model: HandModel, end_ns: int) -> tuple[Matrix, Matrix]:
    """Return the swings of angles and tensions in the evaluated time before `end_ns`."""
    times = np.arange(end_ns - round(EVALUATED_S * 1e9), end_ns, round(model.period * 1e9), dtype=np.int64)
    real = GroundTruth.of(truth, hand, times)
    return _ripple(real.angle), _ripple(real.tension)


def _ripple(values: Matrix) -> Matrix:
    """Return the peak to peak of each column about its own parabola, because slow creep is no swing."""
    t = np.linspace(-1.0, 1.0, len(values))
    # Columns t^2, t and 1.
    powers = np.vander(t, 3)
    # The residual of the least-squares parabola is the oscillation.
    return np.asarray(np.ptp(values - powers @ np.linalg.lstsq(powers, values, rcond=None)[0], axis=0))


def rings(model: HandModel, factors: PlantFactors) -> bool:
    """Return True if the linear loop of a held tension still oscillates when a step is evaluated.

    Its oscillating eigenvalues are the same at every tension below the knee of the tendon. A step
    is evaluated after `REST_S - EVALUATED_S`. The remaining oscillation must be below the largest
    swing of a loop at rest.

    Args:
        model: model with the gains.
        factors: linear factors of the plant.
    """
    ticks = (REST_S - EVALUATED_S) / model.period
    for i in unlike_tendons(model):
        system = loop(model, i, LoopKind.TENSION, factors)
        poles = np.linalg.eigvals(system.A - system.B @ system.C)
        size = float(np.abs(poles[np.abs(np.angle(poles)) > OSCILLATING]).max(initial=0.0))
        if not size < 1.0 or STEP_N * size**ticks > MAX_HOLD_SWING_N:
            return True
    return False


WITHOUT_FEEDBACK = {
    "motion": {"disturbance_rejection": 0.0},
    "tension": {
        "force_N": 0.2,
        "tension_error_N": 100.0,
        "speed_error_m_s": 10.0,
        "integral_per_s": 0.0,
    },
}
"""Gains with almost no feedback while a tension is held."""
CHATTER_SEEDS = 3
"""Runs whose largest swing counts. Chatter differs by a factor of two between seeds of the noise."""
MIN_FRICTION = {"friction": 1.0 - MIN_SPREAD["friction"]}
"""Factors of the hand's own plant with the least friction of any ensemble."""


@dataclass
class Proof:
    """Proof in lockstep that gains come to rest.

    Four plants are simulated: the hand's own, the same with the least friction of any ensemble, the
    one with the smallest margins, and the one with the most friction. The linear loops leave
    friction out.

    Links of a digit that presses on something may chatter, also under a constant motor torque. Such
    a swing belongs to the plant. It is measured on the same plant with gains without feedback, and
    subtracted for each tendon. If the linear loop oscillates at the tension, no swing is
    subtracted. All tendons have the same gains, so an oscillating loop also shows on tendons
    without chatter, and in its eigenvalues.

    Attributes:
        hand: hand of the plants.
        factors: factors of the ensemble's plants, the hand's own first.
        plants: their linear parts.
        seed: seed of the noise.
        reason: why the last gains did not come to rest, empty if they did.
    """

    hand: Hand
    factors: tuple[dict[str, float], ...]
    plants: tuple[PlantFactors, ...]
    seed: int
    reason: str = ""
    _results: dict[str, str] = field(default_factory=dict)
    _chatter: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def __call__(self, model: HandModel) -> bool:
        """Return True if the gains of a model come to rest."""
        gains = model.gains.model_dump_json()
        if gains not in self._results:
            self._results[gains] = self._simulate(model)
        self.reason = self._results[gains]
        return not self.reason

    def _simulate(self, model: HandModel) -> str:
        """Return why gains do not come to rest, empty if they do."""
        friction = [factors.get("friction", 1.0) for factors in self.factors]
        indices = sorted({0, weakest(model, self.plants), friction.index(max(friction))})
        cases = {f"plant {i + 1} of {len(self.plants)}": (self.factors[i], self.seed + i) for i in indices}
        cases[f"the plant with {MIN_FRICTION['friction']:g} of the friction"] = (
            MIN_FRICTION,
            self.seed,
        )
        for name, (factors, seed) in cases.items():
            result = swing(self.hand, model, factors, seed)
            if result.at_rest:
                continue
            # a swing that is judged at all is compared with the plant's own, which costs another simulation
            ringing = rings(model, linear_factors(factors))
            if result.failure or ringing or not result.beside(self._plant_swing(model, name, factors, seed)).at_rest:
                return f": {name} {result}{' of a loop that rings' if ringing else ''}"
        return ""

    def _plant_swing(self, model: HandModel, name: str, factors: Mapping[str, float], seed: int) -> tuple[float, ...]:
        """Return the largest swing of each held tension without feedback [N]. A failed run counts as zero."""
        if name not in self._chatter:
            still = HandModel.of(model.hand, Gains.model_validate(WITHOUT_FEEDBACK), 1.0 / model.period)
            runs = [swing(self.hand, still, factors, seed + i) for i in range(CHATTER_SEEDS)]
            none = (0.0,) * model.tendon_count
            each = zip(*(none if run.failure else run.hold_swings_N for run in runs), strict=True)
            self._chatter[name] = tuple(max(values) for values in each)
        return self._chatter[name]
