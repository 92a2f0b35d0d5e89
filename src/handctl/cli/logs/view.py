"""``handctl view``: show a log in Rerun, save the log as a Rerun recording, or draw a picture of the run."""

import argparse
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from handctl.cli.console.options import print_escaped, print_json, warn_if_lossy
from handctl.cli.console.progress import progress_bar
from handctl.errors import ConfigError
from handctl.output_files import atomic_path, check_output_path
from handctl.session.exit_codes import ExitCode


def run(args: argparse.Namespace) -> int:
    """Show a log, or write the requested recording and picture. Return the exit code."""
    os.environ.setdefault(
        "RUST_LOG", "error"
    )  # hide the log lines of Rerun itself, because handctl reports the errors
    _check_options(args)
    if args.follow:
        from handctl.view.log_follower import follow_logs

        follow_logs([args.log, *args.further_logs])
        return ExitCode.DONE
    from handctl.log.read.reader import RunLog

    further_runs = []
    for path in args.further_logs:
        with RunLog(path, verify_checksums=False) as log:
            further_runs.append((path, _run_info(log, path, None)))
    with RunLog(args.log, verify_checksums=False) as log:
        run_info = _run_info(log, args.log, args.truth)
        picture_time_s = _picture_time_s(args, log) if args.picture else 0.0
        warning = log.warning
        scan = log.scan
    code = warn_if_lossy(args.log, warning)
    if run_info.missing_mesh_note:
        print_escaped(f"handctl: caution: {args.log}: {run_info.missing_mesh_note}", error=True)
    if args.save or args.picture:
        with progress_bar("drawing" if args.picture else "writing", quiet=args.json):
            result = _write_files(args, run_info, picture_time_s)
    else:
        result = {}
        _show_in_viewer(args.log, run_info, scan, further_runs)
    if args.json:
        print_json(
            result | {"log": args.log, "warning": warning, "note": run_info.missing_mesh_note}
        )
    return code


def _run_info(log: Any, path: Path, truth_path: Path | None) -> Any:
    """Return the data about the run of a log, with the true state of the run if its file exists."""
    from handctl.report.truth_record import find_truth
    from handctl.view.scene.run_info import RunInfo

    return replace(
        RunInfo.from_header(log.header, path.stem), truth=find_truth(truth_path, path, log)
    )


def _picture_time_s(args: argparse.Namespace, log: Any) -> float:
    """Return the instant of the run that the picture shows [s].

    Raises:
        ConfigError: the time given by ``--at`` is not within the run.
    """
    from handctl.view.picture_time import picture_time

    end_s = float(log.times[-1]) if len(log) else 0.0
    if args.at is None:
        return picture_time(log)
    if not 0 <= args.at <= end_s:
        raise ConfigError(f"{args.at:g}", "--at", f"seconds of this run, 0 to {end_s:.3f}")
    return float(args.at)


def _check_options(args: argparse.Namespace) -> None:
    """Raise an error if two options contradict each other.

    ``handctl view`` calls the check before the log is read.
    """
    from handctl.view.viewer import check_screen_exists, software_vulkan

    if args.follow and (args.save or args.picture):
        raise ConfigError("together with --save or --picture", "--follow", "one of them")
    if args.further_logs and (args.save or args.picture):
        raise ConfigError("several logs", "--save, --picture", "one log")
    names = [path.stem for path in (args.log, *args.further_logs)]
    if len(set(names)) < len(names):
        # The viewer would show two logs with the same name as a single recording.
        raise ConfigError(", ".join(names), "LOG", "logs with different file names")
    if args.at is not None and not args.picture:
        raise ConfigError("without --picture", "--at", "--picture FILE.png")
    for option, path, suffix in (
        ("--save", args.save, ".rrd"),
        ("--picture", args.picture, ".png"),
    ):
        if path and (path.suffix != suffix or not path.parent.is_dir()):
            raise ConfigError(
                str(path), option, f"a file name ending in {suffix} in a folder that exists"
            )
        if path:
            check_output_path(path, option, args.log)
    if args.picture:
        software_vulkan()
    elif not args.save:
        check_screen_exists()


def _write_files(args: argparse.Namespace, run_info: Any, picture_time_s: float) -> dict[str, Any]:
    """Write the recording and the picture, if they are requested.

    Return the fields of the JSON result.
    """
    from handctl.view.rerun_conversion import write_rrd

    result: dict[str, Any] = {}
    if args.save:
        with atomic_path(args.save) as temporary_path:
            result = {"rrd": args.save, "bytes": write_rrd(args.log, run_info, temporary_path)}
        _print_note(
            args,
            f"wrote {args.save}, {result['bytes'] / 1e6:.1f} MB; open it with: rerun {args.save}",
        )
    if not args.picture:
        return result
    with tempfile.TemporaryDirectory(prefix="handctl-view-") as folder:
        rerun_file = args.save or Path(folder) / f"{args.log.stem}.rrd"
        if not args.save:
            write_rrd(args.log, run_info, rerun_file)
        return _draw_picture(args, rerun_file, picture_time_s) | result


def _draw_picture(
    args: argparse.Namespace, recording_path: Path, picture_time_s: float
) -> dict[str, Any]:
    from handctl.view.dashboard_picture import draw_recording

    reports = draw_recording(recording_path, picture_time_s, args.picture)
    for report in reports:
        print_escaped(f"handctl: {report}", error=True)
    _print_note(args, f"wrote {args.picture}: the hand at {picture_time_s:.3f} s")
    return {"png": args.picture, "at_s": picture_time_s, "reports": reports}


def _show_in_viewer(
    log: Path, run_info: Any, record_scan: Any, further_runs: list[tuple[Path, Any]]
) -> None:
    """Open the viewer, send all logs to the viewer, and wait until the user closes the viewer."""
    from handctl.view.log_browser import browse_log

    with browse_log(log, run_info, [], {}, record_scan, further_runs) as viewer_process:
        try:
            viewer_process.process.wait()
        except KeyboardInterrupt:
            return


def _print_note(args: argparse.Namespace, text: str) -> None:
    if not args.json:
        print_escaped(text)
