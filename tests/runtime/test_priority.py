"""After its control loop has ended, a controller process gives back its real-time priority and unlocks its memory."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.runtime.clocks import realtime_priority
from handctl.runtime.clocks.awake_processors import AwakeProcessors
from handctl.runtime.clocks.realtime_priority import request_priority, restore_priority

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="real-time scheduling is Linux's"
)


def scheduling_policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def test_priority_is_reset_after_the_run() -> None:
    granted_priority = request_priority()
    assert (scheduling_policy() == os.SCHED_FIFO) == granted_priority.is_realtime
    restore_priority()
    assert scheduling_policy() == os.SCHED_OTHER


def test_the_doctor_tries_real_time_priority_and_resets_it() -> None:
    main(["doctor", "--json"])
    assert scheduling_policy() == os.SCHED_OTHER


def test_memory_is_locked_while_others_may_still_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reproduce a defect: the process locked its memory while it had real-time priority (SCHED_FIFO).

    Locking the memory blocked all other processes on the core for a tenth of a second.
    """
    calls: list[str] = []
    monkeypatch.setattr(realtime_priority, "_lock_memory", lambda: calls.append("memory") is None)
    monkeypatch.setattr(
        realtime_priority, "_set_fifo_scheduling", lambda level: calls.append("priority") is None
    )
    assert request_priority() == realtime_priority.GrantedPriority(
        is_realtime=True, is_memory_locked=True
    )
    assert calls == ["memory", "priority"]


def test_only_ticks_have_realtime_priority() -> None:
    """Reproduce a defect: a control loop had real-time priority even while it started or closed its log.

    With real-time priority, a control loop blocked all other processes on its processor core.
    """
    granted_priority = realtime_priority.prepare_priority()
    policies = []
    assert scheduling_policy() == os.SCHED_OTHER
    with realtime_priority.realtime_priority(AwakeProcessors()) as granted_now:
        policies.append(scheduling_policy())
    restore_priority()
    assert granted_now == granted_priority.is_realtime
    assert policies == [os.SCHED_FIFO if granted_now else os.SCHED_OTHER]
    assert scheduling_policy() == os.SCHED_OTHER


def test_all_libraries_except_the_compiler_are_loaded() -> None:
    """Reproduce a waste: the lock of the memory loaded 150 MB of the compiler, which no tick uses.

    The test runs in a new process, because a process that has compiled code has already loaded the
    compiler.
    """
    sizes_before, sizes = sizes_in_new_process("print_sizes_before_and_after_the_lock()")
    numpy_mapped, numpy_loaded = sizes["_multiarray_umath"]
    assert numpy_loaded == numpy_mapped > 0
    compiler_mapped, loaded_before = sizes_before[realtime_priority.COMPILER_LIBRARY]
    if loaded_before > 0.9 * compiler_mapped:
        pytest.skip("Linux has already loaded the library of the compiler")
    _, compiler_loaded = sizes[realtime_priority.COMPILER_LIBRARY]
    assert compiler_loaded - loaded_before < 0.02 * compiler_mapped


def test_an_old_kernel_loads_all_libraries() -> None:
    _, sizes = sizes_in_new_process("print_sizes_before_and_after_the_lock(is_kernel_old=True)")
    mapped, loaded = sizes[realtime_priority.COMPILER_LIBRARY]
    assert loaded == mapped > 0


LibrarySizes = dict[str, tuple[int, int]]
"""Mapped and loaded size of each library [kB]."""


def sizes_in_new_process(call: str) -> tuple[LibrarySizes, LibrarySizes]:
    """Call ``print_sizes_before_and_after_the_lock`` in a new process, and return the printed sizes."""
    code = f"from {__name__} import print_sizes_before_and_after_the_lock; {call}"
    folder = Path(__file__).parents[2]
    process = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True
    )
    is_memory_locked, sizes_before, sizes_after = json.loads(process.stdout)
    if not is_memory_locked:
        pytest.skip("the system does not allow a process to lock its memory")
    return sizes_before, sizes_after


def print_sizes_before_and_after_the_lock(is_kernel_old: bool = False) -> None:
    """Lock the memory of this process, and print the sizes of two libraries before and after, as JSON.

    The first printed value is True if the system allows the process to lock its memory.
    """
    import handctl.controller.tick  # noqa: F401  # loads the libraries of a run

    if is_kernel_old:
        realtime_priority._load_libraries = lambda libc: False
    sizes_before = mapped_and_loaded_sizes()
    is_memory_locked = realtime_priority._lock_memory()
    print(json.dumps([is_memory_locked, sizes_before, mapped_and_loaded_sizes()]))


def mapped_and_loaded_sizes() -> LibrarySizes:
    """Return the mapped and the loaded size of two libraries [kB], without the parts that cannot be read."""
    sizes = dict.fromkeys(("_multiarray_umath", realtime_priority.COMPILER_LIBRARY), (0, 0))
    mapping = ""
    for line in Path("/proc/self/smaps").read_text().splitlines():
        key, *values = line.split()
        if not key.endswith(":"):
            mapping = line
            mapped = 0
        elif key == "Size:":
            mapped = int(values[0])
        elif key == "Rss:" and " r" in mapping:
            for library, (mapped_before, loaded_before) in sizes.items():
                if library in mapping:
                    sizes[library] = (mapped_before + mapped, loaded_before + int(values[0]))
    return sizes
