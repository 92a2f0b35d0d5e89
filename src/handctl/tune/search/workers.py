"""Who computes the trials of a search: this process, processes beside it, or a Dask cluster; with the same scores."""

import json
import os
import select
import subprocess
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import IO, Any, Protocol

from handctl.errors import ConfigError
from handctl.extras import require
from handctl.tune.trial import evaluate

Job = dict[str, Any]
Result = dict[str, Any]

ATTEMPTS = 3
"""Times that a job is given to a worker before its death is taken for the job's fault."""


class Workers(Protocol):
    """Those who compute."""

    def scores(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Result]]:
        """(index, score) of each job, in the order in which they are done."""
        ...

    def close(self) -> None:
        """Let them go."""
        ...


class Here:
    """This process, one after the other."""

    def scores(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Result]]:
        """See ``Workers``."""
        for i, job in enumerate(jobs):
            yield i, evaluate(job)

    def close(self) -> None:
        """Nothing to let go."""


class Processes:
    """Processes of this machine. One that dies is replaced and its job done again; nothing that is finished is lost."""

    def __init__(self, count: int) -> None:
        self._crew = [self._start() for _ in range(count)]

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of the workers, for those who watch them."""
        return tuple(worker.pid for worker in self._crew)

    @staticmethod
    def _start() -> "subprocess.Popen[bytes]":
        # One core each: numerical libraries that start threads of their own would fight over the cores.
        environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        command = [sys.executable, "-m", "handctl.tune.search.worker"]
        # Out of reach of the terminal's Ctrl-C, also while it imports.
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
        )

    def scores(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Result]]:
        """See ``Workers``.

        Raises:
            ConfigError: a job is wrong, or no worker survives it.
        """
        waiting, tried = deque(range(len(jobs))), [0] * len(jobs)
        busy: dict[int, int] = {}
        while waiting or busy:
            for place in range(len(self._crew)):
                if place not in busy and waiting:
                    busy[place] = waiting.popleft()
                    self._give(place, jobs[busy[place]])
            for place in self._answering(busy):
                i, line = busy.pop(place), _output(self._crew[place]).readline()
                if line.endswith(b"\n"):
                    yield i, _checked(json.loads(line))
                    continue
                self._replace(place)
                tried[i] += 1
                if tried[i] == ATTEMPTS:
                    raise ConfigError(f"a worker died {ATTEMPTS} times on one trial", "tune search", "--workers 1")
                waiting.appendleft(i)

    def _answering(self, busy: Iterable[int]) -> list[int]:
        """Wait for those who have something to say, an end included."""
        outputs = {_output(self._crew[place]): place for place in busy}
        ready, _, _ = select.select(list(outputs), [], [])
        return [outputs[output] for output in ready]

    def _give(self, place: int, job: Job) -> None:
        """Hand over a job; a worker found dead is replaced first."""
        if self._crew[place].poll() is not None:
            self._replace(place)
        channel = self._crew[place].stdin
        assert channel is not None
        try:
            channel.write(json.dumps(job).encode() + b"\n")
            channel.flush()
        except BrokenPipeError:
            return  # its output has ended too, which is found when it is read

    def _replace(self, place: int) -> None:
        self._crew[place].kill()
        self._crew[place].communicate()
        self._crew[place] = self._start()

    def close(self) -> None:
        """End the workers, whatever they are at."""
        for worker in self._crew:
            worker.kill()
            worker.communicate()


class Cluster:
    """An existing Dask cluster.

    Args:
        address: of its scheduler.

    Raises:
        ConfigError: distributed is not installed, or nobody answers.
    """

    def __init__(self, address: str) -> None:
        require("tune search --scheduler", "distributed")
        from distributed import Client

        try:
            self._client = Client(address, timeout="10s")
        except (OSError, ValueError) as error:
            raise ConfigError(f"no cluster answers: {error}", f"--scheduler {address}", "tcp://HOST:PORT") from None

    def scores(self, jobs: Sequence[Job]) -> Iterator[tuple[int, Result]]:
        """See ``Workers``; Dask does a lost worker's jobs again."""
        from distributed import as_completed

        futures = self._client.map(evaluate, jobs, pure=False)
        places = {future.key: i for i, future in enumerate(futures)}
        for future, result in as_completed(futures, with_results=True):
            yield places[future.key], result

    def close(self) -> None:
        """Leave the cluster as it is."""
        self._client.close()


def _output(worker: "subprocess.Popen[bytes]") -> IO[bytes]:
    assert worker.stdout is not None
    return worker.stdout


def _checked(result: Result) -> Result:
    if "error" in result:
        raise ConfigError(str(result["error"]), "tune search")
    return result


def workers(count: int, scheduler: str | None) -> Workers:
    """Whoever was asked for."""
    if scheduler:
        return Cluster(scheduler)
    return Here() if count == 1 else Processes(count)
