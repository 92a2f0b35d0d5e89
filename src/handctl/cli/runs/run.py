"""``handctl run``: run a task on a hand, write a log, and report the result."""

import argparse
import sys
from functools import partial
from typing import Any

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import print_json
from handctl.cli.console.plan import find_calibration, make_plan
from handctl.cli.runs.stdin_watch import StdinWatch
from handctl.errors import ConfigError, DriveError
from handctl.hand.file.toml_text import toml_text
from handctl.programs.live_session import LiveProgram
from handctl.programs.playback import PlaybackProgram
from handctl.programs.program import Program
from handctl.programs.task_program import TaskProgram
from handctl.runtime.socket_paths import truth_path
from handctl.session.calibration import ensure_calibration
from handctl.session.run import RunOutcome, make_controller, refuse_view_without_screen, run_live
from handctl.session.run_plan import RunPlan, commissioning_log_path, default_log_path
from handctl.session.task_loading import load_task_for_hand, load_trajectory_for_hand
from handctl.session.time_scale_advice import late_run_advice


def run(args: argparse.Namespace) -> int:
    """Run a task on a hand, and return the exit code."""
    refuse_view_without_screen(args.view)
    plan = make_plan(args)
    program, attached = _program_and_attachments(args, plan)
    path, calibration, reason = find_calibration(args, plan.hand, plan.buses)
    if args.dry_run:
        load = f"bus load {100 * max(plan.bus_loads):.0f} %"
        summary = f"{plan.hand.name}: all files are valid; {plan.rate_hz:g} Hz, {load}"
        next_step = (
            f"the hand would be commissioned first: {reason}"
            if reason
            else "the hand is commissioned"
        )
        return report_dry_run(args, plan, summary, next_step, commissioning=reason)
    announce_motion(args, plan, path, calibration)
    log = args.log or default_log_path(plan.hand)
    if calibration is None:
        runner = partial(run_live, observer=StdinWatch() if args.until_eof else None)
        calibration = ensure_calibration(plan, path, reason, runner, commissioning_log_path(log))
    plan.attachments.update(attached | {"calibration.toml": path.read_bytes()})
    controller = make_controller(plan, program, calibration, arm_at_once=True)
    stdin_watch = StdinWatch() if args.until_eof else None
    outcome = run_live(plan, controller, log, live_view=args.view, observer=stdin_watch)
    # the imported module reads the log, so it is needed only after the run
    from handctl.session.verdict import judge_run

    truth = args.truth or truth_path(plan.buses[0])
    result = judge_run(plan, outcome, log, truth if truth.exists() else None)
    return print_run_result(result, outcome, plan, args.json)


def _program_and_attachments(
    args: argparse.Namespace, plan: RunPlan
) -> tuple[Program, dict[str, bytes]]:
    """Return the program of the task or dataset, and the files to attach to the log.

    If neither a task nor a dataset is given, the program waits for requests.

    Raises:
        ConfigError: the content of a file is wrong, or an episode is given without a dataset.
    """
    if args.dataset is not None:
        from handctl.replay.dataset_episode import find_episode

        period = plan.period_ns * 1e-9
        return PlaybackProgram(
            find_episode(args.dataset, args.episode or 0, plan.hand, period, args.speed)
        ), {}
    for name in ("episode", "speed"):
        if getattr(args, name) is not None:
            raise ConfigError(f"{getattr(args, name):g}", f"--{name}", "only with --dataset")
    if args.trajectory is not None:
        task = load_trajectory_for_hand(args.trajectory, plan.hand)
        return TaskProgram(task), {"task.toml": toml_text(task.model_dump(by_alias=True)).encode()}
    if args.task is None:
        return LiveProgram(), {}
    task, text = load_task_for_hand(args.task, plan.hand)
    return TaskProgram(task), {"task.toml": text}


def print_run_result(
    run_result: dict[str, Any], outcome: RunOutcome, plan: RunPlan, as_json: bool
) -> int:
    """Print the result of a run, and return the exit code."""
    if as_json:
        print_json(run_result)
    else:
        from handctl.cli.console.verdict import print_summary

        print_summary(run_result, plan)
    if outcome.state.failure:
        print(
            f"handctl: {DriveError(outcome.state.failure, right=late_run_advice(plan, outcome))}",
            file=sys.stderr,
        )
    return outcome.exit_code
