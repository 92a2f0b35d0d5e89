"""Measure the time from the start of a handctl command to the first frame that it sends on the bus.

Also measure the time that a handctl command needs to print its help.

``python benchmarks/start_time.py [--repeats N] [--json]``. The bus is a local bus on which no other
program sends. The byte code of Python and the kernels of handctl are compiled before the first
measurement. As a reference, the benchmark also measures a start of Python that imports numpy. The
starts of Python alternate with the starts of handctl. To compare two runs of the benchmark, compare
the ratios of the start times to the start time of Python. Other programs affect the CPU time less
than the wall time.
"""

import argparse
import json
import os
import resource
import select
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

FRAME_TIMEOUT_S = 600.0
"""Longest time to wait for the first frame of a command, including the compilation of code [s]."""
BUS_NAME = "start"
"""Name of the local bus."""
HAND_BY_RUN = {"handctl run": "jamia", "handctl run, 11 motors": "jamia11"}
"""Packaged hand of each measured run."""


class StartTime(NamedTuple):
    """Times of a start: the wall time [s], and the total CPU time of the started process [s]."""

    wall_s: float
    cpu_s: float


def main() -> None:
    """Measure the start times of all programs, and print them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--repeats", type=int, default=7, help="starts of each program (default: 7)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="h-") as folder:
        os.environ["HANDCTL_RUN_DIR"] = folder
        os.environ.pop(
            "PYTHONDONTWRITEBYTECODE", None
        )  # Without stored byte code, each start of handctl would compile 300 modules.
        os.environ["PYTHONPYCACHEPREFIX"] = folder
        result = measure_starts(args.repeats, Path(folder))
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def measure_starts(repeat_count: int, work_folder: Path) -> dict[str, list[StartTime]]:
    """Start the programs many times, one after the other, and return the times of all starts of each program."""
    command = [sys.executable, "-m", "firmware_sim", "bus", BUS_NAME]
    hub = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1]
    )
    assert hub.stdout
    hub.stdout.readline()
    measures: dict[str, Callable[[], StartTime]] = {
        "python -c 'import numpy'": lambda: time_until_exit([sys.executable, "-c", "import numpy"]),
        "handctl run --help": lambda: time_until_exit(
            [sys.executable, "-m", "handctl.cli", "run", "--help"]
        ),
    }
    for name, hand in HAND_BY_RUN.items():
        measures[name] = partial(time_until_first_frame, hand, work_folder)
    try:
        for measure in measures.values():
            measure()  # Do not count the first start, because it compiles code and fills the disk cache.
        times: dict[str, list[StartTime]] = {name: [] for name in measures}
        for _ in range(repeat_count):
            for name, measure in measures.items():
                times[name].append(measure())
        return times
    finally:
        hub.terminate()
        hub.wait()


def time_until_exit(command: list[str]) -> StartTime:
    """Return the wall time and CPU time of a command from its start to its end."""
    children_cpu_s_before = children_cpu_s()
    start_time_s = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return StartTime(time.monotonic() - start_time_s, children_cpu_s() - children_cpu_s_before)


def children_cpu_s() -> float:
    """Return the total CPU time of all child processes that have ended [s]."""
    resource_usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return resource_usage.ru_utime + resource_usage.ru_stime


def process_cpu_s(pid: int) -> float:
    """Return the CPU time of a running process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def time_until_first_frame(hand_name: str, work_folder: Path) -> StartTime:
    """Return the wall time and CPU time from the start of ``handctl run`` to its first frame."""
    from handctl.runtime.buses.local_bus import connect_to_hub

    listener = connect_to_hub(BUS_NAME)
    words = [
        "run",
        "--hand",
        hand_name,
        "--bus",
        f"local:{BUS_NAME}",
        "--log",
        str(work_folder / "run.mcap"),
    ]
    start_time_s = time.monotonic()
    run = subprocess.Popen(
        [sys.executable, "-m", "handctl.cli", *words],
        cwd=work_folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        if not select.select([listener], [], [], FRAME_TIMEOUT_S)[0]:
            raise SystemExit(
                f"handctl {' '.join(words)} has sent no frame within {FRAME_TIMEOUT_S:g} s"
            )
        return StartTime(time.monotonic() - start_time_s, process_cpu_s(run.pid))
    finally:
        run.terminate()
        run.wait()
        listener.close()
        (work_folder / "run.mcap").unlink(missing_ok=True)


def print_results(result: dict[str, list[StartTime]]) -> None:
    """Print a table of the start times."""
    print(f"{'program':28} {'median [s]':>11} {'smallest':>9} {'largest':>8} {'CPU [s]':>8}")
    for name, start_rows in result.items():
        times = [start.wall_s for start in start_rows]
        cpu = statistics.median(start.cpu_s for start in start_rows)
        print(
            f"{name:28} {statistics.median(times):11.2f} {min(times):9.2f} {max(times):8.2f} {cpu:8.2f}"
        )


if __name__ == "__main__":
    main()
