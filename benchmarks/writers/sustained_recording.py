"""Measure the recorder of handctl at 1 kHz in real time, with eleven motors and their frames.

The results are the number of dropped ticks, and the effect of the recorder on the control loop.

All ticks are computed before the measurement, so that only the recorder affects the timing of the
control loop. Control loop and recorder run on different cores. Before and after the measurement,
the same control loop runs without a recorder. The runs without a recorder show how much other
programs on the computer delay a run.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import synthetic_run

from handctl.compiled import compile_kernels
from handctl.core.tick_types import (
    TELEMETRY_FIELDS,
    HandMode,
    IoEvent,
    PackedTelemetry,
    TelemetrySlices,
    TickIn,
    TickOut,
    TickRequest,
)
from handctl.drives.frame import Frame
from handctl.drives.frame_records import Frames, frames_as_records
from handctl.log.read.reader import RunLog
from handctl.log.tick_packing import pack_tick_record
from handctl.log.write.recorder import Recorder
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.clocks.realtime_priority import request_priority, restore_priority
from handctl.runtime.loop import ControlLoop, LoopStats

HAND_NAME = "jamia11"
RATE_HZ = 1000
PREPARED_RUN_DURATION_S = 0.5
PERIOD_NS = 10**9 // RATE_HZ
LATENESS_PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9, "max": 100.0}

TickInputAndOutput = tuple[TickIn, TickOut]


def measure_sustained(log_path: Path, duration_s: float) -> dict[str, Any]:
    """Run the control loop with the recorder.

    Also run the control loop without the recorder, before and after the recording. Each run without
    the recorder lasts half as long as the run with the recorder.

    Args:
        log_path: path of the new log file.
        duration_s: duration of the loop with the recorder [s].

    Returns:
        content of the log, number of dropped ticks, fraction of one core that the recorder uses, lateness
        of the control loop [us].
    """
    compile_kernels()  # as before every run: a compilation during a tick would make the tick late
    ticks = [
        packed_tick(*tick)
        for tick in synthetic_run.SyntheticRunTicks(
            synthetic_run.synthetic_header(HAND_NAME, RATE_HZ), PREPARED_RUN_DURATION_S
        )
    ]
    recorder = Recorder.start(
        log_path, synthetic_run.synthetic_header(HAND_NAME, RATE_HZ, deterministic=False)
    )
    with _on_separate_cores(recorder._child.pid) as uses_separate_cores:
        stats_before = _run_loop(
            duration_s / 2, uses_separate_cores, ticks, lambda tick_input, out: None, list
        )
        recorder_cpu_s_before = _recorder_cpu_s(recorder._child.pid)
        start = time.perf_counter()
        stats_with_log = _run_loop(
            duration_s,
            uses_separate_cores,
            ticks,
            _tick_recorder_of(recorder),
            lambda: list(recorder.take_events()),
        )
        fraction = (_recorder_cpu_s(recorder._child.pid) - recorder_cpu_s_before) / (
            time.perf_counter() - start
        )
        stats_after = _run_loop(
            duration_s / 2, uses_separate_cores, ticks, lambda tick_input, out: None, list
        )
    summary = recorder.close("finished")
    with RunLog(log_path) as log:
        frames = sum(len(tick.tick_in.frames) + len(tick.frames) for tick in log.ticks())
        result = {"ticks": stats_with_log.ticks, "ticks_in_log": len(log), "frames_in_log": frames}
    summary_counts = {name: int(str(summary[name])) for name in ("dropped", "lost", "bytes")}
    lateness_results = {
        "without_us": _lateness_figures(stats_before, stats_after),
        "with_us": _lateness_figures(stats_with_log),
    }
    return {
        "seconds": duration_s,
        "real_time": uses_separate_cores,
        **result,
        **summary_counts,
        "recorder_core_share": fraction,
        **lateness_results,
    }


def packed_tick(tick_in: TickIn, tick_output: TickOut) -> TickInputAndOutput:
    """Convert the frames of a tick to frame records, and the telemetry of the tick to one array.

    The control loop of a real run converts frames and telemetry in the same way.
    """
    telemetry_slices = TelemetrySlices()
    at = 0
    for name, values in zip(TELEMETRY_FIELDS, tick_output.telemetry, strict=True):
        telemetry_slices[name] = slice(at, at + len(values))
        at += len(values)
    telemetry = PackedTelemetry(np.concatenate(tuple(tick_output.telemetry)), telemetry_slices)
    return tick_in._replace(frames=frames_as_records(tick_in.frames)), tick_output._replace(
        frames=frames_as_records(tick_output.frames), telemetry=telemetry
    )


@contextmanager
def _on_separate_cores(recorder_pid: int) -> Iterator[bool]:
    """Put control loop and recorder on different cores if possible. Yield True if the loop has real-time priority."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if cores:
        os.sched_setaffinity(recorder_pid, {max(cores)})
        os.sched_setaffinity(0, {min(cores)})
    try:
        yield request_priority().is_realtime
    finally:
        restore_priority()
        if cores:
            os.sched_setaffinity(0, cores)


class _SyntheticBus:
    """A bus that delivers stored frames.

    The frames belong to a run that was computed before the measurement.
    """

    def __init__(self, ticks: list[TickInputAndOutput]) -> None:
        self._ticks = ticks
        self._at = 0

    def drain(self) -> Frames:
        """Return the frames that the controller receives in the next tick."""
        self._at += 1
        return frames_as_records(self._ticks[self._at % len(self._ticks)][0].frames)

    def send(self, frames: Sequence[Frame]) -> int:
        """Accept all frames that the controller sends."""
        return len(frames)

    def take_events(self) -> list[tuple[str, str, int]]:
        """Return an empty list, because this bus has no events."""
        return []


@dataclass
class _PrecomputedTick:
    """A tick of the control loop, with a result that was computed before the run.

    Attributes:
        state: number of ticks so far.
        tick_output: output of the tick.
    """

    state: int
    tick_output: TickOut

    def decide(self, requests: tuple[TickRequest, ...]) -> None:
        """Do nothing, because the result of the tick was computed before the run."""

    def command(self, targets: tuple[TickRequest, ...]) -> Sequence[Frame]:
        """Return the frames that the tick sends."""
        return self.tick_output.frames

    def conclude(self) -> tuple[int, TickOut]:
        """Return the result of the tick, which was computed before the run."""
        return self.state, self.tick_output


def _run_loop(
    duration_s: float,
    busy_wait: bool,
    ticks: list[TickInputAndOutput],
    record_tick: Callable[[TickIn, TickOut], None],
    take_events: Callable[[], list[IoEvent]],
) -> LoopStats:
    """Run the control loop with ticks that were computed before the run, and return the statistics of the loop."""
    last_tick = int(duration_s * RATE_HZ)

    def begin(state: int, tick_input: TickIn) -> _PrecomputedTick:
        tick_output = ticks[state % len(ticks)][1]
        return _PrecomputedTick(
            state + 1,
            tick_output._replace(mode=HandMode.DONE) if tick_input.k >= last_tick else tick_output,
        )

    clock = RealClock(PERIOD_NS, busy_wait=busy_wait)
    loop = ControlLoop(
        clock,
        PERIOD_NS,
        [_SyntheticBus(ticks)],
        begin,
        (),
        tuple,
        take_events,
        record_tick,
        lambda tick_input, out: None,
    )
    loop.run(0)
    return loop.stats


def _tick_recorder_of(recorder: Recorder) -> Callable[[TickIn, TickOut], None]:
    """Return a function that packs a tick and passes it to the recorder."""

    def record(tick_input: TickIn, tick_output: TickOut) -> None:
        recorder.send_record(pack_tick_record(tick_input, tick_output))

    return record


def _recorder_cpu_s(pid: int) -> float:
    """Return the CPU time of the recorder and of its sync process [s]."""
    processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    return float(
        sum(process.cpu_times().user + process.cpu_times().system for process in processes)
    )


def _lateness_figures(*loop_stats: LoopStats) -> dict[str, float]:
    """Return percentiles of the lateness of the control loop [us] and the fraction of missed deadlines."""
    us = (
        np.concatenate([np.array(stats_of_loop.tick_lateness_ns) for stats_of_loop in loop_stats])
        / 1e3
    )
    missed_fraction = sum(stats_of_loop.missed_ticks for stats_of_loop in loop_stats) / sum(
        stats_of_loop.ticks + stats_of_loop.missed_ticks for stats_of_loop in loop_stats
    )
    return {
        name: float(np.percentile(us, percentile))
        for name, percentile in LATENESS_PERCENTILES.items()
    } | {"missed_share": missed_fraction}
