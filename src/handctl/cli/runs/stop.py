"""``handctl stop``: relax and disarm a hand whose controller runs in another terminal."""

import argparse

from handctl.cli.console.buses import controller_bus
from handctl.cli.console.options import print_json
from handctl.runtime.confirmed_requests import request_action


def run(args: argparse.Namespace) -> int:
    """Ask the controller on a bus to stop.

    Return 0 after all drives have confirmed that they are disabled.
    """
    word = "cut" if args.cut else "stop"
    bus = controller_bus(args)
    line = request_action(bus, word)
    if args.json:
        print_json({"asked": word, "bus": bus, "confirmed": True, "mode": line["mode"]})
    else:
        print(
            f"the controller on {bus} has switched the drives off, and each drive has reported this"
        )
    return 0
