"""Functions of small arrays as machine code: numpy pays for every operation, a compiled loop once for all of them.

Types are declared, so that everything is compiled while its module is imported, and read from numba's cache at the next
start: a tick never waits for a compiler. Operations keep their order and their rounding (no fast math), so the results
are those of the same lines run by Python, which is what ``NUMBA_DISABLE_JIT=1`` does.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit, types

F = TypeVar("F", bound=Callable[..., Any])

REAL = types.float64
COUNT = types.int64
FLAG = types.boolean
VECTOR = types.Array(types.float64, 1, "A", readonly=True)
MATRIX = types.Array(types.float64, 2, "A", readonly=True)
STACK = types.Array(types.float64, 3, "A", readonly=True)
COUNTS = types.Array(types.int64, 1, "A", readonly=True)
FLAGS = types.Array(types.boolean, 1, "A", readonly=True)
"""Arguments: any array of the kind, whatever its strides, and none that is written to."""


def compiled(*arguments: object) -> Callable[[F], F]:
    """Compile a function of these argument types; division by zero gives inf or NaN, as in numpy."""

    def decorate(function: F) -> F:
        return cast(F, njit(arguments, cache=True, error_model="numpy")(function))

    return decorate
