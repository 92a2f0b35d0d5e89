"""Bus that tells a command which running controller the user means."""

import argparse

from handctl.session.buses import named_buses


def controller_bus(args: argparse.Namespace) -> str:
    """Return the bus that identifies a running controller: the first ``--bus`` without the NAME= in front."""
    return next(iter(named_buses(args.bus).values()))
