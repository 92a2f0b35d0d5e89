"""What the simulator computes every half millisecond, as machine code: a compiled loop instead of Python's.

Types are declared, so that everything is compiled while its module is imported, and read from numba's cache at the next
start. Operations keep their order and their rounding (no fast math): results are those of the same lines run by Python.
The cache of a file does not notice changes in others: functions that call one another belong into one file.
"""

import ctypes
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]
from numba import config, from_dtype, njit, types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

COMPILES = not config.DISABLE_JIT  # type: ignore[attr-defined, unused-ignore]
"""Whether anything is compiled; with ``NUMBA_DISABLE_JIT=1`` Python runs the same lines."""
REAL = types.float64
COUNT = types.int64
ADDRESS = types.intp
VECTOR = types.Array(types.float64, 1, "C")
COUNTS = types.Array(types.int64, 1, "C")


def rows(structure: type[ctypes.Structure]) -> object:
    """Return the type of an array of such structures."""
    return types.Array(from_dtype(np.dtype(structure)), 1, "C")


def compiled(*arguments: object) -> Callable[[F], F]:
    """Compile a function of these argument types; division by zero gives inf or NaN, as in numpy."""

    def decorate(function: F) -> F:
        return cast(F, njit(arguments, cache=True, error_model="numpy")(function))

    return decorate


def inner(function: F) -> F:
    """Compile a function for the use of compiled functions of the same file."""
    return cast(F, njit(error_model="numpy")(function))


def _call(typing: Any, function: Any, first: Any, second: Any) -> Any:
    """Return type and code of ``call``."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer]).as_pointer()
        target, *values = arguments
        builder.call(builder.inttoptr(target, kind), [builder.inttoptr(value, pointer) for value in values])
        return context.get_dummy_value()

    return types.void(ADDRESS, ADDRESS, ADDRESS), code


call: Any = intrinsic(_call)
"""Calls a C function ``void f(void *, void *)`` from compiled code, all three given by their addresses.

An address is an argument, not a constant: code with a constant address could not be kept for the next process.
"""
