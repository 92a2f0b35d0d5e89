"""Equations 3 to 12 of the paper: at random states, each printed term is compared with the correct term.

The correct terms follow from Lagrange's equations.

All derivatives are calculated with complex steps. Complex-step derivatives are exact except for
rounding errors, and need no formulas derived by hand.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from handctl.hand import rigid_body
from handctl.hand.digit import Array, DigitModel
from handctl.hand.dynamics import inverse_dynamics
from handctl.hand.hand_loading import load_hand
from handctl.paper.errata_item import ErrataItem, ErrataVerdict
from handctl.paper.model import equations
from handctl.paper.model.equations import EquationTerm
from handctl.paper.model.expression import Dimension, DimensionError
from handctl.paper.verdicts import verdict_of_ambiguous_statement, verdict_of_statement

STATE_COUNT = 200
"""Number of random states."""
RELATIVE_TOLERANCE = 1e-9
"""Largest relative difference that counts as a rounding error.

The smallest relative difference that a misprint causes is about 0.1.
"""
COMPLEX_STEP = 1e-30
"""Size of the complex step of a derivative.

The step can be as small as desired, because the complex-step method never subtracts one number from
another. Source: Squire & Trapp (1998).
"""
ENERGY_DIMENSION: Dimension = (1, 2, -2)
"""Dimension of energy, and of torque."""
SYMBOL_DIMENSIONS: dict[str, Dimension] = {
    **{f"I{i}": (1, 2, 0) for i in (1, 2, 3)},
    **{f"m{i}": (1, 0, 0) for i in (1, 2, 3)},
    **{f"{name}{i}": (0, 1, 0) for name in "Ld" for i in (1, 2, 3)},
    **{"d" * order + f"th{i}": (0, 0, -order) for order in (0, 1, 2) for i in (1, 2, 3)},
    "g": (0, 1, -2),
}
"""Dimension of each symbol in Eq. 3 to 12."""
StateSamples = Mapping[str, Any]


@cache
def random_states() -> StateSamples:
    """Return random parameters, angles, rates and accelerations of order 1. Each has the shape (STATES,).

    The random values are the same in every run of the program.
    """
    random = np.random.default_rng(7)
    values: dict[str, Array] = {}
    for name in sorted(SYMBOL_DIMENSIONS):
        is_motion_symbol = "th" in name
        values[name] = (
            random.normal(scale=1.5, size=STATE_COUNT)
            if is_motion_symbol
            else random.uniform(0.5, 2.0, STATE_COUNT)
        )
    return values


def finger_states(digit: DigitModel) -> StateSamples:
    """Return random motions, combined with the lengths, masses and inertias of the given digit."""
    states = dict(random_states())
    for i in range(3):
        states |= {f"I{i + 1}": digit.inertias[i, 2, 2], f"m{i + 1}": digit.masses[i]}
        states |= {f"L{i + 1}": digit.lengths[i], f"d{i + 1}": digit.centres_of_mass[i, 0]}
    return {**states, "g": 9.81}


def relative_deviation(printed_value: Any, correct_value: Any) -> float:
    """Return the largest difference between printed and correct values, divided by the largest correct value."""
    return float(np.max(np.abs(printed_value - correct_value)) / np.max(np.abs(correct_value)))


def lagrange_torques(states: StateSamples) -> list[Array]:
    """Return the torques T_i (3, STATES) [N m] that follow from the correct energies by Eq. 7 to 9.

    T_i = d/dt(∂L/∂θ̇_i) − ∂L/∂θ_i.
    """
    return [_momentum_rate(states, i) - _lagrangian_slope(states, i) for i in (1, 2, 3)]


def _energy_of_terms(terms: Sequence[EquationTerm], states: StateSamples) -> Any:
    """Return the sum of the given energy terms, each in its correct form instead of its printed form."""
    return sum(term.correct_form.evaluate(states) for term in terms)


def _momentum_rate(states: StateSamples, i: int) -> Array:
    """Return the derivative of ∂K/∂θ̇_i with respect to time.

    The kinetic energy K is quadratic in the rates. Therefore a difference quotient of the kinetic
    energy K with a step of size 1 is exact.
    """
    shifted_states = dict(states)
    for j in (1, 2, 3):
        # In a total derivative with respect to time, an angle changes with its rate, and a rate
        # changes with its acceleration.
        shifted_states[f"th{j}"] = states[f"th{j}"] + 1j * COMPLEX_STEP * states[f"dth{j}"]
        shifted_states[f"dth{j}"] = states[f"dth{j}"] + 1j * COMPLEX_STEP * states[f"ddth{j}"]
    # Because K is quadratic in a rate r, (K(r + 1) - K(r - 1)) / 2 is exactly the derivative of K
    # with respect to r.
    rate = f"dth{i}"
    value_above, value_below = (
        _energy_of_terms(
            equations.KINETIC_TERMS, {**shifted_states, rate: shifted_states[rate] + unit}
        )
        for unit in (1.0, -1.0)
    )
    return np.asarray(np.imag((value_above - value_below) / 2.0) / COMPLEX_STEP)


def _lagrangian_slope(states: StateSamples, i: int) -> Array:
    """Return ∂L/∂θ_i, where L is the Lagrangian with the correct energies."""
    shifted_states = {**states, f"th{i}": states[f"th{i}"] + 1j * COMPLEX_STEP}
    lagrangian = _energy_of_terms(equations.KINETIC_TERMS, shifted_states) - _energy_of_terms(
        equations.POTENTIAL_TERMS, shifted_states
    )
    return np.asarray(np.imag(lagrangian) / COMPLEX_STEP)


def term_errata() -> list[ErrataItem]:
    """Return one errata item for each term of Eq. 3 to 6 and 10 to 12."""
    return [
        _term_item(term)
        for term in (
            *equations.KINETIC_TERMS,
            *equations.POTENTIAL_TERMS,
            *sum(equations.TORQUE_TERMS, ()),
        )
    ]


def _term_item(term: EquationTerm) -> ErrataItem:
    """Return the errata item that compares a printed term with the correct term."""
    states = random_states()
    correct_values = term.correct_form.evaluate(random_states())
    deviations = [
        relative_deviation(reading.evaluate(states), correct_values) for reading in term.readings
    ]
    verdict = verdict_of_ambiguous_statement([value < RELATIVE_TOLERANCE for value in deviations])
    # A reader of the paper can find wrong dimensions and a missing symmetry without a computer.
    faults = (
        []
        if verdict == ErrataVerdict.EQUAL
        else [_wrong_dimensions_text(term), _asymmetry_text(term)]
    )
    return ErrataItem(
        term.id, term.where, term.printed_form, term.correct_form.as_typeset_text(), "", verdict, term.explanation,
        (*filter(None, faults), "Lagrange"), min(deviations),
    )  # fmt: skip


def _wrong_dimensions_text(term: EquationTerm) -> str:
    """Return the text "dimensions" if one of the interpretations of a term has a wrong physical dimension.

    Return an empty text if all interpretations (``term.readings``) have the dimension of an energy.
    """
    for reading in term.readings:
        try:
            if reading.dimension(SYMBOL_DIMENSIONS) != ENERGY_DIMENSION:
                return "dimensions"
        except DimensionError:
            return "dimensions"
    return ""


def _asymmetry_text(term: EquationTerm) -> str:
    """Compare the printed coefficients of two terms that must be equal because the inertia matrix is symmetric.

    The second term is the term whose identifier is ``mirror_id``. If the printed coefficients of
    the two terms differ, return a text that describes the difference. If the coefficients are
    equal, or if there is no second term, return an empty text.
    """
    if not term.mirror_id:
        return ""
    mirror_term = next(
        other_term
        for terms in equations.TORQUE_TERMS
        for other_term in terms
        if other_term.id == term.mirror_id
    )
    states_with_unit_accelerations = {**random_states(), **{f"ddth{i}": 1.0 for i in (1, 2, 3)}}
    is_asymmetric = (
        relative_deviation(
            term.readings[0].evaluate(states_with_unit_accelerations),
            mirror_term.readings[0].evaluate(states_with_unit_accelerations),
        )
        > RELATIVE_TOLERANCE
    )
    return f"symmetry with {mirror_term.where}" if is_asymmetric else ""


def equation_errata() -> list[ErrataItem]:
    """Return the errata items for Eq. 7 to 9, and for Eq. 10 to 12 as a whole.

    Each equation is compared with handctl's equations of motion.
    """
    digit = paper_finger()
    states = finger_states(digit)
    model = model_torques(digit, states)
    max_deviation = max(
        relative_deviation(model_torque, lagrange_torque)
        for model_torque, lagrange_torque in zip(model, lagrange_torques(states), strict=True)
    )
    errata_items = [
        ErrataItem(
            "eq7-9.lagrange", "Eq. 7-9", "d/dt(∂L/∂θ̇ᵢ) − ∂L/∂θᵢ = Tᵢ", "the same", "",
            verdict_of_statement(max_deviation < RELATIVE_TOLERANCE),
            "Lagrange's equations in absolute angles. The corrected energies, derived numerically, give the torques "
            "that the control loop of this project computes.", ("Lagrange", "this project's dynamics"), max_deviation,
        ),
        _check_joint_torque(digit, states, model),
    ]  # fmt: skip
    for i, terms in enumerate(equations.TORQUE_TERMS):
        deviation = relative_deviation(printed_equation_value(terms, states), model[i])
        remaining_deviation = relative_deviation(
            sum(term.correct_form.evaluate(states) for term in terms), model[i]
        )
        wrong_terms = [
            item.id for item in map(_term_item, terms) if item.verdict != ErrataVerdict.EQUAL
        ]
        errata_items.append(
            ErrataItem(
                f"eq{10 + i}.sum", f"Eq. {10 + i}", f"T{'₁₂₃'[i]} = sum of {len(terms)} terms",
                " + ".join(term.correct_form.as_typeset_text() for term in terms).replace("+ −", "− "), "",
                verdict_of_statement(deviation < RELATIVE_TOLERANCE),
                f"These terms are wrong as printed: {', '.join(wrong_terms)}. The corrected equation gives the "
                "torque that "
                f"the control loop of this project computes, {_agreement_text(remaining_deviation)} at "
                f"{STATE_COUNT} random states.",
                ("Lagrange", "this project's dynamics"), deviation,
            )
        )  # fmt: skip
    return errata_items


def _check_joint_torque(
    digit: DigitModel, states: StateSamples, model: Sequence[Array]
) -> ErrataItem:
    """Check whether T_i in the paper is the torque at joint i.

    T_i belongs to an absolute link angle. The torques at the joints are tau = S^T T, where S is a
    lower triangular matrix of ones.
    """
    joints = joint_torques(digit, states)
    is_equal = relative_deviation(model[0], joints[:, 0]) < RELATIVE_TOLERANCE
    deviation_of_sum = relative_deviation(model[0] + model[1] + model[2], joints[:, 0])
    return ErrataItem(
        "eq7-9.joint_torque", "Sec. 7", "T₁, T₂ and T₃ at each joint E₁, E₂ and E₃",
        "τ₁ = T₁ + T₂ + T₃, τ₂ = T₂ + T₃, τ₃ = T₃", "", verdict_of_statement(is_equal),
        "Tᵢ belongs to an absolute link angle. The torque at a joint follows by virtual work from θ = S q with S lower "
        f"triangular of ones: τ = Sᵀ T (at random states {_agreement_text(deviation_of_sum)}).", ("virtual work",),
        relative_deviation(model[0], joints[:, 0]),
    )  # fmt: skip


def _agreement_text(deviation: float) -> str:
    """Return a text that states how closely the printed and the correct value agree.

    The text contains no decimal digits that can differ between machines.
    """
    return "to rounding" if deviation < RELATIVE_TOLERANCE else f"to {deviation:.1g}"


def paper_finger() -> DigitModel:
    """Return a finger of the packaged hand, changed to satisfy the assumptions of Eq. 3 to 12."""
    # In Eq. 3 to 12, the joints have no armature inertia, and the weight acts along -y in the plane
    # of the finger.
    digit = DigitModel.from_hand(load_hand("jamia"), "index")
    digit = digit.with_gravity(digit.mount_rotation @ np.array([0.0, -9.81, 0.0]))
    table = digit.table.copy()
    table[rigid_body.JOINT_ARMATURE_ROW] = 0.0
    return replace(digit, table=table)


def joint_torques(digit: DigitModel, states: StateSamples) -> Array:
    """Return the joint torques (STATES, 3) [N m] from the inverse dynamics of handctl."""
    q, dq, ddq = (_relative_from_absolute(states, "d" * order + "th") for order in (0, 1, 2))
    rows = zip(q.tolist(), dq.tolist(), ddq.tolist(), strict=True)
    return np.array([inverse_dynamics(digit, *row) for row in rows])


def model_torques(digit: DigitModel, states: StateSamples) -> list[Array]:
    """Return the torques T for absolute link angles, computed from handctl's joint torques tau.

    The conversion is T_1 = tau_1 - tau_2, T_2 = tau_2 - tau_3 and T_3 = tau_3. Each torque has the
    shape (STATES,) and the unit N m.
    """
    tau = joint_torques(digit, states)
    return [tau[:, 0] - tau[:, 1], tau[:, 1] - tau[:, 2], tau[:, 2]]


def _relative_from_absolute(states: StateSamples, name: str) -> Array:
    """Return relative joint angles, or their derivatives, (STATES, 3), calculated from the absolute angles."""
    return np.diff(np.column_stack([states[f"{name}{i}"] for i in (1, 2, 3)]), axis=1, prepend=0.0)


def printed_equation_value(terms: Sequence[EquationTerm], states: StateSamples) -> Any:
    """Return the value of a printed equation.

    If a printed term has several possible meanings (``readings``), the first meaning is used.
    """
    return sum(term.readings[0].evaluate(states) for term in terms)
