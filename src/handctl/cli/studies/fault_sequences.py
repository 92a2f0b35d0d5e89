"""``handctl fault sequences``: run random sequences of faults on a simulated hand in lockstep."""

import argparse
from typing import Any

from handctl.campaign import fault_sequences
from handctl.campaign.run_stages import hand_with_protocol
from handctl.cli.console.options import check_seed, print_json
from handctl.cli.console.progress import progress_bar
from handctl.cli.studies.fault_campaign import (
    FIRST_PROGRESS_LABEL,
    MAX_JOBS,
    failure_log_writer,
    report_folder,
)
from handctl.errors import ConfigError
from handctl.session.exit_codes import ExitCode
from handctl.session.run_plan import default_control_rate

MAX_SEQUENCE_COUNT = 1_000_000


def run(args: argparse.Namespace) -> int:
    """Run random sequences of faults, and report which rules the hand has violated.

    Return the exit code.
    """
    for name, value, maximum in (
        ("--jobs", args.jobs, MAX_JOBS),
        ("--count", args.count, MAX_SEQUENCE_COUNT),
    ):
        if not 1 <= value <= maximum:
            raise ConfigError(f"{value}", name, f"1 to {maximum}")
    check_seed(args.seed)
    hand = hand_with_protocol(args.hand, args.protocol)
    folder = report_folder(args)
    seeds = range(args.seed, args.seed + args.count)
    with progress_bar(FIRST_PROGRESS_LABEL, quiet=args.json) as update_progress:
        results = fault_sequences.run_sequences(
            hand,
            args.protocol,
            default_control_rate(hand),
            seeds,
            jobs=args.jobs,
            on_progress=lambda done: update_progress(done, args.count, args.protocol),
            on_failure=failure_log_writer(folder),
        )
    broken_results = [result for result in results if not result.ok]
    figures: dict[str, Any] = {
        "hand": args.hand,
        "protocol": args.protocol,
        "rate_hz": default_control_rate(hand),
        "first_seed": args.seed,
        "sequences": len(results),
        "broken": len(broken_results),
        "felt": sum(result.effect_count for result in results),
        "worst_tension_N": max(result.tension for result in results),
    }
    if args.json:
        print_json(figures | {"results": [result.as_json() for result in broken_results]})
    else:
        print(
            f"{len(results)} sequences, {figures['felt']} faults with an effect; {len(broken_results)} violated a rule"
        )
        print(f"largest true tension {figures['worst_tension_N']:.0f} N")
        for result in broken_results:
            print(f"{result.scenario}: {result.problem}")
        if broken_results:
            print(f"logs: {folder}; to repeat one sequence: --seed SEED --count 1")
    return ExitCode.FAILED if broken_results else ExitCode.DONE
