"""Start of a run: time from the command to the first frame on the bus, and the time of the help of a verb.

``python benchmarks/start.py [--repeats N] [--json]``. The bus is the local bus, with nobody else on it. The kernels
are compiled before the first measurement. The start of Python with numpy is measured in between, as a reference of
the same machine: compare ratios.
"""

import argparse
import json
import os
import select
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

LONGEST_S = 600.0
"""Longest time to wait for a frame, with compilation [s]."""
BUS = "start"
"""Name of the local bus."""
RUNS = {"handctl run": "jamia", "handctl run, 11 motors": "jamia11"}
"""Packaged hand of each measured run."""


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7, help="starts of each program (default: 7)")
    parser.add_argument("--json", action="store_true", help="numbers for programs")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="h-") as folder:
        os.environ["HANDCTL_RUN_DIR"] = folder
        result = measure(args.repeats, Path(folder))
    print(json.dumps(result, indent=2)) if args.json else show(result)


def measure(repeats: int, folder: Path) -> dict[str, list[float]]:
    """Return the times of each program [s]. The programs take turns."""
    command = [sys.executable, "-m", "firmware_sim", "bus", BUS]
    hub = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
    assert hub.stdout
    hub.stdout.readline()
    measures: dict[str, Callable[[], float]] = {
        "python -c 'import numpy'": lambda: until_end([sys.executable, "-c", "import numpy"]),
        "handctl run --help": lambda: until_end([sys.executable, "-m", "handctl.cli", "run", "--help"]),
    }
    for name, hand in RUNS.items():
        measures[name] = partial(until_first_frame, hand, folder)
    try:
        for one in measures.values():
            one()  # compiles, and fills the cache of the disk
        times: dict[str, list[float]] = {name: [] for name in measures}
        for _ in range(repeats):
            for name, one in measures.items():
                times[name].append(one())
        return times
    finally:
        hub.terminate()
        hub.wait()


def until_end(command: list[str]) -> float:
    """Return the time of a command [s]."""
    begin = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.monotonic() - begin


def until_first_frame(hand: str, folder: Path) -> float:
    """Return the time from the start of ``handctl run`` to its first frame [s]."""
    from handctl.runtime.buses.local import connect

    listener = connect(BUS)
    words = ["run", "--hand", hand, "--bus", f"local:{BUS}", "--log", str(folder / "run.mcap")]
    begin = time.monotonic()
    run = subprocess.Popen(
        [sys.executable, "-m", "handctl.cli", *words], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        if not select.select([listener], [], [], LONGEST_S)[0]:
            raise SystemExit(f"handctl {' '.join(words)} has sent no frame within {LONGEST_S:g} s")
        return time.monotonic() - begin
    finally:
        run.terminate()
        run.wait()
        listener.close()
        (folder / "run.mcap").unlink(missing_ok=True)


def show(result: dict[str, list[float]]) -> None:
    """Print a table."""
    print(f"{'program':28} {'median [s]':>11} {'smallest':>9} {'largest':>8}")
    for name, times in result.items():
        print(f"{name:28} {statistics.median(times):11.2f} {min(times):9.2f} {max(times):8.2f}")


if __name__ == "__main__":
    main()
