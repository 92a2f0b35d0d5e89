"""Test that stored machine code of a kernel is loaded without the compiler of numba.

The tests also check that other compiled functions can call a kernel that was loaded from a file.
"""

import subprocess
import sys

import numba
import pytest

from handctl import compiled, kernel_loading
from handctl.session.lockstep_simulation import SimulatorSettings

KERNEL_LOADING_SCRIPT = """
import sys
from handctl import compiled, kernel_loading
compiled.compile_kernels()
print("registered", "numba.np.arraymath" in sys.modules)
print("imported", "numba.np.arrayobj" in sys.modules)
print("loaded", compiled.square.stats.cache_hits != {}, compiled.square(3.0))
from numba import njit
square = compiled.square
print("linked", njit(lambda value: square(value) + 1.0)(3.0))
"""
FIRST_CALL_SCRIPT = """
import sys
from handctl import compiled
print("called", compiled.square(3), compiled.square(2), compiled.square.nopython_signatures)
print("registered", "numba.np.arraymath" in sys.modules)
"""
SIMULATOR_SCRIPT = """
import sys
from handctl.session.lockstep_simulation import SimulatorSettings
SimulatorSettings("jamia").check_hand_constructible()
print("simulator registered", "numba.np.arraymath" in sys.modules)
"""
CONCURRENT_CALLS_SCRIPT = """
import sys
from concurrent.futures import ThreadPoolExecutor
from handctl import compiled, kernel_loading
sys.setswitchinterval(1e-6)
load = kernel_loading.caching.Cache.load_overload
with ThreadPoolExecutor(6) as pool:
    print("called", set(pool.map(compiled.square, [3.0] * 60)))
print("unchanged", kernel_loading.caching.Cache.load_overload is load)
"""
WRONG_TYPE_SCRIPT = """
import numpy as np
from handctl.hand import rigid_body
table, parent = np.zeros((rigid_body.LINK_TABLE_ROW_COUNT, 1)), np.zeros(1, np.int64)
try:
    rigid_body.link_poses(table, parent, np.zeros(1, np.int64))
except TypeError:
    print("refused")
"""
UNKNOWN_VERSION_SCRIPT = (
    "from handctl import kernel_loading\nkernel_loading.TESTED_NUMBA_VERSIONS = ()\n"
)

pytestmark = pytest.mark.skipif(
    compiled._CACHE_FOLDER is None, reason="no folder for compiled code"
)


def printed_lines(program_text: str) -> list[str]:
    """Run the text of a Python program, and return the lines that it prints."""
    result = subprocess.run(
        [sys.executable, "-c", program_text], check=True, capture_output=True, text=True
    )
    return result.stdout.splitlines()


def test_stored_code_is_loaded_without_the_compiler_and_linked_later() -> None:
    compiled.compile_kernels()
    assert printed_lines(KERNEL_LOADING_SCRIPT) == [
        "registered False",
        "imported False",
        "loaded True 9.0",
        "linked 10.0",
    ]


def test_a_kernel_that_is_called_early_has_its_declared_types() -> None:
    """An integer does not lead to a second compilation of a kernel that is declared for real numbers."""
    compiled.compile_kernels()
    assert printed_lines(FIRST_CALL_SCRIPT) == [
        "called 9.0 4.0 [(float64,) -> float64]",
        "registered False",
    ]


def test_threads_can_call_a_kernel_for_the_first_time_together() -> None:
    compiled.compile_kernels()
    assert printed_lines(CONCURRENT_CALLS_SCRIPT) == ["called {9.0}", "unchanged True"]


def test_the_first_call_checks_the_types_of_arrays() -> None:
    assert printed_lines(WRONG_TYPE_SCRIPT) == ["refused"]


def test_the_code_of_the_simulator_is_loaded_without_the_compiler() -> None:
    SimulatorSettings("jamia").check_hand_constructible()
    assert printed_lines(SIMULATOR_SCRIPT) == ["simulator registered False"]


def test_other_versions_of_numba_load_in_their_own_way() -> None:
    compiled.compile_kernels()
    assert printed_lines(UNKNOWN_VERSION_SCRIPT + KERNEL_LOADING_SCRIPT) == [
        "registered True",
        "imported True",
        "loaded True 9.0",
        "linked 10.0",
    ]


def test_the_installed_version_is_known() -> None:
    """Fail for a new version of numba until a developer has checked ``kernel_loading`` with this version."""
    version: object = numba.version_info
    assert getattr(version, "short", None) in kernel_loading.TESTED_NUMBA_VERSIONS
