"""Test the exit code of commands if a drive does not confirm that it is disabled.

If a drive does not confirm that it is disabled, every command exits with code 71, even if other
errors occurred.
"""

import pytest

from handctl.cli.checks import conformance
from handctl.cli.console import bench_drive
from handctl.cli.main import main
from handctl.cli.runs import commission
from handctl.cli.tuning import identify
from handctl.drives.discovery import DiscoveredNode
from handctl.errors import PowerError
from handctl.runtime.diagnostics.drive_rig import DriveRig
from handctl.runtime.loop import LoopStats
from handctl.session.run import RunOutcome
from tests.runtime.run_without_nodes import EmptyBus

FAILURE_TEXT = "fault B17 index_motor; REMOVE POWER: not confirmed disabled: index_motor"


def outcome_with_enabled_motor(plan, controller, log_path):
    """Return the outcome of a run in which a motor did not confirm that it is disabled."""
    state = controller.initial_state()
    state.decide(failure=FAILURE_TEXT, unconfirmed_motors=("index_motor",))
    return RunOutcome(state, LoopStats(), {}, None, 0)


@pytest.mark.parametrize(
    ("command_module", "cli_verb"), [(commission, "commission"), (identify, "identify")]
)
def test_the_exit_code_reports_a_motor_left_enabled(
    work_folder, monkeypatch, capsys, command_module, cli_verb
):
    monkeypatch.setattr(command_module, "run_live", outcome_with_enabled_motor)
    assert main([cli_verb, "--bus", "local:nobody", "--log", "run.mcap"]) == 71
    assert "REMOVE POWER" in capsys.readouterr().err


def test_a_motor_left_on_by_a_bug_is_reported_after_the_traceback(work_folder, monkeypatch, capsys):
    def raise_power_error(plan, controller, log):
        raise PowerError(
            "REMOVE POWER: not confirmed disabled: index_motor"
        ) from ZeroDivisionError("in a tick")

    monkeypatch.setattr(commission, "run_live", raise_power_error)
    assert main(["commission", "--bus", "local:nobody", "--log", "run.mcap"]) == 71
    *earlier_lines, last_line = capsys.readouterr().err.splitlines()
    assert "ZeroDivisionError: in a tick" in earlier_lines
    assert last_line == "handctl: REMOVE POWER: not confirmed disabled: index_motor"


@pytest.mark.parametrize(("drive_is_off", "exit_code"), [(False, 71), (True, 130)])
def test_a_check_that_is_interrupted_says_whether_the_drive_is_off(
    monkeypatch, capsys, drive_is_off, exit_code
):
    def raise_interrupt(device):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(conformance, "run_checks", raise_interrupt)
    monkeypatch.setattr(bench_drive, "open_bus", lambda *arguments: EmptyBus())
    monkeypatch.setattr(conformance, "find_drive", lambda args: DiscoveredNode("mit", 1))
    monkeypatch.setattr(DriveRig, "confirm_disabled", lambda rig, watchdog_s: drive_is_off)
    words = (
        "--protocol",
        "mit",
        "--node",
        "1",
        "--bus",
        "local:nobody",
        "--torque-limit-Nm",
        "0.1",
        "--yes",
    )
    assert main(["conformance", *words]) == exit_code
    assert ("REMOVE ITS POWER" in capsys.readouterr().err) != drive_is_off
