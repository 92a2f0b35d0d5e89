"""Design of gains by one of two methods.

The first design method varies the force weight of each loop. The force weight is a motor force [N]
that sets the weights of the LQR cost by Bryson's rule. A motor force as large as the force weight
costs as much as the errors ``position_error_m`` or ``speed_error_m_s`` in the gains. A larger force
weight makes a loop faster and its margins smaller. Therefore the first design method finds the
largest force weight of each tendon with which all simulated plants have the required margins. The
smallest force weight of all tendons becomes the common ``force_N``. A tendon that permits more than
twice the common force weight gets a separate force weight. So a digit with a small force weight,
such as a heavy wrist, does not make other digits slow. The second design method places the poles at
given frequencies. The eigenvalues of the closed loop confirm the reported margins. A function that
the caller provides, such as a simulation, confirms the designed gains.

The second method uses an equation for a plant with one input, and with weights on position and
speed. The characteristic polynomial d of the closed loop satisfies

    d(s) d(-s) = p(s) p(-s) + (q1 |g1(s)|^2 + q2 |g2(s)|^2) / r.

Here, p is the characteristic polynomial of the plant. The polynomials g1 and g2 are the numerators
of position and speed, with the weights q1 and q2. The weight of the input is r. Two ratios of
weights determine two poles of the closed loop. Therefore the weights for a pair of poles can be
computed directly, if the damping ratio is above 1/sqrt(2).
Source: Kalman's symmetric root locus.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

from handctl.core.gains.gain_bounds import TENDON_SECTION, gains_with_values
from handctl.core.gains.gains import Gains
from handctl.core.gains.motion_design import design_motion, force_weight_at_period
from handctl.core.hand_model import HandModel
from handctl.document import validate_content
from handctl.errors import ConfigError
from handctl.tune.loops.linear_models import (
    LinearSystem,
    LoopKind,
    PlantFactors,
    connect_in_series,
    controller_system,
    plant_system,
)
from handctl.tune.loops.margins import (
    LoopMargins,
    confirmed_margins,
    margins_by_loop,
    margins_of_loop,
    minimum_margins,
    zeroed_margins,
)

MIN_FORCE_N = 0.2
"""Smallest force weight of the search [N]."""
MAX_FORCE_N = 400.0
"""Largest force weight of the search [N]."""
FORCE_SEARCH_STEP = math.log(1.7)
"""Step of the search for the largest force weight, in the natural logarithm of the force."""
BISECTION_STEPS = 5
"""Number of bisections of the last step of the search, for an accuracy of two per cent."""
FORCE_REDUCTION_STEP = math.log(1.03)
"""Step by which a force is reduced after the search, in the natural logarithm of the force.

The force is reduced until the margins, which the eigenvalues confirm, are large enough.
"""
MAX_FORCE_REDUCTIONS = 6
"""Largest number of reductions of a force after the search."""
MAX_UNIFORM_REDUCTIONS = 5
"""Largest number of steps by which all forces are reduced together.

The forces are reduced if the loops keep their margins but the hand does not come to rest in
simulation.
"""
MIN_TENSION_LIMIT_N = 1.0
"""Limit of the tension loops' force weights below which no further limit is tried [N]."""
MIN_SEPARATE_FORCE_RATIO = 2.0
"""Ratio of a tendon's force weight to the common one, above which the tendon gets a separate force weight."""
FORCE_SIGNIFICANT_DIGITS = 3
"""Number of significant digits of a designed force. The force is rounded down to these digits."""
DISTURBANCE_REJECTION_FRACTIONS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1, 0.0)
"""Fractions of disturbance rejection that the design tries, largest first.

With the filters of a few hands, loops with a large fraction of disturbance rejection have no
margin.
"""


@dataclass(frozen=True, slots=True)
class GainDesign:
    """Result of the design of gains.

    Attributes:
        gains: designed gains.
        margins_before: margins of each tendon and loop with the old gains, on the nominal plant.
        margins_after: margins of each tendon and loop with the designed gains, on the nominal
            plant.
        worst_margins_before: smallest value of each margin over all plants of the ensemble, with the old
            gains.
        worst_margins_after: smallest value of each margin over all plants of the ensemble, with the
            designed gains.
        old_gains_failure: reason why the hand does not come to rest in simulation with the old
            gains, or an empty text.
    """

    gains: Gains
    margins_before: dict[tuple[str, LoopKind], LoopMargins]
    margins_after: dict[tuple[str, LoopKind], LoopMargins]
    worst_margins_before: LoopMargins
    worst_margins_after: LoopMargins
    old_gains_failure: str = ""

    def with_zero_old_margins(self, reason: str) -> "GainDesign":
        """Return the design with margins of zero for the old gains.

        Call this method if the hand did not come to rest with the old gains in simulation.

        Args:
            reason: reason why the hand does not come to rest.
        """
        margins_before = {
            loop: zeroed_margins(margin) for loop, margin in self.margins_before.items()
        }
        return replace(
            self,
            margins_before=margins_before,
            worst_margins_before=zeroed_margins(self.worst_margins_before),
            old_gains_failure=reason,
        )

    def as_weights(self) -> Gains:
        """Convert the designed gains to gains with the default force weights, and return the result.

        The errors in the gains are multiplied by the same factor as the force weights. The returned
        gains describe the same controller as the designed gains, because LQR depends only on ratios
        of weights.
        """
        defaults = Gains()
        gains = self.gains
        motion = defaults.motion.force_N / gains.motion.force_N
        tension = defaults.tension.force_N / gains.tension.force_N
        motion_gains = gains.motion
        tension_gains = gains.tension
        motion_table = {
            "position_error_m": motion_gains.position_error_m * motion,
            "speed_error_m_s": motion_gains.speed_error_m_s * motion,
        }
        tension_table = {
            "tension_error_N": tension_gains.tension_error_N * tension,
            "speed_error_m_s": tension_gains.speed_error_m_s * tension,
        }
        return _replace_gain_sections(
            gains,
            motion={
                **motion_gains.model_dump(),
                **motion_table,
                "force_N": defaults.motion.force_N,
            },
            tension={
                **tension_gains.model_dump(),
                **tension_table,
                "force_N": defaults.tension.force_N,
            },
            tendon=_scaled_tendon_forces(gains, motion, tension),
        )


def linear_factors(plant_factors: Mapping[str, float]) -> PlantFactors:
    """Return only those factors of a plant that scale linear parameters.

    The result does not contain the factors of the friction, because friction is not linear.
    """
    names = PlantFactors.__dataclass_fields__
    return PlantFactors(**{key: value for key, value in plant_factors.items() if key in names})


def gains_with_poles(
    model: HandModel, kind: LoopKind, frequency_hz: float, damping: float
) -> Gains:
    """Return gains that place a pair of poles of a loop at a given natural frequency and damping ratio.

    Args:
        model: model of the hand with its present gains.
        kind: kind of the loop, motion or tension.
        frequency_hz: natural frequency of the pole pair [Hz].
        damping: damping ratio of the poles. For a damping ratio of 1/sqrt(2) or less, the motion
            loop has no weights with these poles.

    Raises:
        ValueError: no weights lead to these poles.
    """
    w = 2.0 * math.pi * frequency_hz
    position, speed = (_motion_weights if kind == LoopKind.MOTION else _tension_weights)(
        model, w, damping
    )
    shared_gains = _without_tendon_forces(model.gains, kind)
    if kind == LoopKind.MOTION:
        motion = shared_gains.motion
        force = force_weight_at_period(motion.force_N, model.period)
        table = {"position_error_m": force / position, "speed_error_m_s": force / speed}
        return _replace_gain_sections(shared_gains, motion={**motion.model_dump(), **table})
    tension = shared_gains.tension
    force = force_weight_at_period(tension.force_N, model.period)
    table = {"tension_error_N": force / position, "speed_error_m_s": force / speed}
    return _replace_gain_sections(shared_gains, tension={**tension.model_dump(), **table})


def _scaled_tendon_forces(
    gains: Gains, motion_factor: float, tension_factor: float
) -> list[dict[str, Any]]:
    """Multiply each tendon's separate forces by factors, and return the ``tendon`` section of the gains.

    The motion loop and the tension loop have different factors.
    """
    return [
        {
            "name": tendon_gains.name,
            "motion_force_N": tendon_gains.motion_force_N
            and tendon_gains.motion_force_N * motion_factor,
            "tension_force_N": tendon_gains.tension_force_N
            and tendon_gains.tension_force_N * tension_factor,
        }
        for tendon_gains in gains.tendon
    ]


def _replace_gain_sections(
    gains: Gains, **sections: dict[str, float] | list[dict[str, Any]]
) -> Gains:
    """Return gains in which the given sections are replaced, after a check of the bounds.

    Raises:
        ValueError: a value is out of its bounds.
    """
    try:
        return validate_content(gains.model_dump(by_alias=True) | sections, Gains, "weights")
    except ConfigError as error:
        raise ValueError(str(error)) from None


def _motion_weights(model: HandModel, frequency: float, damping: float) -> tuple[float, float]:
    """Return the two ratios of LQR weights of the motion loop: force / error, and force / speed error.

    The plant of the motion loop is a single mass, and the characteristic polynomial is d(s) = s^2 +
    2 z w s + w^2.
    """
    # At low frequencies, the rotor and a freely moving digit act as one mass.
    mass = float((model.tendon_constants.motor_mass + model.tendon_constants.load_mass).mean())
    return mass * frequency**2, mass * frequency * _positive_root(
        4.0 * damping**2 - 2.0, MIN_DAMPING_TEXT
    )


def _tension_weights(model: HandModel, frequency: float, damping: float) -> tuple[float, float]:
    """Return the two ratios of LQR weights of the tension loop: force / error, and force / speed error.

    The plant of the tension loop is a rotor on its tendon. No weights give poles below the natural
    frequency of the uncontrolled rotor.
    """
    tendons = model.tendon_constants
    m = float(tendons.motor_mass.mean())
    k = float(tendons.stiffness.mean())
    a0 = k / m
    a1 = float((tendons.motor_damping + tendons.damping).mean()) / m
    expected = (
        f"tension poles above {math.sqrt(a0) / (2.0 * math.pi):.1f} "
        "Hz, the frequency of the free rotor on its tendon"
    )
    speed = 2.0 * a0 - a1**2 - 2.0 * frequency**2 * (1.0 - 2.0 * damping**2)
    return _positive_root(frequency**4 - a0**2, expected) * m / k, m * _positive_root(
        speed, MIN_DAMPING_TEXT
    )


MIN_DAMPING_TEXT = "a damping of more than 0.71"
"""Text for error messages about the allowed damping."""


def _positive_root(squared_value: float, expected_text: str) -> float:
    """Return the square root of a positive number.

    Raises:
        ValueError: the number is not positive. A number that is not positive means that no weights
            lead to the requested poles.
    """
    if squared_value <= 0.0:
        raise ValueError(f"no weights have these poles; expected {expected_text}")
    return math.sqrt(squared_value)


def model_with_gains(model: HandModel, gains: Gains) -> HandModel:
    """Return the model with the given gains of both control loops, and an unchanged design of its Kalman filter."""
    return replace(
        model, gains=gains, motion_design=design_motion(model.tendon_constants, gains, model.period)
    )


def worst_margins(
    model: HandModel, plants: tuple[PlantFactors, ...], kinds: Iterable[LoopKind] = LoopKind
) -> LoopMargins:
    """Return the smallest value of each margin over all plants and all loops.

    In each group of equal tendons, the margins of only one tendon are computed.

    The eigenvalues of the closed loops confirm the returned margins.
    """
    return reduce(minimum_margins, _margins_of_loops(model, plants, kinds, confirmed_margins))


def weakest_plant(model: HandModel, plants: tuple[PlantFactors, ...]) -> int:
    """Return the index of the plant on which a loop has the smallest disk margin."""
    disk_margins = [
        min(margin.disk for margin in _margins_of_loops(model, (factors,), LoopKind))
        for factors in plants
    ]
    return disk_margins.index(min(disk_margins))


def keeps_required_margins(
    model: HandModel,
    plants: tuple[PlantFactors, ...],
    kinds: Iterable[LoopKind] = LoopKind,
    tendons: Iterable[int] | None = None,
) -> bool:
    """Return True if the loops of the given tendons have the required margins on every plant.

    If `tendons` is not given, all tendons are checked. The function stops at the first loop whose
    margin is too small.
    """
    return all(
        margin.are_sufficient for margin in _margins_of_loops(model, plants, kinds, tendons=tendons)
    )


def _margins_of_loops(
    model: HandModel,
    plants: tuple[PlantFactors, ...],
    kinds: Iterable[LoopKind],
    margins_function: Callable[[LinearSystem], LoopMargins] = margins_of_loop,
    tendons: Iterable[int] | None = None,
) -> Iterator[LoopMargins]:
    """Yield the margins of each loop, tendon, and plant.

    If `tendons` is not given, one tendon of each group of equal tendons is used.
    """
    for kind in kinds:
        for i in distinct_tendons(model) if tendons is None else tendons:
            loop_controller = controller_system(model, i, kind)
            yield from (
                margins_function(
                    connect_in_series(plant_system(model, i, kind, factors), loop_controller)
                )
                for factors in plants
            )


def distinct_tendons(model: HandModel) -> tuple[int, ...]:
    """Return the index of one tendon in each group of equal tendons."""
    return tuple(group[0] for group in _groups_of_equal_tendons(model))


def _groups_of_equal_tendons(model: HandModel) -> tuple[tuple[int, ...], ...]:
    """Return groups of tendons whose constants and forces are the same, apart from rounding errors."""
    tendons = model.tendon_constants
    groups: dict[tuple[str, ...], tuple[int, ...]] = {}
    for i, name in enumerate(tendons.names):
        numbers = (*tendons.constants_of_tendon(i), *model.gains.force_weights_of_tendon(name))
        key = tuple(f"{number:.6g}" for number in numbers)
        groups[key] = (*groups.get(key, ()), i)
    return tuple(groups.values())


def design_gains(
    model: HandModel,
    plants: tuple[PlantFactors, ...],
    passes_test: Callable[[HandModel], bool] = lambda _: True,
) -> GainDesign:
    """Design gains with the largest disturbance rejection and the largest force weights.

    With the designed gains, all plants keep the margins.

    Args:
        model: model of the hand with its present gains. The design of the gains does not change the
            filter of this model.
        plants: ensemble of plants on all of which the margins must be kept.
        passes_test: function that returns True if the gains of a model pass a further test, such as
            a simulation.

    Raises:
        ValueError: the smallest force weight already violates a margin, or no gains pass the further
            test.
    """
    has_unproven_design = False
    for rejection in DISTURBANCE_REJECTION_FRACTIONS:
        if rejection > model.gains.motion.disturbance_rejection:
            continue
        candidate = model_with_largest_force(
            _model_with_motion_gains(model, disturbance_rejection=rejection),
            LoopKind.MOTION,
            plants,
        )
        candidate = candidate and model_with_largest_force(candidate, LoopKind.TENSION, plants)
        if not candidate:
            continue
        for tried_model in _models_with_decreasing_force(candidate, plants):
            margins_after = worst_margins(tried_model, plants)
            if margins_after.are_sufficient and passes_test(tried_model):
                return GainDesign(
                    tried_model.gains,
                    margins_by_loop(model),
                    margins_by_loop(tried_model),
                    worst_margins(model, plants),
                    margins_after,
                )
            has_unproven_design = has_unproven_design or margins_after.are_sufficient
        # A smaller gain for disturbance rejection changes only one term of the control law. If the
        # hand does not come to rest even with a smaller disturbance rejection, another term must be
        # the cause.
        if has_unproven_design:
            raise ValueError(
                "the gains that keep the margins do not come to rest in simulation; expected other weights"
            )
    raise ValueError(
        "no force weight (motion.force_N, tension.force_N) keeps the margins with this filter; expected a larger "
        f"filter.encoder_noise_counts than {model.gains.filter.encoder_noise_counts:g}"
    )


def _models_with_decreasing_force(
    model: HandModel, plants: tuple[PlantFactors, ...]
) -> Iterator[HandModel]:
    """Yield the given model, and then those models with smaller force weights that keep the required margins.

    First, the force weights of all loops are reduced. Then the force weights of the tension loops
    alone are limited more and more. Without load cells, the margins of a tension loop allow a large
    force weight with which a spool pair oscillates while it closes.
    """
    yield model
    for weaker_model in _weaker_models(model):
        if keeps_required_margins(weaker_model, plants):
            yield weaker_model


def _weaker_models(model: HandModel) -> Iterator[HandModel]:
    """Yield models with ever smaller force weights, see ``_models_with_decreasing_force``."""
    for step in range(1, MAX_UNIFORM_REDUCTIONS + 1):
        yield _model_with_scaled_forces(model, math.exp(-step * FORCE_SEARCH_STEP))
    tension_limit = _largest_tension_force(model.gains)
    while tension_limit > MIN_TENSION_LIMIT_N:
        tension_limit = _rounded_force(math.log(tension_limit) - FORCE_SEARCH_STEP)
        yield _model_with_tension_force_limit(model, tension_limit)


def _model_with_scaled_forces(model: HandModel, factor: float) -> HandModel:
    """Return the model with the force weights of all loops multiplied by a factor."""
    motion, tension = model.gains.motion, model.gains.tension
    gains = _replace_gain_sections(
        model.gains,
        motion={**motion.model_dump(), "force_N": motion.force_N * factor},
        tension={**tension.model_dump(), "force_N": tension.force_N * factor},
        tendon=_scaled_tendon_forces(model.gains, factor, factor),
    )
    return model_with_gains(model, gains)


def _largest_tension_force(gains: Gains) -> float:
    """Return the largest force weight [N] of the tension loops of all tendons."""
    separate_forces = [tendon_gains.tension_force_N or 0.0 for tendon_gains in gains.tendon]
    return max([gains.tension.force_N, *separate_forces])


def _model_with_tension_force_limit(model: HandModel, limit: float) -> HandModel:
    """Return the model in which no tension loop has a larger force weight than a limit [N]."""
    force = min(model.gains.tension.force_N, limit)
    tendon_sections = []
    for tendon_gains in model.gains.tendon:
        separate_force = min(tendon_gains.tension_force_N or 0.0, limit)
        section = tendon_gains.model_dump() | {
            "tension_force_N": separate_force if separate_force > force else None
        }
        if section["motion_force_N"] or section["tension_force_N"]:
            tendon_sections.append(section)
    gains = _replace_gain_sections(
        model.gains,
        tension={**model.gains.tension.model_dump(), "force_N": force},
        tendon=tendon_sections,
    )
    return model_with_gains(model, gains)


def _model_with_motion_gains(model: HandModel, **values: float) -> HandModel:
    """Return the model in which the given gains of the motion loop are replaced."""
    gains = _replace_gain_sections(
        model.gains, motion={**model.gains.motion.model_dump(), **values}
    )
    return model_with_gains(model, gains)


def model_with_largest_force(
    model: HandModel, kind: LoopKind, plants: tuple[PlantFactors, ...]
) -> HandModel | None:
    """Give each tendon the largest force weight with which its loop keeps the margins, and return the model.

    If a tendon influences the loops of other tendons, all tendons have equal force weights. If no
    force weight keeps the margins, return None.
    """
    model = model_with_gains(model, _without_tendon_forces(model.gains, kind))
    forces: dict[int, float] = {}
    for group in _groups_of_equal_tendons(model):
        force = _largest_force(model, kind, group[0], plants)
        if force is None:
            return None
        forces |= dict.fromkeys(group, force)
    shared_force = min(forces.values())
    model_with_equal_forces = _model_with_equal_forces(model, kind, shared_force)
    separate_force_by_tendon = {
        model.tendon_constants.names[i]: force
        for i, force in forces.items()
        if force > MIN_SEPARATE_FORCE_RATIO * shared_force
    }
    if not separate_force_by_tendon:
        return model_with_equal_forces
    model_with_tendon_forces = _model_with_tendon_forces(
        model_with_equal_forces, kind, separate_force_by_tendon
    )
    # The force of each tendon was found while all tendons had the same force. If two tendons share
    # a joint, a larger force of the first tendon reduces the margins of the second.
    return (
        model_with_tendon_forces
        if keeps_required_margins(model_with_tendon_forces, plants, (kind,))
        else model_with_equal_forces
    )


def _largest_force(
    model: HandModel, kind: LoopKind, tendon: int, plants: tuple[PlantFactors, ...]
) -> float | None:
    """Return the largest force weight [N] with which the loop of a tendon keeps its stability margins.

    If no force weight keeps the margins, return None.

    The search begins with the smallest possible force. Even the smallest force can violate the
    margins: if the feedback without the integrator is too weak, the integrator makes the tendon
    oscillate. After the first force that keeps the margins, the force is increased until a margin
    is violated. A bisection then finds the limit between the last force that keeps the margins and
    the first larger force that violates a margin. Larger forces are not tried.
    """

    def has_required_margins(force_logarithm: float) -> bool:
        return keeps_required_margins(
            _model_with_equal_forces(model, kind, _rounded_force(force_logarithm)),
            plants,
            (kind,),
            (tendon,),
        )

    best_logarithm = None
    next_logarithm = math.log(MIN_FORCE_N)
    while next_logarithm < math.log(MAX_FORCE_N):
        if has_required_margins(next_logarithm):
            best_logarithm = next_logarithm
        elif best_logarithm is not None:
            break
        next_logarithm += FORCE_SEARCH_STEP
    if best_logarithm is None:
        return None
    high_logarithm = min(next_logarithm, math.log(MAX_FORCE_N))
    for _ in range(BISECTION_STEPS):
        middle_logarithm = (best_logarithm + high_logarithm) / 2.0
        if has_required_margins(middle_logarithm):
            best_logarithm = middle_logarithm
        else:
            high_logarithm = middle_logarithm
    # The search uses the response at few frequencies. At more frequencies, or from the eigenvalues,
    # the calculated margins can be smaller.
    for _ in range(MAX_FORCE_REDUCTIONS):
        tried_model = _model_with_equal_forces(model, kind, _rounded_force(best_logarithm))
        if all(
            margin.are_sufficient
            for margin in _margins_of_loops(
                tried_model, plants, (kind,), confirmed_margins, (tendon,)
            )
        ):
            break
        best_logarithm -= FORCE_REDUCTION_STEP
    return _rounded_force(best_logarithm)


def _rounded_force(force_logarithm: float) -> float:
    """Return the force whose natural logarithm is given, rounded down to a few digits [N]."""
    force = math.exp(force_logarithm)
    unit = 10.0 ** (math.floor(math.log10(force)) - FORCE_SIGNIFICANT_DIGITS + 1)
    # The added number 1e-9 compensates the rounding error of the quotient.
    return float(f"{math.floor(force / unit + 1e-9) * unit:.{FORCE_SIGNIFICANT_DIGITS}g}")


def _without_tendon_forces(gains: Gains, kind: LoopKind) -> Gains:
    """Return a copy of the gains without the separate forces of single tendons for one kind of loop."""
    removed_key = f"{kind}_force_N"
    entries = [tendon_gains.model_copy(update={removed_key: None}) for tendon_gains in gains.tendon]
    kept_entries = [
        entry.model_dump() for entry in entries if entry.motion_force_N or entry.tension_force_N
    ]
    return _replace_gain_sections(gains, tendon=kept_entries)


def _model_with_tendon_forces(
    model: HandModel, kind: LoopKind, force_of_tendon: Mapping[str, float]
) -> HandModel:
    """Return the model in which the named tendons have separate forces [N] in one loop."""
    values = {
        f"{TENDON_SECTION}.{name}.{kind}_force_N": force for name, force in force_of_tendon.items()
    }
    return model_with_gains(model, gains_with_values(model.gains, values, "design"))


def _model_with_equal_forces(model: HandModel, kind: LoopKind, force: float) -> HandModel:
    """Return the model in which one loop of every tendon has the force weight ``force`` [N]."""
    if kind == LoopKind.MOTION:
        return _model_with_motion_gains(model, force_N=force)
    table = {**model.gains.tension.model_dump(), "force_N": force}
    return model_with_gains(model, _replace_gain_sections(model.gains, tension=table))


def design_with_poles(
    model: HandModel,
    plants: tuple[PlantFactors, ...],
    motion_hz: float,
    tension_hz: float,
    damping: float,
) -> GainDesign:
    """Return the design in which the poles of the loops have given frequencies, with the resulting margins.

    Raises:
        ValueError: no weights lead to these poles.
    """
    model_with_poles = model_with_gains(
        model, gains_with_poles(model, LoopKind.MOTION, motion_hz, damping)
    )
    model_with_poles = model_with_gains(
        model_with_poles, gains_with_poles(model_with_poles, LoopKind.TENSION, tension_hz, damping)
    )
    margins_before = worst_margins(model, plants)
    margins_after = worst_margins(model_with_poles, plants)
    return GainDesign(
        model_with_poles.gains,
        margins_by_loop(model),
        margins_by_loop(model_with_poles),
        margins_before,
        margins_after,
    )
