"""What the verbs take. What they do, and all that it needs, is imported only when one is carried out."""

import argparse
from pathlib import Path

from handctl.cli.console.options import (
    bus_option,
    dry_run_option,
    gains_options,
    hand_option,
    json_option,
    perturb_option,
    run_options,
    time_scale_option,
    yes_option,
)

EXAMPLES = {
    "identify": "handctl identify --hand jamia --lockstep --digits thumb --calibration /tmp/identified.toml",
    "gains": "handctl gains show --hand jamia",
    "tune": "handctl tune design --hand jamia --plants 2 --out tuned.toml",
}
"""Of each verb, for its help."""


def identify(parser: argparse.ArgumentParser) -> None:
    """Declare what ``identify`` takes."""
    run_options(parser, bus_required=False)
    parser.add_argument(
        "--digits", nargs="+", action="extend", metavar="DIGIT", help="which (default: all, one after the other)"
    )
    parser.add_argument(
        "--from",
        dest="logs",
        nargs="+",
        action="extend",
        type=Path,
        metavar="LOG",
        help="use recorded runs instead of any new motion",
    )
    parser.add_argument("--lockstep", action="store_true", help="the simulated hand in virtual time, without a bus")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated hand")
    perturb_option(parser)
    parser.add_argument("--no-write", action="store_true", help="leave the calibration file as it is")


def gains(parser: argparse.ArgumentParser) -> None:
    """Declare what ``gains`` takes."""
    what = parser.add_subparsers(dest="what", required=True, metavar="show|diff|apply|rollback|log|set")
    show = what.add_parser("show", help="every gain, its bounds, and where it comes from")
    gains_options(show)
    diff = what.add_parser("diff", help="compare two: a file, a log, a number of the history, present, packaged")
    diff.add_argument("sides", nargs="*", default=[], metavar="WHICH", help="one or two (default: packaged present)")
    apply = what.add_parser("apply", help="make the gains of a file those that runs use")
    apply.add_argument("file", type=Path, help="gains file")
    for name, meaning in (("fit", "calibration they rest on"), ("study", "search that found them"), ("note", "why")):
        apply.add_argument(f"--{name}", default="", help=meaning)
    apply.add_argument("--from-log", dest="log", action="append", type=Path, default=[], help="run they rest on")
    back = what.add_parser("rollback", help="bring back the gains from before")
    back.add_argument("--to", type=int, metavar="N", help="number in the history; 0: the packaged gains")
    log = what.add_parser("log", help="everything that was applied")
    live = what.add_parser("set", help="change gains of a running controller, without a step in torque")
    live.add_argument("values", nargs="+", metavar="KEY=VALUE")
    bus_option(live)
    for one in (show, diff, apply, back, log, live):
        json_option(one)
        if one is not live:  # a running controller knows its hand
            hand_option(one)


def tune(parser: argparse.ArgumentParser) -> None:
    """Declare what ``tune`` takes."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    _design(_kind(kinds, "design", "gains with margins on every plant of an ensemble, from linear models"))
    _search(_kind(kinds, "search", "the best gains on an ensemble of simulated plants"))
    _verify(
        _kind(kinds, "verify", "new gains on the hand at rising amplitude; back to the old ones when a limit is met")
    )


def _kind(
    kinds: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, text: str
) -> argparse.ArgumentParser:
    parser = kinds.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    hand_option(parser)
    json_option(parser)
    gains_options(parser)
    parser.add_argument("--rate", type=float, metavar="HZ", help="control rate (default: by the bus load)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of plants, noise and search (default: 0)")
    return parser


def _plants(parser: argparse.ArgumentParser, default: int) -> None:
    text = f"plants to keep the margins on, the hand's own first (default: {default})"
    parser.add_argument("--plants", type=int, default=default, metavar="N", help=text)
    text = "tune the hand as it was identified"
    parser.add_argument("--fit", "--calibration", dest="fit", type=Path, metavar="FILE", help=text)
    perturb_option(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="gains file to write (default: HAND.KIND.toml)")


def _design(parser: argparse.ArgumentParser) -> None:
    _plants(parser, 8)
    parser.add_argument(
        "--poles-Hz", dest="poles", metavar="MOTION,TENSION", help="place the poles here; nothing is sought then"
    )
    parser.add_argument("--damping", type=float, default=1.0, metavar="X", help="of these poles (default: 1)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="default: beside --out")


def _search(parser: argparse.ArgumentParser) -> None:
    _plants(parser, 3)
    parser.add_argument("--trials", type=int, default=64, metavar="N", help="in all, a resumed study's included")
    parser.add_argument(
        "--study", type=Path, metavar="FILE", help="journal to write or go on with (default: HAND.study)"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default: 1)")
    parser.add_argument("--scheduler", metavar="tcp://...", help="an existing Dask cluster instead")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="default: beside --out")


def _verify(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("candidate", type=Path, metavar="NEW.toml", help="gains to verify")
    bus_option(parser, required=False)
    dry_run_option(parser)
    parser.add_argument("--lockstep", action="store_true", help="on a simulated hand in this process, in virtual time")
    perturb_option(parser)
    text = "default: HAND.calibration.toml; with --lockstep only what it says was identified counts (default: nothing)"
    parser.add_argument("--calibration", type=Path, metavar="FILE", help=text)
    text = "with --lockstep: so many runs, each with another seed, whose spread decides (default: 3)"
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help=text)
    text = "say verified although a column is worse than with the old gains"
    parser.add_argument("--accept-worse", action="store_true", help=text)
    parser.add_argument("--log", type=Path, metavar="FILE", help="log to write (default: logs/DATE-HAND-verify.mcap)")
    parser.add_argument("--clear", action="store_true", help="clear latched drive errors; find the cause first")
    yes_option(parser)
    time_scale_option(parser)
