"""``handctl replay``: execute a recorded run again, repeat the motion on a hand, or test new safety limits on the run.

handctl imports only the module of the requested kind of replay. Therefore the modules of buses are
imported only for ``replay drive``.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Run the selected kind of replay, and return the exit code."""
    exit_code: int = importlib.import_module(f"handctl.cli.logs.replay_{args.kind}").run(args)
    return exit_code
