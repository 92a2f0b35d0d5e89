"""Bus of a running controller, from a command line."""

import argparse

from handctl.session.buses import named_buses


def controller_bus(args: argparse.Namespace) -> str:
    """Return the bus that identifies a running controller: the first bus, without its name in the hand file."""
    return next(iter(named_buses(args.bus).values()))
