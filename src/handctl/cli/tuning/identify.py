"""``handctl identify``: identify the parameters of a hand from its motion or from logs, and save them."""

import argparse
import shlex
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from handctl.cli.console.dry_run import report_dry_run
from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.options import check_seed, print_escaped, print_json
from handctl.cli.console.plan import (
    calibration_path,
    check_perturb,
    find_calibration,
    make_plan,
    print_notice,
    refuse_bus_options,
)
from handctl.cli.console.verbosity import is_verbose, print_note
from handctl.cli.tuning.tune_files import hand_arguments
from handctl.core.calibration import Calibration
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.log.header import RunHeader
from handctl.log.read.reader import RunLog
from handctl.programs.excitation import ExciteProgram
from handctl.replay.controller_rebuild import logged_hand
from handctl.runtime.buses.bus_opening import real_buses
from handctl.runtime.hold_timeout import HoldTimeout
from handctl.session.calibration import (
    ensure_calibration,
    load_calibration,
    previous_identified_parameters,
    run_commissioning,
    write_calibration,
)
from handctl.session.exit_codes import ExitCode
from handctl.session.gains import gain_assignments
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import RunFunction, RunOutcome, make_controller, run_live, run_lockstep
from handctl.session.run_plan import RunPlan, commissioning_log_path, default_log_path
from handctl.tune.identify.excitation import (
    excitation_steps,
    identifiable_digits,
    unidentifiable_reason,
)
from handctl.tune.identify.identification_figure import draw_identification
from handctl.tune.identify.identify import (
    LOW_COHERENCE_TEXT,
    TendonResult,
    identify_tendons,
    result_table,
    utc_now_text,
)

BLOCKED_DIGIT_HINT = (
    "expected a digit that touches nothing: remove the object "
    "that it touches, or correct the springs in the hand file"
)


def run(args: argparse.Namespace) -> int:
    """Excite a hand with a series of motions, or read logs of such motions.

    Then fit the parameters of the hand to the data, report and save the parameters, and return the
    exit code.
    """
    source_count = sum(map(bool, (args.bus, args.lockstep, args.logs)))
    if source_count != 1:
        raise ConfigError(
            f"{source_count or 'none'} given", "--bus, --lockstep, --from-log", "one of them"
        )
    check_perturb(args, args.lockstep)
    if args.logs and args.digits:
        raise ConfigError(
            "together with --from-log", "--digits", "logs of these digits, or a new motion"
        )
    check_seed(args.seed)
    if not args.bus:
        refuse_bus_options(args)
    if args.logs:
        return _identify_from_logs(args)
    plan = make_plan(args, lockstep=args.lockstep)
    program = ExciteProgram(excitation_steps(plan.hand, _digits_to_excite(args, plan.hand)))
    path, calibration, reason = find_calibration(args, plan.hand, plan.buses)
    # the results of a simulation must not be written to the file of a real hand
    if args.lockstep and not args.calibration:
        path = _simulated_calibration_path(plan.hand)
    total = sum(step.duration_s for step in program.steps)
    if args.dry_run:
        digits = list(dict.fromkeys(step.digit for step in program.steps))
        line = f"{plan.hand.name}: would move {len(digits)} digits for {total:.0f} s"
        return report_dry_run(args, plan, line, digits=digits, seconds=total, commissioning=reason)
    log = args.log or default_log_path(plan.hand, "identify")
    announcement = f"exciting {plan.hand.name} for about {total:.0f} s, one digit at a time"
    if args.lockstep:
        calibration, outcome = _identify_in_lockstep(args, plan, program, log, announcement)
    else:
        announce_motion(args, plan, path, calibration)
        print_note(announcement)
        calibration = calibration or ensure_calibration(
            plan, path, reason, run_live, commissioning_log_path(log)
        )
        controller = make_controller(plan, program, calibration, arm_at_once=True)
        hold_timeout = HoldTimeout()
        outcome = run_live(plan, controller, log, observer=hold_timeout)
        hold_timeout.raise_if_stopped(f"identifying {plan.hand.name}, log {log}")
    outcome.raise_if_not_finished(f"identifying {plan.hand.name}, log {log}")
    with RunLog(log) as record:
        results = identify_tendons(record, plan.hand, print_note)
    return _report_results(args, plan.hand, {log: results}, path, calibration)


def _digits_to_excite(args: argparse.Namespace, hand: Hand) -> tuple[str, ...]:
    """Return the digits that the operator has named, or all digits whose parameters can be identified.

    The function prints the name of each digit that is left out. If no digit has parameters that can
    be identified, the function returns all digits.
    """
    if args.digits:
        return tuple(args.digits)
    digits = identifiable_digits(hand)
    if not digits:
        return hand.digit_names
    for name in hand.digit_names:
        if name not in digits:
            print_notice(
                f"handctl: {name} is left out: {unidentifiable_reason(hand, name)}; "
                "its values stay those of the hand file"
            )
    return digits


def _identify_in_lockstep(
    args: argparse.Namespace,
    plan: RunPlan,
    program: ExciteProgram,
    log: Path,
    introduction_text: str,
) -> tuple[Calibration, RunOutcome]:
    """Commission a simulated hand in virtual time, and then excite it.

    Return the calibration and the outcome of the run.
    """
    perturb = gain_assignments(args.perturb, "--perturb")
    simulator = SimulatorSettings(
        args.hand, seed=args.seed, perturb=perturb, truth=log.with_suffix(".truth")
    )
    with simulator.lockstep_clock(plan.period_ns) as clock:
        print_note(introduction_text)
        return _commission_and_excite(plan, program, log, partial(run_lockstep, clock=clock))


def _commission_and_excite(
    plan: RunPlan, program: ExciteProgram, log: Path, runner: RunFunction
) -> tuple[Calibration, RunOutcome]:
    """Commission and then excite a hand. Return the calibration and the outcome of the run."""
    start_time_s = time.monotonic()
    calibration, _ = run_commissioning(plan, commissioning_log_path(log), runner)
    outcome = runner(plan, make_controller(plan, program, calibration, arm_at_once=True), log)
    simulated_s = (outcome.offset_ns + outcome.state.k * plan.period_ns) / 1e9
    print_note(
        f"{simulated_s:.0f} s of the simulated hand in {time.monotonic() - start_time_s:.0f} s"
    )
    return calibration, outcome


def _identify_from_logs(args: argparse.Namespace) -> int:
    """Identify the parameters of a hand from recorded runs, without moving the hand.

    Return the exit code.

    If several logs give results for the same tendon, the results of the last log are used.

    Raises:
        ConfigError: a log cannot be used, or the results would change the calibration of another
            hand.
    """
    hand = load_hand(args.hand)
    path = calibration_path(args, hand)
    headers = {log: _log_header(log) for log in args.logs}
    is_simulated = _are_simulated(headers)
    if all(header.deterministic for header in headers.values()) and not args.calibration:
        path = _simulated_calibration_path(hand)
    calibration = load_calibration(path, hand) if path.exists() else None
    has_explicit_output = args.calibration or args.no_write
    if (
        calibration is not None
        and calibration.simulated != is_simulated
        and not has_explicit_output
    ):
        kinds = ["a simulated hand", "a real hand"][:: 1 if is_simulated else -1]
        expected = f"--calibration FILE, because {path} is of {kinds[1]}"
        raise ConfigError(f"is of {kinds[0]}", str(args.logs[0]), expected)
    results: dict[Path, dict[str, TendonResult]] = {}
    for log in args.logs:
        print_note(f"reading {log}")
        with RunLog(log) as record:
            if logged_hand(record).identity != hand.identity:
                raise ConfigError(
                    "is of another hand", str(log), f"a log of {hand.name} {hand.identity[:12]}"
                )
            results[log] = {} if args.dry_run else identify_tendons(record, hand, print_note)
    if args.dry_run:
        if args.json:
            print_json(
                {"hand": hand.name, "logs": list(map(str, results)), "calibration": str(path)}
            )
        else:
            print_escaped(
                f"{hand.name}: would identify from {', '.join(map(str, results))}, and write {path}"
            )
        return ExitCode.DONE
    return _report_results(args, hand, results, path, calibration)


def _simulated_calibration_path(hand: Hand) -> Path:
    """Return the path of the calibration file for a simulated hand.

    A real hand is never armed with the calibration at this path.
    """
    return Path(f"{hand.name}.lockstep.calibration.toml")


def _log_header(log: Path) -> RunHeader:
    """Return the header of a log."""
    with RunLog(log) as record:
        return record.header


def _are_simulated(header_of_log: dict[Path, RunHeader]) -> bool:
    """Return True if all logs were recorded with a simulated hand: in lockstep, or on buses without real motors.

    Raises:
        ConfigError: the logs come from both a simulated hand and a real hand.
    """
    kinds = {}
    for log, header in header_of_log.items():
        buses = header.metadata.get("bus", "").split()
        kinds[header.deterministic or (bool(buses) and not real_buses(buses))] = log
    if len(kinds) > 1:
        raise ConfigError(
            "is of a simulated hand", str(kinds[True]), f"runs of one hand, as {kinds[False]}"
        )
    return kinds.get(True) is not None


def _report_results(
    args: argparse.Namespace,
    hand: Hand,
    results_of_log: dict[Path, dict[str, TendonResult]],
    path: Path,
    calibration: Calibration | None,
) -> int:
    """Write the calibration, draw the pictures, and print the results. Return the exit code."""
    date_text = utc_now_text()
    identified_parameters = previous_identified_parameters(
        path, hand, calibration.drive if calibration else {}, print_notice
    )
    all_results = [tendon for tendons in results_of_log.values() for tendon in tendons.values()]
    blocked_events = {
        tendon_result.data.digit: tendon_result.blocked_event_text
        for tendon_result in all_results
        if tendon_result.blocked_event_text
    }
    contact_by_digit = {
        result.data.digit: result.contact_text
        for result in all_results
        if result.contact_text and not result.blocked_event_text
    }
    incoherent_names = [result.data.tendon for result in all_results if result.is_incoherent]
    any_identified = False
    for log, tendons in results_of_log.items():
        new_entries = {
            name: result.calibration_entry(log, date_text) for name, result in tendons.items()
        }
        any_identified = any_identified or any(
            new_entry is not None for new_entry in new_entries.values()
        )
        identified_parameters |= {
            name: new_entry.merge_older_parameters(identified_parameters.get(name))
            for name, new_entry in new_entries.items()
            if new_entry is not None
        }
    is_written = (
        calibration is not None
        and not args.no_write
        and (any_identified or not (blocked_events or contact_by_digit))
    )
    if calibration is not None and is_written:
        write_calibration(
            path, calibration.model_copy(update={"identified": identified_parameters})
        )
    pictures = _draw_pictures(
        hand, results_of_log, print_note
    )  # the calibration is written first, so that it is not lost if the drawing fails
    _print_rejected_parameters(blocked_events, contact_by_digit, incoherent_names)
    exit_code = ExitCode.FAILED if blocked_events or contact_by_digit else ExitCode.DONE
    if args.json:
        print_json(
            _result_fields(results_of_log, pictures, path if is_written else None)
            | {"blocked": blocked_events, "met": contact_by_digit, "incoherent": incoherent_names}
        )
        return exit_code
    for log, tendons in results_of_log.items():
        print("\n".join([f"from {log}:", *result_table(tendons, is_verbose())]))
    print("pictures: " + ", ".join(map(str, pictures)))
    if is_written:
        print(f"calibration written to {path}")
        if not incoherent_names:
            print(f"next: {_search_command(args, path)}")
        return exit_code
    if args.no_write:
        reason = "as asked"
    elif calibration is None:
        reason = f"there is no {path}: handctl commission first"
    else:
        all_blocked = set(blocked_events) == {result.data.digit for result in all_results}
        reason = "every digit was blocked" if all_blocked else "no parameter was identified"
    print_escaped(f"no calibration written: {reason}")
    return exit_code


def _print_rejected_parameters(
    blocked_digits: dict[str, str], contact_by_digit: dict[str, str], incoherent_tendons: list[str]
) -> None:
    """Print which identified parameters are rejected, and the reason for each rejection.

    Args:
        blocked_digits: for each digit that was blocked, the event that reports the blocking.
        contact_by_digit: for each digit that touched an obstacle in its sweep, the description of
            the contact.
        incoherent_tendons: names of the tendons whose coherence is too low.
    """
    for digit, reason in blocked_digits.items():
        print_escaped(
            f"handctl: no parameters of {digit} are kept: {reason}; expected a digit that touches nothing",
            error=True,
        )
    for digit, reason in contact_by_digit.items():
        print_escaped(
            f"handctl: springs and friction of {digit} are not kept: {reason}; {BLOCKED_DIGIT_HINT}",
            error=True,
        )
    if incoherent_tendons:
        print_escaped(
            f"handctl: inertia, viscous friction and delay of {', '.join(incoherent_tendons)} are not kept: "
            f"{LOW_COHERENCE_TEXT}, so the values are not worth using; let handctl identify move the digits",
            error=True,
        )


def _search_command(args: argparse.Namespace, path: Path) -> str:
    """Return the command line that tunes gains for the identified hand.

    The options of the returned command line select the same hand as the present command.
    """
    words = ["handctl", "tune", "search", "--hand", str(args.hand), "--calibration", str(path)]
    return shlex.join(words + hand_arguments(args))


def _draw_pictures(
    hand: Hand,
    results_of_log: dict[Path, dict[str, TendonResult]],
    print_line: Callable[[str], None],
) -> list[Path]:
    pictures = []
    for log, tendons in results_of_log.items():
        for name, tendon_result in tendons.items():
            picture = log.with_suffix(f".identify-{name}.png")
            print_line(f"drawing {picture}")
            draw_identification(picture, tendon_result, f"{hand.name} {name}: {log.name}")
            pictures.append(picture)
    return pictures


def _result_fields(
    results_of_log: dict[Path, dict[str, TendonResult]],
    picture_paths: list[Path],
    path: Path | None,
) -> dict[str, Any]:
    logs = {
        str(log): {name: tendon_result.as_json() for name, tendon_result in tendons.items()}
        for log, tendons in results_of_log.items()
    }
    return {"logs": logs, "pictures": picture_paths, "calibration": path}
