"""``handctl commission``: tare the load cells, zero the motors, prove each tendon's sign, write calibration.toml."""

import argparse
import datetime
import sys
from pathlib import Path

from handctl.cli.options import print_json, run_options
from handctl.cli.plan import Plan, default_log, find_calibration, make_plan
from handctl.cli.session import Outcome, Runner, make_controller, run_live
from handctl.controller.calibration import Calibration
from handctl.controller.commission import CommissionProgram, result
from handctl.errors import DriveError
from handctl.hand.toml_text import toml_text

EXAMPLE = "handctl commission --hand jamia --bus local:demo --calibration /tmp/jamia.calibration.toml --dry-run"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    run_options(parser)


def run(args: argparse.Namespace) -> int:
    """Commission the hand; each tendon is pulled with 3 N."""
    plan = make_plan(args)
    path, _, _ = find_calibration(args, plan.hand) if not args.calibration else (args.calibration, None, "")
    if args.dry_run:
        print(f"{plan.hand.name}: ready to commission at {plan.rate_hz:g} Hz, would write {path}")
        return 0
    log = args.log or default_log(plan.hand, "commission")
    calibration, outcome = commission(plan, log, run_live)
    write_calibration(path, calibration)
    if args.json:
        print_json({"calibration": str(path), "log": str(log), **calibration.model_dump(by_alias=True)})
    else:
        print(f"calibration written to {path}")
    return outcome.exit


def commission(plan: Plan, log: Path, runner: Runner) -> tuple[Calibration, Outcome]:
    """Run the commissioning program.

    Args:
        plan: of the run.
        log: file to write.
        runner: how to run it.

    Raises:
        DriveError: a tendon, sensor or drive did not pass.
    """
    controller = make_controller(plan, CommissionProgram(), None, arm_at_once=True)
    outcome = runner(plan, controller, log)
    if outcome.state.failure or not outcome.state.progress.finished:
        raise DriveError(outcome.state.failure or "stopped before the end", f"commissioning {plan.hand.name}")
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return result(controller.model, outcome.state.progress, now), outcome


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write the file; its rows are tables by tendon."""
    rows = calibration.model_dump(by_alias=True)
    tendons = rows.pop("tendon")
    text = toml_text(rows) + "".join(f"\n[tendon.{name}]\n{toml_text(row)}" for name, row in tendons.items())
    path.write_text(text)


def ensure_calibration(plan: Plan, path: Path, why: str, runner: Runner, log: Path) -> Calibration:
    """Commission a hand that cannot be armed otherwise, and say so."""
    print(f"commissioning {plan.hand.name} first: {why}", file=sys.stderr)
    calibration, _ = commission(plan, log, runner)
    write_calibration(path, calibration)
    return calibration
