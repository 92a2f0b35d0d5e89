"""``handctl report``: one self-contained HTML page of a run."""

import argparse
from pathlib import Path

from handctl.cli.exit_codes import Exit
from handctl.cli.options import json_option, print_json, say
from handctl.output import check_output

EXAMPLE = "handctl demo --lockstep --log run.mcap && handctl report run.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    json_option(parser)
    parser.add_argument("log", type=Path, help="the log")
    parser.add_argument("--output", type=Path, metavar="FILE", help="the page (default: LOG.html)")
    parser.add_argument(
        "--truth", type=Path, metavar="FILE", help="truth of a lockstep run, drawn beside the estimates"
    )


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from handctl.log.header import TRUTH_OFFSET
    from handctl.log.reader import RunLog
    from handctl.replay.rebuild import logged_hand
    from handctl.report.page import write_page
    from handctl.report.truth import read_truth

    if args.output:
        check_output(args.output, "--output")
    truth = read_truth(args.truth) if args.truth else None
    with RunLog(args.log) as log:
        out = args.output or args.log.with_suffix(".html")
        offset = log.header.metadata.get(TRUTH_OFFSET, "0")
        size = write_page(out, log, logged_hand(log), truth, int(offset) if offset.isdecimal() else 0, args.log.name)
        lossy = bool(log.warning)
    if args.json:
        print_json({"log": str(args.log), "page": str(out), "bytes": size})
    else:
        say(f"{out}: {size / 1e6:.1f} MB")
    return Exit.LOSSY_LOG if lossy else Exit.DONE
