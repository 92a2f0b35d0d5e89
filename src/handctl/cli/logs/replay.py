"""``handctl replay``: execute a recorded run again, drive it on the hand, or judge it by other limits.

Only the module of the requested kind is imported, because only ``drive`` uses buses.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected kind of replay and return its exit code."""
    done: int = importlib.import_module(f"handctl.cli.logs.replay_{args.kind}").run(args)
    return done
