"""Declaration of the command-line arguments of the commands in the folder ``cli/logs``.

The code of a command is imported only when that command runs. Because the code of commands is
imported late, help texts appear fast.
"""

import argparse
from pathlib import Path

from handctl.cli.console.options import (
    add_jobs_option,
    add_json_option,
    add_output_option,
    add_run_options,
)
from handctl.cli.parsing.parser import CommandExample, VerbParser, add_sub_verb


def _example_with_log(command: str) -> CommandExample:
    """Return an example of a command that reads a log.

    If the log ``run.mcap`` does not exist, the example first records this log.
    """
    return CommandExample(f"[ -e run.mcap ] || handctl demo --lockstep --log run.mcap; {command}")


COMMAND_EXAMPLES = {
    "view": _example_with_log("handctl view run.mcap --save run.rrd"),
    "replay": _example_with_log("handctl replay execute run.mcap"),
    "replay execute": _example_with_log("handctl replay execute run.mcap"),
    "replay drive": _example_with_log(
        "handctl replay drive run.mcap --hand jamia --bus local:demo --dry-run"
    ),
    "replay safety": _example_with_log(
        "echo 'tension_trip_N = 60' > 60.toml; handctl replay safety run.mcap --limits 60.toml"
    ),
    "log": _example_with_log("handctl log info run.mcap"),
    "log info": _example_with_log("handctl log info run.mcap"),
    "log check": _example_with_log("handctl log check run.mcap"),
    "log diff": _example_with_log("handctl log diff run.mcap run.mcap"),
    "log recover": _example_with_log("handctl log recover run.mcap --output whole.mcap"),
    "log export": _example_with_log("handctl log export run.mcap --csv"),
    "report": _example_with_log("handctl report run.mcap"),
}
"""Example command line that the help of each command and subcommand prints."""
EXPORT_FORMATS = {
    "parquet": "one table with a row per tick",
    "csv": "the table of --parquet as text",
    "candump": "all frames as a text log of can-utils",
    "rrd": "a recording for the Rerun viewer",
    "lerobot": "a LeRobot dataset (3.0) in a folder, with an episode for each log",
}
"""Description of each format to which ``log export`` can convert a log."""


def view(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``view``."""
    parser.add_argument("log", type=Path, metavar="LOG", help="log of a run")
    text = "further logs for the same viewer, for example of a second hand"
    parser.add_argument("further_logs", type=Path, nargs="*", metavar="LOG", help=text)
    parser.add_argument(
        "--save", type=Path, metavar="FILE.rrd", help="write a Rerun recording, open nothing"
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE.png",
        help="draw the dashboard without a screen, open nothing",
    )
    parser.add_argument(
        "--at",
        type=float,
        metavar="SECONDS",
        help="moment of the picture (default: in the middle of the hold phase)",
    )
    text = "file with the true state of a lockstep run, to draw its object (default: LOG.truth)"
    parser.add_argument("--truth", type=Path, metavar="FILE", help=text)
    parser.add_argument(
        "--follow", action="store_true", help="show a log that is still being written, as it grows"
    )
    add_json_option(parser)


def replay(parser: VerbParser) -> None:
    """Declare the arguments of ``replay``."""
    subparsers = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    _add_execute_options(
        _add_replay_verb(
            subparsers,
            "execute",
            "run the controller on the inputs of the log, and compare all output bytes; no bus",
        )
    )
    _add_drive_options(
        _add_replay_verb(
            subparsers,
            "drive",
            "repeat the recorded run on the hand, and print how the two runs differ",
        )
    )
    _add_safety_options(
        _add_replay_verb(
            subparsers, "safety", "apply other safety limits to the recorded run; no bus"
        )
    )


def _add_replay_verb(
    subparsers: "argparse._SubParsersAction[VerbParser]", name: str, text: str
) -> VerbParser:
    parser = add_sub_verb(subparsers, name, text, COMMAND_EXAMPLES[f"replay {name}"])
    parser.add_argument("recorded", type=Path, metavar="LOG", help="log of the recorded run")
    return parser


def _add_execute_options(parser: argparse.ArgumentParser) -> None:
    add_json_option(parser)
    text = "compute the commands that these gains give with the inputs of the log"
    parser.add_argument("--gains", type=Path, metavar="FILE", help=text)
    text = "picture of the commands with --gains (default: LOG.gains.png)"
    parser.add_argument("--picture", type=Path, metavar="FILE", help=text)
    text = "begin at the last recorded state of the controller before this time of the run [s]"
    parser.add_argument("--from", type=float, dest="from_s", metavar="S", help=text)
    text = "end at this time of the run [s]"
    parser.add_argument("--until", type=float, dest="until_s", metavar="S", help=text)
    add_jobs_option(parser, None, "number of parallel processes")
    parser.add_argument(
        "--within",
        type=float,
        metavar="X",
        help="for logs of other machines: accept differences up to X (relative above 1) if all decisions are equal",
    )


def _add_drive_options(parser: argparse.ArgumentParser) -> None:
    add_run_options(parser)
    text = "follow the recorded tensions, and do not correct the angles"
    parser.add_argument("--raw", action="store_true", help=text)


def _add_safety_options(parser: argparse.ArgumentParser) -> None:
    add_json_option(parser)
    text = "TOML file with safety limits, e.g. tension_trip_N = 60"
    parser.add_argument("--limits", type=Path, required=True, metavar="FILE", help=text)


def log(parser: VerbParser) -> None:
    """Declare the arguments of ``log``."""
    subparsers = parser.add_subparsers(dest="what", required=True, metavar="WHAT")

    def add_log_verb(name: str, text: str) -> VerbParser:
        subparser = add_sub_verb(subparsers, name, text, COMMAND_EXAMPLES[f"log {name}"])
        add_json_option(subparser)
        subparser.add_argument("log", type=Path, help="the log")
        return subparser

    add_log_verb(
        "info",
        "print events with times, the end of the run, phases, hand, versions and gaps; with -v also the gains",
    )
    add_log_verb("check", "check counters, gaps, clock, hashes, and every byte")
    diff_parser = add_log_verb(
        "diff", "compare the log with another run of the same hand, phase by phase"
    )
    diff_parser.add_argument("other", type=Path, help="the other log")
    recover_parser = add_log_verb("recover", "write a complete log from a damaged log")
    add_output_option(recover_parser, "the complete log (default: LOG.recovered.mcap)")
    export_parser = add_log_verb("export", "write the log in a format that other tools read")
    export_parser.add_argument(
        "more", type=Path, nargs="*", metavar="LOG", help="further logs of the hand, with --lerobot"
    )
    group = export_parser.add_mutually_exclusive_group(required=True)
    for name, text in EXPORT_FORMATS.items():
        group.add_argument(f"--{name}", dest="format", action="store_const", const=name, help=text)
    export_parser.add_argument(
        "--fps",
        type=int,
        metavar="HZ",
        help="frame rate of a LeRobot dataset (default: the control rate)",
    )
    export_parser.add_argument(
        "--camera", nargs="+", action="append", default=[], metavar=("NAME", "VIDEO"),
        help="camera of a LeRobot dataset: its name, and one video for each log (needs ffmpeg)",
    )  # fmt: skip
    export_parser.add_argument(
        "--camera-start", type=float, nargs="+", default=[0.0], metavar="SECONDS",
        help="time from the start of the run to the first video frame, for all logs or for each (default: 0)",
    )  # fmt: skip
    add_output_option(export_parser, "a new file or folder (default: LOG.FORMAT)", "FILE|DIR")


def report(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``report``."""
    add_json_option(parser)
    parser.add_argument("log", type=Path, help="the log")
    add_output_option(parser, "the page (default: LOG.html)")
    text = "file with the true state of a lockstep run, drawn beside the estimates (default: LOG.truth)"
    parser.add_argument("--truth", type=Path, metavar="FILE", help=text)
