"""One tick's exchange, a command to each motor and its answer: CPU and wall time of handctl and of what one may use.

``python benchmarks/bus.py [--quick] [--json]``. Four and eleven MIT motors, on the local bus and on vcan (in user-mode
Linux where the kernel has none); the motors are in the same process and are not timed, so what counts is what the
host pays. The floor is a C program with the same system calls. What counts are the ratios within a run.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
MOTORS = (4, 11)
FLOOR = "C, the same system calls"
REFERENCE = "python-can, scalar codec"


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer ticks")
    parser.add_argument("--json", action="store_true", help="numbers for programs")
    parser.add_argument("--one", nargs=3, metavar=("MEDIUM", "FLOOR", "TICKS"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        medium, floor, ticks = args.one
        print(json.dumps(measure(medium, floor, int(ticks))))
        return
    result = everything(500 if args.quick else 5000)
    print(json.dumps(result, indent=2)) if args.json else show(result)


def everything(ticks: int) -> dict:
    """Both buses; a reason instead of numbers where one cannot be had."""
    with tempfile.TemporaryDirectory(prefix="h-") as short:
        os.environ["HANDCTL_RUN_DIR"] = short
        floor = build(Path(short))
        return {"local": measure("local", floor, ticks), "vcan": in_guest(floor, ticks)}


def build(folder: Path) -> str:
    """The C program; empty without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return ""
    target = folder / "floor"
    subprocess.run([compiler, "-O2", "-o", str(target), str(HERE / "exchange" / "floor.c")], check=True)
    return str(target)


def in_guest(floor: str, ticks: int) -> dict:
    """The same beside vcan0."""
    sys.path.insert(0, str(HERE.parent))
    from tests.vcan import uml

    kind, why_not = uml.means()
    if not kind:
        return {"skipped": why_not}
    said: list[str] = []
    command = [sys.executable, __file__, "--one", "vcan", floor, str(ticks // 5)]
    status = uml.run(command, timeout_s=240.0, say=said.append)
    return json.loads(said[-1]) if status == 0 else {"skipped": f"status {status}: {said[-1:]}"}


def measure(medium: str, floor: str, ticks: int) -> dict:
    """Wall and CPU time of each way [us], by number of motors."""
    sys.path.insert(0, str(HERE))
    from exchange.media import MEDIA, motors_on
    from exchange.ways import WAYS

    result: dict = {}
    for motors in MOTORS:
        rows: dict = {}
        if floor:
            words = [floor, medium, MEDIA[medium][2], str(motors), str(ticks)]
            out = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
            rows[FLOOR] = {"wall_us": int(out[0]) / 1e3, "cpu_us": int(out[1]) / 1e3}
        for name, way in WAYS.items():
            with motors_on(medium) as (peer, interface, channel):
                try:
                    made = way(interface, channel, motors)
                except ImportError as error:
                    print(f"{name}: skipped: {error}", file=sys.stderr)
                    continue
                rows[name] = timed(made, peer, motors, ticks)
        result[str(motors)] = with_ratios(rows)
    return result


def timed(way, peer, motors: int, ticks: int) -> dict:
    """Median wall time and mean CPU time of a tick's sending and receiving [us]."""
    torques = [0.01 * i for i in range(motors)]

    def spans(clock, count: int) -> list[int]:
        """Of so many ticks, by one clock alone: in user-mode Linux a look at a clock costs as much as a frame."""
        found = []
        for _ in range(count):
            a = clock()
            way.send(torques)
            b = clock()
            peer.answer(motors)
            c = clock()
            got = way.receive()
            found.append(b - a + clock() - c)
            assert len(got) == motors
        return found

    spans(time.perf_counter_ns, ticks // 10)
    wall, used = spans(time.perf_counter_ns, ticks), spans(time.thread_time_ns, ticks)
    way.close()
    return {"wall_us": statistics.median(wall) / 1e3, "cpu_us": statistics.fmean(used) / 1e3}


def with_ratios(rows: dict) -> dict:
    """Each row with its ratio to the floor, and how many times faster than python-can it is."""
    floor, reference = rows.get(FLOOR), rows[REFERENCE]
    for row in rows.values():
        row["times_floor"] = row["wall_us"] / floor["wall_us"] if floor else None
        row["times_faster_than_python_can"] = reference["wall_us"] / row["wall_us"]
    return rows


def show(result: dict) -> None:
    """The same for people."""
    for medium, sizes in result.items():
        if "skipped" in sizes:
            print(f"{medium}: skipped: {sizes['skipped']}")
            continue
        for motors, rows in sizes.items():
            print(f"{medium}, {motors} motors           wall us  CPU us  x floor  x faster than python-can")
            for name, row in rows.items():
                floor = f"{row['times_floor']:8.1f}" if row["times_floor"] else "       -"
                ratio = row["times_faster_than_python_can"]
                print(f"  {name:<26}{row['wall_us']:8.1f}{row['cpu_us']:8.1f}{floor}{ratio:10.1f}")


if __name__ == "__main__":
    main()
