"""Formulas as text: evaluated on numbers or arrays, checked for dimensions, and written for people.

The same text is what the tests give to sympy, so that what is proven is what is printed.
"""

import ast
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Dimension = tuple[int, int, int]
"""Powers of kilogram, metre and second."""
NONE: Dimension = (0, 0, 0)


class DimensionError(Exception):
    """Two things are added, or an angle is taken of something, whose dimensions do not allow it."""


@dataclass(frozen=True, slots=True)
class Expression:
    """A formula of names, numbers, ``+ - * / **``, ``sin``, ``cos`` and ``pi``.

    Attributes:
        text: in Python's notation; ``th1``, ``dth1``, ``ddth1`` are an angle and its derivatives.
    """

    text: str

    @property
    def tree(self) -> ast.expr:
        """Its syntax tree."""
        return ast.parse(self.text, mode="eval").body

    @property
    def names(self) -> frozenset[str]:
        """Names that occur in it, functions left out."""
        found = {node.id for node in ast.walk(self.tree) if isinstance(node, ast.Name)}
        return frozenset(found - FUNCTIONS.keys() - {"pi"})

    def value(self, values: Mapping[str, Any]) -> Any:
        """Its value; arrays are taken element by element.

        Raises:
            KeyError: a name has no value.
        """
        return _value(self.tree, values)

    def dimension(self, dimensions: Mapping[str, Dimension]) -> Dimension:
        """Its dimension.

        Raises:
            DimensionError: it has none.
        """
        return _dimension(self.tree, dimensions)

    def pretty(self) -> str:
        """For people: θ̇₁² and products without signs."""
        return _pretty(self.tree)[0]


FUNCTIONS: dict[str, Callable[[Any], Any]] = {"sin": np.sin, "cos": np.cos}


def _value(node: ast.expr, values: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=int() | float() as number):
            return number
        case ast.Name(id="pi"):
            return math.pi
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_value(inner, values)
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATIONS[type(op)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=[inner]):
            return FUNCTIONS[name](_value(inner, values))
    raise ValueError(f"not a formula: {ast.unparse(node)}")


_OPERATIONS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}


def _dimension(node: ast.expr, known: Mapping[str, Dimension]) -> Dimension:
    match node:
        case ast.Constant() | ast.Name(id="pi"):
            return NONE
        case ast.Name(id=name):
            return known[name]
        case ast.UnaryOp(operand=inner):
            return _dimension(inner, known)
        case ast.Call(args=[inner]):
            if _dimension(inner, known) != NONE:
                raise DimensionError(f"{ast.unparse(node)}: not an angle")
            return NONE
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)):
            kg, m, s = _dimension(left, known)
            return (kg * power, m * power, s * power)
        case ast.BinOp(left=left, op=op, right=right):
            return _combined(node, op, _dimension(left, known), _dimension(right, known))
    raise ValueError(f"not a formula: {ast.unparse(node)}")


def _combined(node: ast.expr, op: ast.operator, one: Dimension, other: Dimension) -> Dimension:
    if isinstance(op, ast.Add | ast.Sub):
        if one != other:
            raise DimensionError(f"{ast.unparse(node)}: {shown(one)} and {shown(other)}")
        return one
    sign = -1 if isinstance(op, ast.Div) else 1
    return (one[0] + sign * other[0], one[1] + sign * other[1], one[2] + sign * other[2])


def shown(dimension: Dimension) -> str:
    """A dimension as text, e.g. kg m² s⁻²."""
    units = zip(("kg", "m", "s"), dimension, strict=True)
    parts = [unit + ("" if power == 1 else str(power).translate(_RAISED)) for unit, power in units if power]
    return " ".join(parts) or "1"


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_SUM, _PRODUCT, _POWER = 1, 2, 3


def _pretty(node: ast.expr) -> tuple[str, int]:
    """Text and how strongly it binds."""
    match node:
        case ast.Constant(value=value):
            return f"{value:g}" if isinstance(value, int | float) else str(value), _POWER
        case ast.Name(id=name):
            return pretty_name(name), _POWER
        case ast.UnaryOp(operand=inner):
            return "−" + _bound(inner, _PRODUCT), _SUM
        case ast.Call(func=ast.Name(id=name), args=[inner]):
            text, strength = _pretty(inner)
            return (f"{name} {text}" if strength == _POWER else f"{name}({text})"), _PRODUCT
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=power)):
            return _bound(left, _POWER) + str(power).translate(_RAISED), _POWER
        case ast.BinOp(op=ast.Mult() | ast.Div()) if (positive := _without_minus(node)) is not node:
            return "−" + _pretty(positive)[0], _SUM
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return f"{_bound(left, _PRODUCT)}/{_bound(right, _POWER)}", _PRODUCT
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return f"{_bound(left, _PRODUCT)} {_bound(right, _PRODUCT)}", _PRODUCT
        case ast.BinOp(left=left, op=op, right=right):
            sign = "+" if isinstance(op, ast.Add) else "−"
            return f"{_bound(left, _SUM)} {sign} {_bound(right, _SUM if sign == '+' else _PRODUCT)}", _SUM
    raise ValueError(f"not a formula: {ast.unparse(node)}")


def _without_minus(node: ast.expr) -> ast.expr:
    """A product without the minus of its first factor; the node itself if there is none."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return inner
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            first = _without_minus(left)
            return node if first is left else ast.BinOp(first, op, right)
    return node


def _bound(node: ast.expr, least: int) -> str:
    text, strength = _pretty(node)
    return text if strength >= least else f"({text})"


def pretty_name(name: str) -> str:
    """A name as physicists write it: ddth1 is θ̈₁, L1 is L₁."""
    found = re.fullmatch(r"(d{0,2})th(\d)", name)
    if found:
        dots = ("θ", "θ̇", "θ̈")[len(found[1])]
        return dots + found[2].translate(_LOWERED)
    greek = {"pi": "π", "theta": "θ", "L_L": "L_L", "mu": "μ", "sigma": "σ"}
    return greek.get(name) or re.sub(r"\d+$", lambda number: number[0].translate(_LOWERED), name)
