"""Test runs that fail when they start.

If the start of a run fails, the recorder and the buses that are already open must be closed.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from handctl.cli.checks import bus_watch
from handctl.cli.main import main
from handctl.errors import BusError
from handctl.log.read.record_scan import scan_path
from handctl.log.write.recorder import Recorder
from handctl.runtime.loop import StopSignals
from handctl.session import run
from handctl.session.lockstep_simulation import SimulatorSettings
from tests.drives.protocol_bench import hand_file, move_to_second_bus
from tests.runtime.run_without_nodes import EmptyBus, plan_and_controller


class StartError(Exception):
    """Error that a test raises while a run starts."""


class ClosableDisplay:
    """A fake display process that shows nothing."""

    def __init__(self):
        self.closed = False

    def show_tick(self, entry, out):
        return

    def close(self):
        self.closed = True


def raise_error(*arguments, **options):
    raise StartError


@pytest.fixture
def started_recorders(tmp_path, monkeypatch):
    """Return the list of all recorders that a test starts."""
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "h"))
    started = []
    start = Recorder.start

    def start_recorder(*words):
        started.append(start(*words))
        return started[-1]

    monkeypatch.setattr(run.Recorder, "start", start_recorder)
    return started


def check_recorder_closed(recorder: Recorder, log_path: Path) -> None:
    """Check that a recorder process has ended, and that its log has an end mark."""
    assert recorder._child.poll() is not None
    assert scan_path(log_path).is_complete


def check_failed_lockstep_run(started_recorders, work_folder, start_display):
    """Check that a run in lockstep closes its recorder if its display fails."""
    path, plan, controller = plan_and_controller(work_folder, start_display)
    log = work_folder / "run.mcap"
    with (
        SimulatorSettings(path, homed=True).lockstep_clock(plan.period_ns) as clock,
        pytest.raises(StartError),
    ):
        run.run_lockstep(plan, controller, log, clock)
    (recorder,) = started_recorders
    check_recorder_closed(recorder, log)


@pytest.mark.parametrize("failing_step", ["display", "view", "handlers"])
def test_a_live_run_that_does_not_start_closes_its_recorder(
    failing_step, started_recorders, tmp_path, monkeypatch
):
    buses = []
    monkeypatch.setattr(run, "open_bus", lambda *words: buses.append(EmptyBus()) or buses[-1])
    display = ClosableDisplay()
    if failing_step == "view":
        monkeypatch.setattr(run, "_start_view", raise_error)
    if failing_step == "handlers":
        monkeypatch.setattr(StopSignals, "install_handlers", raise_error)
    _, plan, controller = plan_and_controller(
        tmp_path, raise_error if failing_step == "display" else lambda plan: display
    )
    plan = replace(plan, buses=("local:x",))
    log = tmp_path / "run.mcap"
    with pytest.raises(StartError):
        run.run_live(plan, controller, log, live_view=failing_step == "view")
    (recorder,) = started_recorders
    check_recorder_closed(recorder, log)
    assert display.closed == (failing_step != "display")
    assert [bus.closed for bus in buses] == [True]


def test_a_lockstep_run_that_does_not_start_closes_its_recorder(started_recorders, tmp_path):
    check_failed_lockstep_run(started_recorders, tmp_path, raise_error)


def test_a_display_that_does_not_close_leaves_no_recorder(started_recorders, tmp_path):
    display = ClosableDisplay()
    display.close = raise_error
    check_failed_lockstep_run(started_recorders, tmp_path, lambda plan: display)


def test_bus_watch_closes_the_first_bus_if_the_second_does_not_open(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "h"))
    hand = move_to_second_bus(hand_file(tmp_path, ["mit"]))
    first_closable_bus = EmptyBus()

    def open_only_first_bus(spec, index, *words):
        if index:
            raise BusError("is missing", spec, "a bus")
        return first_closable_bus

    monkeypatch.setattr(bus_watch, "open_bus", open_only_first_bus)
    words = ["--hand", str(hand), "--bus", "main=local:x", "--bus", "second=local:y"]
    assert main(["bus", "watch", *words]) == 1
    assert "is missing" in capsys.readouterr().err
    assert first_closable_bus.closed
