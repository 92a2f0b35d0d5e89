"""Measure the time that handctl and other CAN clients need to exchange the frames of one tick.

The benchmark measures the CPU time and the wall time of the exchange. It compares the client of
handctl, other CAN clients, and C programs.

``python benchmarks/bus.py [--quick] [--json]``. The benchmark runs with four and with eleven motors
in MIT mode, on handctl's local bus (a Unix socket) and on vcan. If the kernel of the machine does
not support vcan, the benchmark uses vcan in user-mode Linux. The simulated motors run in the
process of the benchmark. The reported times do not include the computing time of the simulated
motors. An exchange converts torques to payloads, sends the frames, receives the reply frames of the
motors, and converts their payloads to values. In addition, handctl updates the state of each drive,
because the controller does so in every tick. Absolute times of different runs are not comparable.
Compare only ratios of times from the same run.

A C program makes the same system calls as handctl and encodes the same frames. The time of the C
program is the lower bound for the times of all clients. On the local bus, handctl and the C program
send all frames of a tick in one packet. Therefore, the time of the C program on the local bus
hardly grows with the number of motors. For comparison, another C program sends one packet per frame
(sendmmsg, recvmmsg), as a CAN socket does.
"""

import argparse
import gc
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

BENCHMARKS_FOLDER = Path(__file__).parent
MOTOR_COUNTS = (4, 11)
C_REFERENCE_LABEL = "C, the same system calls"
PACKET_PER_FRAME_LABEL = "C, one packet per frame"
MEASUREMENT_ROUNDS = 5
REFERENCE_LABEL = "python-can, scalar codec"


def main() -> None:
    """Measure the exchange times of all clients on both buses, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer ticks")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--one", nargs=3, metavar=("MEDIUM", "C_PROGRAM", "TICKS"), help=argparse.SUPPRESS
    )
    args = parser.parse_args()
    if args.one:
        medium, c_program, ticks = args.one
        print(json.dumps(measure_bus(medium, c_program, int(ticks))))
        return
    result = measure_both_buses(1000 if args.quick else 5000)
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def use_one_core() -> str:
    """Bind this process to one core, with real-time priority if the operating system allows real-time priority.

    Return a text that names the core and the priority of the process. The kernel of user-mode Linux
    and the programs inside user-mode Linux are processes of the host. The processes of user-mode
    Linux would wait for each other if they ran on two cores.
    """
    if sys.platform != "linux":
        return "any core, ordinary priority"
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    except PermissionError:
        return f"core {core}, ordinary priority"
    return f"core {core}, SCHED_FIFO"


def measure_both_buses(tick_count: int) -> dict:
    """Measure the exchange of frames on the local bus and on vcan.

    For a bus that is not available, the result contains the reason why the bus is missing.
    """
    with tempfile.TemporaryDirectory(prefix="h-") as short_folder:
        os.environ["HANDCTL_RUN_DIR"] = short_folder
        c_program = compile_reference(Path(short_folder))
        core_text = use_one_core()
        return {
            "local": measure_bus("local", c_program, tick_count),
            "vcan": measure_vcan(c_program, tick_count),
            "on": core_text,
        }


def compile_reference(build_folder: Path) -> str:
    """Compile the C program and return its path. Return an empty string if the machine has no C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return ""
    program_path = build_folder / "floor"
    subprocess.run(
        [compiler, "-O2", "-o", str(program_path), str(BENCHMARKS_FOLDER / "exchange" / "floor.c")],
        check=True,
    )
    return str(program_path)


def measure_vcan(c_program: str, tick_count: int) -> dict:
    """Measure the exchange of frames on the interface vcan0."""
    sys.path.insert(0, str(BENCHMARKS_FOLDER.parent))
    from tests.vcan import uml_guest

    kind, reason = uml_guest.vcan_access()
    if not kind:
        return {"skipped": reason}
    output: list[str] = []
    command = [sys.executable, __file__, "--one", "vcan", c_program, str(tick_count // 5)]
    status = uml_guest.run_with_vcan(command, timeout_s=240.0, print_line=output.append)
    return json.loads(output[-1]) if status == 0 else {"skipped": f"status {status}: {output[-1:]}"}


def measure_bus(bus_kind: str, c_program: str, tick_count: int) -> dict:
    """Measure the wall time [us] and the CPU time [us] of each client, for each number of motors.

    For a client that cannot run, the result contains the reason why the client cannot run.

    Each round measures all clients, because other work on the machine disturbs some rounds more
    than others. The reported wall time is the wall time of the fastest round. The reported CPU time
    is the mean over all rounds, because user-mode Linux counts CPU time in units of 10 ms.
    """
    result: dict = {}
    for motors in MOTOR_COUNTS:
        rows_by_round: dict = {}
        for _ in range(MEASUREMENT_ROUNDS):
            for name, row in measure_round(
                bus_kind, c_program, motors, tick_count // MEASUREMENT_ROUNDS
            ):
                rows_by_round.setdefault(name, []).append(row)
        result[str(motors)] = add_ratios(
            {name: combine_rounds(rows) for name, rows in rows_by_round.items()}
        )
    return result


def combine_rounds(round_rows: list[dict]) -> dict:
    """Combine the rounds of one client into one result: shortest wall time, and mean CPU time."""
    if "skipped" in round_rows[0]:
        return round_rows[0]
    wall_us, cpu_us = ([row[key] for row in round_rows] for key in ("wall_us", "cpu_us"))
    return {"wall_us": min(wall_us), "cpu_us": statistics.fmean(cpu_us)}


def measure_round(bus_kind: str, c_program: str, motor_count: int, tick_count: int):
    """Measure the clients one after another, and yield the name and the times of each client."""
    sys.path.insert(0, str(BENCHMARKS_FOLDER))
    from exchange.can_exchanges import EXCHANGE_BY_NAME
    from exchange.pypi_clients import CLIENT_BY_PACKAGE
    from exchange.simulated_motors import BUS_SETTINGS_BY_KIND, open_simulated_motors

    warnings.simplefilter("ignore")  # The client libraries print warnings.
    if c_program:
        yield (
            C_REFERENCE_LABEL,
            measure_c_program(
                c_program,
                bus_kind,
                BUS_SETTINGS_BY_KIND[bus_kind][2],
                motor_count,
                tick_count,
            ),
        )
        if bus_kind == "local":
            yield (
                PACKET_PER_FRAME_LABEL,
                measure_c_program(c_program, "packets", "-", motor_count, tick_count),
            )
    for name, make_exchange in {**EXCHANGE_BY_NAME, **CLIENT_BY_PACKAGE}.items():
        with open_simulated_motors(bus_kind) as (peer, interface, channel):
            try:
                exchange = make_exchange(interface, channel, motor_count)
            except (ImportError, ValueError) as error:
                yield name, {"skipped": str(error)}
                continue
            yield (
                name,
                measure_client(
                    exchange,
                    peer,
                    motor_count,
                    tick_count if name in EXCHANGE_BY_NAME else max(50, tick_count // 5),
                ),
            )


def measure_c_program(
    c_program: str, bus_kind: str, channel: str, motor_count: int, tick_count: int
) -> dict:
    """Measure the wall time [us] and the CPU time [us] that the C program needs for one tick on a bus."""
    words = [c_program, bus_kind, channel, str(motor_count), str(tick_count)]
    output_text = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
    return {"wall_us": int(output_text[0]) / 1e3, "cpu_us": int(output_text[1]) / 1e3}


def measure_client(client, simulated_motors, motor_count: int, tick_count: int) -> dict:
    """Measure the time that a client needs to send and to receive the frames of one tick [us].

    Return the median wall time and the mean CPU time. Python's garbage collection is off during the
    measurement.
    """
    torques = [0.01 * i for i in range(motor_count)]

    def measure_ticks(clock, count: int) -> list[int]:
        """Measure how long each of ``count`` ticks takes [ns].

        The measured time does not include the time for reading the clock. In user-mode Linux, a
        reading of the clock takes as long as sending a frame.
        """
        times = []
        clock_read_ns = statistics.median(-clock() + clock() for _ in range(100))
        for _ in range(count):
            a = clock()
            client.send(torques)
            b = clock()
            simulated_motors.send_replies(motor_count, client.reply_frame)
            c = clock()
            frames = client.receive()
            times.append(b - a + clock() - c - 2 * clock_read_ns)
            assert len(frames) == motor_count
        return times

    measure_ticks(time.perf_counter_ns, max(20, tick_count // 10))
    gc.collect()
    gc.disable()
    wall_times_ns = measure_ticks(time.perf_counter_ns, tick_count)
    cpu_times_ns = measure_ticks(time.thread_time_ns, tick_count)
    gc.enable()
    client.close()
    return {
        "wall_us": statistics.median(wall_times_ns) / 1e3,
        "cpu_us": statistics.fmean(cpu_times_ns) / 1e3,
    }


def add_ratios(row_by_name: dict) -> dict:
    """Add three ratios of wall times to each measured row.

    For the first two ratios, the wall time of the client is divided by the wall time of each of the
    two C programs. For the third ratio, the wall time of python-can is divided by the wall time of
    the client.
    """
    reference = row_by_name[REFERENCE_LABEL]
    for row in row_by_name.values():
        if "skipped" not in row:
            row["times_floor"] = (
                row["wall_us"] / row_by_name[C_REFERENCE_LABEL]["wall_us"]
                if C_REFERENCE_LABEL in row_by_name
                else None
            )
            row["times_packets"] = (
                row["wall_us"] / row_by_name[PACKET_PER_FRAME_LABEL]["wall_us"]
                if PACKET_PER_FRAME_LABEL in row_by_name
                else None
            )
            row["times_faster_than_python_can"] = reference["wall_us"] / row["wall_us"]
    return row_by_name


def print_results(result: dict) -> None:
    """Print the results of the exchange benchmark as text."""
    print(f"on {result.pop('on')}; the fastest of {MEASUREMENT_ROUNDS} rounds")
    for medium, sizes in result.items():
        if "skipped" in sizes:
            print(f"{medium}: skipped: {sizes['skipped']}")
            continue
        for motors, rows in sizes.items():
            title = f"{medium}, {motors} motors"
            print(f"{title:<28}wall us  CPU us  x C  x C by packets  times faster than python-can")
            for name, row in rows.items():
                if "skipped" in row:
                    print(f"  {name:<26} skipped: {row['skipped']}")
                    continue
                ratio_texts = (
                    f"{value:.1f}" if value else "-"
                    for value in (row["times_floor"], row["times_packets"])
                )
                ratio = row["times_faster_than_python_can"]
                times = f"{row['wall_us']:7.1f}{row['cpu_us']:8.1f}"
                print("  {:<26}{}{:>6}{:>15}{:>30.2f}".format(name, times, *ratio_texts, ratio))


if __name__ == "__main__":
    main()
