"""A step of each loop in lockstep: does the whole controller come to rest where the linear loops say it does?

The linear loops leave out friction, limits, quantisation, the drives and the other digits. So gains are believed only
after the running controller has answered a step of the angle and a step of the tension on the simulated plant and has
come to rest after each of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.hand.description import Hand
from handctl.programs.exercise import HOME_RAD, Exercise, Stage
from handctl.report.truth import Truth
from handctl.tune.loops.design import linear_factors, unlike_tendons, weakest
from handctl.tune.loops.linear import LoopKind, Matrix, PlantFactors, loop
from handctl.tune.search.ensemble import LEAST_SPREAD
from handctl.tune.trial import Reality, simulated

STEP_RAD, HELD_N, STEP_N = 0.15, 30.0, 10.0
"""Step of the angle; tension before its step, and that step."""
OSCILLATING = 1e-3
"""Angle of an eigenvalue from which on it oscillates [rad a tick]: 0.08 Hz at 500 Hz."""
REST_S = 0.5
"""After a step, until it is over."""
JUDGED_S = 0.25
"""The end of that, in which nothing may swing any more."""
MOST_ANGLE_RAD, MOST_FREE_N, MOST_HELD_N = 0.01, 1.0, 2.0
"""Largest swings of a loop that has come to rest.

Gains with 6 dB and 45 degrees swing by up to 0.0004 rad, 0.1 N and 1.2 N (quantisation, noise and stick-slip). Those
with 2 dB or less, and unstable ones, swing by 2.9 N and more, or end with a fault.
"""


class Steps(Exercise):
    """Tightens, then steps the angle in free motion and the tension against the closed stops."""

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All parts, in order."""
        return (
            Stage("settle", 0.5, HOME_RAD),
            Stage("move", 0.1 + REST_S, HOME_RAD + STEP_RAD, rest=REST_S),
            Stage("close", 0.8, tension=HELD_N),
            Stage("hold", REST_S, tension=HELD_N + STEP_N),
        )


@dataclass(frozen=True, slots=True)
class Swing:
    """What still moves after the steps, the most of any digit or tendon.

    Attributes:
        angle_rad: peak to peak of the mean joint angle after the step of motion.
        free_N: peak to peak of the true tension after the step of motion.
        each_held_N: (N,) the same of each tendon after the step of tension.
        failure: why the run ended early; empty if it did not.
    """

    angle_rad: float
    free_N: float
    each_held_N: tuple[float, ...]
    failure: str = ""

    @property
    def largest_held(self) -> float:
        """Largest swing of a held tension [N]."""
        return max(self.each_held_N)

    @property
    def at_rest(self) -> bool:
        """Whether nothing swings any more."""
        small = self.angle_rad <= MOST_ANGLE_RAD and self.free_N <= MOST_FREE_N and self.largest_held <= MOST_HELD_N
        return small and not self.failure

    def beside(self, own_N: tuple[float, ...]) -> "Swing":
        """Return what is left of it beside swings of the held tensions that the plant makes by itself [N]."""
        left = (max(0.0, one - own) for one, own in zip(self.each_held_N, own_N, strict=True))
        return replace(self, each_held_N=tuple(left))

    def __str__(self) -> str:
        """Say what still swings."""
        if self.failure:
            return self.failure
        angle = np.degrees(self.angle_rad)
        return f"swings by {angle:.2f} deg, {self.free_N:.1f} N free and {self.largest_held:.1f} N held"


def swing(hand: Hand, model: HandModel, factors: Mapping[str, float], seed: int) -> Swing:
    """Step both loops on one simulated plant.

    Args:
        hand: description of the plant.
        model: the hand with the gains.
        factors: of the plant, on what the description says.
        seed: of its noise.
    """
    ticks, truth, failure = simulated(hand, model, Steps(), factors, seed)
    active = [(entry.t_ns, out.phase) for entry, out in ticks if out.mode == Mode.ACTIVE]
    ends = {name: max((t for t, phase in active if phase == name), default=None) for name in ("move", "hold")}
    if failure or ends["hold"] is None or ends["move"] is None:
        return Swing(np.inf, np.inf, (np.inf,) * model.tendon_count, failure or "never active")
    angle, free = _swing(hand, truth, model, ends["move"])
    _, held = _swing(hand, truth, model, ends["hold"])
    return Swing(float(angle.max()), float(free.max()), tuple(held.tolist()))


def _swing(hand: Hand, truth: Truth, model: HandModel, end_ns: int) -> tuple[Matrix, Matrix]:
    times = np.arange(end_ns - round(JUDGED_S * 1e9), end_ns, round(model.period * 1e9), dtype=np.int64)
    real = Reality.of(truth, hand, times)
    return _ripple(real.angle), _ripple(real.tension)


def _ripple(values: Matrix) -> Matrix:
    """Return the peak to peak of each column about its own parabola: what creeps to its goal does not swing."""
    t = np.linspace(-1.0, 1.0, len(values))
    powers = np.vander(t, 3)
    return np.asarray(np.ptp(values - powers @ np.linalg.lstsq(powers, values, rcond=None)[0], axis=0))


def rings(model: HandModel, factors: PlantFactors) -> bool:
    """Return whether the linear loop of a held tension still rings where a step is judged.

    Its oscillating eigenvalues are the same at every tension below the knee of the tendon. A step is judged after
    ``REST_S - JUDGED_S``; what is left of it then must be below the largest swing of a loop that is at rest.

    Args:
        model: the hand with the gains.
        factors: of the plant, as far as it is linear.
    """
    ticks = (REST_S - JUDGED_S) / model.period
    for i in unlike_tendons(model):
        system = loop(model, i, LoopKind.TENSION, factors)
        poles = np.linalg.eigvals(system.A - system.B @ system.C)
        size = float(np.abs(poles[np.abs(np.angle(poles)) > OSCILLATING]).max(initial=0.0))
        if not size < 1.0 or STEP_N * size**ticks > MOST_HELD_N:
            return True
    return False


FEEDBACKLESS = {
    "motion": {"disturbance_rejection": 0.0},
    "tension": {"force_N": 0.2, "tension_error_N": 100.0, "speed_error_m_s": 10.0, "integral_per_s": 0.0},
}
"""Gains that feed next to nothing back while a tension is held."""
CHATTER_SEEDS = 3
"""Runs of which the largest swing counts: chatter differs by a factor of two from one seed of the noise to another."""
LEAST_FRICTION = {"friction": 1.0 - LEAST_SPREAD["friction"]}
"""The hand's own plant with the least friction of any ensemble."""


@dataclass
class Proof:
    """Confirm in lockstep that gains come to rest.

    Four plants are simulated: the hand's own, the same with the least friction of any ensemble, the one with the
    smallest margins, and the one with the most friction. The linear loops leave friction out.

    Links of a digit that presses on something may chatter by themselves, under a constant motor torque as well. Such
    a swing is the plant's. It is measured on the same plant with gains that feed nothing back, and allowed on top, to
    the tendon that makes it and only if the linear loop does not ring at that tension: all tendons have the same gains,
    so that a loop that rings shows on those that do not chatter, and in its eigenvalues.

    Attributes:
        hand: that the plants are made of.
        factors: of the ensemble's plants, the hand's own first.
        plants: the same as far as they are linear.
        seed: of the noise.
        told: what did not come to rest in the last question.
    """

    hand: Hand
    factors: tuple[dict[str, float], ...]
    plants: tuple[PlantFactors, ...]
    seed: int
    told: str = ""
    _known: dict[str, str] = field(default_factory=dict)
    _chatter: dict[str, tuple[float, ...]] = field(default_factory=dict)

    def __call__(self, model: HandModel) -> bool:
        """Return whether the gains of a model come to rest."""
        gains = model.gains.model_dump_json()
        if gains not in self._known:
            self._known[gains] = self._ask(model)
        self.told = self._known[gains]
        return not self.told

    def _ask(self, model: HandModel) -> str:
        friction = [one.get("friction", 1.0) for one in self.factors]
        indices = sorted({0, weakest(model, self.plants), friction.index(max(friction))})
        asked = {f"plant {i + 1} of {len(self.plants)}": (self.factors[i], self.seed + i) for i in indices}
        asked[f"the plant with {LEAST_FRICTION['friction']:g} of the friction"] = (LEAST_FRICTION, self.seed)
        for name, (factors, seed) in asked.items():
            found = swing(self.hand, model, factors, seed)
            if found.at_rest:
                continue
            # a swing that is judged at all is compared with the plant's own, which costs another simulation
            ringing = rings(model, linear_factors(factors))
            if found.failure or ringing or not found.beside(self._own_swing(model, name, factors, seed)).at_rest:
                return f": {name} {found}{' of a loop that rings' if ringing else ''}"
        return ""

    def _own_swing(self, model: HandModel, name: str, factors: Mapping[str, float], seed: int) -> tuple[float, ...]:
        """Return the largest swing of each held tension without feedback [N]; a run that failed has none."""
        if name not in self._chatter:
            still = HandModel.of(model.hand, Gains.model_validate(FEEDBACKLESS), 1.0 / model.period)
            runs = [swing(self.hand, still, factors, seed + i) for i in range(CHATTER_SEEDS)]
            none = (0.0,) * model.tendon_count
            each = zip(*(none if run.failure else run.each_held_N for run in runs), strict=True)
            self._chatter[name] = tuple(max(values) for values in each)
        return self._chatter[name]
