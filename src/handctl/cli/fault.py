"""``handctl fault``: faults for a simulated hand, one by one or the whole matrix."""

import argparse

from handctl.cli.options import json_option, print_json
from handctl.runtime.simulator import ask_simulator, find_simulator

EXAMPLE = "handctl fault campaign --row N04 --calm 0"
CAMPAIGN = "example: handctl fault campaign --quick --protocol odrive"
TEXT = """a fault is KIND COMPONENT=INSTANCE [size=X] [p=X] [at=TIME] [for=TIME] [seed=N], as in
'drop node=3 p=0.05 at=3s for=2s', 'snap tendon=index_tendon', 'stuck cell=thumb_tendon at=500ms'"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="inject|list|campaign")
    inject = actions.add_parser("inject", help="let a fault begin in a running simulator", description=TEXT)
    inject.add_argument("text", metavar="FAULT", help='as in "drop node=3 p=0.05 at=3s for=2s"')
    listed = actions.add_parser("list", help="the faults of a running simulator, and what was felt of each")
    for sub in (inject, listed):
        sub.add_argument("--bus", metavar="SPEC", help="of the simulator (default: the only one that runs)")
        json_option(sub)
    from handctl.cli import fault_campaign

    fault_campaign.configure(actions.add_parser("campaign", help="the whole fault matrix in lockstep", epilog=CAMPAIGN))


def run(args: argparse.Namespace) -> int:
    """Do it."""
    if args.action == "campaign":
        from handctl.cli import fault_campaign

        return fault_campaign.run(args)
    return _ask(args, {"inject": args.text} if args.action == "inject" else {"list": True})


def _ask(args: argparse.Namespace, question: dict[str, object]) -> int:
    """Ask a running simulator, and show its faults."""
    faults = ask_simulator(find_simulator(args.bus), question)
    if args.json:
        print_json({"faults": faults})
        return 0
    for fault in faults:
        print(f"{fault['state']:8}felt {fault['felt']:<8}{fault['fault']}")
    if not faults:
        print("no faults")
    return 0
