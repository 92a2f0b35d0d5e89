"""``handctl tune verify``: test new gains on the hand, in rounds of rising amplitude.

If the hand violates a limit in a round, the controller returns to the old gains.
"""

import argparse
import shlex
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import check_count, print_escaped, print_json
from handctl.cli.console.plan import check_perturb, find_calibration, make_plan, refuse_bus_options
from handctl.cli.console.rich_console import rich_console
from handctl.cli.console.verbosity import print_note
from handctl.errors import ConfigError
from handctl.session.calibration import (
    ensure_calibration,
    homed_calibration,
    identified_parameters_in_file,
)
from handctl.session.exit_codes import ExitCode
from handctl.session.gains import gain_assignments, read_gains_for_hand
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import RunOutcome, make_controller, run_live, run_lockstep
from handctl.session.run_plan import (
    RunPlan,
    check_gain_margins,
    commissioning_log_path,
    default_log_path,
)


def run(args: argparse.Namespace) -> int:
    """Test new gains on the hand, and return the exit code.

    The exit code is 0 only if the new gains pass the round with the full amplitude.
    """
    from handctl.programs.gains_exercise import ExerciseProgram, largest_exercise
    from handctl.tune.gains_verification import VerifyObserver, round_amplitudes

    if args.amplitude is not None and not 0.0 < args.amplitude <= 1.0:
        raise ConfigError(f"{args.amplitude:g}", "--amplitude", "more than 0, at most 1")
    if bool(args.bus) == args.lockstep:
        raise ConfigError(
            "none or both given",
            "--bus, --lockstep",
            "one of them, --lockstep for a simulated hand",
        )
    check_perturb(args, args.lockstep)
    if args.lockstep:
        refuse_bus_options(args)
    plan = make_plan(args, lockstep=args.lockstep)
    candidate_file = read_gains_for_hand(plan.hand, args.candidate, plan.show_notice)
    check_gain_margins(plan.hand, candidate_file.gains, plan.rate_hz)
    present_gains = plan.gains
    gains_with_new_filter = present_gains.model_copy(update={"filter": candidate_file.gains.filter})
    if present_gains.filter != candidate_file.gains.filter:
        print_note(
            "the filter's gains cannot change in a run: both halves use the new filter gains"
        )
    largest_amplitude, turns = largest_exercise(plan.hand)
    amplitudes = round_amplitudes(args.amplitude or largest_amplitude)
    program = ExerciseProgram(amplitudes, turns)
    if args.dry_run:
        line = f"{plan.hand.name}: would verify {args.candidate} in {len(amplitudes)} rounds"
        return report_dry_run(args, plan, line, gains=args.candidate, amplitudes=amplitudes)
    log = args.log or default_log_path(plan.hand, "verify")
    plan = _plan_with_gains(plan, gains_with_new_filter, args.candidate)
    first_seed = args.seed
    runs = []
    for seed in range(
        first_seed, first_seed + (check_count(args.seeds, "--seeds", 100) if args.lockstep else 1)
    ):
        args.seed = seed
        run_log = log if seed == first_seed else log.with_stem(f"{log.stem}-seed{seed}")
        observer = VerifyObserver(
            plan.hand, gains_with_new_filter, candidate_file.gains, amplitudes=amplitudes
        )
        outcome, truth = _run_test_round(args, plan, program, observer, run_log)
        runs.append(_judge_run(plan, outcome, observer, run_log, truth))
        if not runs[-1]["through"]:
            break
    args.seed = first_seed
    return _report_verification(args, runs, outcome)


def _plan_with_gains(plan: RunPlan, gains: Any, candidate_path: Path) -> RunPlan:
    from dataclasses import replace

    return replace(
        plan,
        gains=gains,
        attachments=plan.attachments | {"candidate.toml": candidate_path.read_bytes()},
    )


def _run_test_round(
    args: argparse.Namespace, plan: RunPlan, program: Any, verify_observer: Any, log: Path
) -> tuple[RunOutcome, Path | None]:
    if not args.lockstep:
        path, calibration, reason = find_calibration(args, plan.hand, plan.buses)
        announce_motion(args, plan, path, calibration)
        if calibration is None:
            calibration = ensure_calibration(
                plan, path, reason, run_live, commissioning_log_path(log)
            )
        controller = make_controller(plan, program, calibration, True)
        return run_live(plan, controller, log, observer=verify_observer), None
    calibration = homed_calibration(
        plan.hand, identified_parameters_in_file(args.calibration, plan.hand)
    )
    truth = log.with_suffix(".truth")
    perturb = gain_assignments(args.perturb, "--perturb")
    with SimulatorSettings(
        args.hand, None, args.seed, perturb, homed=True, truth=truth
    ).lockstep_clock(plan.period_ns) as clock:
        return run_lockstep(
            plan, make_controller(plan, program, calibration, True), log, clock, verify_observer
        ), truth


def _judge_run(
    plan: RunPlan, outcome: RunOutcome, verify_observer: Any, log: Path, truth_file: Path | None
) -> dict[str, Any]:
    """Compute the scores of one test run, and draw a picture of this run.

    Return the fields of the JSON result.
    """
    from handctl.log.read.reader import RunLog
    from handctl.report.truth_record import read_truth
    from handctl.tune.gains_verification import scores_by_round
    from handctl.tune.tuning_figures import draw_verify

    truth = read_truth(truth_file) if truth_file else None
    with RunLog(log) as record:
        rounds = scores_by_round(record, plan.hand, truth, outcome.offset_ns)
        picture = log.with_suffix(".png")
        draw_verify(picture, record, plan.hand, truth, outcome.offset_ns, verify_observer.rollback)
    stop_reason = _stop_reason(outcome.state.failure, verify_observer, len(rounds))
    return {
        "through": not stop_reason,
        "stopped": stop_reason,
        "blocked": asdict(verify_observer.blocked) if verify_observer.blocked else None,
        "amplitudes": verify_observer.amplitudes,
        "returned": asdict(verify_observer.rollback) if verify_observer.rollback else None,
        "failure": outcome.state.failure,
        "rounds": rounds,
        "judged_by": "truth" if truth else "estimates",
        "log": str(log),
        "picture": str(picture),
    }


def _stop_reason(failure: str, verify_observer: Any, round_count: int) -> str:
    """Return the reason why a test run did not pass all rounds, or an empty text.

    If a digit was blocked, the text describes only the blocked digit, because a blocked digit
    causes most failures.
    """
    if verify_observer.blocked:
        return str(verify_observer.blocked)
    if failure:
        return f"the run failed: {failure}"
    if verify_observer.rollback:
        return f"{verify_observer.rollback.why} at amplitude {verify_observer.rollback.amplitude:g}"
    if round_count < len(verify_observer.amplitudes):
        return f"the run ended in round {round_count} of {len(verify_observer.amplitudes)}"
    return ""


def _report_verification(
    args: argparse.Namespace, round_results: list[dict[str, Any]], outcome: RunOutcome
) -> int:
    """Print the results of all test runs, and a table about the last run.

    Return the exit code.
    """
    from handctl.tune.gains_verification import compare_rounds

    last_run = round_results[-1]
    columns = (
        compare_rounds([run_result["rounds"] for run_result in round_results])
        if last_run["through"]
        else []
    )
    worse = [column.name for column in columns if column.verdict == "worse"]
    reason = last_run["stopped"]
    if worse and not args.accept_worse:
        reason = f"{', '.join(worse)} worse than with the old gains; --accept-worse accepts this"
    if not reason and outcome.exit_code != ExitCode.DONE:
        reason = f"the run ended with exit code {int(outcome.exit_code)}"
    verified = last_run["through"] and not reason
    result = {
        key: value for key, value in last_run.items() if key not in ("through", "stopped")
    } | {
        "verified": verified,
        "why_not": reason,
        "columns": [asdict(column) for column in columns],
        "worse": worse,
        "rounds": [asdict(test_round) for test_round in last_run["rounds"]],
        "runs": len(round_results),
        "logs": [run_result["log"] for run_result in round_results],
    }
    if args.json:
        print_json(result)
    else:
        _print_rounds(result, last_run["rounds"], args)
    if outcome.exit_code != ExitCode.DONE:
        return outcome.exit_code
    return ExitCode.DONE if verified else ExitCode.FAILED


def _print_columns(result: dict[str, Any]) -> None:
    runs = result["runs"]
    spread_source = f"spread of {runs} seeds" if runs > 1 else "one run, spread assumed"
    for measure in result["columns"]:
        change = (
            f"{measure['old']:.2f} -> {measure['new']:.2f} {measure['unit']}, "
            f"difference +-{measure['spread']:.2f} ({spread_source})"
        )
        print(f"{measure['name']}: {measure['verdict']}, {change}")


def _print_rounds(
    result: dict[str, Any], test_rounds: Iterable[Any], args: argparse.Namespace
) -> None:
    from rich.table import Table

    table = Table(title=f"judged by the {result['judged_by']}")
    for heading in (
        "gains",
        "amplitude",
        "tracking [deg]",
        "tension [N]",
        "effort [N m/s]",
        "peak tension [N]",
    ):
        table.add_column(heading)
    for i, (test_round, amplitude) in enumerate(
        zip(test_rounds, result["amplitudes"], strict=False)
    ):
        numbers = (
            test_round.tracking_deg,
            test_round.tension_N,
            test_round.effort_Nm_per_s,
            test_round.peak_tension_N,
        )
        table.add_row(
            _gains_label(i, result["returned"], result["amplitudes"]),
            f"{amplitude:g}",
            *(f"{number:.2f}" for number in numbers),
        )
    console = rich_console()
    console.print(table)
    returned_gains = result["returned"]
    if returned_gains:
        console.print(rollback_text(returned_gains))
    if result.get("columns"):
        _print_columns(result)
    console.print(f"log: {result['log']}\npicture: {result['picture']}", soft_wrap=True)
    # The last line of the report says whether the new gains passed, even if a run has ended early.
    if result["verified"]:
        words = ("handctl", "gains", "apply", str(args.candidate), "--hand", str(args.hand))
        apply = shlex.join(words)
        print_escaped(f"verified; to use them: {apply}")
    else:
        print_escaped(f"not verified: {result['why_not']}")


def rollback_text(rollback: dict[str, Any]) -> str:
    """Return a line that states when and why the controller went back to the old gains."""
    return (
        f"returned to the old gains at {rollback['t_s']:.3f} s (tick {rollback['k']}), "
        f"amplitude {rollback['amplitude']:g}: {rollback['why']}"
    )


def _gains_label(
    round_number: int, rollback: dict[str, Any] | None, amplitudes: tuple[float, ...]
) -> str:
    """Return the label of the gains in a test round: old, new, new then old, or old again."""
    from handctl.tune.gains_verification import ROUNDS_WITH_OLD_GAINS

    if round_number < ROUNDS_WITH_OLD_GAINS:
        return "old"
    if rollback is None:
        return "new"
    end = ROUNDS_WITH_OLD_GAINS + amplitudes[ROUNDS_WITH_OLD_GAINS:].index(rollback["amplitude"])
    return "new" if round_number < end else "new, then old" if round_number == end else "old again"
