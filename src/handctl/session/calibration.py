"""The calibration of a run: found, or made by commissioning the hand first."""

import datetime
import time
from collections.abc import Mapping
from pathlib import Path

from handctl.core.identified import Identified
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.toml_text import toml_text
from handctl.output import write_whole
from handctl.programs.calibration import Calibration, TendonCalibration, load_calibration
from handctl.programs.commission import CommissionProgram, result
from handctl.session.notices import Tell, silent
from handctl.session.pace import remedy
from handctl.session.plan import Plan
from handctl.session.run import Outcome, Runner, make_controller

FRESH_S = 24 * 3600.0
"""A calibration older than this is not armed with: load cells drift and ropes creep."""
VIRTUAL_DATE = datetime.datetime.fromtimestamp(0, datetime.UTC)
Known = dict[str, Identified]
"""Identified parameters by tendon."""


def find_calibration(path: Path, hand: Hand, named: bool) -> tuple[Calibration | None, str]:
    """Read the hand's calibration file, if it is good enough to arm with.

    Args:
        path: where it is or shall be.
        hand: that is to be armed.
        named: whether the operator has named it: then it must be good.

    Returns:
        the calibration or None, and why it is None.

    Raises:
        ConfigError: the file that is named is there and cannot be used.
    """
    if not path.exists():
        return None, f"there is no {path}"
    try:
        calibration = load_calibration(path, hand)
    except ConfigError as error:
        if named:
            raise
        return None, str(error)
    made = datetime.datetime.fromisoformat(calibration.made).timestamp()
    if time.time() - made > FRESH_S:
        return None, f"{path} is older than a day"
    return calibration, ""


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


def kept(path: Path, hand: Hand, drives: Mapping[str, str], tell: Tell = silent) -> Known:
    """What was identified before: a new tare does not change what the hand is made of; nothing of another hand.

    Args:
        path: of the calibration before.
        hand: description.
        drives: that were there now, by motor; empty if unknown.
        tell: takes a notice for the operator.
    """
    try:
        before = load_calibration(path, hand) if path.exists() else None
    except ConfigError:
        return {}
    if before is None:
        return {}
    if drives and before.drive and before.drive != drives:
        if before.identified:
            tell(f"handctl: caution: {path}: was of other drives, what was identified with them is left out")
        return {}
    return before.identified


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
    """Commission a hand that cannot be armed otherwise, and say so.

    Args:
        plan: of the run that follows.
        path: of the calibration to write.
        why: there is none.
        runner: how to run it.
        log: file to write.

    Raises:
        DriveError: as ``commission``.
    """
    plan.tell(f"commissioning {plan.hand.name} first: {why}")
    calibration, _ = commission(plan, log, runner)
    calibration = calibration.model_copy(update={"identified": kept(path, plan.hand, calibration.drive, plan.tell)})
    write_calibration(path, calibration)
    return calibration
