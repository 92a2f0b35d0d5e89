"""``handctl bus``: what a hand's buses must carry, and how the buses here are.

The arguments are declared here; what does it is imported when it is asked for, because only the plan knows controllers.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Plan, or look."""
    done: int = importlib.import_module(f"handctl.cli.checks.bus_{args.what}").run(args)
    return done
