"""Kill or stop hundreds of controllers at random times: ``python -m fuzz.controller_kills --times 500``."""

import argparse
import sys

from tests.runtime.killed_controllers import (
    KillVerdict,
    disturb_controllers_in_batches,
    summary_of_kills,
)


def main() -> int:
    """Start controllers, and kill or stop each controller at a random time.

    Return 1 if a drive still makes torque after the end of its controller, or if a log is
    incomplete.
    """
    parser = argparse.ArgumentParser(prog="python -m fuzz.controller_kills", description=__doc__)
    parser.add_argument(
        "--times",
        type=int,
        default=500,
        help="number of disturbed controllers (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    parser.add_argument(
        "--time-scale",
        type=float,
        default=0.7,
        help="ratio of simulated time to wall time, smaller for a busy machine (default: %(default)s)",
    )
    args = parser.parse_args()
    runs: list[KillVerdict] = []
    for batch in disturb_controllers_in_batches(args.times, args.seed, args.time_scale):
        for run in batch:
            if not (run.torque_ended_in_time and run.has_complete_log):
                print(run, flush=True)
        runs += batch
        print(summary_of_kills(runs), flush=True)
    return 0 if all(run.torque_ended_in_time and run.has_complete_log for run in runs) else 1


if __name__ == "__main__":
    sys.exit(main())
