"""Bus by which a command line identifies a running controller."""

import argparse

from handctl.session.buses import named_buses


def controller_bus(args: argparse.Namespace) -> str:
    """Return the bus that identifies a running controller: the first bus given, without the name from the hand file."""
    return next(iter(named_buses(args.bus).values()))
