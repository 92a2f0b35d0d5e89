"""What a person reads and is asked before a hand moves: which files were found, and whether it may move at all."""

import argparse
import datetime
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

from handctl.cli.console.options import say
from handctl.cli.console.verbosity import note
from handctl.core.gains.gains import load_gains_file
from handctl.errors import ConfigError
from handctl.programs.calibration import Calibration
from handctl.runtime.buses.open import real_buses
from handctl.session.plan import Plan

MINUTE_S = 60.0
HOUR_S = 3600.0
DAY_S = 86400.0


def announce(args: argparse.Namespace, plan: Plan, path: Path, calibration: Calibration | None) -> None:
    """Name what was found in the working folder, then ask once before anything moves on a real bus.

    Args:
        args: with ``yes``, and with ``gains`` and ``calibration`` where the command line names them.
        plan: of the run.
        path: of the calibration.
        calibration: what was read from it; None if it will be made first.

    Raises:
        ConfigError: nobody is there to be asked, or whoever is there does not want the hand to move.
    """
    files = []
    gains = Path(f"{plan.hand.name}.gains.toml")
    if not args.gains and "gains.toml" in plan.attachments:
        files.append(_described("gains", gains, load_gains_file(gains).provenance.made))
    if not args.calibration and calibration:
        files.append(_described("calibration", path, calibration.made))
    if files:
        note(f"handctl: found in this folder: {'; '.join(files)}")
    if calibration and not calibration.drive:
        text = "does not name the drives it was made with, any hand of this design would be armed with it"
        say(f"handctl: caution: {path} {text}; handctl commission makes one that does", error=True)
    if real := real_buses(plan.buses):
        joints = ", ".join(plan.hand.digit_names)
        ask(f"{plan.hand.name} on {', '.join(real)} is armed and moves {joints}", args.yes)


def _described(what: str, path: Path, made: str) -> str:
    """Return a file's kind, whole path and age: since it was made, or changed if it does not say when it was."""
    then = path.stat().st_mtime
    with suppress(ValueError):
        then = datetime.datetime.fromisoformat(made).timestamp()
    return f"{what} {os.path.abspath(path)}, {age(time.time() - then)} old"


def age(seconds: float) -> str:
    """Return an age in its largest whole unit."""
    for unit, name in ((DAY_S, "days"), (HOUR_S, "h"), (MINUTE_S, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{max(0.0, seconds):.0f} s"


def ask(warning: str, yes: bool) -> None:
    """Go on only if the command line or a person at the terminal says so.

    Args:
        warning: what will happen.
        yes: whether ``--yes`` was given.

    Raises:
        ConfigError: nobody has said so.
    """
    if yes:
        return
    if not (sys.stdin and sys.stdin.isatty() and sys.stderr.isatty()):
        raise ConfigError(warning, "", "--yes, once nothing and nobody is near it")
    print(f"{warning}. Go on? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ConfigError(f"{warning}: not confirmed", "", "y at the question, or --yes")
