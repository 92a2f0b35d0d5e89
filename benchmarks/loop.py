"""Compare the control loop of handctl with a hand-written loop: lateness of ticks, and highest control rate.

``python benchmarks/loop.py [--quick] [--json]``. Both control loops run with 4 and with 11 motors
on the same bus. For both control loops, a separate process simulates the drives. The process
simulates neither tendons nor digits. Absolute results of different runs are not comparable. Compare
only ratios of results from the same run.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

LATENESS_RATE_HZ = 500.0
MAX_MISSED_FRACTION = 0.01
AT_RATE_DURATION_S = {500.0: 30.0, 1000.0: 60.0}
"""Duration of the measurement with eleven motors at each fixed rate [s], by the rate [Hz]."""
AT_RATE_PAIRS = 3
"""Number of pairs of alternating measurements at each fixed rate."""
MEASUREMENT_PAIRS = 5
"""Number of pairs of alternating measurements whose medians are compared."""
RATE_REDUCTION_FACTOR = 0.85
"""The search for the highest control rate multiplies a control rate that was too high by ``RATE_REDUCTION_FACTOR``."""
LOOP_MODULE_BY_NAME = {"ours": "loops.handctl_loop", "usual": "loops.handwritten_loop"}
"""For each key in the results, the module that contains the control loop."""


def main() -> None:
    """Measure the lateness and the highest rate of both control loops, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="short measurement (less than half a minute)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--one",
        nargs=5,
        metavar=("WHICH", "HAND", "BUS", "SECONDS", "RATE"),
        help=argparse.SUPPRESS,
    )
    args = parser.parse_args()
    if args.one:
        print(json.dumps(measure_in_this_process(*args.one)))
        return
    with tempfile.TemporaryDirectory(prefix="h-") as short_folder:
        os.environ["HANDCTL_RUN_DIR"] = short_folder
        result = measure_loops(0.4 if args.quick else 5.0, quick=args.quick)
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def measure_loops(duration_s: float, quick: bool) -> dict:
    """Measure the lateness and the highest rate of both control loops, with 4 and with 11 motors.

    The results also include the behaviour at fixed control rates.
    """
    result: dict = {"motors": {}}
    pairs = 1 if quick else MEASUREMENT_PAIRS
    for hand, motors in (("jamia", 4), ("jamia11", 11)):
        with simulated_drives(hand) as bus:
            if motors == 4:
                handctl_lateness_us = measure_in_child_process(
                    "ours", hand, bus, 2 * duration_s, LATENESS_RATE_HZ
                )["late_us"]
                sleep_lateness_us = measure_in_child_process(
                    "bare", hand, bus, 2 * duration_s, LATENESS_RATE_HZ
                )["late_us"]
                result["lateness_us"] = {
                    "rate_hz": LATENESS_RATE_HZ,
                    "handctl": handctl_lateness_us,
                    "bare_sleep": sleep_lateness_us,
                }
            if motors == 11:
                result["at_rate"] = {
                    rate: measure_in_turn(
                        ("ours", "bare_spin"),
                        hand,
                        bus,
                        2 * duration_s if quick else long_s,
                        rate,
                        1 if quick else AT_RATE_PAIRS,
                    )
                    for rate, long_s in AT_RATE_DURATION_S.items()
                }
                # In some seconds, the host of a virtual machine makes every loop late. Only the
                # medians of several measurements can be compared.
                with both_cores_loaded():
                    loaded = measure_in_turn(
                        ("ours", "bare_spin"), hand, bus, 2 * duration_s, LATENESS_RATE_HZ, pairs
                    )
                result["loaded_us"] = {
                    loop_kind: [outcome["late_us"] for outcome in outcomes]
                    for loop_kind, outcomes in loaded.items()
                }
            result["motors"][motors] = measure_max_rates(hand, bus, duration_s, quick)
    return result


def measure_in_turn(
    loop_names: Iterable[str],
    hand_name: str,
    bus_name: str,
    duration_s: float,
    rate_hz: float,
    rounds: int,
) -> dict[str, list[dict]]:
    """Measure several control loops in turn, each ``rounds`` times, and return all results of each loop."""
    outcomes: dict[str, list[dict]] = {name: [] for name in loop_names}
    for _ in range(rounds):
        for name, rows in outcomes.items():
            rows.append(measure_in_child_process(name, hand_name, bus_name, duration_s, rate_hz))
    return outcomes


def measure_max_rates(hand_name: str, bus_name: str, duration_s: float, quick: bool) -> dict:
    """Measure the highest rates of both control loops [Hz], without deadlines and with deadlines.

    Without deadlines, the measurements of the two loops alternate, and each ratio is the ratio of
    two consecutive measurements. The result has the medians.
    """
    pairs = 1 if quick else MEASUREMENT_PAIRS
    outcomes = measure_in_turn(LOOP_MODULE_BY_NAME, hand_name, bus_name, duration_s, 0.0, pairs)
    free_rates = {name: [row["hz"] for row in rows] for name, rows in outcomes.items()}
    result: dict = {}
    for name, rates in free_rates.items():
        free_hz = statistics.median(rates)
        held_hz = measure_held_rate(name, hand_name, bus_name, duration_s, free_hz, quick)
        result[name] = {"free_hz": free_hz, "held_hz": held_hz}
    ours, usual = (result[name]["held_hz"] for name in ("ours", "usual"))
    pair_ratios = [a / b for a, b in zip(free_rates["ours"], free_rates["usual"], strict=True)]
    return result | {
        "free_hz_ratio": statistics.median(pair_ratios),
        "free_hz_pair_ratios": pair_ratios,
        "held_hz_ratio": ours / usual if ours and usual else None,
    }


def measure_held_rate(
    loop_name: str,
    hand_name: str,
    bus_name: str,
    duration_s: float,
    free_rate_hz: float,
    quick: bool,
) -> float | None:
    """Return the highest rate at which a control loop misses less than 1 % of the deadlines [Hz].

    Return None if all tested rates were too high.
    """
    rate = (0.6 if quick else 0.9) * free_rate_hz
    for _ in range(1 if quick else 12):
        outcome = measure_in_child_process(loop_name, hand_name, bus_name, duration_s, rate)
        if outcome["missed"] < MAX_MISSED_FRACTION:
            return rate
        rate *= RATE_REDUCTION_FACTOR
    return None


def measure_in_child_process(
    loop_name: str, hand_name: str, bus_name: str, duration_s: float, rate_hz: float
) -> dict:
    """Run one measurement of a control loop in a separate process, and return the result."""
    words = ["--one", loop_name, hand_name, bus_name, str(duration_s), str(rate_hz)]
    output_text = subprocess.run(
        [sys.executable, __file__, *words], capture_output=True, text=True, timeout=120
    )
    if output_text.returncode:
        raise SystemExit(output_text.stderr)
    return json.loads(output_text.stdout)


def measure_in_this_process(
    loop_name: str, hand_name: str, bus_name: str, duration_text: str, rate_text: str
) -> dict:
    """Run one measurement of a control loop in this process, which ``measure_in_child_process`` has started."""
    sys.path.insert(0, str(Path(__file__).parent))
    log = Path(os.environ["HANDCTL_RUN_DIR"]) / f"{os.getpid()}.log"
    if loop_name == "bare":
        outcome = measure_bare_sleep(float(duration_text), float(rate_text))
    elif loop_name == "bare_spin":
        outcome = measure_bare_spin(float(duration_text), float(rate_text))
    else:
        run_loop = __import__(LOOP_MODULE_BY_NAME[loop_name], fromlist=["run_loop"]).run_loop
        try:
            outcome = run_loop(
                hand_name, bus_name, float(duration_text), float(rate_text) or None, log
            )
        except RuntimeError as error:
            # At a rate that is too high, the controller cannot set up the drives, or relaxes the hand.
            return {
                "hz": 0.0,
                "missed": 1.0,
                "late_us": percentiles_us([]),
                "failure": str(error),
            }
    hz, missed_ticks, lateness_us, *other_values = outcome
    result = {"hz": hz, "missed": missed_ticks, "late_us": percentiles_us(lateness_us)}
    if other_values:
        wall_time_s, cpu = other_values
        result |= {"tick_us": percentiles_us(wall_time_s), "cpu": cpu}
    return result


def percentiles_us(times_ns: list[int]) -> dict:
    """Return percentiles of a list of times [us]."""
    percentiles = np.percentile(times_ns, [50, 99, 99.9, 100]) / 1e3 if times_ns else [0.0] * 4
    return dict(
        zip(
            ("p50", "p99", "p99_9", "max"),
            (float(percentile) for percentile in percentiles),
            strict=True,
        )
    )


def measure_bare_spin(duration_s: float, rate_hz: float) -> tuple[float, float, list[int]]:
    """Measure how late the controller's clock returns from its waits for deadlines."""
    lateness_ns = list(bare_spin_lateness(duration_s, rate_hz))
    return rate_hz, 1.0 - len(lateness_ns) / int(duration_s * rate_hz), lateness_ns


def bare_spin_lateness(duration_s: float, rate_hz: float) -> Iterator[int]:
    """Yield the lateness of each tick of a loop that only waits for its deadlines [ns].

    The clock sleeps until shortly before a deadline. With real-time priority, the clock polls from
    the end of the sleep until the deadline.
    """
    from handctl.runtime.clocks.real_clock import RealClock
    from handctl.runtime.clocks.realtime_priority import request_priority

    period_ns = round(1e9 / rate_hz)
    clock = RealClock(period_ns)
    clock.busy_wait = request_priority().is_realtime
    clock.start()
    tick_count = int(duration_s * rate_hz)
    k = 1
    while k <= tick_count:
        lateness_ns = clock.wait(k)
        yield lateness_ns
        k += 1 + lateness_ns // period_ns


@contextmanager
def both_cores_loaded():
    """Keep two cores busy with two processes that compute without pause."""
    busy_processes = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)
    ]
    try:
        yield
    finally:
        for process in busy_processes:
            process.kill()
            process.wait()


def measure_bare_sleep(duration_s: float, rate_hz: float) -> tuple[float, float, list[int]]:
    """Measure how late ``time.sleep`` returns in a process with the priority of the control loop.

    In each tick, the function only sleeps until the deadline.
    """
    from handctl.runtime.clocks.realtime_priority import request_priority

    request_priority()
    start = time.monotonic_ns()
    lateness_us = []
    for k in range(1, int(duration_s * rate_hz)):
        deadline = start + int(k * 1e9 / rate_hz)
        time.sleep(max(0, deadline - time.monotonic_ns()) / 1e9)
        lateness_us.append(time.monotonic_ns() - deadline)
    return rate_hz, 0.0, lateness_us


@contextmanager
def simulated_drives(hand_name: str):
    """Start simulated drives on a local bus, and return the name of the bus."""
    command = [
        sys.executable,
        str(Path(__file__).parent / "loops" / "simulated_drives.py"),
        hand_name,
        "b",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        assert process.stdout.readline() == "ready\n"
        yield "b"
    finally:
        process.kill()
        process.wait()


def print_results(result: dict) -> None:
    """Print the results of both control loops as text."""
    lateness_us = result["lateness_us"]
    print(f"lateness at {lateness_us['rate_hz']:g} Hz [us]       p50     p99   p99.9     max")
    for name in ("handctl", "bare_sleep"):
        print(f"  {name:<24}" + "".join(f"{value:8.1f}" for value in lateness_us[name].values()))
    print("lateness, cores loaded [us]     p50     p99   p99.9     max   (medians)")
    for name, label in (("ours", "handctl"), ("bare_spin", "bare sleep and spin")):
        rows = result["loaded_us"][name]
        medians = (statistics.median(row[key] for row in rows) for key in rows[0])
        print(f"  {label:<24}" + "".join(f"{value:8.1f}" for value in medians))
        print("    p99.9 of each run:", ", ".join(f"{row['p99_9']:.0f}" for row in rows))
    for rate, rows in result["at_rate"].items():
        print_fixed_rate(rate, rows["ours"], rows["bare_spin"])
    print("rate [Hz]                 handctl   usual   ratio")
    for motors, rates in result["motors"].items():
        for kind in ("free_hz", "held_hz"):
            handctl_rate, baseline = rates["ours"][kind], rates["usual"][kind]
            ratio = rates[f"{kind}_ratio"]
            print(
                f"  {motors:>2} motors, {kind[:4]:<12}{handctl_rate or 0:10.0f}{baseline or 0:8.0f}{ratio or 0:8.2f}"
            )
        pairs = ", ".join(f"{ratio:.2f}" for ratio in rates["free_hz_pair_ratios"])
        print(f"  {motors:>2} motors, free, ratios of the pairs: {pairs}")


def print_fixed_rate(rate_hz: float, ours: list[dict], bare: list[dict]) -> None:
    """Print the results of alternating measurements of both loops at a fixed rate: medians, and all missed ticks."""
    for row in ours:
        if "failure" in row:
            print(f"11 motors at {rate_hz:g} Hz: {row['failure']}")
    ours = [row for row in ours if "failure" not in row]
    if not ours:
        return
    tick_us = {
        key: statistics.median(row["tick_us"][key] for row in ours) for key in ("p50", "p99")
    }
    cpu = statistics.median(row["cpu"] for row in ours)
    print(
        f"11 motors at {rate_hz:g} Hz: {100 * cpu:.0f} % of a core, "
        f"a tick {tick_us['p50']:.0f} us, p99 {tick_us['p99']:.0f} us   (medians)"
    )
    for label, rows in (("handctl", ours), ("bare sleep and spin", bare)):
        missed = ", ".join(f"{1e6 * row['missed']:.0f}" for row in rows)
        latest_us = max(row["late_us"]["max"] for row in rows)
        print(f"  {label:<24}missed of a million ticks: {missed}; at most {latest_us:.0f} us late")


if __name__ == "__main__":
    main()
