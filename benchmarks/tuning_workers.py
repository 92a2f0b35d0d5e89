"""Compare how long one worker and several workers take for the same trials of a search for gains.

The wall time depends on other load on the computer. The CPU time of the busiest worker is the wall
time that the trials would take on cores without other load. Wall time and CPU time both include the
start of a worker.

    python benchmarks/tuning_workers.py [--quick] [--json] [--trials N] [--workers N]
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from handctl.core.gains.gain_bounds import gains_with_values
from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import load_hand
from handctl.tune.search.ensemble import sample_ensemble
from handctl.tune.search.workers import ProcessPool

ScoringJob = dict[str, Any]

RATE_HZ = 500.0


def scoring_jobs(job_count: int) -> list[ScoringJob]:
    """Return jobs for trials that differ slightly in their gains.

    The search computes equal trials only once. Therefore, the trials must not be equal.
    """
    gain_changes = [
        gains_with_values(Gains(), {"tension.integral_per_s": 2.0 + 0.1 * i}, "benchmark")
        for i in range(job_count)
    ]
    job_fields = {
        "hand": load_hand("jamia").to_toml(),
        "rate_hz": RATE_HZ,
        "plants": list(sample_ensemble(1, 0)),
        "seed": 1,
    }
    return [job_fields | {"gains": gains.model_dump(by_alias=True)} for gains in gain_changes]


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used so far [s]. Source: manual page proc(5), fields 14 and 15 of stat."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure_search(
    worker_count: int, jobs: list[ScoringJob]
) -> tuple[ScoringJob, list[ScoringJob]]:
    """Measure how long a search with ``worker_count`` workers takes.

    Return the wall time and CPU time of the search, and the scores in the order of the jobs.
    """
    start_time_s = time.monotonic()
    worker_pool = ProcessPool(worker_count)
    try:
        scores = dict(worker_pool.compute_scores(jobs))
        cpu_times_s = [cpu_s(pid) for pid in worker_pool.process_ids]
    finally:
        worker_pool.close()
    row = {
        "workers": worker_count,
        "clock_s": time.monotonic() - start_time_s,
        "cpu_s": cpu_times_s,
        "load": os.getloadavg()[0],
    }
    return row, [scores[i] for i in range(len(jobs))]


def main() -> int:
    """Measure the duration of a search for gains with one worker and with several workers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quick", action="store_true", help="four trials")
    parser.add_argument("--trials", type=int, default=12, help="number of trials (default: 12)")
    parser.add_argument(
        "--workers",
        type=int,
        default=2,
        help="number of workers that are compared with one worker (default: 2)",
    )
    args = parser.parse_args()
    jobs = scoring_jobs(4 if args.quick else args.trials)
    (one_worker, first_scores), (several_workers, second_scores) = (
        measure_search(1, jobs),
        measure_search(args.workers, jobs),
    )
    result = {
        "trials": len(jobs),
        "one": one_worker,
        "several": several_workers,
        "faster_by_the_clock": one_worker["clock_s"] / several_workers["clock_s"],
        "faster_by_cpu": one_worker["cpu_s"][0] / max(several_workers["cpu_s"]),
        "same_scores": first_scores == second_scores,
    }
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        for row in (one_worker, several_workers):
            cpu_text = ", ".join(f"{worker_cpu_s:.1f}" for worker_cpu_s in row["cpu_s"])
            print(
                f"{row['workers']} worker(s): {row['clock_s']:.1f} s, CPU {cpu_text} s, load {row['load']:.1f}"
            )
        print(
            f"{args.workers} workers are {result['faster_by_the_clock']:.2f} times as fast by the clock, "
            f"{result['faster_by_cpu']:.2f} times by CPU time; same scores: {result['same_scores']}"
        )
    return 0 if result["same_scores"] else 1


if __name__ == "__main__":
    sys.exit(main())
