"""Sections 5 and 6 of the paper: moments, tension, torque, payload and wire.

This module calculates all values from numbers of the paper.
"""

import math
from fractions import Fraction

from handctl.paper import paper_data as src
from handctl.paper.errata_item import ErrataItem
from handctl.paper.model.expression import DIMENSIONLESS, Dimension, DimensionError, Expression
from handctl.paper.verdicts import (
    rounding_interval,
    verdict_of_contradiction,
    verdict_of_derived_number,
    verdict_of_number,
    verdict_of_statement,
)

ARITHMETIC_TAG = ("arithmetic",)
STATICS_TAG = ("statics",)


def statics_errata() -> list[ErrataItem]:
    """Return the errata items about all numbers and formulas of the statics."""
    return [
        *_check_joint_moments(),
        *_check_moment_labels(),
        *_check_formulas(),
        *_check_finger(),
        *_check_payload(),
        *_check_wire_diameters(),
        *_check_knee(),
        *_check_thumb(),
    ]


def number_item(
    id: str,
    location: str,
    printed: str,
    exact_value: Fraction | float,
    unit: str,
    reason: str,
    symbol: str = "",
) -> ErrataItem:
    """Return an errata item about a printed number.

    The verdict compares the printed digits with the exact value.

    The argument `symbol` is the text that the paper prints after the number.
    """
    verdict = verdict_of_number(printed, exact_value)
    return ErrataItem(
        id, location, printed + symbol, float(exact_value), unit, verdict, reason, ARITHMETIC_TAG
    )


def _check_joint_moments() -> list[ErrataItem]:
    """Check the printed moments in sections 5 and 6."""
    rows = [
        ("sec5.M", "Sec. 5", src.paper_finger(), ("55", "25", "10"), "F"),
        ("sec6.MT", "Sec. 6", src.paper_thumb(), ("25", "10"), "Fₜ"),
    ]
    return [
        number_item(f"{id}{i + 1}", location, printed_value, lever, "N mm per N",
               f"Lever of the tip about joint {i + 1} of the straight digit.", f" {symbol}")
        for id, location, digit, printed_values, symbol in rows
        for i, (printed_value, lever) in enumerate(zip(printed_values, src.tip_distances_mm(digit), strict=True))
    ]  # fmt: skip


FIGURE_LABELS = (
    ("sec5.M1_label", "Sec. 5", "M₁: moment at first three joint", src.paper_finger, 0, (0, 1, 2)),
    (
        "sec5.M2_label",
        "Sec. 5",
        "M₂: moment at first two joints from the end of the link",
        src.paper_finger,
        1,
        (1, 2),
    ),
    (
        "sec5.M3_label",
        "Sec. 5",
        "M₃: moment at first joint at the end link",
        src.paper_finger,
        2,
        (2,),
    ),
    (
        "sec6.MT1_label",
        "Sec. 6",
        "M_T1: moment at each joint from the end",
        src.paper_thumb,
        0,
        (0, 1),
    ),
    ("sec6.MT2_label", "Sec. 6", "M_T2: moment at end joint link2", src.paper_thumb, 1, (1,)),
)
"""Printed label of each moment, with the joint at which the moment acts and the joints that the label names.

Joints are counted from the palm, beginning with 0.
"""


def _check_moment_labels() -> list[ErrataItem]:
    """Check the labels of the moments in the paper.

    If a label names several joints, the paper states that the moments at the named joints are
    equal.
    """
    rows = []
    for id, location, printed_label, digit, joint, named_joint in FIGURE_LABELS:
        tip_distances = src.tip_distances_mm(digit())
        moments_text = ", ".join(f"{tip_distances[i]}F" for i in named_joint)
        rows.append(
            ErrataItem(
                id, location, printed_label, f"moment at joint {joint + 1}", "",
                verdict_of_statement(all(tip_distances[i] == tip_distances[joint] for i in named_joint)),
                f"{tip_distances[joint]}F is the moment at joint {joint + 1}, counted from the palm. "
                f"At the joints that the label names it is {moments_text}.", STATICS_TAG,
            )
        )  # fmt: skip
    return rows


FORCE_DIMENSION = (1, 1, -2)
LENGTH_DIMENSION = (0, 1, 0)
MASS_DIMENSION = (1, 0, 0)
STRESS_DIMENSION = (1, -1, -2)
SYMBOL_DIMENSIONS: dict[str, Dimension] = {
    "M": (1, 2, -2), "T": FORCE_DIMENSION, "F": FORCE_DIMENSION, "r_p": LENGTH_DIMENSION, "r_a": LENGTH_DIMENSION,
    "g": (0, 1, -2), "mu": DIMENSIONLESS, "A": (0, 2, 0),
    "sigma": STRESS_DIMENSION,
}  # fmt: skip
"""Dimension of each symbol in the formulas of section 5."""


def _check_formulas() -> list[ErrataItem]:
    """Check the formulas in section 5: their dimensions, and their agreement with the statics of the hand."""
    hand = src.paper_hand()
    tendons = src.paper_hand().digit_tendons["index"]
    arms = hand.moment_arms[tendons, hand.digit_joints["index"]][0].tolist()
    spool = hand.motor_of_tendon(hand.tendon_names[tendons][0]).spool_radius_m
    tension = 110.0
    grip_force_N = float(src.FINGER_GRIP_FORCE_N)
    values = {
        "T": tension, "F": grip_force_N, "r_p": float(src.PULLEY_RADIUS_MM) / 1000,
        "r_a": float(src.SPOOL_RADIUS_MM) / 1000,
        "g": float(src.GRAVITY_M_PER_S2), "mu": float(src.FRICTION_COEFFICIENT),
        "sigma": 1e6 * float(src.ALLOWABLE_STRESS_MPA),
    }  # fmt: skip
    diameter = src.wire_diameter_mm(tension) / 1000
    values["A"] = math.pi * diameter**2 / 4
    # Each formula is evaluated with the numbers of the hand.
    rows = (
        ("moment", "M = T r_p", "T*r_p", (1, 2, -2), arms[0] * tension,
         "By virtual work: the tendon's moment arm at each joint is its pulley's radius."),
        ("torque", "T_orque = T r_a", "T*r_a", (1, 2, -2), spool * tension,
         "By virtual work at the spool. The letter T is the tension, T_orque a torque."),
        ("payload", "m = F μ/g", "F*mu/g", MASS_DIMENSION, float(src.payload_kg(src.FINGER_GRIP_FORCE_N)),
         "Coulomb's friction at one contact with normal force F, along its tangent."),
        ("stress", "σ = T/A", "T/A", STRESS_DIMENSION, 1e6 * src.wire_stress_mpa(tension, 1000 * diameter),
         "Mean stress of the wire in tension."),
        ("wire", "D_min = √(4T/(π σ_a))", "4*T/(pi*sigma)", (0, 2, 0), diameter**2,
         "Solves σ_a = T/A with A = π d²/4. Judged by its square."),
    )  # fmt: skip
    formula_items = []
    for name, printed_formula, text, dimension, correct_value, reason in rows:
        expression = Expression(text)
        is_correct = expression.dimension(SYMBOL_DIMENSIONS) == dimension and math.isclose(
            expression.evaluate(values), correct_value, rel_tol=1e-9
        )
        location = "Sec. 5, Sec. 6" if name in ("moment", "torque") else "Sec. 5"
        evidence = ("dimensions", "statics")
        formula_items.append(
            ErrataItem(
                f"sec5.{name}_formula",
                location,
                printed_formula,
                printed_formula,
                "",
                verdict_of_statement(is_correct),
                reason,
                evidence,
            )
        )
    return formula_items


def _check_finger() -> list[ErrataItem]:
    """Check the tendon tension and the torque that the paper prints for a finger."""
    tension = src.tension_per_newton(src.paper_finger())
    torque = tension * src.SPOOL_RADIUS_MM / 1000
    tension_item = number_item(
        "sec5.tension", "Sec. 5", "18.33", tension, "N per N",
        f"55/3. At 6 N: {float(6 * tension):g} N.", " F")  # fmt: skip
    # The paper rounds the tension, and calculates the torque from the rounded tension. Therefore
    # the torque in the paper contains a rounding error.
    torque_from_rounded_tension = Fraction("18.33") * src.SPOOL_RADIUS_MM / 1000
    verdict = verdict_of_derived_number(
        "0.09165", torque, torque_from_rounded_tension, tension_item.verdict
    )
    torque_item = ErrataItem(
        "sec5.torque", "Sec. 5", "0.09165 F", float(torque), "N m per N", verdict,
        f"Computed from the rounded 18.33. At 6 N: {float(6 * torque):g} N m.", ARITHMETIC_TAG)  # fmt: skip
    return [tension_item, torque_item]


def _check_payload() -> list[ErrataItem]:
    """Check the printed payloads."""
    single_payload = src.payload_kg(src.FINGER_GRIP_FORCE_N)
    triple_payload = src.payload_kg(src.FINGER_COUNT * src.FINGER_GRIP_FORCE_N)
    first_item = number_item(
        "sec5.payload",
        "Sec. 5",
        "0.305",
        single_payload,
        "kg",
        "μ F/g = 0.5 × 6/9.81, truncated instead of rounded.",
    )
    verdict = verdict_of_derived_number(
        "0.915", triple_payload, 3 * Fraction("0.305"), first_item.verdict
    )
    force = src.GRAVITY_M_PER_S2 / (src.FINGER_COUNT * src.FRICTION_COEFFICIENT)
    tension = src.tension_for_payload(1)
    return [
        first_item,
        ErrataItem("sec5.payload3", "Sec. 5", "0.915", float(triple_payload), "kg", verdict, "3 × the truncated 0.305.",
            ARITHMETIC_TAG),
        number_item(
            "abstract.payload", "Abstract", "1", triple_payload, "kg",
            "The maximum load of the abstract is the load of section 5 to one digit, 0.917 kg at 6 N per finger. A "
            f"whole kilogram needs {float(force):.4g} N per finger and {float(tension):.4g} N in the tendon."),
    ]  # fmt: skip


def _check_wire_diameters() -> list[ErrataItem]:
    """Check the printed diameters of the wire."""
    tension = src.FINGER_GRIP_FORCE_N * src.tension_per_newton(src.paper_finger())
    diameter = src.wire_diameter_mm(tension)
    low, high = (
        src.ALLOWABLE_STRESS_MPA * Fraction(math.pi) * bound**2 / 4
        for bound in rounding_interval("0.866")
    )
    return [
        number_item(
            "sec5.wire", "Sec. 5", "0.866", diameter, "mm",
            f"√(4 × {float(tension):g}/(π 190)). 0.866 mm belongs to {float(low):.4g} to {float(high):.4g} N."),
        number_item(
            "abstract.wire", "Abstract", "0.86", diameter, "mm",
            "This is the wire for 0.917 kg, which the abstract rounds to 1 kg. Here the digits are right, unlike in "
            f"section 5. A whole kilogram would need {src.wire_diameter_mm(src.tension_for_payload(1)):.4g} mm."),
        _check_area(),
    ]  # fmt: skip


def _check_area() -> ErrataItem:
    """Check the printed formula for the area of the wire, A = pi d2/4.

    The printed formula gives an area only if the 2 after d is an exponent.
    """
    printed_formula = Expression("pi*d2/4")
    correct_formula = Expression("pi*d**2/4")
    lengths = {"d": (0, 1, 0), "d2": (0, 1, 0)}
    try:
        is_correct = printed_formula.dimension(lengths) == correct_formula.dimension(lengths)
    except DimensionError:
        is_correct = False
    return ErrataItem(
        "sec5.area", "Sec. 5", "A = π d2/4", correct_formula.as_typeset_text(), "", verdict_of_statement(is_correct),
        "The exponent is printed on the base line. As printed, the result is a length.", ("dimensions",))  # fmt: skip


def _check_knee() -> list[ErrataItem]:
    """Check the statements of the paper about the knee of the force-displacement curve."""
    diameter = src.wire_diameter_mm(
        src.FINGER_GRIP_FORCE_N * src.tension_per_newton(src.paper_finger())
    )
    knee, knee_abstract = src.KNEE_TENSIONS_N
    stress_mpa = src.wire_stress_mpa(knee, diameter)
    printed_tensions = [str(value) for value in src.KNEE_TENSIONS_N]
    verdict = verdict_of_contradiction(printed_tensions, None)
    reason = "Section 5 states 200 N, the abstract 250 N. The paper prints no data and no law that give the knee."
    return [
        ErrataItem(
            "fig5.knee", "Abstract, Sec. 5", f"linear up to {knee_abstract} N / {knee} N", None, "N", verdict, reason,
            ("contradiction",)),
        ErrataItem(
            "fig5.stress", "Sec. 5", f"σ = 190 MPa allowed, wire used up to {knee} N and beyond", stress_mpa, "MPa",
            verdict_of_statement(stress_mpa <= src.ALLOWABLE_STRESS_MPA),
            f"In the 0.8586 mm wire 190 MPa are reached at 110 N. 200 N are {stress_mpa:.0f} MPa and 250 N "
            f"{src.wire_stress_mpa(knee_abstract, diameter):.0f} MPa: the knee lies far beyond what section 5 allows.",
            ARITHMETIC_TAG),
    ]  # fmt: skip


def _check_thumb() -> list[ErrataItem]:
    """Check the tendon tension and the torque that the paper prints for the thumb."""
    tension = src.tension_per_newton(src.paper_thumb())
    torque = tension * src.SPOOL_RADIUS_MM / 1000
    first_item = number_item(
        "sec6.tension",
        "Sec. 6",
        "8.33",
        tension,
        "N per N",
        f"25/3. At 10 N: {float(10 * tension):.6g} N.",
        " Fₜ",
    )
    torque_from_rounded_tension = Fraction("8.33") * src.SPOOL_RADIUS_MM / 1000
    verdict = verdict_of_derived_number(
        "0.04165", torque, torque_from_rounded_tension, first_item.verdict
    )
    wire = src.wire_diameter_mm(src.THUMB_GRIP_FORCE_N * tension)
    return [
        _missing_radius(),
        first_item,
        ErrataItem(
            "sec6.torque", "Sec. 6", "0.04165 Fₜ", float(torque), "N m per N", verdict,
            "Computed from the rounded 8.33.", ARITHMETIC_TAG),
        number_item(
            "sec6.torque10", "Sec. 6", "0.4166", src.THUMB_GRIP_FORCE_N * torque, "N m",
            f"5/12, truncated (rounded it is 0.4167). The thumb's wire, not printed, needs {wire:.4f} mm."),
    ]  # fmt: skip


def _missing_radius() -> ErrataItem:
    """Calculate the pulley radius that the paper does not state.

    The radius follows from the tendon tension 8.33 F, which the paper prints for the tip force F.
    """
    printed_formula = "r_p = mm"
    # All numbers that are rounded to 8.33 correspond to an interval of pulley radii. The interval
    # of the radii contains exactly one whole number of millimetres.
    low, high = sorted(
        src.tip_distances_mm(src.paper_thumb())[0] / bound for bound in rounding_interval("8.33")
    )
    integer_radii = [radius for radius in range(1, 10) if low <= radius <= high]
    return ErrataItem(
        "sec6.pulley", "Sec. 6", printed_formula, float(integer_radii[0]), "mm",
        verdict_of_statement(f"= {integer_radii[0]} mm" in printed_formula),
        f"The number is missing. 8.33 F implies {float(low):.4f} to {float(high):.4f} mm, which is the 3 mm of the "
        "fingers.",
        ("back-computed",))  # fmt: skip
