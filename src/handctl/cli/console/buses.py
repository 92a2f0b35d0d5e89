"""Functions that find the bus of a running controller, and the command that starts a missing simulator."""

import argparse
import shlex

from handctl.session.buses import parse_bus_arguments


def controller_bus(args: argparse.Namespace) -> str:
    """Return the bus that identifies a running controller.

    The result is the first ``--bus`` of the command line without its prefix ``NAME=``.
    """
    return next(iter(parse_bus_arguments(args.bus).values()))


def simulator_command(args: argparse.Namespace) -> str:
    """Return the command that starts a simulator of the hand or drive, on the buses that a command line names."""
    bus_names = parse_bus_arguments([args.bus] if isinstance(args.bus, str) else args.bus)
    buses = (
        [f"{name}={spec}" for name, spec in bus_names.items()]
        if len(bus_names) > 1
        else bus_names.values()
    )
    if (node := getattr(args, "node", None)) is not None:
        words = ["python", "-m", "firmware_sim", "drive", args.protocol, "--ids", str(node)]
    else:
        hand = getattr(args, "hand", None)
        words = ["handctl", "sim", *(["--hand", str(hand)] if hand else [])]
    return shlex.join([*words, *(word for bus in buses for word in ("--bus", bus))])
