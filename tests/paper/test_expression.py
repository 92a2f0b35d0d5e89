"""Test formulas that handctl parses from a text.

The tests check the value, the physical dimension and the typesetting of each formula.
"""

import numpy as np
import pytest
import sympy

from handctl.paper.model import equations
from handctl.paper.model.expression import DimensionError, Expression, dimension_text, typeset_name
from handctl.paper.model.lagrange import ENERGY_DIMENSION, SYMBOL_DIMENSIONS, random_states

EQUATION_TERMS = [
    *equations.KINETIC_TERMS,
    *equations.POTENTIAL_TERMS,
    *sum(equations.TORQUE_TERMS, ()),
]
FORMULA_TEXTS = sorted(
    {
        expression.text
        for term in EQUATION_TERMS
        for expression in (*term.readings, term.correct_form)
    }
)


@pytest.mark.parametrize("formula_text", FORMULA_TEXTS)
def test_values_equal_those_of_sympy(formula_text: str) -> None:
    states, expression = random_states(), Expression(formula_text)
    names = sorted(expression.quantity_names)
    sympy_function = sympy.lambdify(
        [sympy.Symbol(name) for name in names], sympy.sympify(formula_text), "numpy"
    )
    assert expression.evaluate(states) == pytest.approx(
        sympy_function(*(states[name] for name in names)), rel=1e-12, abs=1e-12
    )


@pytest.mark.parametrize("equation_term", EQUATION_TERMS, ids=lambda term: term.id)
def test_right_terms_are_energies_or_torques(equation_term: equations.EquationTerm) -> None:
    assert equation_term.correct_form.dimension(SYMBOL_DIMENSIONS) == ENERGY_DIMENSION


@pytest.mark.parametrize("formula_text", ["m1 + d1", "sin(d1)", "m1*d1 - g"])
def test_an_inconsistent_expression_has_no_dimension(formula_text: str) -> None:
    with pytest.raises(DimensionError):
        Expression(formula_text).dimension(SYMBOL_DIMENSIONS)


def test_dimensions_multiply_and_divide() -> None:
    assert Expression("m1*g*d1/I1").dimension(SYMBOL_DIMENSIONS) == (0, 0, -2)
    assert dimension_text((1, 2, -2)) == "kg m² s⁻²"
    assert dimension_text((0, 0, 0)) == "1"


@pytest.mark.parametrize(
    ("formula_text", "typeset_text"),
    [
        ("-(m2*d2 + m3*L2)*L1*sin(th1 - th2)*dth1**2", "−(m₂ d₂ + m₃ L₂) L₁ sin(θ₁ − θ₂) θ̇₁²"),
        ("I1*dth1**2/2", "I₁ θ̇₁²/2"),
        ("a - (b - c)", "a − (b − c)"),
        ("cos(theta)*ddth3", "cos θ θ̈₃"),
        ("pi*d**2/4", "π d²/4"),
        ("-a", "−a"),
    ],
)
def test_expression_is_typeset_as_expected(formula_text: str, typeset_text: str) -> None:
    assert Expression(formula_text).as_typeset_text() == typeset_text


def test_names_are_found_and_other_code_is_refused() -> None:
    assert typeset_name("L_L") == "L_L"
    assert Expression("sin(th1)*pi*m2").quantity_names == {"th1", "m2"}
    for text in ("__import__('os')", "a if b else c", "[1]"):
        with pytest.raises((ValueError, KeyError)):
            Expression(text).evaluate({"a": 1.0})
    assert np.allclose(Expression("2*x").evaluate({"x": np.ones(3)}), 2.0)
