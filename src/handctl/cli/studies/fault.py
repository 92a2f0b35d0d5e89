"""``handctl fault``: faults for a simulated hand, one by one, the whole matrix, or sequences by chance."""

import argparse

from handctl.cli.console.options import json_option, print_json
from handctl.runtime.simulator import ask_simulator, find_simulator

EXAMPLE = "handctl fault campaign --row N04 --calm 0"
CAMPAIGN = "example: handctl fault campaign --quick --protocol odrive"
SEQUENCES = "example: handctl fault sequences --count 12 --seed 7"
TEXT = """a fault is KIND COMPONENT=INSTANCE [size=X] [p=X] [at=TIME] [for=TIME] [seed=N], as in
'drop node=3 p=0.05 at=3s for=2s', 'snap tendon=index_tendon', 'stuck cell=thumb_tendon at=500ms';
handctl fault kinds lists all that a running simulator knows"""
MOST_NAMES = 8
"""Names of instances that are shown in one line."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="inject|list|kinds|campaign|sequences")
    inject = actions.add_parser("inject", help="let a fault begin in a running simulator", description=TEXT)
    inject.add_argument("text", metavar="FAULT", help='as in "drop node=3 p=0.05 at=3s for=2s"')
    listed = actions.add_parser("list", help="the faults of a running simulator, and what was felt of each")
    kinds = actions.add_parser("kinds", help="what can be injected into a running simulator, and on what")
    for sub in (inject, listed, kinds):
        sub.add_argument("--bus", metavar="SPEC", help="of the simulator (default: the only one that runs)")
        json_option(sub)
    from handctl.cli.studies import fault_campaign, fault_sequences

    fault_campaign.configure(actions.add_parser("campaign", help="the whole fault matrix in lockstep", epilog=CAMPAIGN))
    text = "random sequences of faults in lockstep, and rules that must hold in each"
    fault_sequences.configure(actions.add_parser("sequences", help=text, description=text, epilog=SEQUENCES))


def run(args: argparse.Namespace) -> int:
    """Do it."""
    if args.action in ("campaign", "sequences"):
        from handctl.cli.studies import fault_campaign, fault_sequences

        return fault_campaign.run(args) if args.action == "campaign" else fault_sequences.run(args)
    if args.action == "kinds":
        return _kinds(args)
    return _ask(args, {"inject": args.text} if args.action == "inject" else {"list": True})


def _ask(args: argparse.Namespace, question: dict[str, object]) -> int:
    """Ask a running simulator, and show its faults."""
    faults = ask_simulator(find_simulator(args.bus), question)["faults"]
    if args.json:
        print_json({"faults": faults})
        return 0
    print(f"{'state':8} {'felt':>6}  fault" if faults else "no faults so far; handctl fault kinds lists what there is")
    for fault in faults:
        print(f"{fault['state']:8} {fault['felt']:>6}  {fault['fault']}")
    return 0


def _kinds(args: argparse.Namespace) -> int:
    """What can be injected."""
    kinds = ask_simulator(find_simulator(args.bus), {"kinds": True})["kinds"]
    if args.json:
        print_json({"kinds": kinds})
        return 0
    for kind in kinds:
        print(f"{kind['kind']:10} on {' or '.join(kind['on'])}: {kind['text']}; size {kind['size']:g}")
    print()
    names = {component: names for kind in kinds for component, names in kind["on"].items()}
    for component, instances in names.items():
        shown = ", ".join(instances[:MOST_NAMES]) + (", ..." if len(instances) > MOST_NAMES else "")
        print(f"{component:10} {shown or 'none'}")
    return 0
