"""``handctl tune``: gains by design, by a search on the twin, and the proof on the hand.

The arguments of all kinds are declared here; what does a kind is imported when it is asked for.
"""

import argparse
import importlib

from handctl.cli.console.options import (
    check_seed,
)


def run(args: argparse.Namespace) -> int:
    """Tune."""
    check_seed(args.seed)
    done: int = importlib.import_module(f"handctl.cli.tuning.tune_{args.kind}").run(args)
    return done
