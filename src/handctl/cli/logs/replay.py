"""``handctl replay``: a recorded run through the controller again, on the hand again, or past other limits.

The arguments of all kinds are declared here; what does a kind is imported when it is asked for, because only one of
them knows buses.
"""

import argparse
import importlib


def run(args: argparse.Namespace) -> int:
    """Replay."""
    done: int = importlib.import_module(f"handctl.cli.logs.replay_{args.kind}").run(args)
    return done
