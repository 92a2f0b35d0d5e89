"""The bus of a running controller, from a command line."""

import argparse

from handctl.session.buses import named_buses


def controller_bus(args: argparse.Namespace) -> str:
    """The bus by which a running controller is called: the first, without the name that a hand file gives it."""
    return next(iter(named_buses(args.bus).values()))
