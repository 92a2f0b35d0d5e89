"""``handctl log``: show, check, compare, export and repair logs."""

import argparse
import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from handctl.cli.console.options import print_escaped, print_json, warn_if_lossy
from handctl.cli.console.progress import progress_bar
from handctl.cli.console.verbosity import is_verbose
from handctl.errors import ConfigError, LogError
from handctl.log.read.reader import RunLog
from handctl.output_files import atomic_path, path_with_suffix
from handctl.session.exit_codes import ExitCode

EXPORT_UNITS = {"candump": "frames", "rrd": "bytes", "lerobot": "frames"}
"""Unit in which ``log export`` counts the exported data, by format.

For a format that is not in this mapping, ``log export`` counts rows.
"""


def run(args: argparse.Namespace) -> int:
    """Run the selected subcommand of ``log``, and return the exit code."""
    run_function_by_kind: dict[str, Callable[[argparse.Namespace], int]] = {
        "info": _print_info,
        "check": _check_log,
        "diff": _compare_logs,
        "recover": _recover_log,
        "export": _export_log,
    }
    return run_function_by_kind[args.what](args)


def _print_info(args: argparse.Namespace) -> int:
    from handctl.log.topics.clock_pair_topic import clock_steps

    with RunLog(args.log) as log:
        header = log.header
        result = {
            "log": str(args.log),
            "whole": not log.warning,
            "problem": log.warning,
            "ticks": len(log),
            "seconds": float(log.times[-1]) if len(log) else 0.0,
            "late_us": _lateness_us(log),
            "clock_steps": [step._asdict() for step in clock_steps(log.clock_pairs)],
            "missing": sum(gap.first_tick_after - gap.last_tick_before - 1 for gap in log.gaps),
            "gaps": [[gap.last_tick_before, gap.first_tick_after] for gap in log.gaps],
            "phases": [change.name for change in log.phases],
            "events": [
                f"{event.t_ns / 1e9:.3f} s {event.event.level}: {event.event.text}"
                for event in log.events
            ],
            "end": log.end,
            **header.metadata,
            **header.wall,
            "attachments": sorted(header.attachments),
            "gains": header.gains,
        }
    if args.json:
        print_json(result)
        return ExitCode.DONE if result["whole"] else ExitCode.LOSSY_LOG
    if not is_verbose():
        del result["gains"]
    for key, value in result.items():
        table = (
            [f"{name}: {_value_text(element)}" for name, element in value.items()]
            if isinstance(value, dict)
            else [value]
        )
        first_line, *other_lines = (value if isinstance(value, list) else table) or [""]
        print_escaped(f"{key:<12} {_value_text(first_line)}")
        for line in other_lines:
            print_escaped(f"{'':<12} {_value_text(line)}")
    return ExitCode.DONE if result["whole"] else ExitCode.LOSSY_LOG


def _value_text(value: object) -> str:
    """Return a value as text.

    The text is yes or no, a number with 9 significant digits, or ``-`` for no value. The text
    ``None`` also counts as no value, because it is the priority in the log header of a run in
    lockstep.
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value in (None, "None"):
        return "-"
    return f"{value:.9g}" if isinstance(value, float) else str(value) or "-"


def _lateness_us(log: RunLog) -> dict[str, float]:
    """Return the median, the 99.9th percentile and the maximum of the lateness of the ticks [us]."""
    import numpy as np

    lateness_us = log.late_ns / 1e3
    if not len(lateness_us):
        return {}
    return {
        "p50": float(np.percentile(lateness_us, 50)),
        "p99_9": float(np.percentile(lateness_us, 99.9)),
        "max": float(lateness_us.max()),
    }


def _check_log(args: argparse.Namespace) -> int:
    from handctl.replay.damage_description import describe_damaged_log
    from handctl.replay.log_check import check_log

    try:
        with RunLog(args.log) as log, progress_bar("checking", quiet=args.json):
            problems = check_log(log)
            ticks = len(log)
            is_incomplete = bool(log.warning)
    except LogError as error:
        problems = [str(error), *filter(None, [describe_damaged_log(args.log)])]
        ticks = 0
        is_incomplete = False
    if args.json:
        print_json(
            {"log": str(args.log), "ticks": ticks, "sound": not problems, "findings": problems}
        )
    else:
        for line in problems or [f"{args.log}: {ticks} ticks, nothing wrong"]:
            print_escaped(line)
    return ExitCode.LOSSY_LOG if is_incomplete else ExitCode.FAILED if problems else ExitCode.DONE


def _compare_logs(args: argparse.Namespace) -> int:
    from handctl.replay.phase_comparison import compare_logs
    from handctl.replay.run_comparison import difference_lines

    with RunLog(args.log) as a, RunLog(args.other) as b, progress_bar("comparing", quiet=args.json):
        result = compare_logs(a, b, str(args.other))
        code = max(warn_if_lossy(args.log, a.warning), warn_if_lossy(args.other, b.warning))
    if args.json:
        print_json({"logs": [str(args.log), str(args.other)], **result})
        return code
    for name, (first_value, second_value) in result["gains"].items():
        print_escaped(
            f"gain {name} differs: {first_value} in the first log, {second_value} in the second"
        )
    for list_name in ("only_in_first", "only_in_second"):
        if result[list_name]:
            print_escaped(f"phases {list_name.replace('_', ' ')}: {', '.join(result[list_name])}")
    for name, phase in result["phases"].items():
        first_duration_s, second_duration_s = phase.pop("duration_s")
        lines = list(difference_lines(phase))
        too_short_text = ", too short to compare" if phase and not lines else ""
        print_escaped(
            f"{name}: {first_duration_s:.3f} s and {second_duration_s:.3f} s{too_short_text}"
        )
        for line in lines:
            print_escaped(f"  {line}")
    return code


def _export_log(args: argparse.Namespace) -> int:
    os.environ.setdefault(
        "RUST_LOG", "error"
    )  # hide the log lines of Rerun itself, because handctl reports the errors
    if args.more and args.format != "lerobot":
        raise ConfigError(
            f"{args.more[0]}: a second log", f"log export --{args.format}", "one log, or --lerobot"
        )
    has_dataset_options = args.fps is not None or args.camera or args.camera_start != [0.0]
    if has_dataset_options and args.format != "lerobot":
        raise ConfigError("frame rate or camera", f"log export --{args.format}", "--lerobot")
    with ExitStack() as stack:
        logs = [stack.enter_context(RunLog(path)) for path in (args.log, *args.more)]
        output_path = args.output or path_with_suffix(args.log, f".{args.format}")
        with (
            atomic_path(output_path, must_be_new=True) as temporary_path,
            progress_bar("writing", quiet=args.json),
        ):
            count = _write_export(args, logs, temporary_path)
        code = max(
            warn_if_lossy(path, log.warning)
            for path, log in zip((args.log, *args.more), logs, strict=True)
        )
    if args.json:
        print_json({"log": str(args.log), "output": str(output_path), "count": count})
    else:
        print_escaped(f"{output_path}: {count} {EXPORT_UNITS.get(args.format, 'rows')}")
    return code


def _write_export(args: argparse.Namespace, logs: list[RunLog], output_path: Path) -> int:
    export_format = args.format
    log = logs[0]
    if export_format == "rrd":
        from handctl.view.rerun_conversion import write_rrd
        from handctl.view.scene.run_info import RunInfo

        return write_rrd(args.log, RunInfo.from_header(log.header, args.log.stem), output_path)
    if export_format == "parquet":
        from handctl.log.export.parquet import export_parquet

        return export_parquet(log, output_path)
    if export_format == "lerobot":
        from handctl.log.export.camera_video import make_cameras
        from handctl.log.export.lerobot import export_lerobot

        names = [words[0] for words in args.camera]
        paths_by_camera = [[Path(word) for word in words[1:]] for words in args.camera]
        return export_lerobot(
            logs,
            output_path,
            args.fps,
            make_cameras(names, paths_by_camera, args.camera_start, len(logs)),
        )
    from handctl.log.export.csv_and_candump import export_candump, export_csv

    return (
        export_csv(log, output_path) if export_format == "csv" else export_candump(log, output_path)
    )


def _recover_log(args: argparse.Namespace) -> int:
    from handctl.log.read.recover import recover_log

    output = args.output or Path(str(args.log).removesuffix(".mcap") + ".recovered.mcap")
    with progress_bar("copying", quiet=args.json):
        recovery = recover_log(args.log, output)
    status = recovery.status.name.lower()
    if args.json:
        lost_parts = [list(lost_range) for lost_range in recovery.lost_ranges]
        result = {
            "status": status,
            "messages": recovery.messages,
            "lost": lost_parts,
            "problem": recovery.problem,
        }
        print_json(result | {"output": str(output)})
    else:
        copied = "" if not recovery.messages else f", {recovery.messages} messages in {output}"
        print_escaped(
            f"{args.log}: {status}{copied}" + (f" ({recovery.problem})" if recovery.problem else "")
        )
    return int(recovery.status)
