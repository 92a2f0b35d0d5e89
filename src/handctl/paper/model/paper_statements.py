"""Statements in the text of the paper that can be checked by counting or by calculation."""

import re
from collections.abc import Sequence

import numpy as np

from handctl.paper import paper_data as src
from handctl.paper.errata_item import ErrataItem
from handctl.paper.model import equations
from handctl.paper.model.equations import EquationTerm
from handctl.paper.model.lagrange import RELATIVE_TOLERANCE, SYMBOL_DIMENSIONS, random_states
from handctl.paper.verdicts import (
    verdict_of_ambiguous_statement,
    verdict_of_number,
    verdict_of_statement,
)

COUNT_TAG = ("count",)
SYMBOL_PATTERN = re.compile(r"(?<![A-Za-z])[A-Za-z](?:_[A-Za-z]|[₀-₉])?(?![A-Za-z])")
"""Pattern of a symbol in a printed equation: a letter with or without an index."""
CONTROL_LAW_WORDS = ("desired", "error", "gain", "measured", "reference", "feedback")
"""Words by which the meaning of a symbol of a control law is recognised."""
MEANING_BY_SYMBOL = {
    "I": "moment of inertia", "m": "mass", "L": "length", "d": "distance of the centre of mass", "g": "gravity",
}  # fmt: skip
"""Meaning of each letter in the paper."""


def text_errata() -> list[ErrataItem]:
    """Return the errata items about counts, and about statements in the text of the paper."""
    return [
        *_check_degrees_of_freedom(),
        _check_palm_joint(),
        _check_number_of_fingers(),
        _check_phalanges(),
        _find_undefined_symbols(),
        _check_lengths(),
        _check_axis_of_inertia(),
        _check_control_law(),
    ]


def _check_degrees_of_freedom() -> list[ErrataItem]:
    """Check each number of degrees of freedom that the paper states."""
    hand = src.paper_hand()
    joints = [len(digit.joints) for digit in hand.digit]
    joints_per_digit = max(joints)
    total = sum(joints)
    # The rank of the moment arms is the number of motions that the tendons of a digit control
    # independently.
    moment_arm_ranks = [
        int(np.linalg.matrix_rank(hand.moment_arms[tendons]))
        for tendons in hand.digit_tendons.values()
    ]
    joint_sum_text = " + ".join(map(str, joints))
    return [
        ErrataItem("abstract.joints", "Abstract, Sec. 1", "a total of 11 DOF", total, "",
            verdict_of_number("11", total),
             f"{joint_sum_text} joints.", COUNT_TAG),
        ErrataItem("abstract.joints_each", "Abstract, Sec. 1", "each finger having three DOF", min(joints), "",
             verdict_of_ambiguous_statement(
                 [verdict_of_number("3", count) == verdict_of_number("3", 3) for count in joints]
             ),
             f"This is true for the fingers, and not for the thumb: with {joints_per_digit} each the sum would be "
             f"{joints_per_digit * len(joints)}, not {total}. The paper does not state whether the thumb "
             "counts as a finger.", COUNT_TAG),
        ErrataItem("abstract.freedom_each", "Abstract", "every finger and thumb has one degree of freedom",
            max(moment_arm_ranks), "",
             verdict_of_number("1", max(moment_arm_ranks)),
             f"This is true for the motions that the motors control: the tendons of each digit have rank 1, "
             f"{sum(moment_arm_ranks)} in all, for {total} joints. It contradicts the three DOF two sentences before. "
             "The paper never distinguishes joints from controlled motions.",
             COUNT_TAG),
    ]  # fmt: skip


def _check_palm_joint() -> ErrataItem:
    """Check the statement in section 3 of the paper that the joint in the palm link is fixed.

    In the paper, the fixed joint can be the first joint of a finger, or the palm itself.
    """
    joints = len(src.paper_finger().joints)
    angles = {
        name
        for term in equations.KINETIC_TERMS
        for name in term.correct_form.quantity_names
        if name.startswith("dth")
    }
    readings = [joints - 1 == len(angles), joints == len(angles)]
    return ErrataItem(
        "sec3.palm", "Sec. 3", "the joint in the palm link is fixed; one in both the median and distal connections",
        len(angles), "", verdict_of_ambiguous_statement(readings),
        f"If the finger's first joint is meant, {joints - 1} joints move, against the {len(angles)} angles of Eq. 1 to "
        f"12 and the 11 DOF of the abstract. If the palm is meant, which the next sentence calls the foundation, the "
        f"statement is right, and the first of {joints} joints is not mentioned.", COUNT_TAG)  # fmt: skip


def _check_number_of_fingers() -> ErrataItem:
    """Check the number of fingers that section 8 of the paper states."""
    digits = len(src.paper_hand().digit)
    return ErrataItem("sec8.fingers", "Sec. 8", "it is designed with two fingers", digits, "",
        verdict_of_number("2", digits),
                "The hand has three fingers and a thumb. The sentence belongs to another gripper.",
                COUNT_TAG)  # fmt: skip


def _depends_on_rate(energy_terms: Sequence[EquationTerm], name: str) -> bool:
    """Return True if the energy of the given terms depends on the joint rate with the given name."""
    states = random_states()
    shifted_states = {**states, name: states[name] + 1.0}
    change = sum(
        np.abs(term.correct_form.evaluate(shifted_states) - term.correct_form.evaluate(states))
        for term in energy_terms
    )
    return bool(np.max(change) > RELATIVE_TOLERANCE)


def _check_phalanges() -> ErrataItem:
    """Check whether the energy of each link is independent of the motion of the other links.

    The paper describes the three links as three fingers. If the links were separate fingers, the
    energy of a link would not depend on the motion of the other links.
    """
    # In a single finger, the energy of link 2 depends on the rate of link 1, and the energy of link
    # 3 on the rate of link 2.
    are_independent = not _depends_on_rate(
        equations.KINETIC_TERMS_2, "dth1"
    ) and not _depends_on_rate(equations.KINETIC_TERMS_3, "dth2")
    return ErrataItem(
        "sec1.fingers", "Sec. 1", "three fingers: the first is proximal, the second middle, the third distal",
        "the three phalanges of one finger", "", verdict_of_statement(are_independent),
        "These are the links of each finger, as section 4 says: the energy of the second link (Eq. 4) depends on "
        "the rate of the first link.", ("Eq. 4", "Eq. 5"))  # fmt: skip


def _find_undefined_symbols() -> ErrataItem:
    """Find the symbols in the printed equations that the paper does not define."""
    defined = {name[0] + "₀₁₂₃"[int(name[1])] for name in SYMBOL_DIMENSIONS if len(name) == 2} | {
        "g"
    }
    undefined = sorted(_printed_symbols() - defined)
    return ErrataItem(
        "eq10.symbols", "Eq. 10", ", ".join(undefined), "L₁, m₁", "", verdict_of_statement(not undefined),
        "The paper never defines these symbols. Both are in Eq. 10.", COUNT_TAG)  # fmt: skip


def _printed_symbols() -> set[str]:
    """Return the symbols in the printed equations 3 to 12, except angles."""
    torques = (term for terms in equations.TORQUE_TERMS for term in terms)
    terms = (*equations.KINETIC_TERMS, *equations.POTENTIAL_TERMS, *torques)
    return {
        symbol
        for term in terms
        if not term.printed_form.startswith("(")
        for symbol in SYMBOL_PATTERN.findall(term.printed_form)
    }


def _check_lengths() -> ErrataItem:
    """Check the list of lengths in section 7 of the paper."""
    listed_lengths = {"L₁", "L₂", "L₃", "p₃"}
    required_lengths = {f"L{'₀₁₂₃'[i]}" for i in (1, 2, 3)}
    return ErrataItem(
        "sec7.lengths", "Sec. 7", "the phalanges L₁, L₂ are L₃, and p₃",
        "lengths L₁, L₂, L₃; d₁, d₂, d₃ to the centres of mass", "",
        verdict_of_statement(listed_lengths == required_lengths),
        f"{', '.join(sorted(listed_lengths - _printed_symbols()))} occurs in no equation.", COUNT_TAG)  # fmt: skip


def _check_axis_of_inertia() -> ErrataItem:
    """Check about which axis, y or z, the moment of inertia determines the kinetic energy of a turning bar.

    The bar turns in the x-y plane. The paper states that the moment of inertia is about the y axis.
    """
    length = 30.0
    height = 8.0
    width = 10.0
    grid = [
        np.linspace(-1.0 + 1.0 / 60, 1.0 - 1.0 / 60, 60) * side / 2.0
        for side in (length, height, width)
    ]
    x, y, z = np.meshgrid(*grid, indexing="ij")
    energy = float(np.mean(x**2 + y**2)) / 2.0
    moment_by_axis = {"y": float(np.mean(x**2 + z**2)), "z": float(np.mean(x**2 + y**2))}
    # The energy of rotation is half of the moment of inertia times the squared rate. In the code
    # below, the rate is 1.
    correct_axes = [
        axis
        for axis, inertia in moment_by_axis.items()
        if abs(inertia / 2.0 - energy) < RELATIVE_TOLERANCE * energy
    ]
    return ErrataItem(
        "sec7.axis", "Sec. 7", "I about the y-axis", f"about the {correct_axes[0]}-axis through the centre of mass", "",
        verdict_of_statement(correct_axes == ["y"]),
        "Links turn in the x-y plane (section 4: about z). Eq. 3 adds m₁ d₁², so that I is about the centre of mass. "
        f"For a bar of 30 × 8 × 10 mm the two differ by {100 * (moment_by_axis['y'] / moment_by_axis['z'] - 1):.1f} %.",
        ("mechanics",))  # fmt: skip


def _check_control_law() -> ErrataItem:
    """Check whether any symbol of a control law occurs in the printed equations."""
    symbol_meanings = {MEANING_BY_SYMBOL.get(symbol[0], "") for symbol in _printed_symbols()} | {
        "angle",
        "torque",
    }
    control_law_meanings = [
        meaning for meaning in symbol_meanings if any(word in meaning for word in CONTROL_LAW_WORDS)
    ]
    return ErrataItem(
        "sec8.control", "Sec. 8", "the force controlling is calculated", float(len(control_law_meanings)), "",
        verdict_of_statement(bool(control_law_meanings)),
        "No symbol of any equation is a desired or measured value: the paper has no control law.",
        COUNT_TAG)  # fmt: skip
