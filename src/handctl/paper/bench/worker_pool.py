"""Pool of worker processes that carry out experiments."""

import json
import selectors
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO

from handctl.errors import HandctlError
from handctl.paper.bench.experiments import ExperimentJob, ExperimentResult, JobRunner

WORKER_MODULE = "handctl.paper.bench.worker"
WorkerProcess = subprocess.Popen[str]
ReportFunction = Callable[[ExperimentJob, bool], None]
"""Function that is called with False at the start of each job, and with True at the end of the job."""


@contextmanager
def worker_pool(worker_count: int, report: ReportFunction) -> Iterator[JobRunner]:
    """Start worker processes. The worker processes end at the end of the context, even after an error.

    Args:
        worker_count: number of processes.
        report: function that is called at the start and at the end of each job.
    """
    command = [sys.executable, "-m", WORKER_MODULE]
    # Because the workers have their own process session, they do not receive Ctrl-C from the
    # terminal.
    children = [
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        for _ in range(worker_count)
    ]
    try:
        yield lambda jobs: _distribute_jobs(children, jobs, report)
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.communicate()


def _distribute_jobs(
    workers: Sequence[WorkerProcess], jobs: Sequence[ExperimentJob], report: ReportFunction
) -> list[ExperimentResult]:
    """Distribute jobs among workers, and return the results in the order of the jobs.

    When a worker has returned a result, the worker gets the next job.
    """
    results: dict[int, ExperimentResult] = {}
    pending_jobs = iter(enumerate(jobs))
    job_by_worker: dict[WorkerProcess, int] = {}
    with selectors.DefaultSelector() as answer_selector:
        for child in workers:
            answer_selector.register(_require_pipe(child.stdout), selectors.EVENT_READ, child)
            _send_next_job(child, pending_jobs, job_by_worker, report)
        while job_by_worker:
            for key, _ in answer_selector.select():
                child = key.data
                index = job_by_worker.pop(child)
                results[index] = _read_result(child)
                report(jobs[index], True)
                _send_next_job(child, pending_jobs, job_by_worker, report)
    return [results[index] for index in range(len(jobs))]


def _send_next_job(
    worker: WorkerProcess,
    waiting_jobs: Iterator[tuple[int, ExperimentJob]],
    job_of_worker: dict[WorkerProcess, int],
    report: ReportFunction,
) -> None:
    """Send the next job to a worker, if there is another job."""
    for index, job in waiting_jobs:
        job_of_worker[worker] = index
        report(job, False)
        pipe = _require_pipe(worker.stdin)
        pipe.write(json.dumps(job) + "\n")
        pipe.flush()
        return


def _read_result(child: WorkerProcess) -> ExperimentResult:
    """Return the result of an experiment that a worker has sent.

    Raises:
        HandctlError: the experiment failed, or the worker process ended without a result.
    """
    line = _require_pipe(child.stdout).readline()
    if not line:
        raise HandctlError(
            "a worker ended before its experiment did",
            WORKER_MODULE,
            "a result; see the lines above",
        )
    answer = json.loads(line)
    if "error" in answer:
        raise HandctlError(answer["error"], WORKER_MODULE)
    result: ExperimentResult = answer["result"]
    return result


def _require_pipe(worker_pipe: IO[str] | None) -> IO[str]:
    """Return the given pipe, after an assertion that the pipe is not None."""
    assert worker_pipe is not None
    return worker_pipe
