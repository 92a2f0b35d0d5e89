"""Test the snapshots of the controller state in a log.

Several processes can execute parts of a log again, and each process starts at a snapshot. The
executions of all parts together give the same outputs as one execution of the whole log.
"""

import math
import os
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handctl.campaign.run_stages import hand_with_protocol, homed_run
from handctl.controller.controller_state import ControllerState, serialized_decisions
from handctl.controller.state_snapshot import restore_state, snapshot_bytes
from handctl.controller.tick import Controller
from handctl.core.plain_data import serialized_bytes
from handctl.core.tick_types import HandMode, TickIn, TickOut
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.errors import LogError
from handctl.log.read.reader import RunLog
from handctl.replay import log_runner, parallel_execution
from handctl.replay.controller_rebuild import rebuild_controller
from handctl.replay.log_execution import LogExecution, execute_log
from handctl.replay.tick_difference import state_difference

StateChange = Callable[[ControllerState, TickIn], None]
ExecuteSerialAndParallel = Callable[..., tuple[LogExecution, LogExecution]]


@pytest.fixture
def serial_and_parallel_executions(
    recorded_grasp_log: Path, monkeypatch: pytest.MonkeyPatch
) -> ExecuteSerialAndParallel:
    """Return a function that executes the ticks of a log twice: in one process, and in three processes.

    The first argument of the returned function is None, or a function that falsifies a number in the
    controller state. The other arguments are the times between which the log is executed [s].
    """

    def run(
        change_state: StateChange | None = None,
        from_s: float = -math.inf,
        until_s: float = math.inf,
    ) -> tuple[LogExecution, LogExecution]:
        original_tick = Controller.tick

        def tick(
            controller: Controller, state_before: ControllerState, entry: TickIn
        ) -> tuple[ControllerState, TickOut]:
            if change_state:
                change_state(state_before, entry)
            return original_tick(controller, state_before, entry)

        monkeypatch.setattr(Controller, "tick", tick)
        monkeypatch.setattr(parallel_execution, "MIN_TICKS_PER_PROCESS", 50)
        with RunLog(recorded_grasp_log) as log:
            one_process, three_processes = (
                execute_log(log, worker_count=count, from_s=from_s, until_s=until_s)
                for count in (1, 3)
            )
            return one_process, three_processes

    return run


def results_without_times(execution: LogExecution) -> dict[str, Any]:
    """Return all results of an execution except the measured times."""
    return {
        name: value for name, value in asdict(execution).items() if name not in ("wall_s", "cpu_s")
    }


def change_state_at_tick(field_name: str, first_wrong_tick: int) -> StateChange:
    """Return a function that changes the controller state before tick ``first_wrong_tick``.

    The returned function changes the field ``field_name`` of the second tendon.
    """

    def change_state(state_before: ControllerState, entry: TickIn) -> None:
        if entry.k == first_wrong_tick:
            state_before.view(field_name)[1] += 1e-9

    return change_state


def test_a_snapshot_restores_the_state_unchanged(recorded_grasp_log: Path) -> None:
    """A state that is restored from a snapshot has the same bytes and the same hash as the stored state.

    The test restores the state in every tick of a run with faults and requests. From the restored
    state, the next tick gives the same result as in the run.
    """
    with RunLog(recorded_grasp_log) as log:
        controller = rebuild_controller(log)
        state = controller.initial_state()
        for logged in log.ticks():
            repeated_state = restore_state(
                controller.derived_constants.layout, snapshot_bytes(state)
            )
            assert (repeated_state.digest(), snapshot_bytes(repeated_state)) == (
                state.digest(),
                snapshot_bytes(state),
            )
            assert serialized_decisions(state.decisions) == serialized_bytes(state.decisions)
            other_state, restored_output = controller.tick(repeated_state, logged.tick_in)
            state, out = controller.tick(state, logged.tick_in)
            assert (restored_output.state_hash, other_state.digest()) == (
                out.state_hash,
                logged.state_hash,
            )


@pytest.mark.parametrize("protocol", VERIFIABLE_PROTOCOLS)
def test_a_snapshot_restores_the_state_of_every_protocol(protocol: str) -> None:
    with homed_run(hand_with_protocol("jamia", protocol), 250.0, 0) as simulation:
        seen_modes = set()
        for _ in simulation.run_ticks(max_duration_s=10.0):
            if simulation.state.mode == HandMode.ACTIVE:
                break
            seen_modes.add(simulation.state.mode)
            repeated_state = restore_state(
                simulation.controller.derived_constants.layout, snapshot_bytes(simulation.state)
            )
            assert serialized_bytes(repeated_state.decisions) == serialized_decisions(
                simulation.state.decisions
            )
            assert repeated_state.digest() == simulation.state.digest()
    assert {HandMode.SILENT, HandMode.INVENTORY, HandMode.ARMING} <= seen_modes


def test_a_log_has_a_snapshot_every_half_second(recorded_grasp_log: Path) -> None:
    with RunLog(recorded_grasp_log) as log:
        times = dict(zip(log.k.tolist(), log.times.tolist(), strict=True))
        snapshot_times = [times[k] for k in log.snapshots]
        assert snapshot_times == pytest.approx(np.arange(0.5, log.times[-1], 0.5))


def test_three_processes_find_no_difference_where_one_finds_none(
    serial_and_parallel_executions: ExecuteSerialAndParallel,
) -> None:
    one_process, three_processes = serial_and_parallel_executions()
    assert results_without_times(three_processes) == results_without_times(one_process)
    assert (one_process.differing_ticks, three_processes.differing_ticks) == (0, 0)


@pytest.mark.parametrize("first_wrong_tick", [150, 199, 200, 201, 330])
def test_three_processes_find_the_first_difference_wherever_it_is(
    serial_and_parallel_executions: ExecuteSerialAndParallel, first_wrong_tick: int
) -> None:
    """One test case for each process changes a field of the controller state in the part that this process executes.

    In some test cases, the changed tick is at the border between two parts of the log.
    """
    one_process, three_processes = serial_and_parallel_executions(
        change_state_at_tick("travel", first_wrong_tick)
    )
    assert one_process.first_difference is not None
    assert results_without_times(three_processes) == results_without_times(one_process)


def test_the_first_field_of_the_state_that_differs_is_named(
    serial_and_parallel_executions: ExecuteSerialAndParallel,
) -> None:
    def change_state(state_before: ControllerState, entry: TickIn) -> None:
        if entry.k >= 150:
            state_before.view("nis_mean")[1] += 1e-6

    one_process, _ = serial_and_parallel_executions(change_state)
    assert one_process.first_state_difference is not None
    assert (one_process.first_state_difference.field, one_process.first_state_difference.k) == (
        "state nis_mean",
        200,
    )


def test_a_decision_that_differs_is_named(recorded_grasp_log: Path) -> None:
    with RunLog(recorded_grasp_log) as log:
        state, logged_tick = rebuild_controller(log).initial_state(), next(log.ticks())
        other_state = state.copy()
        other_state.decide(unconfirmed_motors=("index_motor",))
        assert state_difference(log.header, logged_tick, state, state) is None
        difference = state_difference(log.header, logged_tick, state, other_state)
    assert difference is not None
    assert (difference.field, difference.logged, difference.computed) == (
        "state unconfirmed_motors",
        "()",
        "('index_motor',)",
    )


def test_a_refusal_of_the_controller_is_reported_with_any_number_of_processes(
    serial_and_parallel_executions: ExecuteSerialAndParallel,
) -> None:
    def change_state(state_before: ControllerState, entry: TickIn) -> None:
        if entry.k == 330:
            raise ValueError("no such angle")

    with pytest.raises(LogError, match="no such angle"):
        serial_and_parallel_executions(change_state)


@pytest.mark.parametrize("first_wrong_tick", [None, 330, 450])
def test_a_fast_process_takes_over_ticks_of_a_slow_process(
    serial_and_parallel_executions: ExecuteSerialAndParallel,
    monkeypatch: pytest.MonkeyPatch,
    first_wrong_tick: int | None,
) -> None:
    """The calling process is slow, and the other processes execute more than their first ranges."""
    calling_process = os.getpid()
    parallel_executed_parts: list[parallel_execution.ExecutedPart] = []
    original_combined_tally = parallel_execution._combined_tally

    def combined_tally(
        runner: log_runner.LogRunner,
        whole: log_runner.LogPart,
        executed_parts: list[parallel_execution.ExecutedPart],
        progress: Callable[[int], None],
    ) -> log_runner.DifferenceTally:
        parallel_executed_parts.extend(executed_parts)
        return original_combined_tally(runner, whole, executed_parts, progress)

    def change_state(state_before: ControllerState, entry: TickIn) -> None:
        if os.getpid() == calling_process and entry.k < 150:
            time.sleep(0.005)
        if entry.k == first_wrong_tick:
            state_before.view("travel")[1] += 1e-9

    monkeypatch.setattr(parallel_execution, "_combined_tally", combined_tally)
    one_process, three_processes = serial_and_parallel_executions(change_state)
    assert results_without_times(three_processes) == results_without_times(one_process)
    assert len(parallel_executed_parts) > 3
    assert sum(part.stop - part.start for part in parallel_executed_parts) == one_process.ticks


@pytest.mark.parametrize(
    ("from_s", "until_s", "first_tick", "tick_count"),
    [
        (0.0, math.inf, 0, 653),
        (0.49, 1.0, 0, 200),
        (0.5, 0.51, 0, 102),
        (0.51, 0.52, 101, 3),
        (2.3, math.inf, 401, 252),
        (3.0, 3.005, 501, 100),
    ],
)
def test_a_part_of_a_log_is_executed_from_the_last_snapshot_before_it(
    recorded_grasp_log: Path,
    serial_and_parallel_executions: ExecuteSerialAndParallel,
    from_s: float,
    until_s: float,
    first_tick: int,
    tick_count: int,
) -> None:
    with RunLog(recorded_grasp_log) as log:
        start_time_s = log.times[first_tick]
    for execution in serial_and_parallel_executions(None, from_s, until_s):
        assert execution.start_time_s == start_time_s
        assert (execution.ticks, execution.differing_ticks) == (tick_count, 0)


@pytest.mark.parametrize(
    ("from_s", "until_s", "expected_first"), [(1.5, 1.65, None), (1.5, 1.66, 330), (2.1, 3.0, None)]
)
def test_a_part_of_a_log_contains_the_difference_or_not(
    serial_and_parallel_executions: ExecuteSerialAndParallel,
    from_s: float,
    until_s: float,
    expected_first: int | None,
) -> None:
    change_state = change_state_at_tick("travel", 330)
    for execution in serial_and_parallel_executions(change_state, from_s, until_s):
        first_difference = execution.first_difference
        assert (first_difference.k if first_difference else None) == expected_first


def test_a_wrong_snapshot_is_not_used_as_a_start(
    recorded_grasp_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parallel_execution, "MIN_TICKS_PER_PROCESS", 50)
    with RunLog(recorded_grasp_log) as log:
        runner = log_runner.LogRunner.from_log(log)
        whole = runner.part_of_time_range(-math.inf, math.inf)
        starts = runner.starts_after_snapshots()
        assert len(parallel_execution.split_log(runner, whole, 3, starts)) == 3
        changed_snapshots = {
            k: data[:100] + bytes([data[100] ^ 1]) + data[101:]
            for k, data in runner.snapshots.items()
        }
        wrong_snapshots = dict.fromkeys(runner.snapshots, b"x" * 40)
        for unusable_snapshots in (changed_snapshots, wrong_snapshots):
            other_runner = replace(runner, snapshots=unusable_snapshots)
            assert len(parallel_execution.split_log(other_runner, whole, 3, starts)) == 1
            assert other_runner.part_of_time_range(2.3, 3.0).start == 0
        monkeypatch.setattr(RunLog, "snapshots", changed_snapshots)
        assert execute_log(log, worker_count=3).differing_ticks == 0


@pytest.mark.parametrize(
    "snapshot_text",
    [
        "[]",
        "null",
        "{",
        "[" * 100_000,
        '[":core.types.Mode",77]',
        '[":os.system","true"]',
        '[":controller.state.Decisions"]',
        '[":array","O",[1],[":bytes","0000000000000000"]]',
    ],
)
def test_a_snapshot_with_other_objects_than_decisions_is_refused(
    recorded_grasp_log: Path, snapshot_text: str
) -> None:
    with RunLog(recorded_grasp_log) as log:
        controller = rebuild_controller(log)
        state = controller.initial_state()
        head = snapshot_bytes(state)[: 8 + state.block.nbytes]
        with pytest.raises(ValueError, match=r"."):
            restore_state(controller.derived_constants.layout, head + snapshot_text.encode())
