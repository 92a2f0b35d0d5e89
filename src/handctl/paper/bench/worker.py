"""A process that does experiments: a job on each line of its standard input, a result on each line of its output."""

import json
import signal
import sys
import tempfile
from pathlib import Path

from handctl.errors import HandctlError
from handctl.paper.bench.experiments import do


def main() -> None:
    """Work until the input ends; an experiment that fails answers with its error.

    Ctrl-C is for the process that gives the jobs; it ends this one by SIGTERM, which takes the folder away, too.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with tempfile.TemporaryDirectory(prefix="handctl-paper-") as folder:
        for line in sys.stdin:
            try:
                answer: dict[str, object] = {"result": do(json.loads(line), Path(folder))}
            except HandctlError as error:
                answer = {"error": str(error)}
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
