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
    # During a trial, garbage collection would examine all modules and all recorded ticks repeatedly.
    # In a measurement, garbage collection took 7 % of the time of a trial. Therefore, garbage is
    # collected only between two trials, and objects that are left from earlier trials, such as
    # modules and caches, are not examined again.
    gc.disable()
    for line in sys.stdin:
        try:
            result: dict[str, object] = evaluate_job(json.loads(line))
        except HandctlError as error:
            result = {"error": str(error)}
        print(json.dumps(result), flush=True)
        gc.collect()
        gc.freeze()
    return 0


if __name__ == "__main__":
    sys.exit(main())
