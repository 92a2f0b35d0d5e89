"""``handctl bus``: plan the bus load of a hand, check buses, set up interfaces, or watch the readings of a hand.

handctl imports only the module of the selected subcommand. Importing ``plan`` and ``watch`` also
imports the modules of the controller, which the other subcommands do not need.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected subcommand of ``bus``, and return the exit code."""
    exit_code: int = importlib.import_module(f"handctl.cli.checks.bus_{args.what}").run(args)
    return exit_code
