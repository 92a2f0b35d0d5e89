"""``handctl tune search``: search for the best gains by runs of simulated hands.

An interrupted search can be resumed.
"""

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from handctl.cli.console.options import check_count, print_json
from handctl.cli.console.plan import gains_with_sources
from handctl.cli.console.rich_console import rich_console
from handctl.cli.console.verbosity import is_quiet
from handctl.cli.tuning.tune_files import (
    ensemble_of_tuned_hand,
    load_tuned_hand,
    output_files,
    verify_command,
    write_gains,
)
from handctl.controller.bus_load import bus_loads
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.session.exit_codes import ExitCode
from handctl.session.run_plan import control_rate


def run(args: argparse.Namespace) -> int:
    """Search for gains, draw the trials of the search, and write the gains file and the picture.

    The command fails if no trial has large enough stability margins.
    """
    from handctl.tune.search.gain_search import (
        SearchPlan,
        run_search,
        without_uncommissionable_trials,
    )
    from handctl.tune.search.workers import make_workers
    from handctl.tune.tuning_figures import draw_search

    hand, identified_hand, spread = load_tuned_hand(args.hand, args.fit)
    gains = gains_with_sources(args, hand).gains
    rate = control_rate(args.rate, hand, bus_loads(hand))
    output_path, picture = output_files(args, hand.name, "search")
    plants = ensemble_of_tuned_hand(args, spread, 256)
    trials = check_count(args.trials, "--trials", 100_000)
    worker_count = check_count(args.jobs, "--jobs", 64)
    storage = args.study or Path(f"{hand.name}.study")
    with _SearchProgress(trials, args.json or is_quiet()) as progress:
        plan = SearchPlan(
            identified_hand.to_toml(),
            rate,
            gains,
            plants,
            args.seed,
            trials,
            _designed_gains(identified_hand, gains, rate, plants),
        )
        worker_pool = make_workers(worker_count, args.scheduler)
        try:
            result = run_search(plan, storage, worker_pool, progress.show_result)
            result = without_uncommissionable_trials(plan, result, progress.show_commissioning)
        except KeyboardInterrupt as error:
            raise type(error)(f"interrupted; the same command continues with {storage}") from None
        finally:
            worker_pool.close()
    draw_search(
        picture,
        result,
        f"{hand.name} at {rate:g} Hz: {len(result.trials)} trials on {len(plants)} plants",
    )
    if result.best is None:
        return _report_infeasible(args, result, storage, picture, trials)
    best = plan.gains_of(result.best.number, result.best.values)
    note = f"tune search, trial {result.best.number} of {len(result.trials)} on {len(plants)} plants, seed {args.seed}"
    write_gains(output_path, best, hand, note, fit=args.fit, study=str(storage))
    report = _report_fields(result, storage, output_path, picture)
    if args.json:
        print_json(report)
    else:
        _print_search(result, report)
        print(f"next: {verify_command(args, output_path)}")
    return ExitCode.DONE


def _report_infeasible(
    args: argparse.Namespace,
    search_result: Any,
    storage_path: Path,
    picture_path: Path,
    trials: int,
) -> int:
    """Report that no trial has large enough margins and commissions the hand, and return the exit code."""
    if args.json:
        print_json(_report_fields(search_result, storage_path, None, picture_path))
    else:
        print(
            "no trial keeps the margins and commissions the hand on every plant; "
            f"look at {picture_path}, and try --trials {2 * trials}"
        )
    return ExitCode.FAILED


def _designed_gains(
    hand: Hand, gains: Gains, rate_hz: float, plants: tuple[dict[str, float], ...]
) -> tuple[Gains, ...]:
    """Return the gains that ``tune design`` finds for the same simulated plants.

    The gains of the design are one of the starting points of the search. If the design fails, or
    if its gains are out of bounds with the default force weights, return an empty tuple.
    """
    from handctl.tune.loops.gain_design import design_gains, linear_factors

    try:
        result = design_gains(
            HandModel.from_hand(hand, gains, rate_hz),
            tuple(linear_factors(plant) for plant in plants),
        )
        return (result.as_weights(),)
    except (ValueError, ConfigError):
        return ()


class _SearchProgress:
    """Display of the progress of a search: completed trials, best trial and remaining time."""

    def __init__(self, trials: int, quiet: bool) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn("search"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}"),
        )
        self._console = rich_console(error=True)
        self._bar = Progress(
            *columns, console=self._console, disable=quiet or not self._console.is_terminal
        )
        self._task = self._bar.add_task("designing", total=trials)
        self._quiet = quiet
        self._next = 0.0

    def __enter__(self) -> "_SearchProgress":
        self._bar.start()
        if not self._quiet and self._bar.disable:
            self._console.print("designing the initial gains")
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def show_result(self, search_result: Any) -> None:
        """Update the display of the search after a trial.

        Without a terminal, print at most one line in 5 s.
        """
        text = (
            f"best {search_result.relative_cost(search_result.best):.3f}, trial {search_result.best.number}"
            if search_result.best
            else "none feasible yet"
        )
        self._bar.update(self._task, completed=len(search_result.trials), description=text)
        if not self._quiet and self._bar.disable and time.monotonic() >= self._next:
            self._next = time.monotonic() + 5.0
            self._console.print(f"trial {len(search_result.trials)}: {text}")

    def show_commissioning(self, trial: Any) -> None:
        """Show that the plants are commissioned with the gains of a trial."""
        text = f"commissioning with the gains of trial {trial.number}"
        self._bar.update(self._task, description=text)
        if not self._quiet and self._bar.disable:
            self._console.print(text)


def _report_fields(
    search_result: Any, storage_path: Path, gains_path: Path | None, picture_path: Path
) -> dict[str, Any]:
    best = search_result.best
    first_trial = search_result.trials[0]
    best_fields = best and {
        "trial": best.number,
        "values": best.values,
        "score": asdict(best.score),
    }
    return {
        "trials": len(search_result.trials),
        "good": sum(trial.is_feasible for trial in search_result.trials),
        "best": best_fields and best_fields | {"cost": search_result.relative_cost(best)},
        "first": asdict(first_trial.score),
        "front": list(search_result.pareto_front),
        "study": str(storage_path),
        "gains": gains_path,
        "picture": str(picture_path),
    }


def _print_search(search_result: Any, report: dict[str, Any]) -> None:
    from rich.table import Table

    table = Table(
        title=f"{report['trials']} trials, {report['good']} good, {len(report['front'])} on the Pareto front"
    )
    for heading in ("", "where it began", f"trial {search_result.best.number}"):
        table.add_column(heading)
    rows = (
        ("tracking error [deg rms]", "tracking_deg", 2),
        ("tension error [N rms]", "tension_N", 2),
        ("effort [N m/s]", "effort_Nm_per_s", 1),
        ("peak tension [N]", "peak_tension_N", 0),
        ("shortfall of margins", "shortfall", 2),
    )
    for name, key, digits in rows:
        table.add_row(
            name,
            *(
                f"{getattr(trial.score, key):.{digits}f}"
                for trial in (search_result.trials[0], search_result.best)
            ),
        )
    rich_console().print(table)
    if blocked_names := search_result.best.score.blocked:
        text = (
            f"{blocked_names}: blocked in some moves, for example by each other; not scored there"
        )
        rich_console().print(text, soft_wrap=True)
    rich_console().print(
        f"gains: {report['gains']}\npicture: {report['picture']}\nstudy: {report['study']}",
        soft_wrap=True,
    )
