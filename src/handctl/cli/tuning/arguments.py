"""Declaration of the command-line arguments of the commands in the folder ``cli/tuning``.

The code of a command is imported only when that command runs. Because the code of commands is
imported late, help texts appear fast.
"""

import argparse
from pathlib import Path

from handctl.cli.console.options import (
    add_bus_option,
    add_clear_option,
    add_dry_run_option,
    add_gains_options,
    add_hand_option,
    add_jobs_option,
    add_json_option,
    add_output_option,
    add_perturb_option,
    add_rate_option,
    add_run_options,
    add_time_scale_option,
    add_yes_option,
)
from handctl.cli.parsing.parser import (
    RUN_COMMAND_EXAMPLE,
    SIMULATED_HAND,
    CommandExample,
    VerbParser,
    add_sub_verb,
)

WRITE_GAINS_COMMAND = "printf 'schema = 1\\n[motion]\\nforce_N = 12.0\\n' > new.toml;"
"""Shell command that writes a small gains file."""

COMMAND_EXAMPLES = {
    "identify": CommandExample(
        "handctl identify --hand jamia --lockstep --digits thumb --calibration identified.calibration.toml"
    ),
    "gains": CommandExample("handctl gains show --hand jamia"),
    "gains show": CommandExample("handctl gains show --hand jamia"),
    "gains diff": CommandExample("handctl gains diff packaged present --hand jamia"),
    "gains apply": CommandExample(
        f"{WRITE_GAINS_COMMAND} handctl gains apply new.toml --hand jamia --note 'a softer motion loop'"
    ),
    "gains rollback": CommandExample("handctl gains rollback --to 0 --hand jamia"),
    "gains log": CommandExample("handctl gains log --hand jamia"),
    "gains set": CommandExample(
        "handctl gains set motion.force_N=12 --bus local:demo",
        (SIMULATED_HAND, RUN_COMMAND_EXAMPLE),
    ),
    "tune": CommandExample("handctl tune design --hand jamia --plants 2 --output designed.toml"),
    "tune design": CommandExample(
        "handctl tune design --hand jamia --plants 2 --output designed.toml"
    ),
    "tune search": CommandExample(
        "handctl tune search --hand jamia --plants 1 --trials 2 --output found.toml"
    ),
    "tune verify": CommandExample(
        f"{WRITE_GAINS_COMMAND} handctl tune verify new.toml --hand jamia --lockstep --dry-run"
    ),
}
"""Example command line that the help of each command and subcommand prints."""


def identify(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``identify``."""
    add_run_options(parser, is_bus_required=False)
    text = "digits to identify (default: all whose tendons have load cells or are spool pairs)"
    parser.add_argument("--digits", nargs="+", action="extend", metavar="DIGIT", help=text)
    parser.add_argument(
        "--from-log",
        dest="logs",
        nargs="+",
        action="extend",
        type=Path,
        metavar="LOG",
        help="use recorded runs, and do not move the hand",
    )
    text = "identify the simulated hand in virtual time, without a bus"
    parser.add_argument("--lockstep", action="store_true", help=text)
    parser.add_argument("--seed", type=int, default=0, help="random seed of the simulated hand")
    add_perturb_option(parser)
    parser.add_argument(
        "--no-write", action="store_true", help="do not change the calibration file"
    )


def gains(parser: VerbParser) -> None:
    """Declare the arguments of ``gains``."""
    subparsers = parser.add_subparsers(
        dest="what", required=True, metavar="show|diff|apply|rollback|log|set"
    )

    def add_gains_verb(name: str, text: str) -> VerbParser:
        subparser = add_sub_verb(subparsers, name, text, COMMAND_EXAMPLES[f"gains {name}"])
        add_json_option(subparser)
        # The subcommand "set" needs no --hand, because the running controller knows its hand.
        if name != "set":
            add_hand_option(subparser)
        return subparser

    add_gains_options(
        add_gains_verb("show", "show every gain: value, source, meaning, unit and bounds")
    )
    diff_parser = add_gains_verb("diff", "compare two sets of gains")
    text = "one or two of: a file, a log, a number of the history, present, packaged (default: packaged present)"
    diff_parser.add_argument("sides", nargs="*", default=[], metavar="GAINS", help=text)
    apply_parser = add_gains_verb("apply", "use the gains of a file in all later runs")
    apply_parser.add_argument("file", type=Path, metavar="FILE", help="gains file")
    for option, name, option_help in (
        ("--calibration", "fit", "calibration with the identified parameters, for the history"),
        ("--study", "study", "search that found these gains, for the history"),
        ("--note", "note", "reason, for the history"),
    ):
        apply_parser.add_argument(option, dest=name, default="", help=option_help)
    text = "recorded run from which the gains were found, for the history; may be repeated"
    apply_parser.add_argument(
        "--from-log", dest="log", action="append", type=Path, default=[], metavar="LOG", help=text
    )
    rollback_parser = add_gains_verb("rollback", "use earlier gains again")
    rollback_parser.add_argument(
        "--to",
        type=int,
        metavar="N",
        help="number in the history, 0 for the default gains of the hand",
    )
    add_gains_verb("log", "list all gains that were applied")
    gains_set_parser = add_gains_verb(
        "set", "change gains of a running controller, without a step in torque"
    )
    gains_set_parser.add_argument(
        "values", nargs="+", metavar="KEY=VALUE", help="gains and their new values"
    )
    add_bus_option(gains_set_parser)


def tune(parser: VerbParser) -> None:
    """Declare the arguments of ``tune``."""
    subparsers = parser.add_subparsers(dest="kind", required=True, metavar="design|search|verify")
    _add_design_options(
        _add_tune_verb(
            subparsers,
            "design",
            "design gains with margins on every plant of an ensemble, from linear models",
        )
    )
    _add_search_options(
        _add_tune_verb(
            subparsers, "search", "search the best gains on an ensemble of simulated plants"
        )
    )
    text = "try new gains on the hand at rising amplitude, and return to the old ones at a limit"
    _add_verify_options(_add_tune_verb(subparsers, "verify", text))


def _add_tune_verb(
    subparsers: "argparse._SubParsersAction[VerbParser]", name: str, text: str
) -> VerbParser:
    parser = add_sub_verb(subparsers, name, text, COMMAND_EXAMPLES[f"tune {name}"])
    add_hand_option(parser)
    add_json_option(parser)
    add_gains_options(parser)
    add_rate_option(parser)
    text = "random seed of plants, noise and search (default: 0)"
    parser.add_argument("--seed", type=int, default=0, metavar="N", help=text)
    return parser


def _add_plant_options(parser: argparse.ArgumentParser, default: int) -> None:
    text = f"number of simulated plants, the first with the values of the hand (default: {default})"
    parser.add_argument("--plants", type=int, default=default, metavar="N", help=text)
    text = "tune the hand as it was identified (default: as in its file)"
    parser.add_argument("--calibration", dest="fit", type=Path, metavar="FILE", help=text)
    add_perturb_option(parser)
    add_output_option(parser, "gains file to write (default: HAND.design.toml or HAND.search.toml)")


def _add_design_options(parser: argparse.ArgumentParser) -> None:
    _add_plant_options(parser, 8)
    text = "place the poles at these frequencies, and do not search"
    parser.add_argument("--poles-Hz", dest="poles", metavar="MOTION,TENSION", help=text)
    text = "damping ratio of the poles of --poles-Hz (default: 1)"
    parser.add_argument("--damping", type=float, default=1.0, metavar="X", help=text)
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="picture of the result (default: beside --output)",
    )


def _add_search_options(parser: argparse.ArgumentParser) -> None:
    _add_plant_options(parser, 3)
    text = "total number of trials, including the trials of a resumed study (default: 64)"
    parser.add_argument("--trials", type=int, default=64, metavar="N", help=text)
    text = "journal of the search, which is resumed if it exists (default: HAND.study)"
    parser.add_argument("--study", type=Path, metavar="FILE", help=text)
    add_jobs_option(parser, 1, "number of parallel processes")
    text = "use an existing Dask cluster instead of local processes"
    parser.add_argument("--scheduler", metavar="tcp://...", help=text)
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="picture of the result (default: beside --output)",
    )


def _add_verify_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("candidate", type=Path, metavar="NEW.toml", help="gains to verify")
    add_bus_option(parser, required=False)
    add_dry_run_option(parser)
    parser.add_argument(
        "--lockstep",
        action="store_true",
        help="use a simulated hand in virtual time, without a bus",
    )
    add_perturb_option(parser)
    text = (
        "calibration file (default: HAND.calibration.toml; with "
        "--lockstep none, and only identified values are used)"
    )
    parser.add_argument("--calibration", type=Path, metavar="FILE", help=text)
    text = "with --lockstep: number of runs with different seeds; their spread gives the intervals (default: 3)"
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help=text)
    text = "largest amplitude of the rounds, up to 1 (default: the largest at which no digits meet)"
    parser.add_argument("--amplitude", type=float, metavar="X", help=text)
    text = "accept the gains even if a column is worse than with the old gains"
    parser.add_argument("--accept-worse", action="store_true", help=text)
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="log to write (default: logs/DATE-HAND-verify.mcap)",
    )
    add_clear_option(parser)
    add_yes_option(parser)
    add_time_scale_option(parser)
