"""Gains by design: as much authority as the margins allow on every plant, or poles where a person wants them.

Authority is LQR's one knob: the force that counts like the errors of Bryson's rule. More of it makes a loop faster and
its margins smaller, so it is turned up from below as far as they last. Margins that are reported are confirmed by the
closed loop's eigenvalues, and gains that are found by whoever can prove them, e.g. by simulation.

Poles: for a plant with one input and weights on position and speed, the closed loop's characteristic polynomial d
satisfies d(s) d(-s) = p(s) p(-s) + (q1 |g1(s)|^2 + q2 |g2(s)|^2) / r. Two poles and two ratios of weights: each pole
pair with a damping above 1/sqrt(2) has its weights, in closed form. Source: Kalman's symmetric root locus.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce

from handctl.core.gains.gains import Gains
from handctl.core.gains.motion_design import bearable, design_motion
from handctl.core.model import HandModel
from handctl.document import validated
from handctl.errors import ConfigError
from handctl.tune.loops.linear import LoopKind, PlantFactors, System, controller, joined, plant
from handctl.tune.loops.margins import Margins, all_margins, confirmed, margins, unproven, worse

LEAST_FORCE_N, MOST_FORCE_N = 0.2, 400.0
STRIDE, STEPS = math.log(1.7), 5
"""Of the logarithm of the force, and bisections of the last one: within two per cent."""
RETREATS = 3
"""Strides of both forces back down, where the margins are kept and the proof fails."""
REJECTION = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1, 0.0)
"""Shares of disturbance rejection to try, from the largest: what a filter of this hand may leave no margin for."""


@dataclass(frozen=True, slots=True)
class Design:
    """What a design came to.

    Attributes:
        gains: new ones.
        before, after: margins by tendon and loop, on the nominal plant.
        worst_before, worst_after: the least of every margin over the ensemble.
    """

    gains: Gains
    before: dict[tuple[str, LoopKind], Margins]
    after: dict[tuple[str, LoopKind], Margins]
    worst_before: Margins
    worst_after: Margins

    def with_unproven_before(self) -> "Design":
        """The same where the present gains did not come to rest in simulation, whatever their linear loops say."""
        before = {loop: unproven(one) for loop, one in self.before.items()}
        return replace(self, before=before, worst_before=unproven(self.worst_before))

    def as_weights(self) -> Gains:
        """The same gains with the force of each loop put into its weights, for only ratios count (LQR)."""
        fresh, gains = Gains(), self.gains
        motion, tension = fresh.motion.force_N / gains.motion.force_N, fresh.tension.force_N / gains.tension.force_N
        own, hold = gains.motion, gains.tension
        table = {"position_error_m": own.position_error_m * motion, "speed_error_m_s": own.speed_error_m_s * motion}
        held = {"tension_error_N": hold.tension_error_N * tension, "speed_error_m_s": hold.speed_error_m_s * tension}
        return _checked(
            gains,
            motion={**own.model_dump(), **table, "force_N": fresh.motion.force_N},
            tension={**hold.model_dump(), **held, "force_N": fresh.tension.force_N},
        )


def linear_factors(factors: Mapping[str, float]) -> PlantFactors:
    """A plant of the ensemble as far as it is linear; friction is not."""
    known = PlantFactors.__dataclass_fields__
    return PlantFactors(**{key: value for key, value in factors.items() if key in known})


def with_poles(model: HandModel, kind: LoopKind, hz: float, damping: float) -> Gains:
    """Gains whose weights put a loop's poles at a natural frequency.

    Args:
        model: the hand, with the gains to begin from.
        kind: of loop.
        hz: natural frequency of the pole pair.
        damping: at least 1/sqrt(2), below which no weights lead there.

    Raises:
        ValueError: no weights have these poles.
    """
    w = 2.0 * math.pi * hz
    position, speed = (_motion_weights if kind == LoopKind.MOTION else _tension_weights)(model, w, damping)
    if kind == LoopKind.MOTION:
        own = model.gains.motion
        force = bearable(own.force_N, model.period)
        table = {"position_error_m": force / position, "speed_error_m_s": force / speed}
        return _checked(model.gains, motion={**own.model_dump(), **table})
    tension = model.gains.tension
    force = bearable(tension.force_N, model.period)
    table = {"tension_error_N": force / position, "speed_error_m_s": force / speed}
    return _checked(model.gains, tension={**tension.model_dump(), **table})


def _checked(gains: Gains, **sections: dict[str, float]) -> Gains:
    """The gains with other sections.

    Raises:
        ValueError: one of them is out of its bounds.
    """
    try:
        return validated(gains.model_dump(by_alias=True) | sections, Gains, "weights")
    except ConfigError as error:
        raise ValueError(str(error)) from None


def _motion_weights(model: HandModel, w: float, damping: float) -> tuple[float, float]:
    """force / error and force / speed error of one mass: d(s) = s^2 + 2 z w s + w^2."""
    mass = float((model.space.motor_mass + model.space.load_mass).mean())
    return mass * w**2, mass * w * _root(4.0 * damping**2 - 2.0, LEAST_DAMPING)


def _tension_weights(model: HandModel, w: float, damping: float) -> tuple[float, float]:
    """The same of a rotor on its rope, whose own frequency is the least there is."""
    space = model.space
    m, k = float(space.motor_mass.mean()), float(space.stiffness.mean())
    a0, a1 = k / m, float((space.motor_damping + space.damping).mean()) / m
    least = f"the tension loop's above {math.sqrt(a0) / (2.0 * math.pi):.1f} Hz, the rotor's own on its rope"
    speed = 2.0 * a0 - a1**2 - 2.0 * w**2 * (1.0 - 2.0 * damping**2)
    return _root(w**4 - a0**2, least) * m / k, m * _root(speed, LEAST_DAMPING)


LEAST_DAMPING = "a damping of more than 0.71"


def _root(square: float, right: str) -> float:
    if square <= 0.0:
        raise ValueError(f"no weights have these poles; expected {right}")
    return math.sqrt(square)


def redesigned(model: HandModel, gains: Gains) -> HandModel:
    """The model with other gains of motion and tension; its filter stays."""
    return replace(model, gains=gains, motion=design_motion(model.space, gains, model.period))


def worst_of(model: HandModel, plants: tuple[PlantFactors, ...], kinds: Iterable[LoopKind] = LoopKind) -> Margins:
    """The least of every margin over plants, loops and unlike tendons, confirmed by eigenvalues."""
    return reduce(worse, _each(model, plants, kinds, confirmed))


def weakest(model: HandModel, plants: tuple[PlantFactors, ...]) -> int:
    """Return the index of the plant with the smallest disk margin of any loop."""
    disks = [min(one.disk for one in _each(model, (factors,), LoopKind)) for factors in plants]
    return disks.index(min(disks))


def keeps(model: HandModel, plants: tuple[PlantFactors, ...], kinds: Iterable[LoopKind] = LoopKind) -> bool:
    """Whether every loop keeps its margins on every plant; looks no further than the first that does not."""
    return all(one.enough for one in _each(model, plants, kinds))


def _each(
    model: HandModel,
    plants: tuple[PlantFactors, ...],
    kinds: Iterable[LoopKind],
    judge: Callable[[System], Margins] = margins,
) -> Iterator[Margins]:
    for kind in kinds:
        for i in unlike_tendons(model):
            own = controller(model, i, kind)
            yield from (judge(joined(plant(model, i, kind, factors), own)) for factors in plants)


def unlike_tendons(model: HandModel) -> tuple[int, ...]:
    """One tendon of each kind, so that like ones are not judged again."""
    space, seen = model.space, dict[tuple[str, ...], int]()
    for i in range(model.tendon_count):
        numbers = (space.motor_mass, space.stiffness, space.load_mass, space.load_stiffness, space.spool)
        seen.setdefault(tuple(f"{values[i]:.6g}" for values in numbers), i)
    return tuple(seen.values())


def design(
    model: HandModel, plants: tuple[PlantFactors, ...], proves: Callable[[HandModel], bool] = lambda _: True
) -> Design:
    """The most authority of each loop, and the most disturbance rejection, that keep the margins on every plant.

    Args:
        model: the hand with its present gains; its filter is kept.
        plants: ensemble to keep the margins on.
        proves: whether gains that keep the margins hold elsewhere, too, e.g. in simulation.

    Raises:
        ValueError: not even without authority are the margins kept, or none of those gains is proven.
    """
    unproven = False
    for share in REJECTION:
        if share > model.gains.motion.disturbance_rejection:
            continue
        found = _boldest(_with_motion(model, disturbance_rejection=share), LoopKind.MOTION, plants)
        found = found and _boldest(found, LoopKind.TENSION, plants)
        if not found:
            continue
        for tried in _retreating(found, plants):
            after = worst_of(tried, plants)
            if after.enough and proves(tried):
                return Design(tried.gains, all_margins(model), all_margins(tried), worst_of(model, plants), after)
            unproven = unproven or after.enough
        if unproven:  # less rejection is less of one term; what does not settle in simulation has another cause
            raise ValueError(
                "the gains that keep the margins do not come to rest in simulation; expected other weights"
            )
    raise ValueError("no authority keeps the margins with this filter; expected a filter that trusts its sensors less")


def _retreating(found: HandModel, plants: tuple[PlantFactors, ...]) -> Iterator[HandModel]:
    """The gains, then such with less and less authority that keep the margins as well."""
    yield found
    for step in range(1, RETREATS + 1):
        force = math.exp(-step * STRIDE)
        less = _with_force(found, LoopKind.MOTION, found.gains.motion.force_N * force)
        less = _with_force(less, LoopKind.TENSION, found.gains.tension.force_N * force)
        if keeps(less, plants):
            yield less


def _with_motion(model: HandModel, **values: float) -> HandModel:
    gains = _checked(model.gains, motion={**model.gains.motion.model_dump(), **values})
    return redesigned(model, gains)


def _boldest(model: HandModel, kind: LoopKind, plants: tuple[PlantFactors, ...]) -> HandModel | None:
    """The most authority of one loop that keeps the margins; None if none does.

    It comes up from below. The least may not keep them (an integral alone makes a rope ring); from the first that
    does it goes on as long as they last, and bisects the last step. What keeps them far above is not looked for.
    """
    best, low, most = None, math.log(LEAST_FORCE_N), math.log(MOST_FORCE_N)
    while low < most:
        tried = _with_force(model, kind, math.exp(low))
        if keeps(tried, plants, (kind,)):
            best = tried
        elif best is not None:
            return _bisected(model, kind, plants, low - STRIDE, low, best)
        low += STRIDE
    return best


def _bisected(
    model: HandModel, kind: LoopKind, plants: tuple[PlantFactors, ...], low: float, high: float, best: HandModel
) -> HandModel:
    for _ in range(STEPS):
        middle = (low + high) / 2.0
        tried = _with_force(model, kind, math.exp(middle))
        if keeps(tried, plants, (kind,)):
            low, best = middle, tried
        else:
            high = middle
    return best


def _with_force(model: HandModel, kind: LoopKind, force: float) -> HandModel:
    if kind == LoopKind.MOTION:
        return _with_motion(model, force_N=force)
    table = {**model.gains.tension.model_dump(), "force_N": force}
    return redesigned(model, _checked(model.gains, tension=table))


def placed(
    model: HandModel, plants: tuple[PlantFactors, ...], motion_hz: float, tension_hz: float, damping: float
) -> Design:
    """Poles of both loops where a person wants them, and the margins that they have there.

    Raises:
        ValueError: no weights have these poles.
    """
    moved = redesigned(model, with_poles(model, LoopKind.MOTION, motion_hz, damping))
    moved = redesigned(moved, with_poles(moved, LoopKind.TENSION, tension_hz, damping))
    before, after = worst_of(model, plants), worst_of(moved, plants)
    return Design(moved.gains, all_margins(model), all_margins(moved), before, after)
