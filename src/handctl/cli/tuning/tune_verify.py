"""``handctl tune verify``: test new gains on the hand, in rounds whose amplitude rises.

If a round fails, the hand gets its old gains again.
"""

import argparse
import shlex
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import checked_count, print_escaped, print_json
from handctl.cli.console.plan import check_perturb, find_calibration, make_plan, refuse_bus_options
from handctl.cli.console.screen import rich_console
from handctl.cli.console.verbosity import print_note
from handctl.errors import ConfigError
from handctl.session.calibration import ensure_calibration, homed_calibration, identified_in_file
from handctl.session.exit_codes import ExitCode
from handctl.session.gains import gain_assignments, read_gains_for_hand
from handctl.session.run import RunOutcome, make_controller, run_live, run_lockstep
from handctl.session.run_plan import RunPlan, check_gain_margins, commission_log, default_log
from handctl.session.simulate import SimulatorSettings


def run(args: argparse.Namespace) -> int:
    """Test new gains on the hand, and return the exit code.

    The exit code is 0 only if the new gains pass the round with the full amplitude.
    """
    from handctl.programs.gains_exercise import ExerciseProgram
    from handctl.tune.gains_verification import VerifyObserver, round_amplitudes

    if not 0.0 < args.amplitude <= 1.0:
        raise ConfigError(f"{args.amplitude:g}", "--amplitude", "more than 0, at most 1")
    amplitudes = round_amplitudes(args.amplitude)
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
    new_gains = read_gains_for_hand(plan.hand, args.candidate, plan.show_notice)
    check_gain_margins(plan.hand, new_gains.gains, plan.rate_hz)
    old_gains = plan.gains
    base = old_gains.model_copy(update={"filter": new_gains.gains.filter})
    if old_gains.filter != new_gains.gains.filter:
        print_note(
            "the filter's gains cannot change in a run: both halves use the new filter gains"
        )
    if args.dry_run:
        line = f"{plan.hand.name}: would verify {args.candidate} in {len(amplitudes)} rounds"
        return report_dry_run(args, plan, line, gains=args.candidate, amplitudes=amplitudes)
    log = args.log or default_log(plan.hand, "verify")
    plan = _with_gains(plan, base, args.candidate)
    first_seed = args.seed
    runs = []
    for seed in range(
        first_seed, first_seed + (checked_count(args.seeds, "--seeds", 100) if args.lockstep else 1)
    ):
        args.seed = seed
        run_log = log if seed == first_seed else log.with_stem(f"{log.stem}-seed{seed}")
        observer = VerifyObserver(plan.hand, base, new_gains.gains, amplitudes=amplitudes)
        outcome, truth = _run_test_round(args, plan, ExerciseProgram(amplitudes), observer, run_log)
        runs.append(_judge_run(plan, outcome, observer, run_log, truth))
        if not runs[-1]["through"]:
            break
    args.seed = first_seed
    return _report_verification(args, runs, outcome)


def _with_gains(plan: RunPlan, gains: Any, candidate_path: Path) -> RunPlan:
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
            calibration = ensure_calibration(plan, path, reason, run_live, commission_log(log))
        controller = make_controller(plan, program, calibration, True)
        return run_live(plan, controller, log, observer=verify_observer), None
    calibration = homed_calibration(plan.hand, identified_in_file(args.calibration, plan.hand))
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
        round_scores = scores_by_round(record, plan.hand, truth, outcome.offset_ns)
        picture = log.with_suffix(".png")
        draw_verify(picture, record, plan.hand, truth, outcome.offset_ns, verify_observer.rollback)
    stop_reason = _stop_reason(outcome.state.failure, verify_observer, len(round_scores))
    return {
        "through": not stop_reason,
        "stopped": stop_reason,
        "blocked": asdict(verify_observer.blocked) if verify_observer.blocked else None,
        "amplitudes": verify_observer.amplitudes,
        "returned": asdict(verify_observer.rollback) if verify_observer.rollback else None,
        "failure": outcome.state.failure,
        "rounds": round_scores,
        "judged_by": "truth" if truth else "estimates",
        "log": str(log),
        "picture": str(picture),
    }


def _stop_reason(failure: str, verify_observer: Any, round_count: int) -> str:
    """Return the reason why a test run did not pass all of its rounds.

    If the run passed all rounds, the text is empty.

    A blocked digit is reported before all other reasons, because it explains most of the others.
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

    last_round_result = round_results[-1]
    columns = (
        compare_rounds([round_result["rounds"] for round_result in round_results])
        if last_round_result["through"]
        else []
    )
    worse_names = [column.name for column in columns if column.verdict == "worse"]
    reason = last_round_result["stopped"]
    if worse_names and not args.accept_worse:
        reason = (
            f"{', '.join(worse_names)} worse than with the old gains; --accept-worse accepts this"
        )
    if not reason and outcome.exit_code != ExitCode.DONE:
        reason = f"the run ended with exit code {int(outcome.exit_code)}"
    is_verified = last_round_result["through"] and not reason
    result = {
        key: value for key, value in last_round_result.items() if key not in ("through", "stopped")
    } | {
        "verified": is_verified,
        "why_not": reason,
        "columns": [asdict(column) for column in columns],
        "worse": worse_names,
        "rounds": [asdict(round_result) for round_result in last_round_result["rounds"]],
        "runs": len(round_results),
        "logs": [round_result["log"] for round_result in round_results],
    }
    if args.json:
        print_json(result)
    else:
        _print_rounds(result, last_round_result["rounds"], args)
    if outcome.exit_code != ExitCode.DONE:
        return outcome.exit_code
    return ExitCode.DONE if is_verified else ExitCode.FAILED


def _print_columns(result: dict[str, Any]) -> None:
    runs = result["runs"]
    spread_text = f"spread of {runs} seeds" if runs > 1 else "one run, spread assumed"
    for column in result["columns"]:
        change = f"{column['old']:.2f} -> {column['new']:.2f} {column['unit']}"
        print(
            f"{column['name']}: {column['verdict']}, {change}, difference +-{column['spread']:.2f} ({spread_text})"
        )


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
    for i, (round_row, amplitude) in enumerate(
        zip(test_rounds, result["amplitudes"], strict=False)
    ):
        numbers = (
            round_row.tracking_deg,
            round_row.tension_N,
            round_row.effort_Nm_per_s,
            round_row.peak_tension_N,
        )
        table.add_row(
            _gains_label(i, result["returned"], result["amplitudes"]),
            f"{amplitude:g}",
            *(f"{number:.2f}" for number in numbers),
        )
    console = rich_console()
    console.print(table)
    gains_return = result["returned"]
    if gains_return:
        console.print(gains_return_text(gains_return))
    if result.get("columns"):
        _print_columns(result)
    console.print(f"log: {result['log']}\npicture: {result['picture']}", soft_wrap=True)
    # The last line is the verdict, even if a run has ended early.
    if result["verified"]:
        words = ("handctl", "gains", "apply", str(args.candidate), "--hand", str(args.hand))
        apply_command = shlex.join(words)
        print_escaped(f"verified; to use them: {apply_command}")
    else:
        print_escaped(f"not verified: {result['why_not']}")


def gains_return_text(gains_return: dict[str, Any]) -> str:
    """Return the line of the report about a return to the old gains."""
    return (
        f"returned to the old gains at {gains_return['t_s']:.3f} s (tick {gains_return['k']}), "
        f"amplitude {gains_return['amplitude']:g}: {gains_return['why']}"
    )


def _gains_label(
    round_number: int, gains_return: dict[str, Any] | None, amplitudes: tuple[float, ...]
) -> str:
    """Return the label of the gains in a test round: old, new, first new and then old, or old again."""
    from handctl.tune.gains_verification import OLD_GAINS_ROUNDS

    if round_number < OLD_GAINS_ROUNDS:
        return "old"
    if gains_return is None:
        return "new"
    end = OLD_GAINS_ROUNDS + amplitudes[OLD_GAINS_ROUNDS:].index(gains_return["amplitude"])
    return "new" if round_number < end else "new, then old" if round_number == end else "old again"
