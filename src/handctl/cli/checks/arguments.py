"""What the verbs take. What they do, and all that it needs, is imported only when one is carried out."""

import argparse
from pathlib import Path

from handctl.cli.console.options import SPOKEN, bitrate_options, bus_option, gains_options, hand_option, json_option

EXAMPLES = {
    "config": "handctl config show --hand jamia",
    "bus": "handctl bus plan --hand jamia11 --rate 200",
    "scan": "handctl scan --bus socketcan:can0 --dry-run",
    "conformance": "handctl conformance --drive odrive --node 3 --bus socketcan:can0 --torque-limit-Nm 0.1 --dry-run",
    "doctor": "handctl doctor",
}
"""Of each verb, for its help."""


def config(parser: argparse.ArgumentParser) -> None:
    """Declare what ``config`` takes."""
    hand_option(parser)
    json_option(parser)
    parser.add_argument(
        "what",
        choices=["show", "check", "list", "export"],
        help="show the hand, check files, list what is packaged, write the hand's buses for other tools",
    )
    parser.add_argument("--dbc", action="store_true", help="export: the frames of each bus, as a CAN database")
    parser.add_argument("--output", type=Path, metavar="FILE", help="export: a new file (default: HAND.dbc)")
    parser.add_argument("--task", type=Path, help="task file to check with the hand")
    gains_options(parser)
    parser.add_argument("--calibration", type=Path, help="calibration file to check (default: HAND.calibration.toml)")


def bus(parser: argparse.ArgumentParser) -> None:
    """Declare what ``bus`` takes."""
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


def scan(parser: argparse.ArgumentParser) -> None:
    """Declare what ``scan`` takes."""
    bus_option(parser)
    json_option(parser)
    parser.add_argument("--dry-run", action="store_true", help="print every frame that may be sent, open no bus")
    parser.add_argument("--force", action="store_true", help="ask although another host seems to control the bus")
    bitrate_options(parser, "of the buses", "of CAN FD's data phase, for the fragment")


def conformance(parser: argparse.ArgumentParser) -> None:
    """Declare what ``conformance`` takes."""
    add = parser.add_argument
    add("--drive", required=True, choices=sorted(SPOKEN), help="what it speaks")
    add("--node", required=True, type=lambda word: int(word, 0), metavar="N", help="its number on the bus")
    add("--bus", required=True, metavar="SPEC", help="local:NAME, socketcan:can0 or any python-can interface:channel")
    add("--torque-limit-Nm", required=True, type=float, metavar="X", dest="limit",
        help="largest torque to ask for, at the drive's shaft; it becomes the drive's own limit too")  # fmt: skip
    add("--yes", action="store_true", help="the shaft may turn now: hands and cables are away from it")
    add("--option", action="append", default=[], metavar="KEY=VALUE", help="as in [motor.options] of a hand file")
    bitrate_options(parser, "of the bus", "of CAN FD's data phase")
    json_option(parser)
    parser.add_argument("--dry-run", action="store_true", help="print what would be checked, open no bus")


def doctor(parser: argparse.ArgumentParser) -> None:
    """Declare what ``doctor`` takes."""
    json_option(parser)
