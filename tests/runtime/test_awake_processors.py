"""Test the request to Linux that idle processors stay awake during a run."""

from pathlib import Path

import pytest

from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.runtime.clocks import awake_processors
from handctl.runtime.clocks.awake_processors import (
    ANY_LATENCY,
    TICKS_PER_SLEEP,
    ZERO_LATENCY,
    AwakeProcessors,
    is_virtual_machine,
)
from handctl.runtime.clocks.realtime_priority import (
    prepare_priority,
    realtime_priority,
    restore_priority,
)
from handctl.session import run
from handctl.session.run_plan import RunPlan, default_control_rate
from tests.drives.protocol_bench import hand_file
from tests.runtime.processes import MOVE_PHASE, TASK_HEAD


@pytest.fixture
def latency_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an ordinary file that replaces ``CPU_LATENCY_FILE``, and contains all requests of the test."""
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
        for _ in range(3 * TICKS_PER_SLEEP):
            processors.sleep(0.0)
    assert latency_file.read_bytes() == ZERO_LATENCY + expected_breaks * (
        ANY_LATENCY + ZERO_LATENCY
    )


def test_the_processors_stay_asleep_while_the_control_loop_sleeps(
    tmp_path, monkeypatch, latency_file
):
    write_processor_file(tmp_path / "cpuinfo", "hypervisor", monkeypatch)
    requests = []
    monkeypatch.setattr(
        awake_processors.time, "sleep", lambda duration_s: requests.append(read_last_request())
    )

    def read_last_request() -> bytes:
        return latency_file.read_bytes()[-4:]

    processors = AwakeProcessors()
    with processors.keep_awake():
        for _ in range(TICKS_PER_SLEEP):
            processors.sleep(0.001)
    assert requests == [ZERO_LATENCY] * (TICKS_PER_SLEEP - 1) + [ANY_LATENCY]


def test_outside_of_the_ticks_a_sleep_writes_no_request(tmp_path, monkeypatch, latency_file):
    write_processor_file(tmp_path / "cpuinfo", "hypervisor", monkeypatch)
    processors = AwakeProcessors()
    for _ in range(2 * TICKS_PER_SLEEP):
        processors.sleep(0.0)
    with processors.keep_awake():
        pass
    for _ in range(2 * TICKS_PER_SLEEP):
        processors.sleep(0.0)
    assert latency_file.read_bytes() == ZERO_LATENCY


def test_processors_stay_awake_only_during_the_ticks(latency_file):
    with realtime_priority():
        assert latency_file.read_bytes() == ZERO_LATENCY
    assert prepare_priority().are_processors_awake
    restore_priority()


def test_a_system_that_lets_processors_sleep_is_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(awake_processors, "CPU_LATENCY_FILE", str(tmp_path / "absent"))
    processors = AwakeProcessors()
    with processors.keep_awake() as is_awake:
        assert not is_awake
        for _ in range(2 * TICKS_PER_SLEEP):
            processors.sleep(0.0)
    assert not prepare_priority().are_processors_awake
    restore_priority()


class EmptyBus:
    """A bus without nodes."""

    def drain(self):
        return []

    def send(self, frames):
        return len(frames)

    def take_events(self):
        return []

    def close(self):
        return None


def test_the_processors_sleep_in_some_ticks_of_a_run(tmp_path, monkeypatch, latency_file):
    write_processor_file(tmp_path / "cpuinfo", "hypervisor", monkeypatch)
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "h"))
    monkeypatch.setattr(run, "open_bus", lambda *words: EmptyBus())
    task = tmp_path / "short.toml"
    task.write_text(TASK_HEAD + MOVE_PHASE.format(name="bend", angle=10.0, duration=0.1))
    hand = load_hand(hand_file(tmp_path, ["mit"]))
    plan = RunPlan(hand, Gains(), default_control_rate(hand), (0.5,), buses=("local:x",))
    controller = run.make_controller(plan, TaskProgram(load_task(task)), None, True)
    run.run_live(plan, controller, tmp_path / "run.mcap")
    with RunLog(tmp_path / "run.mcap") as log:
        tick_count = len(log)
    requests = latency_file.read_bytes()
    break_count = requests.count(ANY_LATENCY + ZERO_LATENCY)
    # At the end of the run, the controller waits for the drives without deadlines of ticks.
    assert 0.5 * tick_count <= break_count * TICKS_PER_SLEEP <= tick_count + TICKS_PER_SLEEP
