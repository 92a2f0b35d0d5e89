"""Run many jobs in sequence or in parallel.

A benchmark that was stopped and started again continues from the results in a folder.
"""

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

JobFunction = Callable[[Any], Any]


@dataclass(frozen=True)
class JobPlan:
    """Options for running jobs.

    Attributes:
        results_folder: folder for the results of the jobs, as JSON. A job whose result is stored
            is not run again. None means that no result is stored.
        max_minutes: time after which no further job starts [min]. The results of jobs that have not
            started are missing.
        worker_count: number of processes. Zero means one process per core.
    """

    results_folder: Path | None = None
    max_minutes: float = float("inf")
    worker_count: int = 0


def collect_results(run_job: JobFunction, jobs: list[Any], plan: JobPlan) -> dict[Any, Any]:
    """Return the result of each job, either from a file or from a new computation.

    The function reads the stored results from the folder of ``plan``, and computes the missing
    results. After the time limit ``plan.max_minutes``, the function starts no further job.

    Args:
        run_job: top-level function that computes one job. The result of this function consists of JSON
            values.
        jobs: arguments of each job, as tuples.
        plan: see ``JobPlan``.
    """
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    result_by_job = {
        job: stored_result
        for job in jobs
        if (stored_result := _stored_result(run_job, job, plan)) is not None
    }
    missing_jobs = [job for job in jobs if job not in result_by_job]
    deadline_s = time.monotonic() + 60.0 * plan.max_minutes
    for job, results in _run_jobs(
        run_job, missing_jobs, plan.worker_count or os.cpu_count() or 1, deadline_s
    ):
        result_by_job[job] = _json_round_trip(results)
        _store_result(run_job, job, result_by_job[job], plan)
        print(
            f"{len(result_by_job)}/{len(jobs)} {run_job.__name__} {job}",
            file=sys.stderr,
            flush=True,
        )
    if len(result_by_job) < len(jobs):
        print(
            f"{len(jobs) - len(result_by_job)} of {len(jobs)} not run: continue with the same --keep",
            file=sys.stderr,
        )
    return {job: result_by_job[job] for job in jobs if job in result_by_job}


def _run_jobs(run_job: JobFunction, jobs: list[Any], worker_count: int, end_time_s: float) -> Any:
    """Yield each job with its result, in the order in which the jobs end. No job starts after ``end_time_s``."""
    if worker_count == 1 or len(jobs) < 2:
        for job in jobs:
            if time.monotonic() < end_time_s:
                yield job, run_job(job)
        return
    job_by_future: dict[Future[Any], Any] = {}
    remaining_jobs = iter(jobs)
    with ProcessPoolExecutor(worker_count) as pool:
        while True:
            while len(job_by_future) < worker_count and time.monotonic() < end_time_s:
                job = next(remaining_jobs, None)
                if job is None:
                    break
                job_by_future[pool.submit(run_job, job)] = job
            if not job_by_future:
                return
            for future in wait(job_by_future, return_when=FIRST_COMPLETED).done:
                yield job_by_future.pop(future), future.result()


def _result_path(run_job: JobFunction, job: Any, results_folder: Path) -> Path:
    """Return the path of the file in which the result of a job is stored."""
    digest = hashlib.sha256(repr(job).encode()).hexdigest()[:16]
    return (
        results_folder / f"{run_job.__module__.rpartition('.')[2]}-{run_job.__name__}-{digest}.json"
    )


def _stored_result(run_job: JobFunction, job: Any, plan: JobPlan) -> Any:
    if (
        plan.results_folder is None
        or not (path := _result_path(run_job, job, plan.results_folder)).exists()
    ):
        return None
    return json.loads(path.read_text("utf-8"))["result"]


def _store_result(run_job: JobFunction, job: Any, result: Any, plan: JobPlan) -> None:
    if plan.results_folder is None:
        return
    plan.results_folder.mkdir(parents=True, exist_ok=True)
    path = _result_path(run_job, job, plan.results_folder)
    path.with_suffix(".part").write_text(json.dumps({"job": repr(job), "result": result}), "utf-8")
    path.with_suffix(".part").replace(path)


def _json_round_trip(result: Any) -> Any:
    """Convert a result to JSON and back.

    The conversion replaces the tuples in the result by lists.
    """
    return json.loads(json.dumps(result))


def add_job_options(parser: Any) -> None:
    """Add the command-line options of a benchmark that runs many jobs."""
    parser.add_argument(
        "--keep", type=Path, help="folder of results: an interrupted benchmark continues"
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=float("inf"),
        help="start no further run after this time [min]",
    )
    parser.add_argument(
        "--jobs", type=int, default=0, help="number of processes (default: one per core)"
    )


def job_plan_of(args: Any) -> JobPlan:
    """Return the ``JobPlan`` for the command-line options of a benchmark."""
    return JobPlan(args.keep, args.minutes, args.jobs)
