"""``handctl clear``: clear the latched faults of a running controller.

The command ``handctl clear`` never arms a hand. If the controller has crashed, use ``handctl run
--clear``. The command ``handctl run --clear`` clears the latched faults of the drives before
arming.
"""

import argparse

from handctl.cli.console.buses import controller_bus
from handctl.cli.console.options import print_json
from handctl.runtime.confirmed_requests import request_action


def run(args: argparse.Namespace) -> int:
    """Ask the controller on a bus to clear all latched faults.

    The result is 0. The function returns only after the controller has confirmed the request.
    """
    bus = controller_bus(args)
    line = request_action(bus, "clear")
    if args.json:
        print_json({"asked": "clear", "bus": bus, "confirmed": True, "mode": line["mode"]})
    else:
        print(f"the controller on {bus} has cleared its faults; mode {line['mode']}")
    return 0
