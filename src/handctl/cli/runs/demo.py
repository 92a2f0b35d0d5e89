"""``handctl demo``: grasp an object with a simulated hand over a local CAN bus.

The demo needs no hardware.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.options import (
    perturb_arguments,
    wire_arguments,
)
from handctl.cli.console.plan import make_plan
from handctl.cli.console.verbosity import print_note
from handctl.cli.runs.protocol_hand_file import use_protocol_hand_file
from handctl.cli.runs.run import print_run_result
from handctl.errors import BusError, ConfigError, DriveError
from handctl.hand.hand_loading import load_hand
from handctl.programs.task_program import TaskProgram
from handctl.runtime.socket_paths import truth_path
from handctl.session.calibration import (
    IdentifiedParametersByTendon,
    identified_parameters_in_file,
    run_commissioning,
    write_calibration,
)
from handctl.session.exit_codes import ExitCode
from handctl.session.gains import gain_assignments
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import (
    RunFunction,
    RunOutcome,
    make_controller,
    refuse_view_without_screen,
    run_live,
    run_lockstep,
)
from handctl.session.run_plan import RunPlan, commissioning_log_path, default_log_path
from handctl.session.task_loading import load_task_for_hand, scene_for_hand

SIMULATOR_PACKAGE = "firmware_sim"
START_TIMEOUT_S = 20.0


def run(args: argparse.Namespace) -> int:
    """Simulate and commission a hand, run a task on the hand, and report the result.

    Return the exit code.
    """
    refuse_view_without_screen(args.view and not args.lockstep)
    with use_protocol_hand_file(args):
        return _run_demo(args)


def _run_demo(args: argparse.Namespace) -> int:
    """Run the demo, and return the exit code.

    The simulator and the controller read the same hand file.
    """
    if args.lockstep and args.time_scale != 1:
        raise ConfigError(
            f"{args.time_scale:g}",
            "--time-scale",
            "1 with --lockstep, which does not run in real time",
        )
    args.bus = _bus_option_values(load_hand(args.hand).bus_names)
    plan = make_plan(args, lockstep=args.lockstep)
    task, text = load_task_for_hand(args.task, plan.hand)
    args.scene = scene_for_hand(args.scene, plan.hand)
    gain_assignments(args.perturb, "--perturb")
    identified = identified_parameters_in_file(args.calibration, plan.hand)
    if args.dry_run:
        _make_simulated_hand(args, None).check_hand_constructible()
        line = f"{plan.hand.name}: {task.name} on {args.scene}, {plan.rate_hz:g} Hz"
        return report_dry_run(args, plan, line, task=task.name, scene=args.scene)
    log = args.log or default_log_path(plan.hand, "demo")
    _check_not_overwritten(_calibration_path(log), log)
    plan.attachments["task.toml"] = text
    start_time_s = time.monotonic()
    if args.lockstep:
        outcome, truth = _run_in_lockstep(args, plan, TaskProgram(task), log, identified)
    else:
        outcome = _run_in_real_time(args, plan, TaskProgram(task), log, identified)
        truth = truth_path(plan.buses[0])
    wall_time_s = time.monotonic() - start_time_s
    # the imported module reads the log, so it is needed only after the run
    from handctl.session.verdict import judge_run

    result = judge_run(plan, outcome, log, truth, task=task)
    if result["truth"] != str(truth):  # a copy of the truth file lies next to the log
        truth.unlink(missing_ok=True)
    result |= _simulation_speed_fields(outcome, plan, wall_time_s) if args.lockstep else {}
    code = print_run_result(result, outcome, plan, args.json)
    if code == ExitCode.DONE and result["failure"]:
        print(
            f"handctl: {DriveError(result['failure'], f'{task.name} on {args.scene}')}",
            file=sys.stderr,
        )
        return ExitCode.FAILED
    return code


def _calibration_path(log: Path) -> Path:
    """Return the path of the file with the calibration of the simulated hand."""
    return log.with_suffix(".calibration.toml")


def _check_not_overwritten(path: Path, log: Path) -> None:
    """Check that a file of the demo does not exist yet.

    The demo overwrites no file, because an existing file could be the calibration of a real hand.

    Raises:
        ConfigError: the file exists.
    """
    if path.exists():
        raise ConfigError(f"would overwrite {path}", f"--log {log}", "another name for the log")


def _bus_option_values(names: tuple[str, ...]) -> list[str]:
    """Return the values of the option ``--bus`` for a hand.

    Each bus of the hand becomes a local bus of this process.
    """
    spec = f"local:demo-{os.getpid()}"
    return [spec] if len(names) == 1 else [f"{name}={spec}-{name}" for name in names]


def _run_in_real_time(
    args: argparse.Namespace,
    plan: RunPlan,
    program: TaskProgram,
    log: Path,
    identified: IdentifiedParametersByTendon,
) -> RunOutcome:
    """Run the demo in real time. The simulator is a separate process."""
    runners = (run_live, partial(run_live, live_view=args.view))
    with running_simulator(args, plan):
        return _commission_and_run(plan, program, log, runners, identified)


def _commission_and_run(
    plan: RunPlan,
    program: TaskProgram,
    log: Path,
    run_functions: tuple[RunFunction, RunFunction],
    identified: IdentifiedParametersByTendon,
) -> RunOutcome:
    """Commission the hand, and then run the program.

    In the run of the program, the controller uses parameters that were identified in an earlier
    run.
    """
    first_function, second_function = run_functions
    print_note(f"commissioning {plan.hand.name}: tare, zero, and a 3 N pull of each tendon")
    calibration, _ = run_commissioning(plan, commissioning_log_path(log), first_function)
    calibration = calibration.model_copy(update={"identified": identified})
    path = _calibration_path(log)
    write_calibration(path, calibration)
    plan.attachments["calibration.toml"] = path.read_bytes()
    return second_function(plan, make_controller(plan, program, calibration, arm_at_once=True), log)


def _run_in_lockstep(
    args: argparse.Namespace,
    plan: RunPlan,
    program: TaskProgram,
    log: Path,
    identified: IdentifiedParametersByTendon,
) -> tuple[RunOutcome, Path]:
    """Run the demo in virtual time. Return the outcome and the path of the truth file."""
    truth = log.with_suffix(".truth")
    with _make_simulated_hand(args, truth).lockstep_clock(plan.period_ns) as clock:
        runner = partial(run_lockstep, clock=clock)
        return _commission_and_run(plan, program, log, (runner, runner), identified), truth


def _make_simulated_hand(args: argparse.Namespace, truth: Path | None) -> SimulatorSettings:
    """Return the settings of the simulated hand for a run in lockstep."""
    perturb = gain_assignments(args.perturb, "--perturb")
    return SimulatorSettings(args.hand, args.scene, args.seed, perturb, truth=truth, wire=args.wire)


def _simulation_speed_fields(outcome: RunOutcome, plan: RunPlan, wall_s: float) -> dict[str, Any]:
    """Return three fields of the result: simulated time, real time, and the ratio of both.

    The simulated time and the real time include the commissioning of the hand.
    """
    simulated_s = (outcome.offset_ns + outcome.state.k * plan.period_ns) / 1e9
    return {
        "lockstep": True,
        "simulated_s": simulated_s,
        "wall_s": wall_s,
        "times_real_time": simulated_s / wall_s,
    }


@contextmanager
def running_simulator(args: argparse.Namespace, plan: RunPlan) -> Iterator[None]:
    """Start the simulator as a separate process. Stop the simulator at the end of the context.

    Raises:
        BusError: the simulator does not start.
    """
    command = [sys.executable, "-m", SIMULATOR_PACKAGE, "--hand", str(args.hand)]
    command += ["--scene", str(args.scene), "--seed", str(args.seed), *wire_arguments(args)]
    command += [
        "--time-scale",
        str(plan.time_scale),
        *["--strict-clock"] * args.strict_clock,
        *perturb_arguments(args),
    ]
    for name, spec in zip(plan.hand.bus_names, plan.buses, strict=True):
        command += ["--bus", f"{name}={spec}"]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert child.stdout is not None
        line = child.stdout.readline()
        if "ready" not in line:
            if child.wait(START_TIMEOUT_S) == ExitCode.BAD_INPUT:
                raise SystemExit(ExitCode.BAD_INPUT)  # the simulator has already printed the reason
            raise BusError(
                "the simulator did not start", SIMULATOR_PACKAGE, "a line that says ready"
            )
        yield
    finally:
        child.terminate()
        try:
            child.wait(START_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            child.kill()
