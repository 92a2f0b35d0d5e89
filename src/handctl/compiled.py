"""Compiles the functions that run for every tendon, motor or joint in every tick.

Such a kernel is a plain function of arrays and numbers. It is written with loops and ``math``, as a reader would write
it, and exists once. ``NUMBA_DISABLE_JIT=1`` runs the same function interpreted. Operations keep their order and their
rounding (no ``fastmath``), so that both give the same numbers to the last bit.

``prepare`` compiles all kernels before a hand is armed. The code is kept in numba's cache, beside the source or in the
user's own folder, and the next process loads it from there. Where no folder can be written, each process compiles anew.
One compilation serves every hand: a kernel's arguments have fixed types, whatever their sizes. The cache notices a
change of a kernel's own file only. So a kernel reads no constant that another file decides, it takes it as an argument,
and of the inner functions of other files it calls ``square`` alone.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit, types

F = TypeVar("F", bound=Callable[..., Any])

_KERNELS: dict[str, tuple[Any, tuple[Any, ...]]] = {}
"""Name of each kernel to its dispatcher and the types of its arguments."""
MARKED: list[Callable[..., Any]] = []
"""Every function that is compiled, as it is written."""
_TYPES = {
    "real": types.float64,
    "count": types.int64,
    "vector": types.Array(types.float64, 1, "A", readonly=True),
    "matrix": types.Array(types.float64, 2, "A", readonly=True),
    "cube": types.Array(types.float64, 3, "A", readonly=True),
    "flags": types.Array(types.boolean, 1, "A", readonly=True),
    "counts": types.Array(types.int64, 1, "A", readonly=True),
    "shorts": types.Array(types.int16, 2, "A", readonly=True),
}


def kernel(*arguments: str) -> Callable[[F], F]:
    """Mark a function as a kernel.

    Args:
        arguments: the type of each: real, count; vector, matrix, cube (of reals), flags, counts (one axis each),
            shorts (two axes). A kernel may read its arguments and returns new arrays.
    """

    def mark(function: F) -> F:
        dispatcher = inner(function)
        _KERNELS[f"{function.__module__}.{function.__name__}"] = dispatcher, tuple(_TYPES[name] for name in arguments)
        return dispatcher

    return mark


def inner(function: F) -> F:
    """Mark a function that only kernels call."""
    MARKED.append(function)
    try:
        dispatcher: Any = njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # numba finds no folder that can be written, neither beside the source nor the user's own
        dispatcher = njit(error_model="numpy")(function)
    return cast(F, dispatcher)


@inner
def square(value: float) -> float:
    """Return the square of a number, by a product: ``**`` is a power for the interpreter, which rounds otherwise."""
    return value * value


def prepare(told: Callable[[int, int], None] | None = None) -> None:
    """Compile every kernel that has been imported, or load its code; afterwards none compiles in a tick.

    Args:
        told: called before each with the number that are ready and the number of all.
    """
    waiting = [(code, types_) for code, types_ in _KERNELS.values() if not getattr(code, "signatures", True)]
    for done, (code, types_) in enumerate(waiting):
        if told:
            told(done, len(waiting))
        code.compile(types_)
        code.disable_compile()
