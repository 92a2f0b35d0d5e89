"""Experiments of the paper, described as jobs for worker processes.

A job and the result of a job consist of plain values. Therefore jobs and results can be sent to
another process.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError
from handctl.paper.bench import force_displacement, payload

ExperimentJob = Mapping[str, Any]
ExperimentResult = Mapping[str, Any]
JobRunner = Callable[[Sequence[ExperimentJob]], list[ExperimentResult]]
"""Function that runs jobs, one or several at a time, and returns their results in the order of the jobs."""


def run_job(job: ExperimentJob, folder: Path) -> ExperimentResult:
    """Run the experiment that a job describes, and return the result.

    Args:
        job: table with the name of the experiment under `do`, and with the arguments of the
            experiment, see `run_experiments`.
        folder: folder for the files that the experiment writes.
    """
    match job["do"]:
        case "pull":
            return force_displacement.measure_tendons(folder)
        case "search":
            return payload.search_grip_tension(folder, job["diameter_mm"])
        case "load":
            return payload.load_until_slip(folder, job["diameter_mm"], job["axis"], job["found"])
    raise ValueError(f"no such experiment: {job['do']}")


def job_description(job: ExperimentJob) -> str:
    """Return a description of a job for reports of progress."""
    match job["do"]:
        case "pull":
            return f"pulling a blocked finger to {force_displacement.MAX_PULL_N:g} N"
        case "search":
            return f"gripping a {job['diameter_mm']:g} mm cylinder with 6 N a finger"
    return f"loading it along {job['axis']} until it slips"


def job_count() -> int:
    """Return the number of jobs of all experiments."""
    return 1 + len(payload.DIAMETERS_MM) * (1 + len(payload.LOAD_DIRECTIONS))


def run_experiments(workers: JobRunner) -> dict[str, Any]:
    """Run all experiments of the paper, and return the results.

    Returns:
        A table with two keys. The key `force_displacement` has the results of
        `force_displacement.measure_tendons`. The key `payload` has a list with one result for each
        diameter and axis.
    """
    search_jobs = [{"do": "search", "diameter_mm": diameter} for diameter in payload.DIAMETERS_MM]
    # The jobs that load the hand need the grip tensions that the search jobs find. Therefore the
    # search jobs run first.
    pull_result, *grip_results = workers([{"do": "pull"}, *search_jobs])
    loads = [
        {"do": "load", "diameter_mm": diameter, "axis": axis, "found": grip}
        for diameter, grip in zip(payload.DIAMETERS_MM, grip_results, strict=True)
        for axis in payload.LOAD_DIRECTIONS
    ]
    return {"force_displacement": pull_result, "payload": workers(loads)}


SIGNIFICANT_DIGITS = 6
"""Number of significant digits of the results in a file."""


def rounded_results(experiment_results: Any) -> Any:
    """Return the results with every float rounded to `SIGNIFICANT_DIGITS` significant digits."""
    if isinstance(experiment_results, float):
        return float(f"{experiment_results:.{SIGNIFICANT_DIGITS}g}")
    if isinstance(experiment_results, Mapping):
        return {key: rounded_results(value) for key, value in experiment_results.items()}
    return (
        [rounded_results(value) for value in experiment_results]
        if isinstance(experiment_results, list | tuple)
        else experiment_results
    )


def load_results(path: Path) -> dict[str, Any]:
    """Read the results of `run_experiments` from a file.

    Raises:
        ConfigError: the file cannot be read, or does not contain the results of all experiments.
    """
    cases = {
        (diameter, axis) for diameter in payload.DIAMETERS_MM for axis in payload.LOAD_DIRECTIONS
    }
    try:
        results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        cases_in_file = {(case["diameter_mm"], case["axis"]) for case in results["payload"]}
        if cases_in_file != cases or not results["force_displacement"]["ropes"]:
            raise ValueError("results are missing")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not all experiments are in it"
        problem = f"no results of the experiments: {reason}"
        expected = "a file that --results has written"
        raise ConfigError(problem, str(path), expected) from None
    return results
