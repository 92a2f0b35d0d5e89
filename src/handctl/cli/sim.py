"""``handctl sim``: start the simulated hand; the same as ``python -m firmware_sim``."""

import argparse
import os
import subprocess
import sys

from handctl.cli.options import (
    bus_option,
    hand_option,
    json_option,
    print_json,
    time_scale_option,
    wire_option,
    wire_words,
)
from handctl.hand.description import load_hand

EXAMPLE = "handctl sim --hand jamia --bus local:demo --scene cylinder --dry-run"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    hand_option(parser)
    bus_option(parser)
    json_option(parser)
    parser.add_argument("--dry-run", action="store_true", help="check what is given, print the command and end")
    parser.add_argument("--scene", default="cylinder", help="cylinder, sphere, box, none, or a scene file")
    parser.add_argument("--seed", type=int, default=0, help="of the simulator's noise")
    wire_option(parser)
    time_scale_option(parser)


def run(args: argparse.Namespace) -> int:
    """Become the simulator."""
    hand = load_hand(args.hand)
    command = [sys.executable, "-m", "firmware_sim", "--hand", args.hand, "--scene", args.scene]
    command += ["--seed", str(args.seed), "--time-scale", str(args.time_scale)]
    for bus in args.bus:
        command += ["--bus", bus]
    command += wire_words(args) + ["--json"] * args.json
    if args.dry_run:
        from handctl.cli.plan import bus_specs  # it brings the whole controller along

        bus_specs(hand, args.bus)
        checked = subprocess.run([*command, "--dry-run"], stdin=subprocess.DEVNULL, check=False)
        if checked.returncode:
            return checked.returncode
        if args.json:
            print_json({"command": ["python", *command[1:]]})
        else:
            print(" ".join(["python", *command[1:]]))
        return 0
    return os.execv(sys.executable, command)
