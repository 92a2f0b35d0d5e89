"""Formulas given as text, such as ``L1*cos(th1)``.

A formula can be evaluated with numbers or arrays, checked for dimensions, and typeset. The tests
check the text of each formula with sympy. The documentation page about the paper is typeset from
the same texts, so the page shows exactly the checked formulas.
"""

import ast
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Dimension = tuple[int, int, int]
"""Exponents of kilogram, metre and second in the unit of a quantity."""
DIMENSIONLESS: Dimension = (0, 0, 0)


class DimensionError(Exception):
    """Error about a sum of quantities with different dimensions, or about a function argument that is not an angle."""


@dataclass(frozen=True, slots=True)
class Expression:
    """Formula that consists of names, numbers, `+ - * / **`, `sin`, `cos` and `pi`.

    Attributes:
        text: formula in Python's notation. The names `th1`, `dth1` and `ddth1` stand for an angle
            and for its first and second derivative with respect to time.
    """

    text: str

    @property
    def syntax_tree(self) -> ast.expr:
        """Return the syntax tree of the formula."""
        return ast.parse(self.text, mode="eval").body

    @property
    def quantity_names(self) -> frozenset[str]:
        """Return the names of the quantities in the formula, without the names of functions."""
        names = {node.id for node in ast.walk(self.syntax_tree) if isinstance(node, ast.Name)}
        return frozenset(names - FUNCTION_BY_NAME.keys() - {"pi"})

    def evaluate(self, values_by_symbol: Mapping[str, Any]) -> Any:
        """Return the value of the formula for given values of the names in the formula.

        If the values are arrays, the formula is evaluated element by element.

        Raises:
            KeyError: no value is given for a name.
        """
        return _value_of_node(self.syntax_tree, values_by_symbol)

    def dimension(self, dimension_of_symbol: Mapping[str, Dimension]) -> Dimension:
        """Return the physical dimension of the formula.

        Raises:
            DimensionError: the formula has no consistent dimension.
        """
        return _dimension_of_node(self.syntax_tree, dimension_of_symbol)

    def as_typeset_text(self) -> str:
        """Return the formula as text with mathematical symbols and without multiplication signs, for example θ̇₁²."""
        return _typeset_text(self.syntax_tree)[0]


FUNCTION_BY_NAME: dict[str, Callable[[Any], Any]] = {"sin": np.sin, "cos": np.cos}
"""Functions that are allowed in a formula."""


def _value_of_node(formula_node: ast.expr, values_by_symbol: Mapping[str, Any]) -> Any:
    """Return the value of a node of the syntax tree."""
    match formula_node:
        case ast.Constant(value=int() | float() as number):
            return number
        case ast.Name(id="pi"):
            return math.pi
        case ast.Name(id=name):
            return values_by_symbol[name]
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_value_of_node(inner, values_by_symbol)
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATION_BY_NODE[type(op)](
                _value_of_node(left, values_by_symbol), _value_of_node(right, values_by_symbol)
            )
        case ast.Call(func=ast.Name(id=name), args=[inner]):
            return FUNCTION_BY_NAME[name](_value_of_node(inner, values_by_symbol))
    raise ValueError(f"not a formula: {ast.unparse(formula_node)}")


_OPERATION_BY_NODE: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}


def _dimension_of_node(
    formula_node: ast.expr, dimension_of_symbol: Mapping[str, Dimension]
) -> Dimension:
    """Return the physical dimension of a node of the syntax tree."""
    match formula_node:
        case ast.Constant() | ast.Name(id="pi"):
            return DIMENSIONLESS
        case ast.Name(id=name):
            return dimension_of_symbol[name]
        case ast.UnaryOp(operand=inner):
            return _dimension_of_node(inner, dimension_of_symbol)
        case ast.Call(args=[inner]):
            if _dimension_of_node(inner, dimension_of_symbol) != DIMENSIONLESS:
                raise DimensionError(f"{ast.unparse(formula_node)}: not an angle")
            return DIMENSIONLESS
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)):
            # For a power, the exponents of the units are multiplied by the exponent of the power.
            kg, m, s = _dimension_of_node(left, dimension_of_symbol)
            return (kg * power, m * power, s * power)
        case ast.BinOp(left=left, op=op, right=right):
            return _combined_dimension(
                formula_node,
                op,
                _dimension_of_node(left, dimension_of_symbol),
                _dimension_of_node(right, dimension_of_symbol),
            )
    raise ValueError(f"not a formula: {ast.unparse(formula_node)}")


def _combined_dimension(
    formula_node: ast.expr, op: ast.operator, left_dimension: Dimension, right_dimension: Dimension
) -> Dimension:
    """Return the physical dimension of a sum, product or quotient."""
    if isinstance(op, ast.Add | ast.Sub):
        if left_dimension != right_dimension:
            raise DimensionError(
                f"{ast.unparse(formula_node)}: {dimension_text(left_dimension)} and {dimension_text(right_dimension)}"
            )
        return left_dimension
    # For a product, the exponents of the units are added. For a quotient, the exponents of the
    # units are subtracted.
    sign = -1 if isinstance(op, ast.Div) else 1
    return (
        left_dimension[0] + sign * right_dimension[0],
        left_dimension[1] + sign * right_dimension[1],
        left_dimension[2] + sign * right_dimension[2],
    )


def dimension_text(dimension: Dimension) -> str:
    """Return a dimension as text, e.g. kg m² s⁻²."""
    units = zip(("kg", "m", "s"), dimension, strict=True)
    unit_powers = [
        unit + ("" if power == 1 else str(power).translate(_SUPERSCRIPT_TABLE))
        for unit, power in units
        if power
    ]
    return " ".join(unit_powers) or "1"


_SUPERSCRIPT_TABLE = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_SUBSCRIPT_TABLE = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_SUM_PRECEDENCE = 1
_PRODUCT_PRECEDENCE = 2
_POWER_PRECEDENCE = 3


def _typeset_text(formula_node: ast.expr) -> tuple[str, int]:
    """Return a node of the syntax tree as text, and the precedence of the operator in this node."""
    match formula_node:
        case ast.Constant(value=value):
            return f"{value:g}" if isinstance(value, int | float) else str(value), _POWER_PRECEDENCE
        case ast.Name(id=name):
            return typeset_name(name), _POWER_PRECEDENCE
        case ast.UnaryOp(operand=inner):
            return "−" + _text_in_brackets(inner, _PRODUCT_PRECEDENCE), _SUM_PRECEDENCE
        case ast.Call(func=ast.Name(id=name), args=[inner]):
            text, precedence_of_argument = _typeset_text(inner)
            return (
                f"{name} {text}"
                if precedence_of_argument == _POWER_PRECEDENCE
                else f"{name}({text})"
            ), _PRODUCT_PRECEDENCE
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=power)):
            return _text_in_brackets(left, _POWER_PRECEDENCE) + str(power).translate(
                _SUPERSCRIPT_TABLE
            ), _POWER_PRECEDENCE
        # If the first factor of a product has a minus sign, this sign is written before the whole
        # product.
        case ast.BinOp(op=ast.Mult() | ast.Div()) if (
            positive := _node_without_minus(formula_node)
        ) is not formula_node:
            return "−" + _typeset_text(positive)[0], _SUM_PRECEDENCE
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return (
                f"{_text_in_brackets(left, _PRODUCT_PRECEDENCE)}/{_text_in_brackets(right, _POWER_PRECEDENCE)}",
                _PRODUCT_PRECEDENCE,
            )
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return (
                f"{_text_in_brackets(left, _PRODUCT_PRECEDENCE)} {_text_in_brackets(right, _PRODUCT_PRECEDENCE)}",
                _PRODUCT_PRECEDENCE,
            )
        case ast.BinOp(left=left, op=op, right=right):
            sign = "+" if isinstance(op, ast.Add) else "−"
            precedence = _SUM_PRECEDENCE if sign == "+" else _PRODUCT_PRECEDENCE
            return (
                f"{_text_in_brackets(left, _SUM_PRECEDENCE)} {sign} {_text_in_brackets(right, precedence)}",
                _SUM_PRECEDENCE,
            )
    raise ValueError(f"not a formula: {ast.unparse(formula_node)}")


def _node_without_minus(formula_node: ast.expr) -> ast.expr:
    """Return a product without the minus sign of its first factor.

    If there is no minus sign, the node is returned unchanged.
    """
    match formula_node:
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return inner
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            first_node = _node_without_minus(left)
            return formula_node if first_node is left else ast.BinOp(first_node, op, right)
    return formula_node


def _text_in_brackets(formula_node: ast.expr, min_precedence: int) -> str:
    """Return a node of the syntax tree as text.

    If the operator of the node has a lower precedence than required, add brackets.
    """
    text, precedence = _typeset_text(formula_node)
    return text if precedence >= min_precedence else f"({text})"


def typeset_name(name: str) -> str:
    """Return a name in the notation of mathematics.

    For example, ddth1 becomes θ̈₁, and L1 becomes L₁.
    """
    match = re.fullmatch(r"(d{0,2})th(\d)", name)
    if match:
        theta_with_dots = ("θ", "θ̇", "θ̈")[len(match[1])]
        return theta_with_dots + match[2].translate(_SUBSCRIPT_TABLE)
    greek_letters = {"pi": "π", "theta": "θ", "L_L": "L_L", "mu": "μ", "sigma": "σ"}
    return greek_letters.get(name) or re.sub(
        r"\d+$", lambda number: number[0].translate(_SUBSCRIPT_TABLE), name
    )
