"""Measure late wake-ups of a loop that only waits, with idle processors awake and asleep in turn.

``python benchmarks/wakeups.py [--seconds S] [--json]``. On each processor core, one loop waits for
deadlines at 1 kHz, with the clock and the priority of the control loop. A wake-up counts as late if
it comes more than 0.3 ms after its deadline. The benchmark shows how much of the lateness of a
control loop comes from the computer itself.
"""

import argparse
import json
import os
import subprocess
import sys

from loop import measure_bare_spin

from handctl.runtime.clocks.realtime_priority import keep_processors_awake

RATE_HZ = 1000.0
LATE_NS = 300_000
"""Delay above which a wake-up counts as late [ns]."""
PAIRS = 2
"""Number of pairs of measurements with processors awake and asleep."""


def main() -> None:
    """Measure the wake-ups on all cores, and print the late ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="duration of a measurement")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--core", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.core is not None:
        print(json.dumps(measure_on_core(args.core, args.seconds)))
        return
    result = {"awake": [], "asleep": []}
    for _ in range(PAIRS):
        result["asleep"].append(measure_all_cores(args.seconds))
        with keep_processors_awake() as is_awake:
            if is_awake:
                result["awake"].append(measure_all_cores(args.seconds))
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def measure_on_core(core: int, seconds: float) -> list[float]:
    """Wait for deadlines on one core. Return the delay of each late wake-up [ms]."""
    os.sched_setaffinity(0, {core})
    _, _, lateness_ns = measure_bare_spin(seconds, RATE_HZ)
    return [late_ns / 1e6 for late_ns in lateness_ns if late_ns > LATE_NS]


def measure_all_cores(seconds: float) -> list[list[float]]:
    """Measure on all cores at the same time. Return the delays of the late wake-ups of each core [ms]."""
    processes = [
        subprocess.Popen(
            [sys.executable, __file__, "--core", str(core), "--seconds", str(seconds)],
            stdout=subprocess.PIPE,
            text=True,
        )
        for core in sorted(os.sched_getaffinity(0))
    ]
    return [json.loads(process.communicate()[0]) for process in processes]


def print_results(result: dict) -> None:
    """Print the number and the largest delay of the late wake-ups as text."""
    for state, runs in result.items():
        for cores in runs:
            late = [delay_ms for core in cores for delay_ms in core]
            numbers = ", ".join(str(len(core)) for core in cores)
            print(
                f"processors {state}: late wake-ups of each core {numbers}; "
                f"at most {max(late, default=0.0):.1f} ms late"
            )


if __name__ == "__main__":
    main()
