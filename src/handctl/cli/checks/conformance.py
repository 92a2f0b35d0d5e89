"""``handctl conformance``: check that a real drive behaves as handctl requires.

The user gives a torque limit, which no check exceeds.
"""

import argparse
import math
import sys
from collections import Counter
from typing import Any

from handctl.cli.console.bench_drive import (
    DRIVE_STILL_ON_WARNING,
    WATCHDOG_MS,
    describe_drive,
    find_drive,
    open_drive_rig,
    parse_options,
    with_torque_range,
)
from handctl.cli.console.motion_confirmation import confirm_motion
from handctl.cli.console.options import print_json
from handctl.drives.contract import Drive
from handctl.drives.discovery import DiscoveredNode
from handctl.errors import ConfigError, PowerError
from handctl.hand.file.quantity_types import MAX_TORQUE_N_M, MIN_TORQUE_LIMIT_N_M
from handctl.runtime.buses.bus_opening import check_bus_spec
from handctl.runtime.diagnostics.conformance import (
    CHECKED_REQUIREMENTS,
    CheckVerdict,
    ConformanceCheck,
    DeviceUnderTest,
    release_drive,
    run_checks,
)
from handctl.runtime.mailbox import bus_lock
from handctl.session.exit_codes import ExitCode

TEXT_BY_VERDICT = {
    CheckVerdict.PASSED: "passed     ",
    CheckVerdict.FAILED: "FAILED     ",
    CheckVerdict.NOT_CHECKED: "not checked",
}


def run(args: argparse.Namespace) -> int:
    """Run the checks of a drive, and return the exit code.

    The exit code is 1 if a check failed. The exit code is 5 if no check failed, but at least one
    check could not be made. The exit code is 71 if the drive does not confirm that it is disabled.
    """
    options = parse_options(args.option)
    if not (math.isfinite(args.limit) and MIN_TORQUE_LIMIT_N_M <= args.limit <= MAX_TORQUE_N_M):
        expected = f"{MIN_TORQUE_LIMIT_N_M:g} to {MAX_TORQUE_N_M:g}"
        raise ConfigError(f"{args.limit:g}", "--torque-limit-Nm", expected)
    check_bus_spec(args.bus)
    describe_drive(args, options, None)
    if args.dry_run:
        return _dry_run(args)
    warning = f"the shaft of {args.protocol} {args.node} on {args.bus} turns, with at most {args.limit:g} N m"
    confirm_motion(warning, args.yes)
    _print_error(f"{warning}. Ctrl-C switches the drive off.")
    with bus_lock(args.bus):
        node = find_drive(args)
        drive = describe_drive(args, options, node)
        results, is_drive_disabled = _run_checks(args, drive, with_torque_range(drive, node))
    counts = Counter(check.verdict for check in results)
    if args.json:
        print_json(_result_fields(args, node, results, is_drive_disabled))
    else:
        print("the drive keeps the watchdog and limits of this check until it is switched off")
        print(", ".join(f"{counts[verdict]} {verdict.value}" for verdict in CheckVerdict))
    if not is_drive_disabled:
        _print_error(DRIVE_STILL_ON_WARNING)
        return ExitCode.REMOVE_POWER
    if counts[CheckVerdict.FAILED]:
        return ExitCode.FAILED
    return ExitCode.NOT_CHECKED if counts[CheckVerdict.NOT_CHECKED] else ExitCode.DONE


def _dry_run(args: argparse.Namespace) -> int:
    if args.json:
        print_json(
            {
                "checks": [name for name, _, _ in CHECKED_REQUIREMENTS],
                "torque_limit_N_m": args.limit,
            }
        )
        return ExitCode.DONE
    print(f"would check that {args.protocol} {args.node}, with at most {args.limit:g} N m,")
    for name, _, turns in CHECKED_REQUIREMENTS:
        print(f"  {name}" + (" (the shaft turns)" if turns else ""))
    return ExitCode.DONE


def _run_checks(
    args: argparse.Namespace, drive: Drive, original_drive: Drive
) -> tuple[list[ConformanceCheck], bool]:
    """Run the checks of a drive, disable the drive, and restore the drive's torque range.

    Return the results of the checks. The second returned value is True if the drive has confirmed
    that it is disabled.
    """
    results: list[ConformanceCheck] = []
    with open_drive_rig(args, drive) as (rig, bus):
        try:
            for check in run_checks(DeviceUnderTest(rig, args.limit, WATCHDOG_MS / 1e3)):
                results.append(check)
                if not args.json:
                    print(
                        f"{TEXT_BY_VERDICT[check.verdict]}  {check.name}: {check.reason}",
                        flush=True,
                    )
        finally:
            if len(results) < len(CHECKED_REQUIREMENTS):
                bus.send(drive.torque_cut_frames())
            is_drive_disabled = release_drive(
                rig, WATCHDOG_MS / 1e3, original_drive if original_drive is not drive else None
            )
            if not is_drive_disabled and len(results) < len(
                CHECKED_REQUIREMENTS
            ):  # Ctrl-C or a bug has ended the checks, and this early end is reported here
                raise PowerError(DRIVE_STILL_ON_WARNING)
    return results, is_drive_disabled


def _result_fields(
    args: argparse.Namespace,
    node: DiscoveredNode,
    check_results: list[ConformanceCheck],
    is_drive_disabled: bool,
) -> dict[str, Any]:
    return {
        "drive": args.protocol,
        "node": args.node,
        "bus": args.bus,
        "torque_limit_N_m": args.limit,
        "firmware": node.firmware,
        "serial": node.serial,
        "confirmed_off": is_drive_disabled,
        "checks": [
            {"name": check.name, "verdict": check.verdict.value, "why": check.reason}
            for check in check_results
        ],
    }


def _print_error(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
