"""Report of a dry run, in which a command checks all inputs but moves nothing.

All commands that run a controller print the same report.
"""

import argparse
from typing import Any

from handctl.cli.console.options import print_escaped, print_json
from handctl.session.exit_codes import ExitCode
from handctl.session.run_plan import RunPlan, check_gain_margins


def report_dry_run(args: argparse.Namespace, plan: RunPlan, *lines: str, **fields: Any) -> int:
    """Check that a controller can be designed with the gains, and report the planned run.

    Args:
        args: arguments with ``json``.
        plan: checked plan of the run.
        lines: lines about the planned run, for the operator.
        fields: further fields for the JSON result.

    Raises:
        ConfigError: no valid controller or filter can be designed with the gains.
    """
    check_gain_margins(plan.hand, plan.gains, plan.rate_hz)
    if args.json:
        run = {"rate_hz": plan.rate_hz, "bus_load": max(plan.bus_loads), "buses": list(plan.buses)}
        print_json({"hand": plan.hand.name, **run, **fields})
    else:
        for line in lines:
            print_escaped(line)
    return ExitCode.DONE
