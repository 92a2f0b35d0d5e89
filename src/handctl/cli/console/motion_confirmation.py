"""Notice about the files that a run uses, and confirmation by the operator before a hand moves."""

import argparse
import datetime
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

from handctl.cli.console.options import print_escaped
from handctl.cli.console.verbosity import print_note
from handctl.core.calibration import Calibration
from handctl.core.gains.gains import load_gains_file
from handctl.errors import ConfigError
from handctl.runtime.buses.bus_opening import real_buses
from handctl.session.run_plan import RunPlan

MINUTE_S = 60.0
HOUR_S = 3600.0
DAY_S = 86400.0


def announce_motion(
    args: argparse.Namespace, plan: RunPlan, path: Path, calibration: Calibration | None
) -> None:
    """Print the files that a run uses.

    On a real bus, also ask the operator whether the hand is allowed to move.

    Args:
        args: arguments with ``yes``, ``gains`` and ``calibration``.
        plan: plan of the run.
        path: path of the calibration file.
        calibration: content of the calibration file. If ``calibration`` is None, the hand is
            commissioned before the run.

    Raises:
        ConfigError: the operator refuses the motion, or there is no terminal on which to ask.
    """
    files = []
    gains = Path(f"{plan.hand.name}.gains.toml")
    if not args.gains and "gains.toml" in plan.attachments:
        files.append(_file_text("gains", gains, load_gains_file(gains).provenance.made))
    if not args.calibration and calibration:
        files.append(_file_text("calibration", path, calibration.made))
    if files:
        print_note(f"handctl: found in this folder: {'; '.join(files)}")
    if calibration and not calibration.drive:
        text = "does not name its drives, so any hand of this design would be armed with it"
        print_escaped(
            f"handctl: caution: {path} {text}; handctl commission writes a file that names them",
            error=True,
        )
    if hardware_buses := real_buses(plan.buses):
        joints = ", ".join(plan.hand.digit_names)
        confirm_motion(
            f"{plan.hand.name} on {', '.join(hardware_buses)} is armed and moves {joints}", args.yes
        )


def _file_text(file_kind: str, path: Path, creation_date: str) -> str:
    """Return the kind, the path and the age of a file in one text.

    The age is counted from the date in the file. If the file contains no date, the age is counted
    from the last modification of the file.
    """
    modification_time_s = path.stat().st_mtime
    with suppress(ValueError):
        modification_time_s = datetime.datetime.fromisoformat(creation_date).timestamp()
    return f"{file_kind} {os.path.abspath(path)}, {age_text(time.time() - modification_time_s)} old"


def age_text(seconds: float) -> str:
    """Return an age as text, in the largest unit that gives a number of 2 or more, such as "26 h"."""
    for unit, name in ((DAY_S, "days"), (HOUR_S, "h"), (MINUTE_S, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{max(0.0, seconds):.0f} s"


def confirm_motion(warning: str, is_confirmed: bool) -> None:
    """Ask the operator to confirm a motion, unless the command line includes ``--yes``.

    Args:
        warning: line that names the consequence of the confirmation for the operator.
        is_confirmed: True if ``--yes`` was given.

    Raises:
        ConfigError: the operator does not confirm, or there is no terminal at which to ask.
    """
    if is_confirmed:
        return
    if not (sys.stdin and sys.stdin.isatty() and sys.stderr.isatty()):
        raise ConfigError(warning, "", "--yes, if nothing and nobody is near the hand")
    print(f"{warning}. Go on? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ConfigError(f"{warning}: not confirmed", "", "the answer y, or --yes")
