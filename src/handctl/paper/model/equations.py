"""Equations 1 to 12 of the paper, term by term. Each term has a printed form, possible readings, and a correct form.

The correct terms (`correct_form`) follow from Lagrange's equations. The tests derive the correct
terms with sympy. If the printed form of a term is ambiguous, because an operator is missing or a
bracket is never closed, the term has several `readings`.
"""

from dataclasses import dataclass

from handctl.paper.model.expression import Expression


@dataclass(frozen=True, slots=True)
class EquationTerm:
    """Term of an equation in the paper, or a group of terms with one errata item.

    Attributes:
        id: identifier of the errata item about this term.
        where: equation that contains the term.
        printed_form: term of the equation, exactly as printed in the paper.
        readings: possible meanings of the printed term. If an undefined symbol can have only one
            meaning, the readings use this meaning.
        correct_form: correct form of the term.
        explanation: explanation of the error in the printed term.
        mirror_id: identifier of another term with the same coefficient. The coefficients of both
            terms must be equal, because the mass matrix is symmetric.
    """

    id: str
    where: str
    printed_form: str
    readings: tuple[Expression, ...]
    correct_form: Expression
    explanation: str
    mirror_id: str = ""


def _equation_term(
    id: str,
    printed_text: str,
    readings: str | tuple[str, ...],
    correct_text: str,
    explanation: str = "",
    mirror_id: str = "",
) -> EquationTerm:
    """Return the data of one term of an equation.

    The identifier of the term contains the number of the equation.
    """
    texts = (readings,) if isinstance(readings, str) else readings
    number = id.removeprefix("eq").partition(".")[0]
    reason = explanation or "As derived."
    return EquationTerm(
        id,
        f"Eq. {number}",
        printed_text,
        tuple(map(Expression, texts)),
        Expression(correct_text),
        reason,
        mirror_id,
    )


KINETIC_TERMS_1 = (
    _equation_term(
        "eq3.all",
        "½ I₁ θ̇₁² + ½ m₁ d₁² θ̇₁²",
        "I1*dth1**2/2 + m1*d1**2*dth1**2/2",
        "I1*dth1**2/2 + m1*d1**2*dth1**2/2",
    ),
)
KINETIC_TERMS_2 = (
    _equation_term("eq4.rotation", "½ I₂ θ̇₂²", "I2*dth2**2/2", "I2*dth2**2/2"),
    _equation_term("eq4.base", "½ m₂ L₁² θ̇₁²", "m2*L1**2*dth1**2/2", "m2*L1**2*dth1**2/2"),
    _equation_term(
        "eq4.own",
        "½ m₂ d₂ θ̇₂²",
        "m2*d2*dth2**2/2",
        "m2*d2**2*dth2**2/2",
        "The square of d₂ is missing.",
    ),
    _equation_term(
        "eq4.cross",
        "½ m₂ 2 L₁ d₂ θ̇₂ θ̇₁ cos(θ₁ − θ₂)",
        "m2*L1*d2*dth2*dth1*cos(th1 - th2)",
        "m2*L1*d2*dth1*dth2*cos(th1 - th2)",
    ),
)
KINETIC_TERMS_3 = (
    _equation_term("eq5.rotation", "½ I₃ θ̇₃²", "I3*dth3**2/2", "I3*dth3**2/2"),
    _equation_term("eq5.base", "½ m₃ L₁² θ̇₁²", "m3*L1**2*dth1**2/2", "m3*L1**2*dth1**2/2"),
    _equation_term(
        "eq5.middle",
        "½ m₃ L₂ θ̇₂²",
        "m3*L2*dth2**2/2",
        "m3*L2**2*dth2**2/2",
        "The square of L₂ is missing.",
    ),
    _equation_term(
        "eq5.own",
        "½ m₃ d₃²",
        "m3*d3**2/2",
        "m3*d3**2*dth3**2/2",
        "θ̇₃² is missing. As printed, the term is a constant, and its derivatives are zero.",
    ),
    _equation_term(
        "eq5.cross12",
        "½ m₃ 2 L₁ L₂ θ̇₁ θ̇₂ cos(θ₁ − θ₂)",
        "m3*L1*L2*dth1*dth2*cos(th1 - th2)",
        "m3*L1*L2*dth1*dth2*cos(th1 - th2)",
    ),
    _equation_term(
        "eq5.cross23",
        "½ m₃ 2 L₂ d₂ θ̇₂ θ̇₃ cos(θ₂ − θ₃)",
        "m3*L2*d2*dth2*dth3*cos(th2 - th3)",
        "m3*L2*d3*dth2*dth3*cos(th2 - th3)",
        "d₂ replaces d₃. The dimensions agree, but the value does not.",
    ),
    _equation_term(
        "eq5.cross13",
        "½ m₃ L₁ d₃ θ̇₁ θ̇₃ cos(θ₁ − θ₃)",
        "m3*L1*d3*dth1*dth3*cos(th1 - th3)/2",
        "m3*L1*d3*dth1*dth3*cos(th1 - th3)",
        "The term is outside of the bracket 2[ ], so it has half the correct value.",
    ),
)
POTENTIAL_TERMS = (
    _equation_term("eq6.link1", "m₁ g d₁ sin θ₁", "m1*g*d1*sin(th1)", "m1*g*d1*sin(th1)"),
    _equation_term(
        "eq6.link2",
        "m₂ g (L₁ sin θ₁ + d₂ sin θ₂)",
        "m2*g*(L1*sin(th1) + d2*sin(th2))",
        "m2*g*(L1*sin(th1) + d2*sin(th2))",
    ),
    _equation_term(
        "eq6.link3",
        "m₂ g [L₁ sin θ₁ + L₂ sin θ₂ d₃ sin θ₃]",
        "m2*g*(L1*sin(th1) + L2*sin(th2)*d3*sin(th3))",
        "m3*g*(L1*sin(th1) + L2*sin(th2) + d3*sin(th3))",
        "The mass of link 3 is m₃, and the plus before d₃ is missing.",
    ),
)
TORQUE_TERMS_1 = (
    _equation_term(
        "eq10.inertia",
        "[I₁ + m₁ d₁² + m₂ L₁²] θ̈₁",
        "(I1 + m1*d1**2 + m2*L1**2)*ddth1",
        "(I1 + m1*d1**2 + (m2 + m3)*L1**2)*ddth1",
        "m₃ L₁² is missing: link 3 moves with link 1 as well.",
    ),
    _equation_term(
        "eq10.coupling12",
        "[L₁ d₂ + L_L L₂] cos(θ₁ − θ₂) θ̈₂",
        "(L1*d2 + L1*L2)*cos(th1 - th2)*ddth2",
        "(m2*d2 + m3*L2)*L1*cos(th1 - th2)*ddth2",
        "Both masses are missing. L_L, which is never defined, is read as L₁.",
        mirror_id="eq11.coupling12",
    ),
    _equation_term(
        "eq10.coupling13",
        "L₁ d₃ cos(θ₁ − θ₃) θ̈₃",
        "L1*d3*cos(th1 - th3)*ddth3",
        "m3*L1*d3*cos(th1 - th3)*ddth3",
        "The mass m₃ is missing.",
        mirror_id="eq12.coupling13",
    ),
    _equation_term(
        "eq10.velocity12",
        "−[L₂ d₂ + L₁ L₂] sin(θ₁ − θ₂)(θ̇₁ − θ̇₂) θ̇₂",
        "-(L2*d2 + L1*L2)*sin(th1 - th2)*(dth1 - dth2)*dth2",
        "(m2*d2 + m3*L2)*L1*sin(th1 - th2)*dth2**2",
        "L₂ d₂ replaces L₁ d₂, both masses are missing, and −∂L/∂θ₁ (a term with θ̇₁ θ̇₂) is missing. "
        "With the missing term the products of speeds cancel.",
    ),
    _equation_term(
        "eq10.velocity13",
        "(not printed)",
        "0*m3*L1*d3*dth3**2",
        "m3*L1*d3*sin(th1 - th3)*dth3**2",
        "All terms with sin(θ₁ − θ₃) are missing.",
    ),
    _equation_term(
        "eq10.gravity",
        "−[a d₁ + m₂ L₁ + m₃ L₃] g cos θ₁",
        "-(m1*d1 + m2*L1 + m3*L3)*g*cos(th1)",
        "(m1*d1 + (m2 + m3)*L1)*g*cos(th1)",
        "The sign is wrong (the torque must hold the finger up, as in Eq. 11 and 12), L₃ replaces L₁, and a, never "
        "defined, is read as m₁.",
    ),
)
_COUPLING_FACTOR_12 = "(m2*d2 + m3*L2)*L1*sin(th1 - th2)"
TORQUE_TERMS_2 = (
    _equation_term(
        "eq11.inertia",
        "[I₂ + m₂ d₂² + m₃ L₂²] θ̈₂",
        "(I2 + m2*d2**2 + m3*L2**2)*ddth2",
        "(I2 + m2*d2**2 + m3*L2**2)*ddth2",
    ),
    _equation_term(
        "eq11.coupling12",
        "[m₂ d₂ + m₃ L₂] L₁ cos(θ₁ − θ₂) θ̈₁",
        "(m2*d2 + m3*L2)*L1*cos(th1 - th2)*ddth1",
        "(m2*d2 + m3*L2)*L1*cos(th1 - th2)*ddth1",
        mirror_id="eq10.coupling12",
    ),
    _equation_term(
        "eq11.coupling23",
        "m₃ L₂ d₂ cos(θ₂ − θ₃) θ̈₃",
        "m3*L2*d2*cos(th2 - th3)*ddth3",
        "m3*L2*d3*cos(th2 - th3)*ddth3",
        "d₂ replaces d₃, as in Eq. 5. Eq. 12 is correct here.",
        mirror_id="eq12.coupling23",
    ),
    _equation_term(
        "eq11.velocity12",
        "[m₂ d₂ + m₃ L₂] L₁ sin(θ₁ − θ₂)(θ̇₁ − θ̇₂) θ̇₁ + [m₂ d₂ + m₃ L₂] L₁ sin(θ₁ − θ₂) θ̇₁ θ̇₂",
        (
            f"{_COUPLING_FACTOR_12}*(dth1 - dth2)*dth1 + {_COUPLING_FACTOR_12}*dth1*dth2",
            f"-{_COUPLING_FACTOR_12}*(dth1 - dth2)*dth1 + {_COUPLING_FACTOR_12}*dth1*dth2",
        ),
        "-(m2*d2 + m3*L2)*L1*sin(th1 - th2)*dth1**2",
        "The operator before the first bracket is missing, and the sign before the second bracket is wrong. If the "
        "operator is a plus, the whole term has the wrong sign. If it is a minus, the products of speeds add up "
        "instead of cancelling.",
    ),
    _equation_term(
        "eq11.velocity23",
        "−m₃ L₂ d₃ sin(θ₂ − θ₃)(θ̇₂ − θ̇₃) θ̇₃ + L₂ d₃ sin(θ₂ − θ₃) θ̇₂ θ̇₃",
        "-m3*L2*d3*sin(th2 - th3)*(dth2 - dth3)*dth3 + L2*d3*sin(th2 - th3)*dth2*dth3",
        "m3*L2*d3*sin(th2 - th3)*dth3**2",
        "The mass m₃ is missing in the second part.",
    ),
    _equation_term(
        "eq11.gravity",
        "[m₂ d₂ + m₃ L₂] g cos θ₂",
        "(m2*d2 + m3*L2)*g*cos(th2)",
        "(m2*d2 + m3*L2)*g*cos(th2)",
    ),
)
TORQUE_TERMS_3 = (
    _equation_term(
        "eq12.inertia", "[I₃ + m₃ d₃²] θ̈₃", "(I3 + m3*d3**2)*ddth3", "(I3 + m3*d3**2)*ddth3"
    ),
    _equation_term(
        "eq12.coupling23",
        "[m₃ L₂ d₃ cos(θ₂ − θ₃)] θ̈₂",
        "m3*L2*d3*cos(th2 - th3)*ddth2",
        "m3*L2*d3*cos(th2 - th3)*ddth2",
        mirror_id="eq11.coupling23",
    ),
    _equation_term(
        "eq12.coupling13",
        "m₃ L₁ d₃ cos(θ₁ − θ₃)] θ̈₁",
        "m3*L1*d3*cos(th1 - th3)*ddth1",
        "m3*L1*d3*cos(th1 - th3)*ddth1",
        mirror_id="eq10.coupling13",
    ),
    _equation_term(
        "eq12.velocity23",
        "−[m₃ L₂ d₃ sin(θ₂ − θ₃)(θ̇₂ − θ̇₃) θ̇₂ .. + L₂ d₃ sin(θ₂ − θ₃) θ̇₂ θ̇₃",
        (
            "-(m3*L2*d3*sin(th2 - th3)*(dth2 - dth3)*dth2 + L2*d3*sin(th2 - th3)*dth2*dth3)",
            "-m3*L2*d3*sin(th2 - th3)*(dth2 - dth3)*dth2 + L2*d3*sin(th2 - th3)*dth2*dth3",
        ),
        "-m3*L2*d3*sin(th2 - th3)*dth2**2",
        "The mass m₃ is missing in the second part, and the bracket never closes, so it is unclear whether the "
        "minus also applies to the second part.",
    ),
    _equation_term(
        "eq12.velocity13",
        "−[ .. + m₃ L₁ d₃ sin(θ₁ − θ₃) θ̇₁ θ̇₃",
        ("-m3*L1*d3*sin(th1 - th3)*dth1*dth3", "m3*L1*d3*sin(th1 - th3)*dth1*dth3"),
        "-m3*L1*d3*sin(th1 - th3)*dth1**2",
        "−m₃ L₁ d₃ sin(θ₁ − θ₃)(θ̇₁ − θ̇₃) θ̇₁ is missing. With this term the products of speeds cancel.",
    ),
    _equation_term(
        "eq12.gravity",
        "−[ .. + + m₃ d₃ g cos θ₃",
        ("m3*d3*g*cos(th3)", "-m3*d3*g*cos(th3)"),
        "m3*d3*g*cos(th3)",
        "The print has two plus signs, and a bracket that never closes. Without the bracket the term is right. Within "
        "−[ ] its sign is wrong, and the torque would pull the finger down.",
    ),
)
KINETIC_TERMS = KINETIC_TERMS_1 + KINETIC_TERMS_2 + KINETIC_TERMS_3
TORQUE_TERMS = (TORQUE_TERMS_1, TORQUE_TERMS_2, TORQUE_TERMS_3)
