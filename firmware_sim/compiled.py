"""Laws of the simulator as machine code, for those who step a plant without waiting for a clock.

A law is a plain function; ``compiled`` notes the types of its arguments. ``machine_code`` makes the compiled twins of a
module's laws, and only then is numba imported: that takes the better part of a second, too long for a simulator that
starts as a process of its own. Operations keep their order and their rounding (no fast math): both do the same to the
bit. The code is kept in numba's cache; since the cache of a file does not notice changes in others, laws that call one
another belong into one file.
"""

import ctypes
import hashlib
import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any, TypeAlias, TypeVar

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

Argument: TypeAlias = "str | type[ctypes.Structure] | np.dtype[Any]"

_LAWS: dict[str, dict[str, tuple[Argument, ...] | None]] = {}
"""Module to its laws and the types of their arguments; None for those that only other laws call."""


def compiled(*arguments: Argument) -> Callable[[F], F]:
    """Let a function be a law.

    Args:
        arguments: the type of each: real, count, flag, address, vector (of reals), counts; or a ``ctypes.Structure``
            or a structured dtype for an array of such rows.
    """

    def note(function: F) -> F:
        _LAWS.setdefault(function.__module__, {})[function.__name__] = arguments
        return function

    return note


def inner(function: F) -> F:
    """Let a function be a law for other laws only."""
    _LAWS.setdefault(function.__module__, {})[function.__name__] = None
    return function


def call(function: int, first: int, second: int) -> None:
    """Call a C function ``void f(void *, void *)``, all three by their addresses.

    Raises:
        NotImplementedError: always, in plain laws: in compiled ones ``_intrinsic`` stands for it.
    """
    raise NotImplementedError("an address can be called in compiled laws only")


def rows_at(address: int, count: int, kind: Any) -> Any:
    """Return the array of so many numbers or rows, of a dtype, at an address; it costs nothing, an argument 0.2 us.

    Raises:
        NotImplementedError: always, in plain laws: in compiled ones ``_rows_at`` stands for it.
    """
    raise NotImplementedError("rows at an address can be had in compiled laws only")


@cache
def machine_code(module: ModuleType) -> Any:
    """Return the compiled laws of a module by their names; division by zero gives inf or NaN, as in numpy."""
    from numba import njit

    names = dict(vars(module), call=_intrinsic(), rows_at=_rows_at())
    foreign = _foreign(module)
    for name, home in foreign.items():
        names[name] = getattr(machine_code(home), vars(module)[name].__name__)
    digest = _digest(set(foreign.values()))
    for name, arguments in _LAWS[module.__name__].items():
        law = FunctionType(vars(module)[name].__code__, names, name)  # calls the twins, not the plain laws
        law.__qualname__ = f"{name}{digest}"
        if arguments is None:
            names[name] = njit(error_model="numpy")(law)
        else:
            names[name] = _kept(tuple(map(_type, arguments)), law)
    return SimpleNamespace(**{name: names[name] for name in _LAWS[module.__name__]})


def _foreign(module: ModuleType) -> dict[str, ModuleType]:
    """Return the laws of other modules that a module has imported, each with its module."""
    found = {}
    for name, value in vars(module).items():
        home = value.__module__ if isinstance(value, FunctionType) else module.__name__
        if home != module.__name__ and value.__name__ in _LAWS.get(home, {}):
            found[name] = sys.modules[home]
    return found


def _digest(modules: set[ModuleType]) -> str:
    """Return a digest of the sources of modules, and of those whose laws they import; empty for none."""
    every, new = set(modules), set(modules)
    while new:
        new = {home for module in new for home in _foreign(module).values()} - every
        every |= new
    sources = [Path(str(module.__file__)).read_bytes() for module in sorted(every, key=lambda one: one.__name__)]
    return "_" + hashlib.sha256(b"".join(sources)).hexdigest()[:12] if sources else ""


def _kept(arguments: tuple[Any, ...], law: FunctionType) -> Any:
    """Compile a law, and keep its code for the next process where there is a folder that can be written."""
    from numba import njit

    try:
        return njit(arguments, cache=True, error_model="numpy")(law)
    except RuntimeError:  # numba finds no such folder, neither beside the source nor the user's own
        return njit(arguments, error_model="numpy")(law)


def use(module: ModuleType) -> None:
    """Have the compiled laws of a module used by everybody in this process who calls them through the module.

    Laws for other laws only stay plain: they take objects as well as rows.
    """
    twins = machine_code(module)
    for name, arguments in _LAWS[module.__name__].items():
        if arguments is not None:
            setattr(module, name, getattr(twins, name))


def _type(name: Argument) -> Any:
    """Numba's type of an argument."""
    from numba import from_dtype, types

    if not isinstance(name, str):
        return types.Array(from_dtype(np.dtype(name)), 1, "C")
    real, count = types.float64, types.int64
    if name in ("vector", "counts"):
        return types.Array(real if name == "vector" else count, 1, "C")
    return {"real": real, "count": count, "flag": types.boolean, "address": types.intp}[name]


def _intrinsic() -> Any:
    """What stands for ``call`` in compiled laws.

    An address is an argument, not a constant: code with a constant address could not be kept for the next process.
    """
    from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]  # some releases come without types
    from numba import types
    from numba.extending import intrinsic

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer]).as_pointer()
        target, *values = arguments
        builder.call(builder.inttoptr(target, kind), [builder.inttoptr(value, pointer) for value in values])
        return context.get_dummy_value()

    def typed(typing: Any, function: Any, first: Any, second: Any) -> Any:
        return types.void(types.intp, types.intp, types.intp), code

    return intrinsic(typed)


def _rows_at() -> Any:
    """What stands for ``rows_at`` in compiled laws."""
    from numba import carray, njit, types  # type: ignore[attr-defined, unused-ignore]
    from numba.extending import intrinsic

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

    pointer: Any = intrinsic(lambda typing, address: (types.voidptr(types.intp), code))

    @njit
    def rows_at(address: Any, count: Any, kind: Any) -> Any:
        return carray(pointer(address), (count,), kind)

    return rows_at


def addresses(arrays: Iterable[Any]) -> list[int]:
    """Return address and length of each array, for ``rows_at``; the arrays must live as long as these are used."""
    return [number for array in arrays for number in (array.ctypes.data, len(array))]


def array_of(memory: Any, structure: type[ctypes.Structure]) -> Any:
    """Return the memory of many structures as an array of rows."""
    return np.frombuffer(memory, np.dtype(structure)) if ctypes.sizeof(memory) else np.empty(0, np.dtype(structure))
