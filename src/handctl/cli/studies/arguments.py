"""Declaration of the command-line arguments of the commands in the folder ``cli/studies``.

The code of a command is imported only when that command runs. Because the code of commands is
imported late, help texts appear fast.
"""

import argparse
from pathlib import Path

from handctl.cli.console.options import (
    add_hand_option,
    add_jobs_option,
    add_json_option,
    add_output_option,
)
from handctl.cli.parsing.parser import SIMULATED_HAND, CommandExample, VerbParser, add_sub_verb
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS

COMMAND_EXAMPLES = {
    "fault": CommandExample("handctl fault campaign --row N04 --calm 0"),
    "fault inject": CommandExample(
        "handctl fault inject 'drop node=3 p=0.05 at=3s for=2s' --bus local:demo", (SIMULATED_HAND,)
    ),
    "fault list": CommandExample("handctl fault list --bus local:demo", (SIMULATED_HAND,)),
    "fault kinds": CommandExample("handctl fault kinds --bus local:demo", (SIMULATED_HAND,)),
    "fault campaign": CommandExample("handctl fault campaign --row N04 --calm 0"),
    "fault sequences": CommandExample("handctl fault sequences --count 2 --seed 7"),
    "paper": CommandExample("handctl paper --quick"),
}
"""Example command line that the help of each command and subcommand prints."""
FAULT_SYNTAX_HELP = """a fault is KIND COMPONENT=INSTANCE [size=X] [p=X] [at=TIME] [for=TIME] [seed=N], as in
'drop node=3 p=0.05 at=3s for=2s', 'snap tendon=index_tendon', 'stuck cell=thumb_tendon at=500ms';
handctl fault kinds lists all faults that a running simulator can inject"""


def fault(parser: VerbParser) -> None:
    """Declare the arguments of ``fault``."""
    subparsers = parser.add_subparsers(
        dest="action", required=True, metavar="inject|list|kinds|campaign|sequences"
    )

    def add_action(name: str, text: str) -> VerbParser:
        return add_sub_verb(subparsers, name, text, COMMAND_EXAMPLES[f"fault {name}"])

    inject_parser = add_action("inject", "start a fault in a running simulator")
    inject_parser.description = FAULT_SYNTAX_HELP
    text = 'fault and its parameters, as in "drop node=3 p=0.05 at=3s for=2s"'
    inject_parser.add_argument("text", metavar="FAULT", help=text)
    list_parser = add_action(
        "list", "list the faults of a running simulator, and how often each took effect"
    )
    fault_kinds_parser = add_action("kinds", "list the faults that a running simulator can inject")
    for subparser in (inject_parser, list_parser, fault_kinds_parser):
        text = "bus of the simulator (default: that of the only running simulator)"
        subparser.add_argument("--bus", metavar="SPEC", help=text)
        add_json_option(subparser)
    _add_campaign_options(
        add_action("campaign", "inject all faults of the fault matrix into a simulated hand")
    )
    _add_sequence_options(
        add_action(
            "sequences", "inject random sequences of faults in lockstep, and check the safety rules"
        )
    )


def paper(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``paper``."""
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--json", action="store_true", help="print the items as JSON on standard output"
    )
    kind.add_argument(
        "--markdown", action="store_true", help="print the page as Markdown on standard output"
    )
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="folder for the figures as PNG and SVG"
    )
    add_output_option(parser, "write all results as one HTML page")
    parser.add_argument(
        "--export", type=Path, metavar="DIR", help="folder for the paper's hand as URDF and MJCF"
    )
    text = "file with the results of the experiments; if it does not exist, run the experiments and write it"
    parser.add_argument("--results", type=Path, metavar="FILE", help=text)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="do not run the experiments, which take a minute or two",
    )
    add_jobs_option(parser, 2, "number of experiments at a time")


def _add_campaign_options(parser: argparse.ArgumentParser) -> None:
    add_hand_option(parser)
    add_json_option(parser)
    text = "protocol of the drives (default: mit)"
    parser.add_argument(
        "--protocol",
        default="mit",
        choices=[*VERIFIABLE_PROTOCOLS, "all"],
        help=text,
    )
    add_jobs_option(parser, 2, "number of scenarios at a time")
    parser.add_argument(
        "--quick", action="store_true", help="run a sample of the campaign, in less than a minute"
    )
    text = "inject only the fault of this row; may be repeated"
    parser.add_argument("--row", action="append", default=[], metavar="ID", help=text)
    text = "duration of the run without a fault (default: 60, with --quick 4)"
    parser.add_argument("--calm", type=float, metavar="S", help=text)
    parser.add_argument(
        "--calm-only", action="store_true", help="run the hand without a fault only"
    )
    parser.add_argument(
        "--seed", type=int, default=1, help="random seed of the simulated hand (default: 1)"
    )
    add_output_option(
        parser, "folder of report.html, report.json and the logs of failures (logs/campaign)", "DIR"
    )


def _add_sequence_options(parser: argparse.ArgumentParser) -> None:
    add_hand_option(parser)
    add_json_option(parser)
    parser.add_argument(
        "--protocol",
        default="mit",
        choices=VERIFIABLE_PROTOCOLS,
        help="protocol of the drives (default: mit)",
    )
    count_help = "number of random fault sequences (default: 30)"
    parser.add_argument("--count", type=int, default=30, metavar="N", help=count_help)
    text = "random seed of the first sequence, each further one adds 1 (default: 1)"
    parser.add_argument("--seed", type=int, default=1, help=text)
    add_jobs_option(parser, 2, "number of sequences at a time")
    add_output_option(parser, "folder of the logs of failures (logs/campaign)", "DIR")
