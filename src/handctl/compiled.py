"""Compilation of kernels.

Kernels are the functions that run for every tendon, motor or joint in every tick. A kernel is a
plain function of arrays and numbers, written with loops and ``math``. With ``NUMBA_DISABLE_JIT=1``,
Python interprets the kernels. Interpreted and compiled kernels give the same numbers to the last
bit, because compiled code does not reorder operations (no ``fastmath``).

``compile_kernels`` compiles all kernels before a hand is armed. One compilation serves every hand,
because the types of a kernel's arguments do not depend on the hand. The compiled code is stored in
a folder. The name of the folder contains a hash of the path and the content of all source files of
kernels. A change in a source file of kernels leads to a new folder, so that no process runs the
compiled code of another version. If no folder for the compiled code can be written, each process
compiles the kernels itself. A program that only needs the model of a hand calls some kernels before
``compile_kernels``. The first call of such a kernel compiles this kernel alone.

A controller needs numba. Without numba, Python interprets the kernels. Programs that only read logs
or send requests to a controller do not need numba.
"""

import contextlib
import fcntl
import hashlib
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar, cast

from numpy.typing import NDArray

from handctl.extras import is_installed, require_extra

NUMBA_INSTALLED = is_installed("numba")
if NUMBA_INSTALLED:
    from numba import njit, types
    from numba.core import cgutils as _cgutils
    from numba.core import config as _config
    from numba.core.errors import TypingError
    from numba.extending import intrinsic, overload

    from handctl.kernel_loading import fast_loading

    numba_config: Any = _config
    """Module with the settings of numba. The module has no type information."""
    cgutils: Any = _cgutils
    """Module with the code generation of numba. The module has no type information."""
F = TypeVar("F", bound=Callable[..., Any])

KERNEL_SOURCES = (
    "compiled.py", "extras.py", "core", "safety",
    "drives/contract.py", "drives/frame.py", "drives/frame_records.py", "drives/readback.py",
    "drives/signals.py",
    "hand/file/quantity_types.py", "hand/rigid_body.py", "hand/tendons.py", "log/tick_packing.py",
    "runtime/buses/canfd_structs.py",
)  # fmt: skip
"""Files and folders of this package that contain functions and constants of kernels.

A test checks that no module with constants of kernels is missing in the list. If a file that is not
in the list changes, nothing is compiled again.
"""
MAX_CACHE_FOLDERS = 16
"""Largest number of versions of handctl whose compiled code stays stored.

The compiled code of older versions is deleted.
"""
MAX_COMPILER_PROCESSES = 8
"""Largest number of processes that compile kernels in parallel."""
COMPILER_POLL_PERIOD_S = 0.1
"""Time between two checks of the progress of the compilation [s]."""

_KERNEL_DISPATCHERS: "dict[str, _UncompiledKernel]" = {}
"""Dispatcher and argument types of each kernel, by name of the kernel."""
_INNER_DISPATCHERS: list[Any] = []
"""Numba dispatchers of all functions that are called only by kernels."""
_TICK_ARGUMENTS = ("block", "words")
"""Argument types that only kernels of a tick have: the state block, and records of frames."""
KERNEL_FUNCTIONS: list[Callable[..., Any]] = []
"""Python functions of all kernels and of all functions that kernels call."""
if NUMBA_INSTALLED:
    _NUMBA_TYPES = {
        "real": types.float64,
        "count": types.int64,
        "block": types.Array(types.float64, 1, "C"),
        "constants": types.Array(types.float64, 1, "C", readonly=True),
        "layout": types.Array(types.int64, 1, "C"),
        "words": types.Array(types.uint64, 2, "C"),
        "frame_tables": types.Array(types.uint64, 1, "C", readonly=True),
        "results": types.Array(types.float64, 2, "C"),
        "vector": types.Array(types.float64, 1, "A", readonly=True),
        "matrix": types.Array(types.float64, 2, "A", readonly=True),
        "cube": types.Array(types.float64, 3, "A", readonly=True),
        "flags": types.Array(types.boolean, 1, "A", readonly=True),
        "counts": types.Array(types.int64, 1, "A", readonly=True),
        "matrix_int": types.Array(types.int64, 2, "A", readonly=True),
        "keys": types.Array(types.int64, 1, "C", readonly=True),
        "table_words": types.Array(types.uint64, 2, "C", readonly=True),
        "bytes": types.Array(types.uint8, 1, "C", readonly=True),
    }


class _UncompiledKernel(NamedTuple):
    """Kernel that is not compiled yet.

    Attributes:
        name: module and name of the kernel.
        dispatcher: numba dispatcher of the kernel.
        types: numba types of the kernel's arguments.
    """

    name: str
    dispatcher: Any
    types: tuple[Any, ...]


def kernel(*arguments: str) -> Callable[[F], F]:
    """Mark a function as a kernel to be compiled.

    Args:
        arguments: type of each argument. The types real and count are numbers. The types vector,
            matrix, cube, flags and counts are arrays that the kernel reads. The types keys (int64),
            table_words (rows of uint64) and frame_tables (uint64) are contiguous arrays that the
            kernel reads and is allowed to borrow. The types block (float64), layout (int64), words
            (rows of uint64) and results (rows of float64) are contiguous arrays into which the
            kernel is allowed to write.
    """

    def register_kernel(function: F) -> F:
        if not NUMBA_INSTALLED:
            return function
        dispatcher: Any = _make_dispatcher(function)
        uncompiled_kernel = _UncompiledKernel(
            f"{function.__module__}.{function.__name__}",
            dispatcher,
            tuple(_NUMBA_TYPES[name] for name in arguments),
        )
        _KERNEL_DISPATCHERS[uncompiled_kernel.name] = uncompiled_kernel
        if not numba_config.DISABLE_JIT:
            dispatcher._compile_for_args = _first_compilation(uncompiled_kernel)
        return cast(F, dispatcher)

    return register_kernel


def _first_compilation(uncompiled_kernel: _UncompiledKernel) -> Callable[..., Any]:
    """Return a function that compiles a kernel, and returns the dispatcher of the kernel.

    A dispatcher without compiled code calls this function instead of a method of numba, and then
    calls the result with the same arguments. The method of numba would register all types of numba,
    and then compile the kernel for the types of the given arguments instead of its declared types.
    """

    def compile_for_declared_types(*_arguments: Any) -> Any:
        _compile_kernel(uncompiled_kernel)
        return uncompiled_kernel.dispatcher

    return compile_for_declared_types


def kernel_helper(function: F) -> F:
    """Mark a function as a helper that is called only by kernels.

    The function is compiled into the kernels that call it.

    Python cannot call the function.
    """
    if not NUMBA_INSTALLED:
        return function
    KERNEL_FUNCTIONS.append(function)
    options: dict[str, Any] = {
        "forceinline": True,
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
    }
    dispatcher: Any = njit(error_model="numpy", **options)(function)
    _INNER_DISPATCHERS.append(dispatcher)
    return cast(F, dispatcher)


def _make_dispatcher(function: F) -> F:
    KERNEL_FUNCTIONS.append(function)
    with _use_kernel_cache(_CACHE_FOLDER):
        try:
            dispatcher: Any = njit(cache=_CACHE_FOLDER is not None, error_model="numpy")(function)
        except (
            RuntimeError
        ):  # numba raises the caught error if it cannot write into the folder of the cache
            dispatcher = njit(error_model="numpy")(function)
    return cast(F, dispatcher)


@contextlib.contextmanager
def _use_kernel_cache(folder: Path | None) -> Iterator[None]:
    """Let numba store the code of kernels in a folder while this context is active.

    The context has no effect on other packages that use numba.
    """
    original_cache_folder = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(folder or "")
    try:
        yield
    finally:
        numba_config.CACHE_DIR = original_cache_folder


def _cache_folder() -> Path | None:
    """Create and return the folder for the compiled code of this version.

    If the folder is not writable, return None.
    """
    cache_root = Path(
        os.environ.get("NUMBA_CACHE_DIR")
        or Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    )
    folder = cache_root / "handctl" / f"kernels-{_source_hash()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except (OSError, RuntimeError):
        return None
    if not os.access(folder, os.W_OK):
        return None
    _remove_old_kernels(folder.parent)
    return folder


def _source_hash() -> str:
    """Return a hash of the package's path and of the content of all source files that contain kernels.

    Numba finds stored code by the path of the source file. If the hash did not contain the path,
    two installations of the same version would share a folder. In a shared folder, one installation
    would find code that only the other installation can use.
    """
    package_folder = Path(__file__).parent
    digest = hashlib.blake2b(os.fsencode(package_folder), digest_size=8)
    for name in KERNEL_SOURCES:
        source_path = package_folder / name
        for path in [source_path] if source_path.is_file() else sorted(source_path.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _remove_old_kernels(cache_folder: Path) -> None:
    """Delete the compiled code of old versions, except the last `MAX_CACHE_FOLDERS` versions that were used."""
    with contextlib.suppress(OSError):
        folders = sorted(
            cache_folder.glob("kernels-*"), key=lambda path: path.stat().st_mtime, reverse=True
        )
        for path in folders[MAX_CACHE_FOLDERS:]:
            shutil.rmtree(path, ignore_errors=True)


_CACHE_FOLDER = None if not NUMBA_INSTALLED or numba_config.DISABLE_JIT else _cache_folder()


@kernel("real")
def square(value: float) -> float:
    """Return the square of a number, computed as the number times itself.

    The operator ``**`` is not used, because interpreted code and compiled code would round its
    result differently.
    """
    return value * value


def _generate_borrowed_array(
    typing_context: Any, flat_array: Any, first_element: Any, shape: Any
) -> Any:
    """Generate the code of ``borrowed_array``.

    This function returns an array that refers to the memory of another array.

    Numba does not count the references to a borrowed array.

    Raises:
        TypingError: the original array is not contiguous in C order.
    """
    if flat_array.layout != "C":
        raise TypingError(f"a kernel can borrow a contiguous array only, not {flat_array}")
    result = types.Array(flat_array.dtype, shape.count, "C")

    def generate_code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        from numba.np import (
            arrayobj as _arrayobj,
        )  # imported here, because only a compilation of kernels needs this module

        arrayobj: Any = _arrayobj
        source = arrayobj.make_array(signature.args[0])(context, builder, arguments[0])
        sizes = cgutils.unpack_tuple(builder, arguments[2], shape.count)
        itemsize = context.get_abi_sizeof(context.get_data_type(flat_array.dtype))
        strides = [context.get_constant(types.intp, itemsize)]
        for size in sizes[:0:-1]:
            strides.insert(0, builder.mul(strides[0], size))
        array = arrayobj.make_array(result)(context, builder)
        data = builder.gep(source.data, [arguments[1]])
        arrayobj.populate_array(
            array, data=data, shape=sizes, strides=strides, itemsize=itemsize, meminfo=None
        )
        return array._getvalue()

    tuple_of: Any = types.UniTuple
    return result(flat_array, types.intp, tuple_of(types.intp, shape.count)), generate_code


def borrowed_array(
    flat_array: NDArray[Any], first_element: int, shape: tuple[int, ...]
) -> NDArray[Any]:
    """Return a part of a contiguous array as an array with another shape.

    Numba does not count the references to the returned array. If a function is called with an
    array, numba counts the references to the array with atomic operations. Kernels pass dozens of
    tables to the functions that they call. Counting the references to these tables would take
    longer than all computations of the kernels. A borrowed array has no reference count, so the
    caller of the kernel must keep the memory alive. If Python interprets the kernel, the borrowed
    array is an ordinary view.

    Args:
        flat_array: contiguous array.
        first_element: index of the first element of the part of the array.
        shape: shape of the result.
    """
    return flat_array.reshape(-1)[first_element : first_element + math.prod(shape)].reshape(shape)


if NUMBA_INSTALLED:
    _borrow: Any = intrinsic(_generate_borrowed_array)

    @overload(borrowed_array, inline="always")
    def _overload_borrowed_array(flat_array: Any, first_element: Any, shape: Any) -> Any:
        def implementation(flat_array: Any, first_element: Any, shape: Any) -> Any:
            return _borrow(flat_array, first_element, shape)

        return implementation


class KernelCalls:
    """Choice of how Python calls the kernels of a tick.

    Attributes:
        check_types: True to check the types of all arguments in every call. The tests set this
            attribute before the kernels are compiled.
    """

    check_types = False


def compile_kernels(progress: Callable[[int, int], None] | None = None) -> None:
    """Compile all imported kernels, or load their code from the disk.

    After this call, no tick has to wait for a compilation.

    Args:
        progress: function called with the number of kernels that are ready and the number of all
            kernels.

    Raises:
        MissingExtraError: numba is not installed.
    """
    require_extra("a controller", "numba")
    report = progress or _ignore_progress
    uncompiled_kernels = [
        known_kernel
        for known_kernel in _KERNEL_DISPATCHERS.values()
        if not getattr(known_kernel.dispatcher, "signatures", True)
    ]
    if _CACHE_FOLDER and _compiled_count(_CACHE_FOLDER, uncompiled_kernels) < len(
        uncompiled_kernels
    ):
        _compile_together(_CACHE_FOLDER, uncompiled_kernels, report)
    for compiled_count, uncompiled_kernel in enumerate(uncompiled_kernels):
        report(compiled_count, len(uncompiled_kernels))
        _compile_kernel(uncompiled_kernel)


def _compile_kernel(uncompiled_kernel: _UncompiledKernel) -> None:
    """Compile a kernel for its declared argument types, or load its code from the disk.

    If another thread has just compiled the kernel, the function does nothing.
    """
    with fast_loading():
        if not uncompiled_kernel.dispatcher.signatures:
            uncompiled_kernel.dispatcher.compile(uncompiled_kernel.types)
            uncompiled_kernel.dispatcher.disable_compile()
    if not KernelCalls.check_types:
        _call_without_dispatcher(uncompiled_kernel)


def fast_loading_of_stored_code() -> AbstractContextManager[None]:
    """Return a context in which numba loads stored code as fast as the kernels, see ``kernel_loading.fast_loading``.

    Without numba, the context has no effect.
    """
    return fast_loading() if NUMBA_INSTALLED else contextlib.nullcontext()


def _call_without_dispatcher(kernel_of_tick: _UncompiledKernel) -> None:
    """Let the name of a kernel refer to its compiled code, if the kernel belongs to a tick.

    In each call, the dispatcher of numba looks up the compiled code for the types of the arguments.
    A kernel has compiled code for only one combination of types, and the look-ups of all kernels
    take a tenth of the time of a tick. The compiled code still checks the number of the arguments
    and the element size of each array.

    A kernel that other kernels call keeps its dispatcher, because numba needs the dispatcher to
    compile the other kernels. Callers must use the name in the module of the kernel, because a name
    that another module has imported still refers to the dispatcher.
    """
    if not any(_NUMBA_TYPES[name] in kernel_of_tick.types for name in _TICK_ARGUMENTS):
        return
    function = kernel_of_tick.dispatcher.py_func
    compiled_code = kernel_of_tick.dispatcher.get_overload(kernel_of_tick.types)
    setattr(sys.modules[function.__module__], function.__name__, compiled_code)


def _ignore_progress(done: int, total: int) -> None:
    """Discard a progress report."""


def _compiled_count(folder: Path, kernels: Sequence[_UncompiledKernel]) -> int:
    """Count the kernels whose compiled code is in a folder.

    Numba chooses the names of the files, and each file name contains the name of a kernel.
    """
    files = [name for _, _, names in os.walk(folder) for name in names]
    compiled_names = {name.partition("-")[0] for name in files if name.endswith(".nbi")}
    return sum(
        ".".join(any_kernel.name.rsplit(".", 2)[1:]) in compiled_names for any_kernel in kernels
    )


def _compile_together(
    folder: Path, waiting_kernels: Sequence[_UncompiledKernel], report: Callable[[int, int], None]
) -> None:
    """Compile kernels into a folder, with one process for each processor core.

    During the compilation, a file lock on ``folder`` makes other processes wait before they use the
    compiled code.

    If a kernel cannot be compiled, ``compile_kernels`` raises the error later.

    Args:
        folder: folder of the compiled code.
        waiting_kernels: kernels whose code is not in the folder yet.
        report: function that reports progress, like the argument ``progress`` of
            ``compile_kernels``.
    """
    kernel_order = sorted(
        range(len(waiting_kernels)),
        key=lambda i: len(waiting_kernels[i].dispatcher.py_func.__code__.co_names),
        reverse=True,
    )
    with contextlib.suppress(OSError), open(folder / "lock", "w") as lock:
        while not _try_file_lock(lock):
            report(_compiled_count(folder, waiting_kernels), len(waiting_kernels))
            time.sleep(COMPILER_POLL_PERIOD_S)
        if _compiled_count(folder, waiting_kernels) == len(waiting_kernels):
            return
        with _use_kernel_cache(
            folder
        ):  # only a compilation needs the compiled code of the functions that kernels call
            for inner_dispatcher in _INNER_DISPATCHERS:
                inner_dispatcher.enable_caching()
        read_end, write_end = os.pipe()
        os.write(
            write_end, bytes(kernel_order)
        )  # a number in the pipe stands for one kernel, and the worker that reads the number compiles this kernel
        os.close(write_end)
        workers = [
            _start_compiler_process(read_end, waiting_kernels)
            for _ in range(min(os.cpu_count() or 1, MAX_COMPILER_PROCESSES))
        ]
        os.close(read_end)
        while workers:
            workers = [worker for worker in workers if os.waitpid(worker, os.WNOHANG)[0] == 0]
            report(_compiled_count(folder, waiting_kernels), len(waiting_kernels))
            time.sleep(COMPILER_POLL_PERIOD_S)


def _try_file_lock(lock_file: IO[str]) -> bool:
    """Try to lock the folder that contains the compiled code, and return True on success."""
    try:
        fcntl.flock(lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _start_compiler_process(
    kernel_number_pipe: int, waiting_kernels: Sequence[_UncompiledKernel]
) -> int:
    """Fork a process that compiles waiting kernels, one after the other, until no kernel is left.

    Return the process id.
    """
    process = os.fork()
    if process:
        return process
    try:
        while number := os.read(kernel_number_pipe, 1):
            waiting_kernels[number[0]].dispatcher.compile(waiting_kernels[number[0]].types)
    finally:
        os._exit(0)
