"""``handctl report``: write an HTML page about a run, in a single file."""

import argparse

from handctl.cli.console.options import print_escaped, print_json, warn_if_lossy
from handctl.cli.console.progress import progress_bar
from handctl.output_files import check_output_path, path_with_suffix


def run(args: argparse.Namespace) -> int:
    """Write the HTML page about a run, and return the exit code."""
    from handctl.log.read.reader import RunLog
    from handctl.replay.controller_rebuild import logged_hand
    from handctl.report.run_report_page import write_page
    from handctl.report.truth_record import find_truth, truth_file_path

    output_path = args.output or path_with_suffix(args.log, ".html")
    check_output_path(output_path, "--output", args.log, args.truth or truth_file_path(args.log))
    with RunLog(args.log) as log:
        truth = find_truth(args.truth, args.log, log)
        offset = log.header.truth_offset_ns
        with progress_bar("drawing", quiet=args.json):
            page_bytes = write_page(
                output_path, log, logged_hand(log), truth, offset, args.log.name
            )
        code = warn_if_lossy(args.log, log.warning)
    if args.json:
        print_json({"log": str(args.log), "page": str(output_path), "bytes": page_bytes})
    else:
        print_escaped(f"{output_path}: {page_bytes / 1e6:.1f} MB")
    return code
