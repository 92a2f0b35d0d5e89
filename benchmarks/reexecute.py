"""Re-execution of logs, tick by tick: CPU time of reading, ticking and comparing, and who spends it.

``python benchmarks/reexecute.py [LOG ...] [--quick] [--json]``, by default those of ``logs/golden``. CPU time of this
process counts, so that a busy machine does not; the fastest of a few passes is told, for the same reason.
"""

import argparse
import gc
import json
import time
from pathlib import Path

from who import spent

from handctl.log.reader import RunLog
from handctl.replay.difference import same
from handctl.replay.rebuild import rebuild

GOLDEN = Path(__file__).resolve().parent.parent / "logs" / "golden"


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="default: those of logs/golden")
    parser.add_argument("--quick", action="store_true", help="one pass")
    parser.add_argument("--json", action="store_true", help="numbers for programs")
    args = parser.parse_args()
    logs = args.logs or sorted(GOLDEN.glob("*.mcap"))
    result = {log.name: measure(log, 1 if args.quick else 3) for log in logs}
    print(json.dumps(result, indent=2)) if args.json else show(result)


def measure(path: Path, passes: int) -> dict:
    """One log."""
    with RunLog(path) as log:
        controller = rebuild(log)
        for _ in controller, *zip(range(200), log.ticks(), strict=False):
            pass
        found = [once(log, controller) for _ in range(passes)]
        best = min(found, key=lambda one: one["read"] + one["tick"] + one["compare"])
        ticks, seconds = len(log), float(log.times[-1])
        equal = best.pop("equal")
        return {
            "ticks": ticks,
            "equal": equal,
            "us_a_tick": {name: took / ticks * 1e6 for name, took in best.items()},
            "times_real_time": seconds / sum(best.values()),
            "spent": spent(lambda: once(log, controller)),
        }


def once(log: RunLog, controller) -> dict:
    """CPU time [s] of each stage, and how many ticks came out equal to the last byte."""
    gc.freeze()
    clock = time.process_time
    began = clock()
    logged = list(zip(log.ticks(), log.packed(), strict=True))
    read = clock()
    state, outs = controller.initial(), []
    for one, _ in logged:
        state, out = controller.tick(state, one.tick_in)
        outs.append(out)
    ticked = clock()
    equal = sum(same(one, numbers, out) for (one, numbers), out in zip(logged, outs, strict=True))
    ended = clock()
    gc.unfreeze()
    return {"read": read - began, "tick": ticked - read, "compare": ended - ticked, "equal": equal}


def show(result: dict) -> None:
    """The same for people."""
    for name, found in result.items():
        parts = ", ".join(f"{stage} {us:.0f}" for stage, us in found["us_a_tick"].items())
        print(
            f"{name}: {found['times_real_time']:.1f} times real time, {found['equal']} of {found['ticks']} ticks equal"
        )
        print(f"  us a tick: {parts}")
        for who, share in sorted(found["spent"].items(), key=lambda row: -row[1]):
            print(f"    {100 * share:5.1f} %  {who}")


if __name__ == "__main__":
    main()
