"""``handctl tune``: design gains, search for gains in simulation, and verify gains on the hand.

handctl imports only the module of the requested kind of tuning.
"""

import argparse
import importlib

from handctl.cli.console.options import (
    check_seed,
)


def run(args: argparse.Namespace) -> int:
    """Run the selected kind of tuning, and return the exit code."""
    check_seed(args.seed)
    exit_code: int = importlib.import_module(f"handctl.cli.tuning.tune_{args.kind}").run(args)
    return exit_code
