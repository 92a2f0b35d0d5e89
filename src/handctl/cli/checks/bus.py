"""``handctl bus``: plan the bus load of a hand, check buses, or watch the readings on them.

Only the module of the sub-verb that runs is imported, because ``plan`` and ``watch`` need the controller.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected sub-verb and return its exit code."""
    done: int = importlib.import_module(f"handctl.cli.checks.bus_{args.what}").run(args)
    return done
