"""``handctl commission``: tare load cells, zero motors, check the sign of each tendon, and write the calibration."""

import argparse

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import print_json
from handctl.cli.console.plan import calibration_path, make_plan
from handctl.session.calibration import (
    previous_identified_parameters,
    run_commissioning,
    write_calibration,
)
from handctl.session.run import run_live
from handctl.session.run_plan import default_log_path


def run(args: argparse.Namespace) -> int:
    """Commission a hand with a tension of 3 N in each tendon, and return the exit code."""
    plan = make_plan(args)
    path = calibration_path(args, plan.hand)
    if args.dry_run:
        line = f"{plan.hand.name}: ready to commission at {plan.rate_hz:g} Hz, would write {path}"
        return report_dry_run(args, plan, line, calibration=path)
    announce_motion(args, plan, path, None)
    log = args.log or default_log_path(plan.hand, "commission")
    calibration, outcome = run_commissioning(plan, log, run_live)
    previous_parameters = previous_identified_parameters(
        path, plan.hand, calibration.drive, plan.show_notice
    )
    calibration = calibration.model_copy(update={"identified": previous_parameters})
    write_calibration(path, calibration)
    if args.json:
        print_json(
            {"calibration": str(path), "log": str(log), **calibration.model_dump(by_alias=True)}
        )
    else:
        print(f"calibration written to {path}")
    return outcome.exit_code
