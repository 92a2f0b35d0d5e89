"""``handctl fault``: inject one fault, every fault of the matrix, or random faults into a simulated hand."""

import argparse

from handctl.cli.console.options import print_json
from handctl.runtime.simulator_requests import ask_simulator, find_simulator

MAX_PRINTED_INSTANCES = 8
"""Largest number of components whose names the command prints in one line."""


def run(args: argparse.Namespace) -> int:
    """Run the selected subcommand of ``fault``, and return the exit code."""
    if args.action in ("campaign", "sequences"):
        from handctl.cli.studies import fault_campaign, fault_sequences

        return fault_campaign.run(args) if args.action == "campaign" else fault_sequences.run(args)
    if args.action == "kinds":
        return _print_fault_kinds(args)
    return _send_request(args, {"inject": args.text} if args.action == "inject" else {"list": True})


def _send_request(args: argparse.Namespace, request: dict[str, object]) -> int:
    """Send a request about faults to a running simulator, and print the faults that the simulator lists."""
    faults = ask_simulator(find_simulator(args.bus), request)["faults"]
    if args.json:
        print_json({"faults": faults})
        return 0
    print(
        f"{'state':8} {'felt':>6}  fault"
        if faults
        else "no faults so far; handctl fault kinds lists the faults that can be injected"
    )
    for fault in faults:
        print(f"{fault['state']:8} {fault['felt']:>6}  {fault['fault']}")
    return 0


def _print_fault_kinds(args: argparse.Namespace) -> int:
    """Print each kind of fault, and the kinds of components that a fault of the kind can affect."""
    kinds = ask_simulator(find_simulator(args.bus), {"kinds": True})["kinds"]
    if args.json:
        print_json({"kinds": kinds})
        return 0
    for kind in kinds:
        print(
            f"{kind['kind']:10} on {' or '.join(kind['on'])}: {kind['text']}; size {kind['size']:g}"
        )
    print()
    names = {component: names for kind in kinds for component, names in kind["on"].items()}
    for component, instances in names.items():
        instances_text = ", ".join(instances[:MAX_PRINTED_INSTANCES]) + (
            ", ..." if len(instances) > MAX_PRINTED_INSTANCES else ""
        )
        print(f"{component:10} {instances_text or 'none'}")
    return 0
