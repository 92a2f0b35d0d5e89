"""Run many jobs in sequence or in parallel.

A benchmark that was stopped continues from the results in a folder.
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
        keep: folder for the results of the jobs, as JSON. A job whose result is stored is not run
            again. None means that no result is stored.
        minutes: time after which no further job starts [min]. The results of the jobs that have not started are left
            out.
        workers: number of processes. Zero means one process per core.
    """

    keep: Path | None = None
    minutes: float = float("inf")
    workers: int = 0


def collect_results(work: JobFunction, jobs: list[Any], plan: JobPlan) -> dict[Any, Any]:
    """Return the result of each job.

    Results are read from the folder, or computed as long as the time limit permits.

    Args:
        work: top-level function that computes one job. The result of this function consists of JSON
            values.
        jobs: arguments of each job, as tuples.
        plan: see ``JobPlan``.
    """
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    done = {job: stored for job in jobs if (stored := _stored_result(work, job, plan)) is not None}
    missing = [job for job in jobs if job not in done]
    until = time.monotonic() + 60.0 * plan.minutes
    for job, results in _run_jobs(work, missing, plan.workers or os.cpu_count() or 1, until):
        done[job] = _through_json(results)
        _store_result(work, job, done[job], plan)
        print(f"{len(done)}/{len(jobs)} {work.__name__} {job}", file=sys.stderr, flush=True)
    if len(done) < len(jobs):
        print(
            f"{len(jobs) - len(done)} of {len(jobs)} not run: continue with the same --keep",
            file=sys.stderr,
        )
    return {job: done[job] for job in jobs if job in done}


def _run_jobs(work: JobFunction, jobs: list[Any], workers: int, until: float) -> Any:
    """Yield each job with its result, in order of completion. No job starts after the time limit."""
    if workers == 1 or len(jobs) < 2:
        for job in jobs:
            if time.monotonic() < until:
                yield job, work(job)
        return
    waiting: dict[Future[Any], Any] = {}
    left = iter(jobs)
    with ProcessPoolExecutor(workers) as pool:
        while True:
            while len(waiting) < workers and time.monotonic() < until:
                job = next(left, None)
                if job is None:
                    break
                waiting[pool.submit(work, job)] = job
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield waiting.pop(future), future.result()


def _result_path(work: JobFunction, job: Any, keep: Path) -> Path:
    """Return the path of the file in which the result of a job is stored."""
    digest = hashlib.sha256(repr(job).encode()).hexdigest()[:16]
    return keep / f"{work.__module__.rpartition('.')[2]}-{work.__name__}-{digest}.json"


def _stored_result(work: JobFunction, job: Any, plan: JobPlan) -> Any:
    if plan.keep is None or not (path := _result_path(work, job, plan.keep)).exists():
        return None
    return json.loads(path.read_text("utf-8"))["result"]


def _store_result(work: JobFunction, job: Any, result: Any, plan: JobPlan) -> None:
    if plan.keep is None:
        return
    plan.keep.mkdir(parents=True, exist_ok=True)
    path = _result_path(work, job, plan.keep)
    path.with_suffix(".part").write_text(json.dumps({"job": repr(job), "result": result}), "utf-8")
    path.with_suffix(".part").replace(path)


def _through_json(result: Any) -> Any:
    """Convert a result to JSON and back.

    This conversion makes lists of the tuples in the result.
    """
    return json.loads(json.dumps(result))


def add_job_options(parser: Any) -> None:
    """Add the options of a benchmark that runs many jobs."""
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
    """Return the plan that the command-line options describe."""
    return JobPlan(args.keep, args.minutes, args.jobs)
