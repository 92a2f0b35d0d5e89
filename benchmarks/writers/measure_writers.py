"""Measure the CPU time of all log writers.

Each log writer writes the same run. The program reads each log back, and prints the CPU times of
writing and reading.
"""

import argparse
import gc
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import synthetic_run
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from benchmarks.writers.library_writers import WRITER_BY_LIBRARY, LogMessage
from benchmarks.writers.sustained_recording import measure_sustained, packed_tick
from handctl.compiled import compile_kernels
from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.tick_record import RECORD_FRAMING_STRUCT
from handctl.log.write.log_writer import LogWriter
from handctl.log.write.recorder import Recorder
from handctl.replay.controller_rebuild import rebuild_controller

RATE_HZ = 1000
EXECUTED_LOG_PATH = Path(__file__).resolve().parents[2] / "logs" / "golden" / "jamia11-grasp.mcap"
"""Log of a run with eleven motors. The log writers record the ticks of this run."""
EXECUTION_COUNT = 5
"""Number of times that the run in ``EXECUTED_LOG_PATH`` is executed."""
TICKS_PER_PAUSE = 100
"""Number of ticks after which the re-execution waits for the recorder."""
RECORDER_PAUSE_S = 0.03
"""Time in which the recorder empties the pipe [s]."""


def main(description: str) -> None:
    """Measure the CPU time of all log writers, and print the results."""
    compile_kernels()
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument(
        "--quick",
        action="store_true",
        help="0.2 s of a run instead of 2 s, and 2 s of continuous writing instead of 30 s",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="h-") as folder:
        result = measure_all_writers(
            Path(folder), 0.2 if args.quick else 2.0, 2.0 if args.quick else 30.0
        )
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


def measure_all_writers(
    log_folder: Path, duration_s: float, sustained_duration_s: float
) -> dict[str, Any]:
    """Measure the CPU time of all log writers. Also measure the recorder of handctl in a longer run."""
    run = synthetic_run.synthetic_header("jamia11", RATE_HZ)
    ticks = [packed_tick(*tick) for tick in synthetic_run.SyntheticRunTicks(run, duration_s)]
    writers = {"handctl": measure_handctl(log_folder / "ours.mcap", run, ticks)}
    messages = decode_messages(log_folder / "ours.mcap")
    for name, make_writer in WRITER_BY_LIBRARY.items():
        try:
            writers[name] = measure_library(
                log_folder / f"{name}.mcap", make_writer, messages, len(ticks)
            )
        except ImportError as error:
            writers[name] = {"skipped": f"{error.name} is not installed: make bench installs it"}
    return {
        "hand": "jamia11",
        "rate_hz": RATE_HZ,
        "ticks": len(ticks),
        "messages": len(messages),
        "frames": sum(
            len(tick_in.frames) + len(tick_output.frames) for tick_in, tick_output in ticks
        ),
        "writers": writers,
        "after_tick_us": 1e6 * conversion_cpu_s(log_folder),
        "sustained": measure_sustained(log_folder / "sustained.mcap", sustained_duration_s),
    }


def conversion_cpu_s(log_folder: Path) -> float:
    """Return the mean time [s] to record a tick that the controller has just computed.

    For the measurement, the controller re-executes a run from its log. The outputs of a tick are
    recorded while they are still in the caches of the processor, as in a control loop. The recorder
    records a run in real time, in which the controller never waits for the recorder. The run is
    repeated, and the shortest recording time of each tick is used.
    """
    durations_by_execution = list[list[float]]()
    with RunLog(EXECUTED_LOG_PATH) as log:
        controller = rebuild_controller(log)
        inputs = [tick.tick_in for tick in log.ticks()]
        header = replace(log.header, deterministic=False)
        gc.disable()  # In a run, the control loop also disables the garbage collector.
        for i in range(EXECUTION_COUNT):
            recorder = Recorder.start(log_folder / f"executed-{i}.mcap", header)
            state = controller.initial_state()
            durations_by_execution.append([])
            for tick_in in inputs:
                if tick_in.k % TICKS_PER_PAUSE == 0:
                    time.sleep(RECORDER_PAUSE_S)
                state, tick_output = controller.tick(state, tick_in)
                start = time.perf_counter()
                recorder.send_record(pack_tick_record(tick_in, tick_output))
                recorder.take_events()
                durations_by_execution[-1].append(time.perf_counter() - start)
            recorder.close("finished")
            if recorder.dropped:
                raise RuntimeError(f"{recorder.dropped} ticks were dropped")
        gc.enable()
    return sum(map(min, zip(*durations_by_execution, strict=True))) / len(inputs)


def _cpu_s(measured_work: Callable[[], object]) -> float:
    """Call the function ``measured_work`` and return the CPU time of the call [s]."""
    start = time.process_time()
    measured_work()
    return time.process_time() - start


def measure_handctl(log_path: Path, run_header: Any, ticks: list[Any]) -> dict[str, float]:
    """Measure the CPU time that handctl needs to pack and send records in the control loop.

    Also measure the CPU time of handctl's log writer, which runs in the same process here.
    """
    records: list[bytes] = []
    packing_cpu_s = _cpu_s(lambda: records.extend(pack_tick_record(*tick) for tick in ticks))
    recorder = Recorder.start(log_path.with_suffix(".pipe.mcap"), run_header)
    sending_cpu_s = _cpu_s(
        lambda: [(recorder.send_record(record), recorder.take_events()) for record in records]
    )
    recorder.close("finished")
    writer = LogWriter(log_path, run_header, print, 1)

    def write() -> None:
        for record in records:
            writer.add_tick(record[RECORD_FRAMING_STRUCT.size :])
        writer.finish("finished", 0)

    writing_cpu_s = _cpu_s(write)

    def read() -> None:
        with RunLog(log_path) as log:
            assert sum(1 for _ in log.ticks()) == len(log.field("tension")) == len(ticks)

    return _cost_row(
        packing_cpu_s + sending_cpu_s,
        packing_cpu_s + sending_cpu_s + writing_cpu_s,
        log_path.stat().st_size,
        _cpu_s(read),
        len(ticks),
    )


def measure_library(
    log_path: Path, make_writer: Any, messages: list[LogMessage], tick_count: int
) -> dict[str, float]:
    """Measure the CPU times that a log writer needs to write all messages, and to read all messages."""
    writer = make_writer(log_path)

    def write() -> None:
        for message in messages:
            writer.write(message)
        writer.close()

    spent_cpu_s = _cpu_s(write)
    count = 0

    def read() -> None:
        nonlocal count
        count = sum(1 for _ in writer.read())

    reading_cpu_s = _cpu_s(read)
    assert count == len(messages), f"{log_path}: {count} of {len(messages)} messages came back"
    files = log_path.rglob("*") if log_path.is_dir() else [log_path]
    return _cost_row(
        spent_cpu_s,
        spent_cpu_s,
        sum(file.stat().st_size for file in files),
        reading_cpu_s,
        tick_count,
    )


def _cost_row(
    loop_cpu_s: float, total_cpu_s: float, log_bytes: int, reading_cpu_s: float, tick_count: int
) -> dict[str, float]:
    return {
        "loop_us_per_tick": 1e6 * loop_cpu_s / tick_count,
        "total_us_per_tick": 1e6 * total_cpu_s / tick_count,
        "bytes_per_tick": log_bytes / tick_count,
        "read_times_real_time": tick_count / RATE_HZ / reading_cpu_s,
    }


def decode_messages(path: Path) -> list[LogMessage]:
    """Return every message of a log with its content as plain values."""
    messages = []
    factory = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, log_message in make_reader(file).iter_messages(log_time_order=False):
            decode_content = factory.decoder_for(channel.message_encoding, schema)
            content = _to_basic_types(decode_content(log_message.data))
            messages.append(
                LogMessage(
                    channel.topic, schema.name, schema.data.decode(), log_message.log_time, content
                )
            )
    return messages


def _to_basic_types(value: Any) -> Any:
    if hasattr(value, "__slots__") and not isinstance(value, (str, bytes, list, tuple)):
        return {name: _to_basic_types(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, bytes):
        return list(value)
    return (
        [_to_basic_types(element) for element in value]
        if isinstance(value, (list, tuple))
        else value
    )


def print_results(result: dict[str, Any]) -> None:
    """Print the CPU times of all log writers as text."""
    print(
        f"{result['ticks']} ticks of {result['hand']} at {result['rate_hz']} Hz: {result['messages']} messages"
    )
    print(f"{'':<18} {'in the loop':>14} {'in all':>14} {'size':>14} {'read':>16}")
    base = result["writers"]["handctl"]
    for name, row in result["writers"].items():
        if "skipped" in row:
            print(f"{name:<18} {row['skipped']}")
            continue
        loop, total, size, read = row.values()
        print(
            f"{name:<18} {loop:8.0f} us/tick {total:8.0f} us/tick {size:8.0f} B/tick {read:8.1f} x real time"
        )
        if row is not base:
            ratios = (
                loop / base["loop_us_per_tick"],
                total / base["total_us_per_tick"],
                size / base["bytes_per_tick"],
            )
            print(
                f"{'':<18} {ratios[0]:8.1f} times    {ratios[1]:8.1f} times    {ratios[2]:8.2f} times"
            )
    print(f"handctl, right after each tick of a controller: {result['after_tick_us']:.1f} us/tick")
    _print_sustained_result(result["sustained"])


def _print_sustained_result(sustained_result: dict[str, Any]) -> None:
    print(
        f"in real time for {sustained_result['seconds']:.0f} s: {sustained_result['ticks']} ticks, "
        f"{sustained_result['frames_in_log']} frames, "
        f"{sustained_result['dropped']} ticks dropped, {sustained_result['ticks_in_log']} in the log; "
        f"the recorder took {100 * sustained_result['recorder_core_share']:.0f} % of its core"
    )
    print(
        f"{'lateness of the loop [us]':<28}{'p50':>8}{'p99':>8}{'p99.9':>8}{'max':>8}{'missed':>10}"
    )
    for name in ("without", "with"):
        *lateness_us, missed_fraction = sustained_result[f"{name}_us"].values()
        print(
            f"  {name + ' recorder':<26}"
            + "".join(f"{percentile_us:8.0f}" for percentile_us in lateness_us)
            + f"{100 * missed_fraction:8.2f} %"
        )
