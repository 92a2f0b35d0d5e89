"""``handctl replay execute``: execute the controller again with the inputs and the gains of a log, or with other gains.

This module and all modules that it imports use no bus.
"""

import argparse
import math
from typing import Any

from handctl.cli.console.options import check_count, print_escaped, print_json, warn_if_lossy
from handctl.cli.console.progress import progress_bar
from handctl.errors import ConfigError, LogError
from handctl.output_files import check_output_path, path_with_suffix
from handctl.processes import usable_cores
from handctl.session.exit_codes import ExitCode

MAX_PRINTED_ULPS = 10_000
"""Largest difference that is printed in units in the last place. A difference up to this size comes from rounding."""


def run(args: argparse.Namespace) -> int:
    """Execute the controller again with the inputs of a log, and return the exit code."""
    from handctl.log.read.reader import RunLog

    if args.within is not None and not args.within >= 0:
        raise ConfigError(f"{args.within:g}", "--within", "0 or more")
    if args.picture and not args.gains:
        raise ConfigError("without --gains", "--picture", "--gains FILE")
    for option, value in (
        ("--within", args.within),
        ("--from", args.from_s),
        ("--until", args.until_s),
    ):
        if value is not None and args.gains:
            raise ConfigError("together with --gains", option, "one of them")

    with RunLog(args.recorded) as log:
        exit_code_of_reading = warn_if_lossy(args.recorded, log.warning)
        exit_code = (
            _compare_with_other_gains(args, log)
            if args.gains
            else _execute_with_logged_gains(args, log)
        )
    return exit_code or exit_code_of_reading


def _execute_with_logged_gains(args: argparse.Namespace, log: Any) -> ExitCode:
    """Execute the controller with the inputs and the gains of the log.

    Returns:
        DONE if all computed ticks equal the ticks in the log, or differ by no more than the
        tolerance. If the states cannot be compared and all other outputs are equal, the function
        returns NOT_COMPARABLE. Otherwise, it returns FAILED.
    """
    from importlib.metadata import version

    from handctl.log.code_identity import code_identity
    from handctl.replay.log_execution import execute_log, is_within_tolerance

    workers = usable_cores() if args.jobs is None else check_count(args.jobs, "--jobs", 64)
    from_s, until_s = _time_range(args, log)
    tick_count = int(((log.times >= from_s) & (log.times < until_s)).sum())
    with progress_bar("executing", tick_count, args.json) as update_progress:
        execution = execute_log(
            log,
            progress=update_progress,
            worker_count=workers,
            from_s=from_s,
            until_s=until_s,
        )
    is_reproduced = (
        not execution.differing_ticks
        if args.within is None
        else is_within_tolerance(execution, args.within)
    )
    exit_code = ExitCode.DONE if is_reproduced else ExitCode.FAILED
    # With a tolerance, the hashes of the states are not judged.
    if is_reproduced and args.within is None and not execution.compares_states:
        exit_code = ExitCode.NOT_COMPARABLE
    running_version = (version("handctl"), code_identity())
    version_and_code_hash = _version_and_code_hash(log)
    result = {
        "log": str(args.recorded),
        "start_s": execution.start_time_s,
        "ticks": execution.ticks,
        "differing": execution.differing_ticks,
        "undecided": execution.different_decisions,
        "missing": [[gap.last_tick_before + 1, gap.first_tick_after - 1] for gap in log.gaps],
        "warning": log.warning,
        "first": execution.first_difference._asdict() if execution.first_difference else None,
        "state": execution.first_state_difference._asdict()
        if execution.first_state_difference
        else None,
        "largest": execution.largest_difference._asdict() if execution.largest_difference else None,
        "same": exit_code is ExitCode.DONE,
        "states_compared": execution.compares_states,
        "version": running_version[0],
        "version_logged": version_and_code_hash[0],
        "code": running_version[1],
        "code_logged": version_and_code_hash[1],
        "wall_s": execution.wall_s,
        "cpu_s": execution.cpu_s,
        "times_real_time": execution.real_time_factor,
    }
    if args.json:
        print_json(result)
    else:
        other_text = f"{execution.different_decisions} with other decisions"
        start_text = f" from {execution.start_time_s:.3f} s" if execution.start_time_s else ""
        print_escaped(
            f"{execution.ticks} ticks{start_text}, {execution.differing_ticks} differ, {other_text}"
        )
        for word, difference_row in (
            ("first", execution.first_difference),
            ("state", execution.first_state_difference),
            ("largest", execution.largest_difference),
        ):
            if difference_row:
                print_escaped(f"{word}: {_difference_line(difference_row)}")
        print_escaped(f"{execution.wall_s:.2f} s, {execution.real_time_factor:.1f} times real time")
        if execution.differing_ticks and log.gaps:
            gap = log.gaps[0]
            print_escaped(
                f"ticks {gap.last_tick_before + 1} to {gap.first_tick_after - 1} are missing in the log, "
                "so the ticks after them differ"
            )
        if not execution.compares_states:
            print_escaped(
                "the states were not compared, because another version of the state is in the log"
            )
        if (
            execution.differing_ticks or not execution.compares_states
        ) and version_and_code_hash != running_version:
            print_escaped(
                "the log was written by handctl {}, code {}; this is handctl {}, code {}".format(
                    *version_and_code_hash, *running_version
                )
            )
        if not is_reproduced and not execution.different_decisions and args.within is None:
            print_escaped(
                "all decisions are equal; if another machine wrote the log, "
                "--within 1e-9 accepts differences by rounding"
            )
    return exit_code


def _time_range(args: argparse.Namespace, log: Any) -> tuple[float, float]:
    """Return the times between which the log is executed again [s of the run].

    Raises:
        ConfigError: the start is not within the run, or the end is not after the start.
    """
    end_s = float(log.times[-1]) if len(log) else 0.0
    from_s, until_s = args.from_s, args.until_s
    if from_s is not None and not 0.0 <= from_s <= end_s:
        raise ConfigError(f"{from_s:g}", "--from", f"a time from 0 to {end_s:.3f} s")
    if until_s is not None and not until_s > (from_s or 0.0):
        raise ConfigError(f"{until_s:g}", "--until", f"a time after {from_s or 0.0:g} s")
    return (
        -math.inf if from_s is None else from_s,
        math.inf if until_s is None else until_s,
    )


def _version_and_code_hash(log: Any) -> tuple[str, str]:
    """Return the version and the code hash of the handctl program that wrote a log."""
    from handctl.log.code_identity import UNKNOWN_IDENTITY

    return log.header.metadata.get("version", UNKNOWN_IDENTITY), log.header.metadata.get(
        "code", UNKNOWN_IDENTITY
    )


def _difference_line(difference: Any) -> str:
    """Return a difference from the log as one line: tick, time [s], field, value in the log, computed value."""
    difference_location = (
        f"{difference.field} of {difference.name}" if difference.name else difference.field
    )
    ulps_text = ""
    if difference.ulps is not None:
        is_small = difference.ulps <= MAX_PRINTED_ULPS
        ulps_text = (
            f", {difference.ulps} units in the last place"
            if is_small
            else f", {difference.computed - difference.logged:+.3g}"
        )
    values = f"logged {difference.logged!r}, now {difference.computed!r}{ulps_text}"
    return f"tick {difference.k} ({difference.t_s:.3f} s), {difference_location}: {values}"


def _compare_with_other_gains(args: argparse.Namespace, log: Any) -> ExitCode:
    """Execute the controller with the inputs of the log, but with other gains, and draw the resulting commands."""
    from handctl.core.gains.gains import load_gains
    from handctl.replay.commands_with_other_gains import (
        CommandCollector,
        command_differences,
        draw_commands,
    )
    from handctl.replay.log_execution import execute_log

    commands = CommandCollector()
    picture = args.picture or path_with_suffix(args.recorded, ".gains.png")
    check_output_path(picture, "--picture", args.recorded, args.gains)
    gains = load_gains(args.gains)
    with progress_bar("executing", len(log), args.json) as update_progress:
        execution = execute_log(log, gains, commands.add_tick, update_progress)
    if not execution.ticks:
        raise LogError("contains no tick", str(args.recorded), "a run with motor commands")
    comparable_ticks = commands.comparable_ticks(log)
    draw_commands(
        picture,
        log,
        commands,
        comparable_ticks,
        f"{log.header.metadata.get('hand', '?')}: {args.recorded.name} with {args.gains.name}",
    )
    change = command_differences(log, commands, comparable_ticks)
    faults = commands.texts_of_faults_in_tick(comparable_ticks)
    if args.json:
        first_difference = (
            execution.first_difference._asdict() if execution.first_difference else None
        )
        counts = {
            "ticks": execution.ticks,
            "differing": execution.differing_ticks,
            "compared": comparable_ticks,
            "faults": faults,
            "first": first_difference,
        }
        print_json(counts | {"gains": str(args.gains), "picture": str(picture), "change": change})
        return ExitCode.DONE
    print_escaped(
        f"{execution.ticks} ticks, {execution.differing_ticks} with other commands or estimates"
    )
    if execution.first_difference:
        print_escaped(f"first: {_difference_line(execution.first_difference)}")
    if comparable_ticks < execution.ticks:
        reason = "; ".join(faults) or "another mode than in the log"
        print_escaped(f"the comparison ends at {log.times[comparable_ticks]:.3f} s: {reason}")
        print_escaped(
            "(the recorded motion does not follow these commands, so this is no fault of a hand)"
        )
    for unit, rows in change.items():
        for name, size in rows.items():
            print_escaped(f"{name:<18} {unit:<18} rms {size['rms']:.4g}, peak {size['peak']:.4g}")
    print_escaped(f"picture: {picture}")
    return ExitCode.DONE
