"""``handctl replay drive``: repeat a recorded motion on the hand, and compare the new run with the recorded run."""

import argparse
from dataclasses import replace

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import print_escaped, print_json, warn_if_lossy
from handctl.cli.console.plan import find_calibration, make_plan
from handctl.log.read.reader import RunLog
from handctl.replay.controller_rebuild import logged_hand
from handctl.replay.motion_replay import (
    active_interval,
    compare_replay,
    count_missing_ticks,
    followed_duration_s,
    playback_program,
)
from handctl.replay.run_comparison import check_same_hand, difference_lines
from handctl.session.calibration import ensure_calibration
from handctl.session.exit_codes import ExitCode
from handctl.session.run import make_controller, run_live
from handctl.session.run_plan import commissioning_log_path, default_log_path


def run(args: argparse.Namespace) -> int:
    """Repeat the recorded motion, compare the new log with the recorded log, and return the exit code."""
    with RunLog(args.recorded) as original_log:
        plan = make_plan(args)
        check_same_hand(original_log, plan.hand.name, plan.hand.identity, f"--hand {args.hand}")
        # Refuse a log whose hand cannot be loaded, because the names of the columns come from the
        # hand.
        logged_hand(original_log)
        program = playback_program(original_log, plan.period_ns * 1e-9, args.raw)
        path, calibration, reason = find_calibration(args, plan.hand, plan.buses)
        start_s, end_s = active_interval(original_log)
        is_incomplete = warn_if_lossy(args.recorded, original_log.warning)
        if missing_tick_count := count_missing_ticks(original_log):
            print_escaped(
                f"handctl: caution: {args.recorded}: {missing_tick_count} ticks are missing; the gap is bridged by "
                "interpolation",
                error=True,
            )
        if args.dry_run:
            line = f"{plan.hand.name}: would drive {end_s - start_s:.2f} s of {args.recorded} at {plan.rate_hz:g} Hz"
            report_dry_run(
                args, plan, line, log=args.recorded, seconds=end_s - start_s, commissioning=reason
            )
            return is_incomplete
        announce_motion(args, plan, path, calibration)
        log = args.log or default_log_path(plan.hand, "replay")
        if calibration is None:
            calibration = ensure_calibration(
                plan, path, reason, run_live, commissioning_log_path(log)
            )
        plan = replace(plan, attachments=plan.attachments | {"calibration.toml": path.read_bytes()})
        outcome = run_live(plan, make_controller(plan, program, calibration, arm_at_once=True), log)
        with RunLog(log) as replayed_log:
            result = compare_replay(original_log, replayed_log)
            seconds = followed_duration_s(original_log, replayed_log)
    is_complete = outcome.state.progress.finished
    fields = {
        "seconds": end_s - start_s,
        "driven_s": seconds,
        "complete": is_complete,
        "failure": outcome.state.failure,
    }
    if args.json:
        print_json(
            {"recorded": str(args.recorded), "log": str(log), "raw": args.raw, **fields, **result}
        )
    else:
        for line in (*difference_lines(result), f"new log: {log}"):
            print_escaped(line)
    if not is_complete:
        reason = outcome.state.failure or "stopped"
        print_escaped(
            f"handctl: {reason}: {seconds:.2f} of {end_s - start_s:.2f} s were driven", error=True
        )
    if outcome.exit_code != ExitCode.DONE:
        return outcome.exit_code
    return is_incomplete if is_complete else ExitCode.FAILED
