"""``handctl stop``: relax and disarm a running hand from another terminal."""

import argparse

from handctl.cli.buses import controller_bus
from handctl.cli.options import bus_option, json_option, print_json
from handctl.runtime.mailbox import CUT, STOP, send_request

EXAMPLE = "handctl stop --help   # with a hand running on local:demo: handctl stop --bus local:demo"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    bus_option(parser)
    json_option(parser)
    parser.add_argument("--cut", action="store_true", help="take the torque away at once, without a ramp")


def run(args: argparse.Namespace) -> int:
    """Ask the controller of the bus to stop."""
    word = "cut" if args.cut else "stop"
    bus = controller_bus(args)
    send_request(bus, CUT if args.cut else STOP)
    if args.json:
        print_json({"asked": word, "bus": bus})
    else:
        print(f"asked the controller on {bus} to {word}")
    return 0
