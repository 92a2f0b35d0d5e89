"""Worker process of a search: jobs as JSON lines on standard input, scores on standard output."""

import json
import signal
import sys

from handctl.errors import HandctlError
from handctl.tune.scoring import evaluate_job


def main() -> int:
    """Evaluate jobs until the input ends. Ctrl-C is ignored here and handled by the search."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for line in sys.stdin:
        try:
            result: dict[str, object] = evaluate_job(json.loads(line))
        except HandctlError as error:
            result = {"error": str(error)}
        print(json.dumps(result), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
