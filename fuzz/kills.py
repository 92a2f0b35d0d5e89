"""Controllers killed and stopped at random instants, hundreds of them: ``python -m fuzz.kills --times 500``."""

import argparse
import sys

from tests.runtime.kills import Judged, batches, told


def main() -> int:
    """Kill; exit code 1 if a drive or a log was not as it must be."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.kills", description=__doc__)
    parser.add_argument("--times", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--time-scale", type=float, default=0.7, help="less than 1 on a busy machine")
    args = parser.parse_args()
    found: list[Judged] = []
    for some in batches(args.times, args.seed, args.time_scale):
        for one in some:
            if not (one.safe and one.whole):
                print(one, flush=True)
        found += some
        print(told(found), flush=True)
    return 0 if all(one.safe and one.whole for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())
