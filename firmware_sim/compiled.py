"""Kernels: plain functions that numba can compile.

Programs that advance a plant without waiting for a clock use the compiled kernels.

``compiled`` registers the argument types of a kernel. ``compile_module_kernels`` compiles the
kernels of a module. Only the function ``compile_module_kernels`` imports numba. The import takes
almost a second, which is too long for a simulator in a separate process. A compiled kernel and the
same kernel in Python return the same bits, because compilation keeps the order and the rounding of
all operations (no fast math).

For each source file, numba stores the compiled code in a cache. numba renews the cached code of a
source file only if this source file changes. Therefore kernels that call each other must be in the
same file. If the called kernels are in other files, the name of the calling kernel must contain a
digest of these files.
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

ArgumentType: TypeAlias = "str | type[ctypes.Structure] | np.dtype[Any]"
"""Type of an argument of a kernel, see ``compiled``."""

_KERNEL_ARGUMENTS: dict[str, dict[str, tuple[ArgumentType, ...] | None]] = {}
"""Argument types of each kernel, by module and kernel name.

For a kernel that only other kernels call, the entry is None.
"""


def compiled(*arguments: ArgumentType) -> Callable[[F], F]:
    """Register a function as a kernel.

    Args:
        arguments: type of each argument: real, count, flag, address, vector (of reals) or counts. A
            ``ctypes.Structure`` or a structured dtype stands for an array whose rows have the given
            type.
    """

    def register_kernel(function: F) -> F:
        _KERNEL_ARGUMENTS.setdefault(function.__module__, {})[function.__name__] = arguments
        return function

    return register_kernel


def kernel_helper(function: F) -> F:
    """Register a function as a kernel that is called only by other kernels."""
    _KERNEL_ARGUMENTS.setdefault(function.__module__, {})[function.__name__] = None
    return function


def call_c_function(function: int, first_argument: int, second_argument: int) -> None:
    """Call a C function with the signature ``void f(void *, void *)``.

    The C function and both arguments are given as memory addresses.

    Raises:
        NotImplementedError: always, if Python calls this function. Compiled kernels call the
            compiled form that ``_build_c_call`` builds.
    """
    raise NotImplementedError("only compiled kernels can call an address")


def array_at(address: int, row_count: int, row_type: Any) -> Any:
    """Return the memory at an address as an array of ``row_count`` numbers or rows.

    A kernel that calls ``array_at`` gets the array without a cost in computing time. An array that
    Python code passes to a kernel as an argument costs 0.2 us per call.

    Args:
        address: address of the first row.
        row_count: number of rows.
        row_type: dtype of a number or row.

    Raises:
        NotImplementedError: always when called from Python. Compiled kernels call the compiled form
            that ``_build_array_at`` builds.
    """
    raise NotImplementedError("only compiled kernels can read rows at an address")


@cache
def compile_module_kernels(module: ModuleType) -> Any:
    """Compile the kernels of a module.

    In compiled kernels, a division by zero gives inf or NaN, as in numpy.

    Returns:
        A namespace that contains each compiled kernel under the name of the kernel.
    """
    from numba import njit

    names = dict(vars(module), call_c_function=_build_c_call(), array_at=_build_array_at())
    imported_kernels = _imported_kernels(module)
    for name, owner in imported_kernels.items():
        names[name] = getattr(compile_module_kernels(owner), vars(module)[name].__name__)
    digest = _source_digest(set(imported_kernels.values()))
    for name, arguments in _KERNEL_ARGUMENTS[module.__name__].items():
        kernel = FunctionType(
            vars(module)[name].__code__, names, name
        )  # inside the code compiled below, kernels call compiled kernels instead of Python functions
        # The qualified name of a function is a part of numba's cache key. With the digest in the
        # qualified name, a change in an imported kernel changes the cache key.
        kernel.__qualname__ = f"{name}{digest}"
        if arguments is None:
            names[name] = njit(error_model="numpy")(kernel)
        else:
            names[name] = _compile_kernel(tuple(map(_numba_type, arguments)), kernel)
    return SimpleNamespace(**{name: names[name] for name in _KERNEL_ARGUMENTS[module.__name__]})


def _imported_kernels(module: ModuleType) -> dict[str, ModuleType]:
    """Return the kernels that a module imports from other modules, each with the module that defines the kernel."""
    kernel_by_name = {}
    for name, value in vars(module).items():
        owner = value.__module__ if isinstance(value, FunctionType) else module.__name__
        if owner != module.__name__ and value.__name__ in _KERNEL_ARGUMENTS.get(owner, {}):
            kernel_by_name[name] = sys.modules[owner]
    return kernel_by_name


def _source_digest(modules: set[ModuleType]) -> str:
    """Return a digest of the source code of the given modules.

    The digest also includes the modules from which the given modules import kernels. If no module
    is given, the digest is an empty text.
    """
    known_modules = set(modules)
    new_modules = set(modules)
    while new_modules:
        new_modules = {
            owner for module in new_modules for owner in _imported_kernels(module).values()
        } - known_modules
        known_modules |= new_modules
    sources = [
        Path(str(module.__file__)).read_bytes()
        for module in sorted(known_modules, key=lambda module: module.__name__)
    ]
    return "_" + hashlib.sha256(b"".join(sources)).hexdigest()[:12] if sources else ""


def _compile_kernel(arguments: tuple[Any, ...], kernel: FunctionType) -> Any:
    """Compile a kernel with numba.

    If a cache folder can be written, store the compiled code for the next process.
    """
    from numba import njit

    try:
        return njit(arguments, cache=True, error_model="numpy")(kernel)
    # No cache folder can be written, neither beside the source file nor in the user's home folder.
    except RuntimeError:
        return njit(arguments, error_model="numpy")(kernel)


def code_of_kernel(kernel: Any) -> Any:
    """Return the compiled code of a kernel from ``compile_module_kernels``, for calls from Python.

    In each call of a kernel, numba finds the types of the arguments. For arrays of structures, this
    takes almost 1 us. The compiled code only checks the number of the arguments and the size of an
    array's elements, so the caller must pass contiguous arrays of the registered types. If numba
    compiles nothing (``NUMBA_DISABLE_JIT=1``), the kernel is returned as it is.
    """
    if not hasattr(kernel, "nopython_signatures"):
        return kernel
    (signature,) = kernel.nopython_signatures
    return kernel.get_overload(signature.args)


def use_compiled_kernels(module: ModuleType) -> None:
    """Replace the kernels of a module by their compiled forms, for all callers in this process.

    Functions marked with ``kernel_helper`` stay Python functions, because Python code calls these
    functions with objects in place of array rows.
    """
    compiled_kernels = compile_module_kernels(module)
    for name, arguments in _KERNEL_ARGUMENTS[module.__name__].items():
        if arguments is not None:
            setattr(module, name, getattr(compiled_kernels, name))


def _numba_type(argument_type: ArgumentType) -> Any:
    """Convert the type of a kernel argument to a numba type."""
    from numba import from_dtype, types

    if not isinstance(argument_type, str):
        return types.Array(from_dtype(np.dtype(argument_type)), 1, "C")
    float_type = types.float64
    integer_type = types.int64
    if argument_type in ("vector", "counts"):
        return types.Array(float_type if argument_type == "vector" else integer_type, 1, "C")
    return {
        "real": float_type,
        "count": integer_type,
        "flag": types.boolean,
        "address": types.intp,
    }[argument_type]


def _build_c_call() -> Any:
    """Build the compiled form of ``call_c_function``.

    The address of the function is an argument of the compiled code. If the address were a constant
    in the compiled code, numba could not store the code for other processes.
    """
    from llvmlite import ir  # type: ignore[import-untyped, unused-ignore]  # some releases come without types
    from numba import types
    from numba.extending import intrinsic

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer]).as_pointer()
        target, *values = arguments
        builder.call(
            builder.inttoptr(target, kind), [builder.inttoptr(value, pointer) for value in values]
        )
        return context.get_dummy_value()

    def typed(typing_context: Any, function: Any, first_argument: Any, second_argument: Any) -> Any:
        return types.void(types.intp, types.intp, types.intp), code

    return intrinsic(typed)


def _build_array_at() -> Any:
    """Build the compiled form of ``array_at``."""
    from numba import carray, njit, types  # type: ignore[attr-defined, unused-ignore]
    from numba.extending import intrinsic

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(types.voidptr))

    pointer: Any = intrinsic(lambda typing_context, address: (types.voidptr(types.intp), code))

    @njit
    def array_at(address: Any, count: Any, kind: Any) -> Any:
        return carray(pointer(address), (count,), kind)

    return array_at


def array_addresses(arrays: Iterable[Any]) -> list[int]:
    """Return the memory address and the length of each array, with which ``array_at`` accesses the array.

    The caller must keep the arrays alive.
    """
    return [number for array in arrays for number in (array.ctypes.data, len(array))]


def structure_array(memory: Any, structure: type[ctypes.Structure]) -> Any:
    """Return a numpy array of rows that uses the memory of an array of structures."""
    return (
        np.frombuffer(memory, np.dtype(structure))
        if ctypes.sizeof(memory)
        else np.empty(0, np.dtype(structure))
    )
