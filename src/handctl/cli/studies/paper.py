"""``handctl paper``: reproduce the source paper and its misprints, as a table, JSON, Markdown, figures or a page."""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from handctl.cli.console.progress import progress_bar
from handctl.cli.console.rich_console import rich_console
from handctl.errors import ConfigError
from handctl.hand.formats.mjcf import mjcf_text
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from handctl.output_files import check_output_path, write_text_atomically
from handctl.paper.bench.experiments import (
    ExperimentJob,
    job_count,
    job_description,
    load_results,
    rounded_results,
    run_experiments,
)
from handctl.paper.bench.worker_pool import worker_pool
from handctl.paper.errata_item import ErrataVerdict
from handctl.paper.figures.all_figures import draw_all_figures
from handctl.paper.page import items_as_json, page_as_html, page_as_markdown, value_text
from handctl.paper.sections import PageSection, count_by_verdict, page_sections
from handctl.session.exit_codes import ExitCode

VERDICT_COLOURS = {
    ErrataVerdict.EQUAL: "green",
    ErrataVerdict.ROUNDED: "blue",
    ErrataVerdict.TRUNCATED: "magenta",
    ErrataVerdict.LOWER_BOUND: "cyan",
    ErrataVerdict.WRONG: "bold red",
    ErrataVerdict.UNDECIDABLE: "yellow",
}


def run(args: argparse.Namespace) -> int:
    """Recompute each equation and number of the paper, run the requested experiments, and print all results.

    Return the exit code.
    """
    if not 1 <= args.jobs <= 64:
        raise ConfigError(f"{args.jobs}", "--jobs", "1 to 64")
    _check_writable(args.output, args.figures, args.export)
    results = None if args.quick else _load_or_measure_results(args.results, args.jobs)
    sections = page_sections(results)
    if args.export:
        _export_files(args.export)
    if args.figures or args.output:
        with tempfile.TemporaryDirectory() as folder:
            figures = draw_all_figures(args.figures or Path(folder), results)
            if args.output:
                write_text_atomically(args.output, page_as_html(sections, figures))
    _print_items(args, sections)
    return ExitCode.DONE


def _load_or_measure_results(path: Path | None, worker_count: int) -> dict[str, Any]:
    """Return the results of the experiments.

    If the file of results exists, read the results from this file. If the file does not exist, run
    the experiments, and save their results in this file.

    Raises:
        ConfigError: the file contains no results, or the file cannot be written.
    """
    if path is None:
        return _measure_all_results(worker_count)
    if path.exists():
        return load_results(path)
    check_output_path(path, "--results")
    write_text_atomically(
        path, json.dumps(rounded_results(_measure_all_results(worker_count))) + "\n"
    )
    return load_results(path)


def _check_writable(report_file: Path | None, *folders: Path | None) -> None:
    """Check that the report file and the files in the output folders can be written.

    The report and the folders are checked before the experiments, because the experiments take a
    long time.
    """
    if report_file:
        check_output_path(report_file, "--output")
    for folder in filter(None, folders):
        if folder.exists() and not folder.is_dir():
            raise ConfigError("not a folder", str(folder), "a folder, or a name for a new one")
        folder.mkdir(parents=True, exist_ok=True)


def _export_files(folder: Path) -> None:
    hand = load_hand("jamia")
    write_text_atomically(folder / f"{hand.name}.urdf", urdf_text(hand))
    write_text_atomically(folder / f"{hand.name}.xml", mjcf_text(hand))


def _print_items(args: argparse.Namespace, shown_sections: tuple[PageSection, ...]) -> None:
    if args.json:
        json.dump(
            items_as_json([item for section in shown_sections for item in section.items]),
            sys.stdout,
            indent=2,
        )
        sys.stdout.write("\n")
    elif args.markdown:
        sys.stdout.write(page_as_markdown(shown_sections))
    else:
        _print_table(shown_sections)
        for path in filter(None, (args.figures, args.output, args.export)):
            print(f"written: {path}")


def _measure_all_results(jobs: int) -> dict[str, Any]:
    """Run all experiments, show the progress, and return the results."""
    finished_count = 0
    with progress_bar("starting the simulator", job_count()) as update_progress:

        def show_job(job: ExperimentJob, is_finished: bool) -> None:
            nonlocal finished_count
            finished_count += is_finished
            update_progress(finished_count, label=None if is_finished else job_description(job))

        with worker_pool(jobs, show_job) as workers:
            return run_experiments(workers)


def _print_table(shown_sections: tuple[PageSection, ...]) -> None:
    """Print a table of the items of each section, and then how many items have each verdict."""
    from rich.table import Table
    from rich.text import Text

    console = rich_console(min_width=80)
    for section in shown_sections:
        if section.table:
            numbers = Table(*section.table[0])
            for row in section.table[1:]:
                numbers.add_row(*row)
            console.print(numbers)
        table = Table(
            title=section.title,
            title_justify="left",
            title_style="bold",
            expand=True,
            show_lines=True,
        )
        table.add_column("id", no_wrap=True)
        table.add_column("verdict", no_wrap=True)
        table.add_column("printed → right, and why", ratio=1)
        for item in section.items:
            verdict = Text(item.verdict.value, VERDICT_COLOURS[item.verdict])
            cell = Text.assemble(
                item.printed, (" → ", "bold"), value_text(item), "\n", (item.why, "dim")
            )
            table.add_row(item.id, verdict, cell)
        console.print(table)
    counts = count_by_verdict([item for section in shown_sections for item in section.items])
    console.print(", ".join(f"{number} {verdict}" for verdict, number in counts.items()))
