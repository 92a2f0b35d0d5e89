"""Equations 3 to 12 judged at random states: each printed term against the right one, and the right ones by Lagrange.

Every derivative is taken by complex steps, to rounding error, so that what is right does not rest on anybody's algebra.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from handctl.hand.digit import Array, DigitModel
from handctl.hand.dynamics import inverse_dynamics
from handctl.hand.load import load_hand
from handctl.paper.item import Item, Verdict
from handctl.paper.model import equations
from handctl.paper.model.equations import Term
from handctl.paper.model.expression import Dimension, DimensionError
from handctl.paper.verdict import of_readings, of_statement

STATES = 200
TOLERANCE = 1e-9
"""Largest relative difference that is rounding; the smallest misprint makes some 0.1."""
STEP = 1e-30
"""Complex step: nothing is subtracted, so it may be as small as one likes. Source: Squire & Trapp (1998)."""
JOULE: Dimension = (1, 2, -2)
"""Also newton metre."""
DIMENSIONS: dict[str, Dimension] = {
    **{f"I{i}": (1, 2, 0) for i in (1, 2, 3)},
    **{f"m{i}": (1, 0, 0) for i in (1, 2, 3)},
    **{f"{name}{i}": (0, 1, 0) for name in "Ld" for i in (1, 2, 3)},
    **{"d" * order + f"th{i}": (0, 0, -order) for order in (0, 1, 2) for i in (1, 2, 3)},
    "g": (0, 1, -2),
}
States = Mapping[str, Any]


@cache
def random_states() -> States:
    """Parameters of the order of one, angles, rates and accelerations, (STATES,) each; the same on every run."""
    chance = np.random.default_rng(7)
    values: dict[str, Array] = {}
    for name in sorted(DIMENSIONS):
        moves = "th" in name
        values[name] = chance.normal(scale=1.5, size=STATES) if moves else chance.uniform(0.5, 2.0, STATES)
    return values


def finger_states(digit: DigitModel) -> States:
    """Random motions of a finger with its own lengths and masses."""
    own = dict(random_states())
    for i in range(3):
        own |= {f"I{i + 1}": digit.inertias[i], f"m{i + 1}": digit.masses[i]}
        own |= {f"L{i + 1}": digit.lengths[i], f"d{i + 1}": digit.coms[i]}
    return {**own, "g": 9.81}


def deviation(one: Any, other: Any) -> float:
    """Largest difference relative to the largest value of the second, which is the right one."""
    return float(np.max(np.abs(one - other)) / np.max(np.abs(other)))


def lagrange_torques(states: States) -> list[Array]:
    """T_i = d/dt(∂L/∂θ̇_i) − ∂L/∂θ_i of the right energies, Eq. 7 to 9, (3, STATES) [N m]."""
    return [_momentum_rate(states, i) - _slope(states, i) for i in (1, 2, 3)]


def _energy(terms: Sequence[Term], states: States) -> Any:
    return sum(term.right.value(states) for term in terms)


def _momentum_rate(states: States, i: int) -> Array:
    """d/dt of ∂K/∂θ̇_i; the difference over a whole unit is exact, since K is quadratic in the rates."""
    moved = dict(states)
    for j in (1, 2, 3):
        moved[f"th{j}"] = states[f"th{j}"] + 1j * STEP * states[f"dth{j}"]
        moved[f"dth{j}"] = states[f"dth{j}"] + 1j * STEP * states[f"ddth{j}"]
    rate = f"dth{i}"
    above, below = (_energy(equations.KINETIC, {**moved, rate: moved[rate] + unit}) for unit in (1.0, -1.0))
    return np.asarray(np.imag((above - below) / 2.0) / STEP)


def _slope(states: States, i: int) -> Array:
    """∂L/∂θ_i."""
    moved = {**states, f"th{i}": states[f"th{i}"] + 1j * STEP}
    lagrangian = _energy(equations.KINETIC, moved) - _energy(equations.POTENTIAL, moved)
    return np.asarray(np.imag(lagrangian) / STEP)


def term_items() -> list[Item]:
    """An item for each term of Eq. 3 to 6 and 10 to 12."""
    return [_item(term) for term in (*equations.KINETIC, *equations.POTENTIAL, *sum(equations.TORQUES, ()))]


def _item(term: Term) -> Item:
    states, sound = random_states(), term.right.value(random_states())
    deviations = [deviation(reading.value(states), sound) for reading in term.readings]
    verdict = of_readings([value < TOLERANCE for value in deviations])
    faults = [] if verdict == Verdict.EQUAL else [_dimensions(term), _symmetry(term)]
    return Item(
        term.id, term.where, term.printed, term.right.pretty(), "", verdict, term.why,
        (*filter(None, faults), "Lagrange"), min(deviations),
    )  # fmt: skip


def _dimensions(term: Term) -> str:
    """What the dimensions of the print say."""
    for reading in term.readings:
        try:
            if reading.dimension(DIMENSIONS) != JOULE:
                return "dimensions"
        except DimensionError:
            return "dimensions"
    return ""


def _symmetry(term: Term) -> str:
    """Whether the printed coefficient differs from its mirror image's, as a mass matrix's never does."""
    if not term.mirror:
        return ""
    mirror = next(other for terms in equations.TORQUES for other in terms if other.id == term.mirror)
    still = {**random_states(), **{f"ddth{i}": 1.0 for i in (1, 2, 3)}}
    unlike = deviation(term.readings[0].value(still), mirror.readings[0].value(still)) > TOLERANCE
    return f"symmetry with {mirror.where}" if unlike else ""


def equation_items() -> list[Item]:
    """Eq. 7 to 9 themselves, and Eq. 10 to 12 as a whole against this project's equations of motion."""
    digit = paper_finger()
    states = finger_states(digit)
    model = model_torques(digit, states)
    by_lagrange = max(deviation(mine, theirs) for mine, theirs in zip(model, lagrange_torques(states), strict=True))
    items = [
        Item(
            "eq7-9.lagrange", "Eq. 7-9", "d/dt(∂L/∂θ̇ᵢ) − ∂L/∂θᵢ = Tᵢ", "the same", "",
            of_statement(by_lagrange < TOLERANCE),
            "Lagrange's equations in absolute angles. The corrected energies, derived numerically, give the torques "
            "that the control loop of this project computes.", ("Lagrange", "this project's dynamics"), by_lagrange,
        ),
        _joint_torque(digit, states, model),
    ]  # fmt: skip
    for i, terms in enumerate(equations.TORQUES):
        off = deviation(printed_sum(terms, states), model[i])
        rest = deviation(sum(term.right.value(states) for term in terms), model[i])
        wrong = [item.id for item in map(_item, terms) if item.verdict != Verdict.EQUAL]
        items.append(
            Item(
                f"eq{10 + i}.sum", f"Eq. {10 + i}", f"T{'₁₂₃'[i]} = sum of {len(terms)} terms",
                " + ".join(term.right.pretty() for term in terms).replace("+ −", "− "), "",
                of_statement(off < TOLERANCE),
                f"Not right as printed: {', '.join(wrong)}. Corrected, it is what the control loop of this project "
                f"computes, {_agreement(rest)} at {STATES} random states.",
                ("Lagrange", "this project's dynamics"), off,
            )
        )  # fmt: skip
    return items


def _joint_torque(digit: DigitModel, states: States, model: Sequence[Array]) -> Item:
    """T_i belongs to an absolute angle; what a motor at the joint must make is tau = S^T T."""
    joints = joint_torques(digit, states)
    held = deviation(model[0], joints[:, 0]) < TOLERANCE
    summed = deviation(model[0] + model[1] + model[2], joints[:, 0])
    return Item(
        "eq7-9.joint_torque", "Sec. 7", "T₁, T₂ and T₃ at each joint E₁, E₂ and E₃",
        "τ₁ = T₁ + T₂ + T₃, τ₂ = T₂ + T₃, τ₃ = T₃", "", of_statement(held),
        "Tᵢ belongs to an absolute link angle. The torque at a joint follows by virtual work from θ = S q with S lower "
        f"triangular of ones: τ = Sᵀ T (at random states {_agreement(summed)}).", ("virtual work",),
        deviation(model[0], joints[:, 0]),
    )  # fmt: skip


def _agreement(off: float) -> str:
    """How well two things agree, without digits that differ from machine to machine."""
    return "to rounding" if off < TOLERANCE else f"to {off:.1g}"


def paper_finger() -> DigitModel:
    """A finger of the packaged hand as in Eq. 3 to 12: no armature, weight along -y of the finger's plane."""
    digit = DigitModel.of(load_hand("jamia"), "index")
    return replace(digit, gravity=(0.0, -9.81), links=digit.links._replace(r1=0.0, r2=0.0, r3=0.0))


def joint_torques(digit: DigitModel, states: States) -> Array:
    """Joint torques of this project's inverse dynamics, (STATES, 3) [N m]."""
    q, dq, ddq = (_relative(states, "d" * order + "th") for order in (0, 1, 2))
    rows = zip(q.tolist(), dq.tolist(), ddq.tolist(), strict=True)
    return np.array([inverse_dynamics(digit, *row) for row in rows])


def model_torques(digit: DigitModel, states: States) -> list[Array]:
    """The same as T of absolute angles, T = S^-T tau."""
    tau = joint_torques(digit, states)
    return [tau[:, 0] - tau[:, 1], tau[:, 1] - tau[:, 2], tau[:, 2]]


def _relative(states: States, name: str) -> Array:
    """Joint angles (or their derivatives) of absolute ones, (STATES, 3)."""
    return np.diff(np.column_stack([states[f"{name}{i}"] for i in (1, 2, 3)]), axis=1, prepend=0.0)


def printed_sum(terms: Sequence[Term], states: States) -> Any:
    """An equation as printed, each term in its first reading."""
    return sum(term.readings[0].value(states) for term in terms)
