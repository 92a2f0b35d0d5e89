"""``handctl bus``: plan the bus load of a hand, or check the buses of this machine.

The module of a sub-verb is imported only when that sub-verb runs, because only ``plan`` needs the controller.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected sub-verb and return its exit code."""
    done: int = importlib.import_module(f"handctl.cli.checks.bus_{args.what}").run(args)
    return done
