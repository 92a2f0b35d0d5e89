"""Settings of OpenBLAS: the matrix kernels, and the number of threads.

With the chosen kernels, a log has the same bits on every x86 processor with AVX2 and FMA. numpy and
scipy compute products of matrices with OpenBLAS. OpenBLAS has kernels for each family of
processors, and the kernels of different families can round the last bit differently. The tension
filter and the design of the controller use products of matrices. With the kernels for AVX-512, the
numbers in a log could therefore differ in their last bits from the numbers on a processor without
AVX-512. The kernels for Haswell run on every processor with AVX2 and FMA. For matrices as small as
those of a hand, the kernels for Haswell are as fast as the other kernels.

OpenBLAS uses a single thread. The matrices of a hand are too small for several threads. With
several threads, the idle threads wait in a loop, and take the processor from other programs.
"""

import os
from collections.abc import Iterable
from pathlib import Path

OPENBLAS_CORE_VARIABLE = "OPENBLAS_CORETYPE"
"""Environment variable with the family of processors whose kernels OpenBLAS uses."""
OPENBLAS_THREADS_VARIABLE = "OPENBLAS_NUM_THREADS"
"""Environment variable with the number of threads that OpenBLAS uses."""
PORTABLE_MATRIX_KERNELS = "Haswell"
REQUIRED_CPU_FEATURES = frozenset({"avx2", "fma"})
"""Features of a processor that can execute the kernels for Haswell."""
CPU_INFO_PATH = Path("/proc/cpuinfo")


def configure_openblas() -> None:
    """Let OpenBLAS use a single thread and the kernels for Haswell in this process and its child processes.

    The call has an effect only before the first import of numpy. The call does not change a setting
    that the user has chosen. If the processor cannot execute the kernels for Haswell, OpenBLAS uses
    other kernels.
    """
    os.environ.setdefault(OPENBLAS_THREADS_VARIABLE, "1")
    if can_run_portable_kernels():
        os.environ.setdefault(OPENBLAS_CORE_VARIABLE, PORTABLE_MATRIX_KERNELS)


def can_run_portable_kernels() -> bool:
    """Return True if the processor has the features that the kernels for Haswell need."""
    try:
        with CPU_INFO_PATH.open() as lines:
            return cpu_features(lines) >= REQUIRED_CPU_FEATURES
    except OSError:  # only Linux has the file ``/proc/cpuinfo``
        return False


def cpu_features(lines: Iterable[str]) -> frozenset[str]:
    """Return the features of the first processor in the lines of ``/proc/cpuinfo``.

    Only x86 processors have a line ``flags``. For other processors, the features are unknown, and
    the result is empty.
    """
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "flags":
            return frozenset(value.split())
    return frozenset()
