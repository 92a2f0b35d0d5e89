"""Test a simulated hand and its controller in real time for hours, with a random fault every minute.

The test measures the memory and the open file descriptors of simulator and controller. If a fault
ends the controller, the test starts a new controller. If a remaining fault of the simulated hand
prevents the new controller from arming the hand, the test starts a new simulator. The test reads
each log completely and then deletes the log.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from firmware_sim.description.hand_description import load_hand as load_simulated
from firmware_sim.faults.fault_text import FAULT_KINDS, instances_of_component
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.runtime.mailbox import StatusWatcher
from tests.runtime.processes import (
    LOCAL_BUS,
    LONG_TASK,
    end_process,
    run_handctl,
    start_handctl,
    write_homed_calibration,
)

MAX_GROWTH_MIB_PER_H = 1.0
"""Largest permitted growth of the memory of a process [MiB/h]."""
WARM_UP_S = 300.0
"""Duration of the warm-up [s], in which a process still allocates its working memory."""
PEAK_WINDOW_S = 300.0
"""Length of the time windows in which the peak of the memory is determined [s].

The growth of the memory is computed from the largest value in each time window.
"""
MIN_SLOPE_SAMPLING_S = 1800.0
"""Shortest duration of the samples [s] from which the growth of the memory per hour is computed."""
ACCEPTED_EXIT_CODES = (0, 1, 71)
"""Accepted exit codes of controllers: 0 (done), 1 (ended by a fault), 71 (a drive did not confirm its stop)."""
SOAK_TASK = LONG_TASK.replace("duration_s = 60.0", "duration_s = 3600.0")


class MemorySample(NamedTuple):
    """Memory [MiB] and number of open file descriptors of a process with its children, at a given time [s]."""

    time_s: float
    rss_mib: float
    descriptors: int


def memory_sample(pid: int, time_s: float) -> MemorySample:
    """Measure the memory and the file descriptors of a process with its children.

    ``time_s`` is the time of the sample [s].
    """
    pids = [pid, *map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())]
    rss = descriptors = 0
    for process_id in pids:
        status = Path(f"/proc/{process_id}/status").read_text()
        rss += next(
            (int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")), 0
        )
        descriptors += len(os.listdir(f"/proc/{process_id}/fd"))
    return MemorySample(time_s, rss / 1024, descriptors)


def memory_slope(samples: list[MemorySample], warm_up_s: float = WARM_UP_S) -> float | None:
    """Return the growth of the memory after the warm-up [MiB/h], or None if the samples cover too short a time.

    The growth is the slope of a line through the largest value in each window of ``PEAK_WINDOW_S``.
    Because only the largest values count, memory that a process frees and allocates again is not
    mistaken for growth.
    """
    warm_samples = [sample for sample in samples if sample.time_s - samples[0].time_s >= warm_up_s]
    if not warm_samples or warm_samples[-1].time_s - warm_samples[0].time_s < MIN_SLOPE_SAMPLING_S:
        return None
    window_count = (warm_samples[-1].time_s - warm_samples[0].time_s) // PEAK_WINDOW_S
    windows = groupby(
        warm_samples,
        lambda warm_sample: (warm_sample.time_s - warm_samples[0].time_s) // PEAK_WINDOW_S,
    )
    peak_samples = [
        max(samples_of_window, key=lambda warm_sample: warm_sample.rss_mib)
        for number, samples_of_window in windows
        if number < window_count
    ]
    return float(
        np.polyfit(
            [peak.time_s / 3600 for peak in peak_samples],
            [peak.rss_mib for peak in peak_samples],
            1,
        )[0]
    )


class SoakTest:
    """State of a soak test: processes of simulator and controller, memory samples, counts of events, and errors."""

    def __init__(self, seed: int, time_scale: float) -> None:
        """Create a test without processes.

        ``seed`` selects the faults. ``time_scale`` is the time scale of simulator and controller.
        """
        self.random_source = random.Random(seed)
        self.scale = str(time_scale)
        self.samples_by_process: dict[str, list[list[MemorySample]]] = {
            "simulator": [],
            "controller": [],
        }
        self.counts = Counter[str]()
        self.errors: list[str] = []
        self.run_number = 0
        self.simulator: subprocess.Popen[str] | None = None
        self.controller: subprocess.Popen[str] | None = None

    def start_simulator(self) -> None:
        """End the old simulated hand, and start a new simulated hand without faults."""
        if self.simulator:
            end_process(self.simulator)
        arguments = ("--bus", LOCAL_BUS, "--homed", "--hand", "jamia", "--time-scale", self.scale)
        command = [sys.executable, "-m", "firmware_sim", *arguments]
        self.simulator = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.simulator.stdout
        assert self.simulator.stdout.readline().startswith("firmware_sim: ready")
        self.samples_by_process["simulator"].append([])
        self.counts["simulators"] += 1

    def start_controller(self) -> bool:
        """Start a controller.

        Return True as soon as the controller has armed the hand and holds the fingers bent. Return
        False if the controller ends earlier, or after 60 s.
        """
        self.run_number += 1
        write_homed_calibration(Path("c.toml"), load_hand("jamia"))
        arguments = (
            "--hand",
            "jamia",
            "--bus",
            LOCAL_BUS,
            "--calibration",
            "c.toml",
            "--task",
            "long.toml",
            "--clear",
            "--json",
        )
        log = ("--log", f"{self.run_number}.mcap", "--time-scale", self.scale)
        self.controller = start_handctl("run", *arguments, *log)
        self.samples_by_process["controller"].append([])
        self.counts["controllers"] += 1
        watcher = StatusWatcher(LOCAL_BUS)
        deadline_s = time.monotonic() + 60.0
        while time.monotonic() < deadline_s and self.controller.poll() is None:
            line = watcher.request_status_line(0.2)
            if line is not None and line["phase"] == "stay":
                watcher.close()
                return True
        watcher.close()
        return False

    def stop_controller(self) -> None:
        """Stop the controller if it runs, and check its exit code and its log."""
        if self.controller is None:
            return
        if self.controller.poll() is None:
            self.controller.send_signal(signal.SIGTERM)
        output_text, err = self.controller.communicate(
            timeout=600.0
        )  # This call includes a check of the log.
        code = self.controller.returncode
        path = Path(f"{self.run_number}.mcap")
        self.controller = None
        self.counts[f"exit {code}"] += 1
        if code not in ACCEPTED_EXIT_CODES or "Traceback" in err:
            self.errors.append(f"run {self.run_number}: exit code {code}: {err[-300:]}")
        if path.exists():
            with RunLog(path) as log:
                self.counts["ticks"] += len(list(log.ticks()))
                if log.warning:
                    self.errors.append(f"run {self.run_number}: log {log.warning}")
        elif code == 0:
            self.errors.append(f"run {self.run_number}: no log; {output_text[-100:]}")
        for remaining_file in Path().glob(f"{self.run_number}.*"):
            remaining_file.unlink()

    def ensure_controller(self) -> None:
        """Ensure that a controller runs and holds the fingers of the hand bent.

        If no controller can arm the hand, start a new simulator.
        """
        if self.controller is not None and self.controller.poll() is None:
            return
        self.stop_controller()
        if not self.start_controller():
            self.stop_controller()
            self.start_simulator()
            if not self.start_controller():
                self.errors.append("a new simulator and a new controller did not arm")

    def inject_random_fault(self) -> str:
        """Inject a random fault, and return the description of the fault."""
        hand = load_simulated("jamia")
        kind = self.random_source.choice(
            [
                fault_kind
                for fault_kind in FAULT_KINDS
                if any(
                    instances_of_component(c, hand, fault_kind)
                    for c in FAULT_KINDS[fault_kind].components
                )
            ]
        )
        component_instances = [
            (component, name)
            for component in FAULT_KINDS[kind].components
            for name in instances_of_component(component, hand, kind)
        ]
        component, name = self.random_source.choice(component_instances)
        text = f"{kind} {component}={name} for={self.random_source.choice((1, 20, 200, 2000))}ms"
        if run_handctl("fault", "inject", text, "--bus", LOCAL_BUS).returncode:
            self.errors.append(f"refused: {text}")
        self.counts["faults"] += 1
        return text

    def sample_memory(self, time_s: float) -> None:
        """Measure memory and file descriptors of simulator and controller."""
        for name, process in (("simulator", self.simulator), ("controller", self.controller)):
            if process is not None and process.poll() is None:
                self.samples_by_process[name][-1].append(memory_sample(process.pid, time_s))

    def soak_result(self) -> dict[str, object]:
        """Return the result of the test: counts of events, growth of memory, open file descriptors, and all errors."""
        slopes_or_none_by_process = {
            name: [memory_slope(life) for life in lives if life]
            for name, lives in self.samples_by_process.items()
        }
        slopes_by_process = {
            name: [slope for slope in slopes_or_none if slope is not None]
            for name, slopes_or_none in slopes_or_none_by_process.items()
        }
        for name, found_slopes in slopes_by_process.items():
            self.errors += [
                f"{name} grows by {slope:.2f} MiB/h"
                for slope in found_slopes
                if slope > MAX_GROWTH_MIB_PER_H
            ]
        memory_rise = {name: max((life[-1].rss_mib - life[0].rss_mib for life in lives if life), default=0) for name,
        lives in
                self.samples_by_process.items()}  # fmt: skip
        descriptors = {name: sorted({s.descriptors for life in lives for s in life}) for name, lives in
                       self.samples_by_process.items()}  # fmt: skip
        simulators = [sample for sample in self.samples_by_process["simulator"] if sample]
        if any(
            max(s.descriptors for s in simulator) > simulator[0].descriptors + 4
            for simulator in simulators
        ):
            self.errors.append("the simulator's descriptors grow")
        return {
            "counts": dict(self.counts),
            "rss_rise_mib": memory_rise,
            "rss_slope_mib_per_h": slopes_by_process,
            "descriptors": descriptors,
            "wrong": self.errors,
        }


def main() -> int:
    """Run the soak test for the requested time. Return 1 if the test found any error."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.soak", description=__doc__)
    parser.add_argument(
        "--hours", type=float, default=24.0, help="duration [h] (default: %(default)s)"
    )
    parser.add_argument(
        "--every",
        type=float,
        default=60.0,
        help="time between two faults [s] (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    parser.add_argument(
        "--time-scale",
        type=float,
        default=1.0,
        help="ratio of simulated time to wall time, smaller for a busy machine (default: %(default)s)",
    )
    parser.add_argument(
        "--calm", action="store_true", help="inject no faults, and report the growth of the memory"
    )
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="h-") as folder:
        os.environ["HANDCTL_RUN_DIR"] = folder
        os.chdir(folder)
        Path("long.toml").write_text(SOAK_TASK)
        soak_test = SoakTest(args.seed, args.time_scale)
        start_s = time.monotonic()
        try:
            soak_test.start_simulator()
            while (elapsed_s := time.monotonic() - start_s) < args.hours * 3600:
                soak_test.ensure_controller()
                soak_test.sample_memory(elapsed_s)
                text = "no fault" if args.calm else soak_test.inject_random_fault()
                print(f"{elapsed_s:8.0f} s  {text}", file=sys.stderr, flush=True)
                time.sleep(args.every)
            soak_test.stop_controller()
        finally:
            for process in (soak_test.controller, soak_test.simulator):
                if process:
                    end_process(process)
        print(json.dumps(soak_test.soak_result(), indent=2))
        return 1 if soak_test.errors else 0


if __name__ == "__main__":
    sys.exit(main())
