"""``handctl tune``: gains by design, by a search on the twin, and the proof on the hand.

The arguments of all kinds are declared here; what does a kind is imported when it is asked for.
"""

import argparse
import importlib
from pathlib import Path

from handctl.cli.console.options import (
    bus_option,
    check_seed,
    dry_run_option,
    gains_options,
    hand_option,
    json_option,
    perturb_option,
    time_scale_option,
    yes_option,
)

EXAMPLE = "handctl tune design --hand jamia --plants 2 --out tuned.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    _design(_kind(kinds, "design", "gains with margins on every plant of an ensemble, from linear models"))
    _search(_kind(kinds, "search", "the best gains on an ensemble of simulated plants"))
    _verify(
        _kind(kinds, "verify", "new gains on the hand at rising amplitude; back to the old ones when a limit is met")
    )


def run(args: argparse.Namespace) -> int:
    """Tune."""
    check_seed(args.seed)
    done: int = importlib.import_module(f"handctl.cli.tuning.tune_{args.kind}").run(args)
    return done


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
