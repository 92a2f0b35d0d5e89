"""What a dry run says: alike in every verb that would run a controller."""

import argparse
from typing import Any

from handctl.cli.console.options import print_json, say
from handctl.session.exit_codes import Exit
from handctl.session.plan import Plan, check_design


def report_dry_run(args: argparse.Namespace, plan: Plan, *lines: str, **fields: Any) -> int:
    """Say that all files are good, and what would be done.

    Args:
        args: with ``json``.
        plan: that was checked.
        lines: for a person.
        what: would be done, for a program.

    Raises:
        ConfigError: no controller follows from the gains.
    """
    check_design(plan.hand, plan.gains, plan.rate_hz)
    if args.json:
        run = {"rate_hz": plan.rate_hz, "bus_load": max(plan.load), "buses": list(plan.buses)}
        print_json({"hand": plan.hand.name, **run, **fields})
    else:
        for line in lines:
            say(line)
    return Exit.DONE
