"""After its control loop has ended, a controller process gives back its real-time priority and unlocks its memory."""

import os
import sys
from contextlib import suppress

import pytest

from handctl.cli.main import main
from handctl.runtime.clocks import realtime_priority
from handctl.runtime.clocks.realtime_priority import request_priority, restore_priority

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="real-time scheduling is Linux's"
)


def scheduling_policy() -> int:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


def open_files() -> set[str]:
    """Return the paths of all files that the test process has open."""
    paths = set()
    for descriptor in os.listdir("/proc/self/fd"):
        # the file descriptor that was used to list the folder is already closed
        with suppress(OSError):
            paths.add(os.readlink(f"/proc/self/fd/{descriptor}"))
    return paths


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
    with realtime_priority.realtime_priority() as granted_now:
        policies.append(scheduling_policy())
    restore_priority()
    assert granted_now == granted_priority.is_realtime
    assert policies == [os.SCHED_FIFO if granted_now else os.SCHED_OTHER]
    assert scheduling_policy() == os.SCHED_OTHER


def test_processors_stay_awake_only_during_the_ticks(tmp_path, monkeypatch) -> None:
    """Processors must not enter a sleep state during ticks.

    In a virtual machine, an idle processor needs a millisecond to wake up.
    """
    latency = tmp_path / "cpu_dma_latency"
    latency.touch()
    monkeypatch.setattr(realtime_priority, "CPU_LATENCY_FILE", str(latency))
    assert str(latency) not in open_files()
    with realtime_priority.realtime_priority():
        assert str(latency) in open_files()
        assert latency.read_bytes() == bytes(4)
    assert str(latency) not in open_files()
    assert realtime_priority.prepare_priority().are_processors_awake
    restore_priority()


def test_a_system_that_lets_processors_sleep_is_no_error(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(realtime_priority, "CPU_LATENCY_FILE", str(tmp_path / "absent"))
    with realtime_priority.keep_processors_awake() as awake:
        assert not awake
    assert not realtime_priority.prepare_priority().are_processors_awake
    restore_priority()
