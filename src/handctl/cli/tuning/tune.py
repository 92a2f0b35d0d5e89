"""``handctl tune``: design gains, search gains on the twin, and verify gains on the hand.

This verb imports the module of a kind only when that kind is requested.
"""

import argparse
import importlib

from handctl.cli.console.options import (
    check_seed,
)


def run(args: argparse.Namespace) -> int:
    """Run the selected kind of tuning and return its exit code."""
    check_seed(args.seed)
    done: int = importlib.import_module(f"handctl.cli.tuning.tune_{args.kind}").run(args)
    return done
