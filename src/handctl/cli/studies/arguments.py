"""What the verbs take. What they do, and all that it needs, is imported only when one is carried out."""

import argparse
from pathlib import Path

from handctl.cli.console.options import PROTOCOLS, hand_option, json_option

EXAMPLES = {
    "fault": "handctl fault campaign --row N04 --calm 0",
    "paper": "handctl paper --quick",
}
"""Of each verb, for its help."""
CAMPAIGN = "example: handctl fault campaign --quick --protocol odrive"
SEQUENCES = "example: handctl fault sequences --count 12 --seed 7"
TEXT = """a fault is KIND COMPONENT=INSTANCE [size=X] [p=X] [at=TIME] [for=TIME] [seed=N], as in
'drop node=3 p=0.05 at=3s for=2s', 'snap tendon=index_tendon', 'stuck cell=thumb_tendon at=500ms';
handctl fault kinds lists all that a running simulator knows"""


def fault(parser: argparse.ArgumentParser) -> None:
    """Declare what ``fault`` takes."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="inject|list|kinds|campaign|sequences")
    inject = actions.add_parser("inject", help="let a fault begin in a running simulator", description=TEXT)
    inject.add_argument("text", metavar="FAULT", help='as in "drop node=3 p=0.05 at=3s for=2s"')
    listed = actions.add_parser("list", help="the faults of a running simulator, and what was felt of each")
    kinds = actions.add_parser("kinds", help="what can be injected into a running simulator, and on what")
    for sub in (inject, listed, kinds):
        sub.add_argument("--bus", metavar="SPEC", help="of the simulator (default: the only one that runs)")
        json_option(sub)
    _campaign(actions.add_parser("campaign", help="the whole fault matrix in lockstep", epilog=CAMPAIGN))
    text = "random sequences of faults in lockstep, and rules that must hold in each"
    _sequences(actions.add_parser("sequences", help=text, description=text, epilog=SEQUENCES))


def paper(parser: argparse.ArgumentParser) -> None:
    """Declare what ``paper`` takes."""
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--json", action="store_true", help="print the items as JSON on standard output")
    kind.add_argument("--markdown", action="store_true", help="print the page as Markdown on standard output")
    parser.add_argument("--figures", type=Path, metavar="DIR", help="write the figures there as PNG and SVG")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write all of it as one HTML page")
    parser.add_argument("--export", type=Path, metavar="DIR", help="write the paper's hand there as URDF and MJCF")
    parser.add_argument(
        "--results", type=Path, metavar="FILE", help="take the experiments from there, or do them and write them there"
    )
    parser.add_argument("--quick", action="store_true", help="leave out the experiments, which take a minute or two")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="experiments at a time (default: 2)")


def _campaign(parser: argparse.ArgumentParser) -> None:
    hand_option(parser)
    json_option(parser)
    parser.add_argument("--protocol", default="mit", choices=[*PROTOCOLS, "all"], help="of the drives (default: mit)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="scenarios at a time (default: 2)")
    parser.add_argument("--quick", action="store_true", help="a sample that takes less than a minute")
    parser.add_argument("--row", action="append", default=[], metavar="ID", help="only this row; may be repeated")
    parser.add_argument(
        "--calm", type=float, metavar="S", help="how long the undisturbed hand is watched (60; quick: 4)"
    )
    parser.add_argument("--calm-only", action="store_true", help="nothing but the undisturbed hand")
    parser.add_argument("--seed", type=int, default=1, help="of the simulated hand (default: 1)")
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="where report.html, report.json and the logs of failures go"
    )


def _sequences(parser: argparse.ArgumentParser) -> None:
    hand_option(parser)
    json_option(parser)
    parser.add_argument("--protocol", default="mit", choices=PROTOCOLS, help="of the drives (default: mit)")
    parser.add_argument("--count", type=int, default=30, metavar="N", help="how many (default: 30)")
    parser.add_argument("--seed", type=int, default=1, help="of the first; the next ones count on (default: 1)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="sequences at a time (default: 2)")
    parser.add_argument("--report", type=Path, metavar="DIR", help="where the logs of failures go")
