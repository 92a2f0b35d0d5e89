"""Test the request to Linux that idle processors stay awake during a run."""

import os
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from handctl.log.read.reader import RunLog
from handctl.runtime.clocks import awake_processors
from handctl.runtime.clocks.awake_processors import (
    ANY_LATENCY,
    TICKS_PER_PROCESSOR_SLEEP,
    ZERO_LATENCY,
    AwakeProcessors,
    is_virtual_machine,
)
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.clocks.realtime_priority import (
    prepare_priority,
    realtime_priority,
    restore_priority,
)
from handctl.session import run
from tests.runtime.run_without_nodes import EmptyBus, plan_and_controller


@pytest.fixture
def latency_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an ordinary file that replaces ``CPU_LATENCY_FILE``.

    The file contains the requests since it was opened for the last time.
    """
    path = tmp_path / "cpu_dma_latency"
    path.touch()
    monkeypatch.setattr(awake_processors, "CPU_LATENCY_FILE", str(path))
    return path


def write_processor_file(path: Path, flags: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a description of the processors with the given flags, and use it instead of ``PROCESSOR_FILE``."""
    path.write_text(f"processor\t: 0\nmodel name\t: hypervisor test\nflags\t\t: {flags}\n")
    monkeypatch.setattr(awake_processors, "PROCESSOR_FILE", path)


@pytest.mark.parametrize(
    ("flags", "is_virtual"), [("fpu hypervisor vme", True), ("fpu vme", False), ("", False)]
)
def test_the_flags_of_the_processor_tell_a_virtual_machine(
    tmp_path, monkeypatch, flags, is_virtual
):
    write_processor_file(tmp_path / "cpuinfo", flags, monkeypatch)
    assert is_virtual_machine() == is_virtual


def test_without_a_description_the_computer_counts_as_real(tmp_path, monkeypatch):
    monkeypatch.setattr(awake_processors, "PROCESSOR_FILE", tmp_path / "absent")
    assert not is_virtual_machine()


@pytest.mark.parametrize(
    ("flags", "expected_breaks"), [("fpu hypervisor", 3), ("fpu", 0)], ids=["virtual", "real"]
)
def test_idle_processors_sleep_in_some_ticks_of_a_virtual_machine(
    tmp_path, monkeypatch, latency_file, flags, expected_breaks
):
    """Reproduce a defect: the host stopped a virtual machine whose processors never slept.

    Each stop lasted up to 7 ms, and ended at a multiple of 100 ms.
    """
    write_processor_file(tmp_path / "cpuinfo", flags, monkeypatch)
    processors = AwakeProcessors()
    with processors.keep_awake() as is_awake:
        assert is_awake
        for _ in range(3 * TICKS_PER_PROCESSOR_SLEEP):
            wait_for_tick(processors)
    assert latency_file.read_bytes() == ZERO_LATENCY + expected_breaks * (
        ANY_LATENCY + ZERO_LATENCY
    )


def wait_for_tick(processors: AwakeProcessors) -> None:
    """Wait as the clock waits for a deadline."""
    if processors.begin_wait():
        processors.sleep(0.0)


def test_the_processors_sleep_while_the_process_sleeps(monkeypatch, latency_file):
    requests = []
    monkeypatch.setattr(
        awake_processors.time,
        "sleep",
        lambda duration_s: requests.append((duration_s, latency_file.read_bytes()[-4:])),
    )
    processors = AwakeProcessors()
    with processors.keep_awake():
        processors.sleep(0.001)
    assert requests == [(0.001, ANY_LATENCY)]
    processors.sleep(0.002)
    assert requests[1][0] == 0.002


def test_processors_that_are_not_kept_awake_get_no_request(tmp_path, monkeypatch, latency_file):
    write_processor_file(tmp_path / "cpuinfo", "hypervisor", monkeypatch)
    processors = AwakeProcessors()
    for _ in range(2 * TICKS_PER_PROCESSOR_SLEEP):
        wait_for_tick(processors)
    with processors.keep_awake():
        pass
    for _ in range(2 * TICKS_PER_PROCESSOR_SLEEP):
        wait_for_tick(processors)
    assert latency_file.read_bytes() == ZERO_LATENCY


def test_processors_stay_awake_only_during_the_ticks(latency_file):
    assert str(latency_file) not in open_files()
    with realtime_priority(AwakeProcessors()):
        assert str(latency_file) in open_files()
        assert latency_file.read_bytes() == ZERO_LATENCY
    assert str(latency_file) not in open_files()
    assert prepare_priority().are_processors_awake
    restore_priority()


def open_files() -> set[str]:
    """Return the paths of all files that the test process has open."""
    paths = set()
    for descriptor in os.listdir("/proc/self/fd"):
        # the file descriptor that was used to list the folder is already closed
        with suppress(OSError):
            paths.add(os.readlink(f"/proc/self/fd/{descriptor}"))
    return paths


def test_a_system_that_lets_processors_sleep_is_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(awake_processors, "CPU_LATENCY_FILE", str(tmp_path / "absent"))
    processors = AwakeProcessors()
    with processors.keep_awake() as is_awake:
        assert not is_awake
        for _ in range(2 * TICKS_PER_PROCESSOR_SLEEP):
            assert not processors.begin_wait()
    assert not prepare_priority().are_processors_awake
    restore_priority()


def test_a_request_that_fails_is_no_error_and_leaves_no_open_file(monkeypatch, latency_file):
    def refuse_request(descriptor: int, data: bytes) -> int:
        raise OSError("refused")

    with monkeypatch.context() as patches:
        patches.setattr(awake_processors.os, "write", refuse_request)
        with AwakeProcessors().keep_awake() as is_awake:
            assert not is_awake
            assert str(latency_file) not in open_files()


def test_the_delay_after_a_sleep_of_the_processors_is_expected_separately(
    tmp_path, monkeypatch, latency_file
):
    """Reproduce a waste: one slow wake-up in eight lengthened the busy wait before all other ticks."""
    write_processor_file(tmp_path / "cpuinfo", "hypervisor", monkeypatch)
    now_ns = [1_000_000_000]
    overshoots_ns = {True: 70_000, False: 20_000}

    def sleep(duration_s: float) -> None:
        do_processors_sleep = latency_file.read_bytes()[-4:] == ANY_LATENCY
        now_ns[0] += round(duration_s * 1e9) + overshoots_ns[do_processors_sleep]

    def read_clock() -> int:
        now_ns[0] += 100
        return now_ns[0]

    monkeypatch.setattr(time, "monotonic_ns", read_clock)
    monkeypatch.setattr(time, "sleep", sleep)
    clock = RealClock(1_000_000, busy_wait=True)
    with clock.processors.keep_awake():
        clock.start()
        lateness_ns = [clock.wait(k) for k in range(100 * TICKS_PER_PROCESSOR_SLEEP)]
    assert clock.wake_up_delay.expected_ns == pytest.approx(20_000, abs=1000)
    assert clock.delay_after_processor_sleep.expected_ns == pytest.approx(70_000, abs=1000)
    assert max(lateness_ns[400:]) < 1000


def test_the_processors_sleep_in_some_ticks_of_a_run(tmp_path, monkeypatch, latency_file):
    write_processor_file(tmp_path / "cpuinfo", "hypervisor", monkeypatch)
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "h"))
    monkeypatch.setattr(run, "open_bus", lambda *words: EmptyBus())
    _, plan, controller = plan_and_controller(tmp_path)
    plan = replace(plan, buses=("local:x",))
    run.run_live(plan, controller, tmp_path / "run.mcap")
    with RunLog(tmp_path / "run.mcap") as log:
        tick_count = len(log)
    requests = latency_file.read_bytes()
    break_count = requests.count(ANY_LATENCY + ZERO_LATENCY)
    # A tick that is already late does not sleep, and some waits at the end of a run belong to no tick.
    assert tick_count > 10 * TICKS_PER_PROCESSOR_SLEEP
    assert 0.5 * tick_count <= break_count * TICKS_PER_PROCESSOR_SLEEP <= 1.1 * tick_count
