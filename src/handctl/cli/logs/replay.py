"""``handctl replay``: execute a recorded run again, repeat its motion on a hand, or judge it by other limits.

Only the module of the kind of replay that the user selected is imported. So the modules for buses
are imported only by ``replay drive``.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected kind of replay, and return the exit code."""
    done: int = importlib.import_module(f"handctl.cli.logs.replay_{args.kind}").run(args)
    return done
