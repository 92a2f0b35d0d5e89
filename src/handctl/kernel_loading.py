"""Fast loading of stored kernels.

This module loads stored kernels without the parts of numba that only a compilation needs. When
numba itself loads a stored function, it spends most of the time on three steps: registration,
imports and parsing. For the registration, numba registers all types and functions that can be
compiled. For the imports, numba imports the modules of all numba functions that the stored function
contains. For the parsing, numba parses the intermediate code (bitcode) of the stored function. The
bitcode is needed only if the stored function is inlined into another function. If the cache folder
contains the code of all kernels, a program compiles nothing, so registration, imports and parsing
are unnecessary. If numba must compile a function, numba registers the types when the compilation
begins. If a newly compiled kernel calls a stored kernel, the bitcode of the stored kernel is parsed
during linking.

Registration, imports and parsing are internal to numba. This module skips registration, imports and
parsing only for the versions of numba in ``TESTED_NUMBA_VERSIONS``.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numba
from llvmlite import binding  # type: ignore[import-untyped, unused-ignore]  # some releases come without types
from numba.core import caching as _caching
from numba.core import codegen as _codegen
from numba.core import compiler_lock as _compiler_lock
from numba.core import environment as _environment
from numba.core import runtime as _runtime

TESTED_NUMBA_VERSIONS = ((0, 68),)
"""Versions of numba with which this module was tested."""

caching: Any = _caching
codegen: Any = _codegen
compiler_lock: Any = _compiler_lock
environment: Any = _environment
runtime: Any = _runtime
"""Internal module of numba without type information, like the modules above."""


@contextmanager
def fast_loading() -> Iterator[None]:
    """Let numba load stored code of ``numba.njit`` in the fast way while this context is active.

    The context also applies to functions of other packages, so it must not contain code that loads
    functions of ``numba.cfunc`` or ``numba.guvectorize``. If a function has no stored code, numba
    compiles the function as usual. Other threads cannot compile or load functions meanwhile.
    """

    def load_without_compiler(cache: Any, argument_types: Any, target_context: Any) -> Any:
        with _without_compiler(target_context):
            return original_load(cache, argument_types, target_context)

    version: Any = numba.version_info
    with compiler_lock.global_compiler_lock:
        if version.short not in TESTED_NUMBA_VERSIONS:
            yield
            return
        original_load = caching.Cache.load_overload
        caching.Cache.load_overload = load_without_compiler
        try:
            yield
        finally:
            caching.Cache.load_overload = original_load


@contextmanager
def _without_compiler(context: Any) -> Iterator[None]:
    """Let numba load stored code without registering types and parsing bitcode, inside this context."""
    # Stored code calls the functions that count references to arrays. numba adds these functions to
    # a context only when it registers types, so they are added here.
    runtime.rtsys.initialize(context)
    library: Any = codegen.CPUCodeLibrary
    original_unserialize = library.__dict__["_unserialize"]
    library._unserialize = classmethod(_load_object_code)
    original_get_executable = context.get_executable
    rebuild_environment = environment._rebuild_env
    context.refresh = _do_nothing
    context.get_executable = partial(_get_executable, original_get_executable)
    environment._rebuild_env = _load_environment
    try:
        yield
    finally:
        # after this context, the original methods of the class are visible again
        del context.refresh, context.get_executable
        environment._rebuild_env = rebuild_environment
        library._unserialize = original_unserialize


def _do_nothing() -> None:
    """Do nothing. This function replaces numba's registration of types."""


def _load_environment(module: str, constants: list[Any], name: str) -> Any:
    """Return the constants that the code of a function uses.

    This function replaces a function of numba that also imports the Python module of the compiled
    function. The import is not necessary, because compiled code does not need its Python module.

    Args:
        module: name of the module.
        constants: Python objects that the code refers to by number.
        name: name by which the code finds the constants.
    """
    environment_object = environment.lookup_environment(name)
    if environment_object is None:
        environment_object = environment.Environment({"__name__": module})
        environment_object.consts[:] = constants
        environment_object.env_name = name
        environment.Environment._memo[name] = environment_object
    return environment_object


def _load_object_code(cls: Any, generator: Any, state: tuple[str, str, tuple[bytes, bytes]]) -> Any:
    """Return a code library made from the object code of a stored function.

    The bitcode of the returned library is parsed only when another library links it.
    """
    name, _, (object_code, bitcode) = state
    library = generator.create_library(name)
    library.enable_object_caching()
    library._set_compiled_object(object_code)
    library._get_module_for_linking = partial(_parse_module, library, bitcode)
    library._finalize_final_module()
    return library


def _parse_module(library: Any, bitcode: bytes) -> Any:
    """Return the module of a code library for linking.

    The first call of this function parses the bitcode of the module.
    """
    if library._shared_module is None:
        library._shared_module = binding.parse_bitcode(bitcode)
    return library._shared_module


def _get_executable(
    original_get_executable: Any, library: Any, function: Any, environment: Any
) -> Any:
    """Return the Python function that a code library contains.

    This function replaces a function of numba that looks up the name of the Python function in the
    parsed bitcode.
    """
    library.codegen._engine._defined_symbols.add(function.llvm_cpython_wrapper_name)
    return original_get_executable(library, function, environment)
