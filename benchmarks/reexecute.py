"""Measure how long the controller needs to re-execute the ticks of a log, and profile the controller.

For each tick, the benchmark measures the CPU time of three steps: read the tick from the log,
compute the tick, and compare the outputs with the log. The benchmark also measures how many times
faster than real time one process and two processes execute the whole log, in turn.

``python benchmarks/reexecute.py [LOG ...] [--quick] [--json]``, by default the logs in
``logs/golden``. Each log is re-executed several times. The benchmark uses the shortest time of each
tick, because other load on the processor core affects the shortest time least.
"""

import argparse
import gc
import json
import statistics
import time
from pathlib import Path

from cpu_profile import cpu_time_fractions

from handctl.blas_kernels import configure_openblas

# The matrix kernels must be chosen before numpy is imported. With other matrix kernels, the last bits
# of the outputs differ from the log.
configure_openblas()

from handctl.controller.tick import Controller  # noqa: E402
from handctl.log.read.reader import RunLog  # noqa: E402
from handctl.replay.controller_rebuild import rebuild_controller  # noqa: E402
from handctl.replay.log_execution import execute_log  # noqa: E402
from handctl.replay.tick_difference import are_outputs_equal  # noqa: E402

GOLDEN_FOLDER = Path(__file__).resolve().parent.parent / "logs" / "golden"


def main() -> None:
    """Measure the CPU time to re-execute each log, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "logs",
        nargs="*",
        type=Path,
        metavar="LOG",
        help="logs to execute (default: those in logs/golden)",
    )
    parser.add_argument("--quick", action="store_true", help="execute each log twice")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    logs = args.logs or sorted(GOLDEN_FOLDER.glob("*.mcap"))
    result = {log.name: measure_log(log, 2 if args.quick else 10) for log in logs}
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def measure_log(log_path: Path, pass_count: int) -> dict:
    """Measure the CPU time to read, compute and compare the ticks of one log."""
    with RunLog(log_path) as log:
        controller = rebuild_controller(log)
        gc.disable()  # In a run, the control loop also disables the garbage collector.
        runs = [execute_once(log, controller) for _ in range(pass_count)]
        gc.enable()
        ticks = len(log)
        period_us = log.header.period_ns / 1e3
        tick = sum(map(min, zip(*(run["tick"] for run in runs), strict=True)))
        shortest_times = {name: min(run[name] for run in runs) for name in ("read", "compare")} | {
            "tick": tick
        }
        return {
            "processes": measure_processes(log, pass_count),
            "ticks": ticks,
            "equal": runs[0]["equal"],
            "us_a_tick": {name: time_s / ticks * 1e6 for name, time_s in shortest_times.items()},
            "times_real_time": period_us * ticks / (sum(shortest_times.values()) * 1e6),
            "spent": cpu_time_fractions(lambda: execute_once(log, controller)),
        }


def measure_processes(log: RunLog, pass_count: int) -> dict[int, list[float]]:
    """Return how many times faster than real time one process and two processes execute a log.

    The wall time is measured. The runs with one process and with two processes alternate.
    """
    factors: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(pass_count):
        for process_count, results in factors.items():
            results.append(execute_log(log, worker_count=process_count).real_time_factor)
    return factors


def execute_once(log: RunLog, controller: Controller) -> dict:
    """Re-execute all ticks of a log once.

    The returned dictionary contains three CPU times [s]: for reading the log, for each tick (a
    list), and for comparing the outputs. The dictionary also contains the number of ticks whose
    outputs equal those in the log.
    """
    cpu = time.process_time
    start_cpu_s = cpu()
    for _ in zip(log.ticks(), log.packed_telemetry(), strict=True):
        pass  # As in an ordinary re-execution, the outputs of the ticks are not stored.
    read = cpu() - start_cpu_s
    logged_ticks = list(zip(log.ticks(), log.packed_telemetry(), strict=True))
    state = controller.initial_state()
    tick_outputs = []
    times_s = []
    for logged_tick, _ in logged_ticks:
        cpu_s_before = cpu()
        state, tick_output = controller.tick(state, logged_tick.tick_in)
        times_s.append(cpu() - cpu_s_before)
        tick_outputs.append(tick_output)
    start_cpu_s = cpu()
    equal_tick_count = sum(
        are_outputs_equal(logged, numbers, out)
        for (logged, numbers), out in zip(logged_ticks, tick_outputs, strict=True)
    )
    return {
        "read": read,
        "tick": times_s,
        "compare": cpu() - start_cpu_s,
        "equal": equal_tick_count,
    }


def print_results(result: dict) -> None:
    """Print the times of the re-execution as text."""
    for name, row in result.items():
        stage_times = ", ".join(f"{stage} {us:.1f}" for stage, us in row["us_a_tick"].items())
        print(
            f"{name}: {row['times_real_time']:.1f} times real time, {row['equal']} of {row['ticks']} ticks equal"
        )
        print(f"  us a tick: {stage_times}")
        for process_count, factors in row["processes"].items():
            numbers = ", ".join(f"{factor:.0f}" for factor in sorted(factors))
            print(
                f"  processes: {process_count}, median {statistics.median(factors):.1f} times real time ({numbers})"
            )
        for who, fraction in sorted(
            row["spent"].items(), key=lambda share_of_function: -share_of_function[1]
        ):
            print(f"    {100 * fraction:5.1f} %  {who}")


if __name__ == "__main__":
    main()
