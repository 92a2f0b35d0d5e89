"""Measure late wake-ups of a loop that only waits, with idle processors awake and asleep in turn.

``python benchmarks/wakeups.py [--seconds S] [--json]``. On each processor core, one loop waits for
deadlines at 1 kHz, with the clock and the priority of the control loop. A wake-up counts as late if
it comes more than 0.3 ms after its deadline. The benchmark shows how much of the lateness of a
control loop comes from the computer itself.

A host can limit the processor time of a virtual machine. Linux counts the time in periods of 100 ms
(``cpu.max`` of a control group), and a virtual machine that has reached its limit stands still until
the end of the period. With such a limit, the late wake-ups are at nearly the same place in each
period. The benchmark counts the late wake-ups of each core in the fullest 2 ms of the period.
"""

import argparse
import json
import os
import subprocess
import sys
import time

from loop import bare_spin_lateness

from handctl.runtime.clocks.awake_processors import AwakeProcessors

RATE_HZ = 1000.0
LATE_NS = 300_000
"""Delay above which a wake-up counts as late [ns]."""
LIMIT_PERIOD_MS = 100.0
"""Period in which Linux counts the processor time of a control group, if nobody has changed it [ms]."""
SAME_PLACE_MS = 2.0
"""Width of the part of a period in which late wake-ups count as being at the same place [ms].

The clocks of host and virtual machine drift apart by 0.02 ms in a second.
"""
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
        with AwakeProcessors().keep_awake() as is_awake:
            if is_awake:
                result["awake"].append(measure_all_cores(args.seconds))
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def measure_on_core(core: int, seconds: float) -> list[tuple[float, float]]:
    """Wait for deadlines on one core. Return the delay and the time of each late wake-up [ms]."""
    os.sched_setaffinity(0, {core})
    return [
        (late_ns / 1e6, time.monotonic_ns() / 1e6)
        for late_ns in bare_spin_lateness(seconds, RATE_HZ)
        if late_ns > LATE_NS
    ]


def measure_all_cores(seconds: float) -> list[list[tuple[float, float]]]:
    """Measure on all cores at the same time. Return the late wake-ups of each core, see ``measure_on_core``."""
    processes = [
        subprocess.Popen(
            [sys.executable, __file__, "--core", str(core), "--seconds", str(seconds)],
            stdout=subprocess.PIPE,
            text=True,
        )
        for core in sorted(os.sched_getaffinity(0))
    ]
    return [json.loads(process.communicate()[0]) for process in processes]


def count_at_same_place(times_ms: list[float]) -> int:
    """Return the largest number of times within ``SAME_PLACE_MS`` of a period of ``LIMIT_PERIOD_MS``."""
    return max(
        (
            sum((other - start) % LIMIT_PERIOD_MS < SAME_PLACE_MS for other in times_ms)
            for start in times_ms
        ),
        default=0,
    )


def print_results(result: dict) -> None:
    """Print the number, the largest delay and the place in the period of the late wake-ups as text."""
    for state, runs in result.items():
        for cores in runs:
            delays_ms = [delay_ms for core in cores for delay_ms, _ in core]
            numbers = ", ".join(
                f"{len(core)} ({count_at_same_place([time_ms for _, time_ms in core])} at the same place)"
                for core in cores
            )
            print(
                f"processors {state}: late wake-ups of each core {numbers}; "
                f"at most {max(delays_ms, default=0.0):.1f} ms late"
            )


if __name__ == "__main__":
    main()
