"""``handctl commission``: tare the load cells, zero the motors, prove each tendon's sign, write calibration.toml."""

import argparse
import datetime
import sys
from collections.abc import Mapping
from pathlib import Path

from handctl.cli.begin import announce
from handctl.cli.dry_run import told
from handctl.cli.options import print_json, run_options, say
from handctl.cli.plan import Plan, calibration_path, default_log, make_plan
from handctl.cli.session import Outcome, Runner, make_controller, remedy, run_live
from handctl.controller.calibration import Calibration, TendonCalibration, load_calibration
from handctl.controller.commission import CommissionProgram, result
from handctl.controller.identified import Identified
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.toml_text import toml_text
from handctl.output import write_whole

EXAMPLE = "handctl commission --hand jamia --bus local:demo --calibration /tmp/jamia.calibration.toml --dry-run"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    run_options(parser)


def run(args: argparse.Namespace) -> int:
    """Commission the hand; each tendon is pulled with 3 N."""
    plan = make_plan(args)
    path = calibration_path(args, plan.hand)
    if args.dry_run:
        line = f"{plan.hand.name}: ready to commission at {plan.rate_hz:g} Hz, would write {path}"
        return told(plan, line, calibration=path)
    announce(args, plan, path, None)
    log = args.log or default_log(plan.hand, "commission")
    calibration, outcome = commission(plan, log, run_live)
    calibration = calibration.model_copy(update={"identified": kept(path, plan.hand, calibration.drive)})
    write_calibration(path, calibration)
    if args.json:
        print_json({"calibration": str(path), "log": str(log), **calibration.model_dump(by_alias=True)})
    else:
        print(f"calibration written to {path}")
    return outcome.exit


VIRTUAL_DATE = datetime.datetime.fromtimestamp(0, datetime.UTC)


def commission(plan: Plan, log: Path, runner: Runner) -> tuple[Calibration, Outcome]:
    """Run the commissioning program.

    Args:
        plan: of the run.
        log: file to write.
        runner: how to run it.

    Raises:
        DriveError: a tendon, sensor or drive did not pass; as ``Outcome.refuse_unfinished``.
    """
    controller = make_controller(plan, CommissionProgram(), None, arm_at_once=True)
    outcome = runner(plan, controller, log)
    outcome.refuse_unfinished(f"commissioning {plan.hand.name}", remedy(plan, outcome))
    virtual = outcome.priority is None  # in lockstep there is no date, or no two runs would be the same
    now = VIRTUAL_DATE if virtual else datetime.datetime.now(datetime.UTC)
    calibration = result(controller.model, outcome.state.progress, now.isoformat(timespec="seconds"))
    there = zip(controller.drives, outcome.state.drives, strict=True)
    drives = {drive.name: drive.identity(known) for drive, known in there}
    return calibration.model_copy(update={"drive": drives}), outcome


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write the file; its rows are tables by tendon."""
    rows = calibration.model_dump(by_alias=True)
    tables = {f"tendon.{name}": row for name, row in rows.pop("tendon").items()}
    tables |= {f"identified.{name}": row for name, row in rows.pop("identified").items()}
    if not rows["drive"]:
        del rows["drive"]
    text = toml_text(rows) + "".join(f"\n[{name}]\n{toml_text(row)}" for name, row in tables.items())
    write_whole(path, text)


def kept(path: Path, hand: Hand, drives: Mapping[str, str]) -> dict[str, Identified]:
    """What was identified before: a new tare does not change what the hand is made of; nothing of another hand.

    Args:
        path: of the calibration before.
        hand: description.
        drives: that were there now, by motor; empty if unknown.
    """
    try:
        before = load_calibration(path, hand) if path.exists() else None
    except ConfigError:
        return {}
    if before is None:
        return {}
    if drives and before.drive and before.drive != drives:
        if before.identified:
            say(f"handctl: caution: {path}: was of other drives, what was identified with them is left out", error=True)
        return {}
    return before.identified


Known = dict[str, Identified]
"""Identified parameters by tendon."""


def identified_in(path: Path | None, hand: Hand) -> Known:
    """Return what a calibration file says was identified; nothing without a file.

    Tares and zeros of a simulated hand are of one seed and one start, what was identified is not.

    Raises:
        ConfigError: the file cannot be read, is of another hand, or holds nothing identified.
    """
    if path is None:
        return {}
    found = load_calibration(path, hand).identified
    if not found:
        raise ConfigError("holds nothing identified", str(path), "a calibration that handctl identify wrote")
    return found


def homed(hand: Hand, known: Known) -> Calibration:
    """Return the calibration of a simulated hand that starts taut with its encoders at zero."""
    zero = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=0.0, crosstalk_N=0.0)
    rows = dict.fromkeys(hand.tendon_names, zero)
    made = VIRTUAL_DATE.isoformat(timespec="seconds")
    return Calibration(hand=hand.name, identity=hand.identity, made=made, tendon=rows, identified=known)


def ensure_calibration(plan: Plan, path: Path, why: str, runner: Runner, log: Path) -> Calibration:
    """Commission a hand that cannot be armed otherwise, and say so."""
    print(f"commissioning {plan.hand.name} first: {why}", file=sys.stderr)
    calibration, _ = commission(plan, log, runner)
    calibration = calibration.model_copy(update={"identified": kept(path, plan.hand, calibration.drive)})
    write_calibration(path, calibration)
    return calibration
