"""Worker process that carries out experiments.

Each line of standard input is a job. Each line of standard output is the result of a job.
"""

import json
import signal
import sys
import tempfile
from pathlib import Path

from handctl.errors import HandctlError
from handctl.paper.bench.experiments import run_job


def main() -> None:
    """Read jobs and run them until the input ends.

    If an experiment fails, the error message is written in place of the result.

    The worker ignores Ctrl-C, because the process that sends the jobs handles Ctrl-C. After Ctrl-C,
    the sending process sends SIGTERM to the worker. After SIGTERM, the worker deletes its temporary
    folder and ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with tempfile.TemporaryDirectory(prefix="handctl-paper-") as folder:
        for line in sys.stdin:
            try:
                answer: dict[str, object] = {"result": run_job(json.loads(line), Path(folder))}
            except HandctlError as error:
                answer = {"error": str(error)}
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
