"""``handctl replay``: a recorded run through the controller again, on the hand again, or past other limits.

The arguments of all kinds are declared here; what does a kind is imported when it is asked for, because only one of
them knows buses.
"""

import argparse
import importlib
from pathlib import Path

from handctl.cli.console.options import json_option, run_options

EXAMPLE = "handctl demo --lockstep --log run.mcap && handctl replay execute run.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    _execute(_kind(kinds, "execute", "run the controller on the log's inputs, compare every output byte; no bus"))
    _drive(_kind(kinds, "drive", "drive the recorded run on the hand again and say how the two differ"))
    _safety(_kind(kinds, "safety", "judge the recorded run by other limits; no bus"))


def run(args: argparse.Namespace) -> int:
    """Replay."""
    done: int = importlib.import_module(f"handctl.cli.logs.replay_{args.kind}").run(args)
    return done


def _kind(
    kinds: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, text: str
) -> argparse.ArgumentParser:
    parser = kinds.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("recorded", type=Path, metavar="LOG", help="the log")
    return parser


def _execute(parser: argparse.ArgumentParser) -> None:
    json_option(parser)
    parser.add_argument("--gains", type=Path, metavar="FILE", help="what would these gains have commanded here?")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="of --gains (default: LOG.gains.png)")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one for each core)")
    parser.add_argument(
        "--within",
        type=float,
        metavar="X",
        help="accept numbers that differ by less, relative above 1, if all decisions are equal (other machines)",
    )


def _drive(parser: argparse.ArgumentParser) -> None:
    run_options(parser)
    parser.add_argument("--raw", action="store_true", help="follow its tensions; no angle is corrected on the way")


def _safety(parser: argparse.ArgumentParser) -> None:
    json_option(parser)
    parser.add_argument(
        "--limits", type=Path, required=True, metavar="FILE", help="TOML file, e.g. tension_trip_N = 60"
    )
