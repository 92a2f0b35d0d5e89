"""Workers of a search: the calling process, a pool of processes, or a Dask cluster.

The scores of the trials do not depend on the kind of worker.
"""

import json
import os
import select
import subprocess
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import IO, Any, Protocol

from handctl.errors import ConfigError
from handctl.extras import require_extra
from handctl.tune.scoring import evaluate_job

ScoreJob = dict[str, Any]
ScoreResult = dict[str, Any]

MAX_JOB_ATTEMPTS = 3
"""Number of attempts at a job.

If a worker dies in every attempt, the search ends and reports the job as the cause.
"""


class SearchWorkers(Protocol):
    """Interface of all kinds of workers, which compute scores."""

    def compute_scores(self, jobs: Sequence[ScoreJob]) -> Iterator[tuple[int, ScoreResult]]:
        """Yield the index and the score of each job, in the order in which the jobs are finished."""
        ...

    def close(self) -> None:
        """Release the resources of the workers."""
        ...


class InProcessWorkers:
    """Workers that run all jobs one after the other, in the calling process."""

    def compute_scores(self, jobs: Sequence[ScoreJob]) -> Iterator[tuple[int, ScoreResult]]:
        """Yield the index and the score of each job.

        The order is the same as in the interface `SearchWorkers`.
        """
        for i, job in enumerate(jobs):
            yield i, evaluate_job(job)

    def close(self) -> None:
        """Do nothing, because these workers have no resources to release."""


class ProcessPool:
    """Pool of worker processes on this machine.

    If a worker process has died, a new process repeats the job of the dead process.
    """

    def __init__(self, worker_count: int) -> None:
        """Start the worker processes."""
        self._processes = [self._start_process() for _ in range(worker_count)]

    @property
    def process_ids(self) -> tuple[int, ...]:
        """Return the process identifiers of the workers."""
        return tuple(worker.pid for worker in self._processes)

    @staticmethod
    def _start_process() -> "subprocess.Popen[bytes]":
        # Each worker process uses one core. Additional threads of numerical libraries would compete
        # with the workers for the cores.
        environment = os.environ | dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
        )
        command = [sys.executable, "-m", "handctl.tune.search.worker_process"]
        # The worker has a process session of its own. So the worker does not receive Ctrl-C from
        # the terminal, not even during its imports.
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
        )

    def compute_scores(self, jobs: Sequence[ScoreJob]) -> Iterator[tuple[int, ScoreResult]]:
        """Yield the index and the score of each job.

        The order is the same as in the interface `SearchWorkers`.

        Raises:
            ConfigError: a job is invalid, or every worker that tries a job dies.
        """
        pending_jobs = deque(range(len(jobs)))
        attempts_by_job = [0] * len(jobs)
        job_by_worker: dict[int, int] = {}
        while pending_jobs or job_by_worker:
            for slot in range(len(self._processes)):
                if slot not in job_by_worker and pending_jobs:
                    job_by_worker[slot] = pending_jobs.popleft()
                    self._send_job(slot, jobs[job_by_worker[slot]])
            for slot in self._wait_for_readable(job_by_worker):
                i = job_by_worker.pop(slot)
                line = _read_output(self._processes[slot]).readline()
                if line.endswith(b"\n"):
                    yield i, _check_result(json.loads(line))
                    continue
                self._replace_process(slot)
                attempts_by_job[i] += 1
                if attempts_by_job[i] == MAX_JOB_ATTEMPTS:
                    raise ConfigError(
                        f"a worker died {MAX_JOB_ATTEMPTS} times on one trial",
                        "tune search",
                        "--jobs 1",
                    )
                # The job of a worker that has died is run before all waiting jobs. So the death of
                # a worker changes the order of the results only a little.
                pending_jobs.appendleft(i)

    def _wait_for_readable(self, busy_workers: Iterable[int]) -> list[int]:
        """Wait until a worker has written a line or has ended, and return the indices of all such workers."""
        slot_by_output = {_read_output(self._processes[slot]): slot for slot in busy_workers}
        readable_outputs, _, _ = select.select(list(slot_by_output), [], [])
        return [slot_by_output[output] for output in readable_outputs]

    def _send_job(self, worker_slot: int, job: ScoreJob) -> None:
        """Send a job to a worker. If the worker has died, replace it first."""
        if self._processes[worker_slot].poll() is not None:
            self._replace_process(worker_slot)
        channel = self._processes[worker_slot].stdin
        assert channel is not None
        try:
            channel.write(json.dumps(job).encode() + b"\n")
            channel.flush()
        except BrokenPipeError:
            return  # the code that reads the output of the worker detects that the worker has died

    def _replace_process(self, worker_slot: int) -> None:
        """Replace a worker by a new process."""
        self._processes[worker_slot].kill()
        self._processes[worker_slot].communicate()
        self._processes[worker_slot] = self._start_process()

    def close(self) -> None:
        """End the workers, even during a job."""
        for worker in self._processes:
            worker.kill()
            worker.communicate()


class DaskCluster:
    """Connection to an existing Dask cluster."""

    def __init__(self, scheduler_address: str) -> None:
        """Connect to a Dask cluster.

        Args:
            scheduler_address: address of the scheduler.

        Raises:
            ConfigError: the package `distributed` is not installed, or the scheduler does not
                answer.
        """
        require_extra("tune search --scheduler", "distributed")
        from distributed import Client

        try:
            self._client = Client(scheduler_address, timeout="10s")
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"no cluster answers: {error}",
                f"--scheduler {scheduler_address}",
                "tcp://HOST:PORT",
            ) from None

    def compute_scores(self, jobs: Sequence[ScoreJob]) -> Iterator[tuple[int, ScoreResult]]:
        """Yield the index and the score of each job.

        The order is the same as in the interface `SearchWorkers`. Dask repeats the jobs of a lost
        worker.
        """
        from distributed import as_completed

        futures = self._client.map(evaluate_job, jobs, pure=False)
        indices = {future.key: i for i, future in enumerate(futures)}
        for future, result in as_completed(futures, with_results=True):
            yield indices[future.key], result

    def close(self) -> None:
        """Disconnect from the cluster. The cluster itself keeps running."""
        self._client.close()


def _read_output(worker: "subprocess.Popen[bytes]") -> IO[bytes]:
    assert worker.stdout is not None
    return worker.stdout


def _check_result(result: ScoreResult) -> ScoreResult:
    if "error" in result:
        raise ConfigError(str(result["error"]), "tune search")
    return result


def make_workers(worker_count: int, scheduler_address: str | None) -> SearchWorkers:
    """Return the workers of a search: either processes on this machine, or the cluster of a Dask scheduler."""
    if scheduler_address:
        return DaskCluster(scheduler_address)
    return InProcessWorkers() if worker_count == 1 else ProcessPool(worker_count)
