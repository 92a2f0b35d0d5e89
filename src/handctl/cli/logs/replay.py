"""``handctl replay``: execute a recorded run again, repeat its motion on a hand, or judge it by other safety limits.

handctl imports only the module of the requested kind of replay. Because of this choice, only
``replay drive`` imports the modules of buses.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected kind of replay, and return the exit code."""
    exit_code: int = importlib.import_module(f"handctl.cli.logs.replay_{args.kind}").run(args)
    return exit_code
