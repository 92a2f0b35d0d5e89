"""Worker process of a search.

The process reads jobs as JSON lines from standard input, and writes scores to standard output.
"""

import gc
import json
import signal
import sys

from handctl.errors import HandctlError
from handctl.tune.scoring import evaluate_job


def main() -> int:
    """Compute the scores of jobs until the input ends.

    The worker ignores Ctrl-C, because the process of the search handles Ctrl-C.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Garbage collection would examine all imported modules repeatedly. In a measurement, garbage
    # collection took 7 % of the time of a trial.
    gc.freeze()
    for line in sys.stdin:
        try:
            result: dict[str, object] = evaluate_job(json.loads(line))
        except HandctlError as error:
            result = {"error": str(error)}
        print(json.dumps(result), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
