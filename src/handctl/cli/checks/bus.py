"""``handctl bus``: what a hand's buses must carry, and how the buses here are.

The arguments are declared here; what does it is imported when it is asked for, because only the plan knows controllers.
"""

import argparse
import importlib

from handctl.cli.console.options import bitrate_options, bus_option, json_option

EXAMPLE = "handctl bus plan --hand jamia11 --rate 200"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    told = "plan: worst-case load of each bus of a hand, stuff bits included; doctor: look at buses, and what to type"
    parser.add_argument("what", choices=["plan", "doctor"], help=told)
    about = "packaged hand or file (plan: jamia; doctor: none)"
    parser.add_argument("--hand", metavar="NAME|FILE", help=about)
    bus_option(parser, required=False)
    json_option(parser)
    bitrate_options(parser, "without a hand", "without a hand: of CAN FD's data phase")
    parser.add_argument("--rate", type=float, metavar="HZ", help="control rate (default: the highest that fits)")
    parser.add_argument("--detail", action="store_true", help="what is counted, frame by frame")
    parser.add_argument("--table", action="store_true", help="no hand: the protocols beside each other, bare")


def run(args: argparse.Namespace) -> int:
    """Plan, or look."""
    done: int = importlib.import_module(f"handctl.cli.checks.bus_{args.what}").run(args)
    return done
