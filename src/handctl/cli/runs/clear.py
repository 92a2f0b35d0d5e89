"""``handctl clear``: clear the latched faults of a running controller; it never arms a hand by itself.

What a drive has latched after a controller died is cleared by ``handctl run --clear``, before anything is armed.
"""

import argparse

from handctl.cli.console.buses import controller_bus
from handctl.cli.console.options import print_json
from handctl.runtime.confirm import request_action


def run(args: argparse.Namespace) -> int:
    """Ask the controller of the bus to clear; 71 if it does not say that it has."""
    bus = controller_bus(args)
    line = request_action(bus, "clear")
    if args.json:
        print_json({"asked": "clear", "bus": bus, "confirmed": True, "mode": line["mode"]})
    else:
        print(f"the controller on {bus} has cleared its faults; mode {line['mode']}")
    return 0
