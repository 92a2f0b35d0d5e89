"""``handctl replay safety``: list the stops that other safety limits would have caused in a recorded run.

The command ``handctl replay safety`` uses no bus.
"""

import argparse
from typing import Any

from handctl.cli.console.options import print_escaped, print_json, warn_if_lossy
from handctl.cli.console.progress import progress_bar
from handctl.log.read.reader import RunLog
from handctl.replay.limits_judgement import StoppingFault, judge_by_limits


def _stop_fields(stop: StoppingFault) -> dict[str, Any]:
    """Return the fields that describe a stop of the hand in the JSON output."""
    fields = stop._asdict()
    fields["logged"] = fields.pop("occurs_in_logged_run")
    return fields


def run(args: argparse.Namespace) -> int:
    """Apply the safety limits of a file to a recorded run, print the resulting stops, and return the exit code."""
    with RunLog(args.recorded) as log:
        with progress_bar("judging", len(log), args.json) as update_progress:
            judgement = judge_by_limits(log, args.limits, update_progress)
        code = warn_if_lossy(args.recorded, log.warning)
    if args.json:
        stops_as_json = [_stop_fields(stop) for stop in judgement.stopping_faults]
        counts = {
            "ticks": judgement.ticks,
            "stopped": judgement.stopped_tick_count,
            "stopped_logged": judgement.ticks_stopped_by_old_limits,
        }
        print_json(
            {
                "log": str(args.recorded),
                **counts,
                "by_fault": judgement.stop_count_by_fault,
                "stops": stops_as_json,
            }
        )
        return code
    print_escaped(
        f"{judgement.ticks} ticks; these limits demand a stop in {judgement.stopped_tick_count} of them, "
        f"the limits of the run in {judgement.ticks_stopped_by_old_limits}"
    )
    for stop in judgement.stopping_faults:
        comparison_text = "as in the run" if stop.occurs_in_logged_run else "new"
        tick_and_time = f"tick {stop.k} ({stop.t_s:.3f} s)"
        print_escaped(
            f"{tick_and_time}: {stop.fault} {stop.title}: {stop.instance} {stop.value:g}: "
            f"{stop.action}, {comparison_text}"
        )
    return code
