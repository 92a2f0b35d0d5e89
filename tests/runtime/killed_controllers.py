"""Start controllers one after the other, and kill or stop each of them at a random time.

The simulated hand continues to run when a controller ends.

Each controller is a fork of the test process, because a new process would have to import all
modules again. As in any run, the recorder and the simulator are separate processes. The truth file
of the simulator shows how the drives react.
"""

import json
import os
import random
import signal
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from handctl.controller.bus_load import bus_loads
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.task_program import TaskProgram
from handctl.report.truth_record import TruthRecord, read_truth
from handctl.runtime.socket_paths import faults_path, local_bus_path, run_dir
from handctl.session.calibration import load_calibration
from handctl.session.run import make_controller, run_live
from handctl.session.run_plan import RunPlan, bus_specs
from handctl.session.task_loading import load_task
from tests.runtime.processes import (
    LOCAL_BUS,
    LONG_TASK,
    end_process,
    make_time_scale_options,
    start_hand,
    write_homed_calibration,
)

SYNC_ID = 0x080
"""CAN identifier of the SYNC frame. The first byte of a SYNC frame is the tick count."""
FRAME_RECORD_BYTES = 72
"""Size of a frame record on the local bus [bytes]."""
RATE_HZ = 500.0
WATCHDOG_MS = 50.0
"""Watchdog time of the drives in the hand file [ms].

``TORQUE_DECAY_MS`` after the end of the watchdog time, no motor is allowed to make torque.
"""
TORQUE_DECAY_MS = 4.0
"""Time that the current of a motor needs to decay after the motor was disabled [ms]."""
MIN_TORQUE_N_M = 1e-3
"""A motor counts as driven if its torque is above this value [N m]."""
MIN_TAUT_N = 8.0
"""A tendon counts as taut if its tension is above this value [N]."""
FINGER_OPENING_TIME_S = 0.3
"""Time that the fingers need to open after the watchdogs have removed the torque [s]."""
MAX_DELAY_S = 1.8
"""Longest time from the first SYNC frame of a controller to the signal that kills or stops the controller [s].

Within 1.8 s, a run arms the hand, bends the fingers and holds them.
"""
PROCESS_TIMEOUT_S = 60.0
"""Longest time that a test waits for a process [s]."""


class DisturbedRun(NamedTuple):
    """Record of one run whose controller was killed or stopped by a signal.

    Attributes:
        sent_signal: signal that was sent to the controller.
        time_before_signal_ns: time on the simulator's clock just before the signal [ns].
        time_after_signal_ns: time on the simulator's clock just after the signal [ns].
        simulator_delay_ns: time after the signal during which the simulator and its drives did not run
            [ns].
        bus_sync_counts: tick counts of the SYNC frames that were on the bus.
        log_sync_counts: tick counts of the SYNC frames that are in the log.
        warning: text about a damaged or incomplete log file. The text is empty if the log is
            complete.
    """

    sent_signal: signal.Signals
    time_before_signal_ns: int
    time_after_signal_ns: int
    simulator_delay_ns: int
    bus_sync_counts: bytes
    log_sync_counts: bytes
    warning: str


class KillVerdict(NamedTuple):
    """Result of the comparison of one disturbed run with the truth file of the simulator.

    Attributes:
        run: record of the run.
        was_taut: True if a tendon was taut at the time of the signal.
        had_motor_torque: True if a motor made torque at the time of the signal.
        max_torque_off_ms: time from ``time_before_signal_ns`` until no motor made torque [ms].
        min_torque_off_ms: time from ``time_after_signal_ns`` until no motor made torque [ms].
        remaining_tension_N: largest tension after the fingers have had time to open [N].
    """

    run: DisturbedRun
    was_taut: bool
    had_motor_torque: bool
    max_torque_off_ms: float
    min_torque_off_ms: float
    remaining_tension_N: float

    @property
    def torque_ended_in_time(self) -> bool:
        """Return True if all motors were without torque within a time limit after the signal.

        The time limit is the watchdog time of the drives plus the decay time of the torque.
        """
        return self.min_torque_off_ms <= WATCHDOG_MS + TORQUE_DECAY_MS

    @property
    def has_complete_log(self) -> bool:
        """Return True if the log contains every tick whose SYNC frame was on the bus.

        The last tick is allowed to be missing. SIGKILL or SIGSTOP can arrive after the SYNC frame
        of a tick, but before the tick is recorded.
        """
        bus_counts = self.run.bus_sync_counts
        log_counts = self.run.log_sync_counts
        return (
            not self.run.warning
            and len(bus_counts) - len(log_counts) in (0, 1)
            and bus_counts.startswith(log_counts)
        )


class KillTestSetup:
    """A simulated hand, and the run plan that every controller of this hand executes."""

    def __init__(self, work_folder: Path, time_scale: float) -> None:
        """Start the simulator with a time scale.

        The truth file of the simulator and all logs are written to one folder.
        """
        self.folder = work_folder
        self.time_scale = time_scale
        hand = load_hand("jamia")
        task = work_folder / "long.toml"
        calibration = work_folder / "c.toml"
        task.write_text(LONG_TASK)
        write_homed_calibration(calibration, hand)
        load = tuple(bus_load.load_at_rate(RATE_HZ) for bus_load in bus_loads(hand))
        self.plan = RunPlan(
            hand,
            Gains(),
            RATE_HZ,
            load,
            bus_specs(hand, [LOCAL_BUS]),
            time_scale=time_scale,
            clear_faults=True,
        )
        self.controller: Controller = make_controller(
            self.plan,
            TaskProgram(load_task(task)),
            load_calibration(calibration, hand),
            arm_at_once=True,
        )
        self.truth = work_folder / "hand.truth"
        self.simulator = start_hand(
            self.truth, "--hand", "jamia", *make_time_scale_options(time_scale)
        )

    def now_ns(self) -> tuple[int, int]:
        """Return the simulated time [ns], and the total time that the late simulator has skipped [ns]."""
        reply_path = run_dir() / f"kills-{os.getpid()}"
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.bind(str(reply_path))
            link.settimeout(PROCESS_TIMEOUT_S)
            link.sendto(b'{"list": true}', str(faults_path(LOCAL_BUS)))
            answer = json.loads(link.recv(1 << 16))
        reply_path.unlink()
        return int(answer["t_ns"]), int(answer["slip_ns"])

    def start_controller(self, log_path: Path) -> int:
        """Start a controller as a fork of the test process, and return the process id of the controller."""
        child = os.fork()
        if child:
            return child
        code = 70
        try:
            devnull = os.open(os.devnull, os.O_WRONLY)
            os.dup2(devnull, 1)
            os.dup2(devnull, 2)
            code = int(run_live(self.plan, self.controller, log_path).exit_code)
        finally:
            os._exit(code)

    def disturb_controller(
        self, run_number: int, sent_signal: signal.Signals, delay_s: float
    ) -> DisturbedRun:
        """Start a controller, and send a signal to it ``delay_s`` after its first SYNC frame.

        Return the record of the disturbed run.
        """
        log = self.folder / f"{run_number}.mcap"
        with SyncListener() as listener:
            child = self.start_controller(log)
            try:
                listener.wait_for_sync(child)
                listener.listen(delay_s / self.time_scale)
                before_ns, slip_ns = self.now_ns()
                os.kill(child, sent_signal)
                after_ns, _ = self.now_ns()
                listener.listen((WATCHDOG_MS * 1e-3 + FINGER_OPENING_TIME_S) / self.time_scale)
                simulator_delay_ns = self.now_ns()[1] - slip_ns
                if sent_signal == signal.SIGSTOP:
                    os.kill(child, signal.SIGCONT)
                wait_for_process_end(child, listener)
            finally:
                with suppress(ProcessLookupError, ChildProcessError):
                    os.kill(child, signal.SIGKILL)
                    os.waitpid(child, 0)
            listener.listen(0.0)
        warning, logged = read_sync_records(log)
        log.unlink()
        return DisturbedRun(
            sent_signal,
            before_ns,
            after_ns,
            simulator_delay_ns,
            bytes(listener.syncs),
            logged,
            warning,
        )

    def kill_verdicts(self, runs: list[DisturbedRun]) -> list[KillVerdict]:
        """Compare the disturbed runs with the truth file of the simulator.

        The simulator must have ended before ``kill_verdicts`` is called.
        """
        truth = read_truth(self.truth)
        return [verdict_of_kill(truth, run) for run in runs]


class SyncListener:
    """A further node on the bus of the hand.

    The node collects the tick counts of all SYNC frames from the controller.

    Attributes:
        syncs: tick counts of the SYNC frames, one byte for each frame.
    """

    def __init__(self) -> None:
        """Create a listener that has not read any SYNC frame.

        The listener connects to the bus when its ``with`` block begins.
        """
        self.syncs = bytearray()
        self._partial = b""

    def __enter__(self) -> "SyncListener":
        self.link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.link.connect(str(local_bus_path(LOCAL_BUS.partition(":")[2])))
        self.link.setblocking(False)
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()

    def listen(self, duration_s: float) -> None:
        """Read the bus for a given time [s].

        If nobody read the socket of the bus, the socket would become full and lose frames.
        """
        until = time.monotonic() + duration_s
        while True:
            self._read_bus()
            remaining_s = until - time.monotonic()
            if remaining_s <= 0.0:
                return
            time.sleep(min(remaining_s, 0.02))

    def _read_bus(self) -> None:
        with suppress(BlockingIOError):
            while data := self.link.recv(1 << 18):
                self._partial += data
        end = len(self._partial) // FRAME_RECORD_BYTES * FRAME_RECORD_BYTES
        for at in range(0, end, FRAME_RECORD_BYTES):
            if int.from_bytes(self._partial[at : at + 4], "little") == SYNC_ID:
                self.syncs.append(self._partial[at + 8])
        self._partial = self._partial[end:]

    def wait_for_sync(self, controller_pid: int) -> None:
        """Wait until the process of a controller has sent its first SYNC frame."""
        until = time.monotonic() + PROCESS_TIMEOUT_S
        while not self.syncs:
            assert os.waitpid(controller_pid, os.WNOHANG) == (0, 0), (
                "the controller ended before the signal"
            )
            assert time.monotonic() < until, "the controller sent no SYNC"
            self.listen(0.004)


def wait_for_process_end(controller_pid: int, listener: SyncListener) -> None:
    """Wait until a controller process ends. If the process does not end in time, terminate it."""
    until = time.monotonic() + 3.0
    while os.waitpid(controller_pid, os.WNOHANG) == (0, 0):
        if time.monotonic() > until:
            os.kill(controller_pid, signal.SIGTERM)
            until += PROCESS_TIMEOUT_S
        listener.listen(0.02)


def read_sync_records(log_path: Path) -> tuple[str, bytes]:
    """Read a log after its recorder has ended.

    Return the warning about the log, and the tick counts of the SYNC frames in the log.
    """
    until = time.monotonic() + 20.0
    while True:
        with RunLog(log_path) as log:
            if not log.warning or time.monotonic() > until:
                frames = (frame for tick in log.ticks() for frame in tick.frames)
                return log.warning, bytes(
                    frame.data[0] for frame in frames if frame.can_id == SYNC_ID
                )
        time.sleep(0.05)


def verdict_of_kill(truth: TruthRecord, run: DisturbedRun) -> KillVerdict:
    """Judge how the drives have reacted when the controller of one run was killed or stopped."""
    torque = truth.values[
        :, [i for i, name in enumerate(truth.columns) if name.startswith("torque/")]
    ]
    tension = truth.values[
        :, [i for i, name in enumerate(truth.columns) if name.startswith("tension/")]
    ]
    begin = np.searchsorted(truth.t_ns, run.time_before_signal_ns)
    end = np.searchsorted(
        truth.t_ns,
        run.time_after_signal_ns + run.simulator_delay_ns + int(FINGER_OPENING_TIME_S * 1e9),
    )
    driven = np.flatnonzero(np.abs(torque[begin:end]).max(axis=1) > MIN_TORQUE_N_M)
    last_ns = (
        int(truth.t_ns[begin + driven[-1]]) - run.simulator_delay_ns
        if len(driven)
        else run.time_before_signal_ns
    )
    return KillVerdict(
        run,
        was_taut=bool(tension[begin].max() > MIN_TAUT_N),
        had_motor_torque=bool(np.abs(torque[begin]).max() > MIN_TORQUE_N_M),
        max_torque_off_ms=(last_ns - run.time_before_signal_ns) * 1e-6,
        min_torque_off_ms=(last_ns - run.time_after_signal_ns) * 1e-6,
        remaining_tension_N=float(tension[min(end, len(tension) - 1)].max()),
    )


def disturb_controllers(
    work_folder: Path, controller_count: int, seed: int, time_scale: float
) -> list[KillVerdict]:
    """Kill or stop ``controller_count`` controllers of one simulated hand.

    The controllers get the signals SIGKILL and SIGSTOP alternately.
    """
    rng = random.Random(seed)
    test_hand = KillTestSetup(work_folder, time_scale)
    runs: list[DisturbedRun] = []
    try:
        for number in range(controller_count):
            signal_number = signal.SIGKILL if number % 2 == 0 else signal.SIGSTOP
            runs.append(
                test_hand.disturb_controller(number, signal_number, rng.uniform(0.0, MAX_DELAY_S))
            )
    finally:
        end_process(test_hand.simulator)
    return test_hand.kill_verdicts(runs)


CONTROLLERS_PER_SIMULATOR = 25
"""Number of controllers that run one after the other with the same simulator (a batch).

After each batch of controllers, the test reads and deletes the truth file of the batch.
"""


def disturb_controllers_in_batches(
    controller_count: int, seed: int, time_scale: float
) -> Iterator[list[KillVerdict]]:
    """Kill or stop ``controller_count`` controllers in batches, and yield the verdicts on the runs of each batch.

    Each batch has a new simulator.
    """
    for first_number in range(0, controller_count, CONTROLLERS_PER_SIMULATOR):
        with tempfile.TemporaryDirectory(prefix="h-") as folder:
            os.environ["HANDCTL_RUN_DIR"] = folder
            yield disturb_controllers(
                Path(folder),
                min(CONTROLLERS_PER_SIMULATOR, controller_count - first_number),
                seed + first_number,
                time_scale,
            )


def summary_of_kills(verdicts: list[KillVerdict]) -> str:
    """Summarise the runs of killed or stopped controllers in one line of text."""
    safe_run_count = sum(run.torque_ended_in_time for run in verdicts)
    complete_log_count = sum(run.has_complete_log for run in verdicts)
    taut_count = sum(run.was_taut for run in verdicts)
    driven_count = sum(run.had_motor_torque for run in verdicts)
    latest_torque_off_ms = max(run.max_torque_off_ms for run in verdicts)
    tension = max(run.remaining_tension_N for run in verdicts)
    return (
        f"{len(verdicts)} controllers: {safe_run_count} times without torque in time, "
        f"at most {latest_torque_off_ms:.1f} ms after the signal; "
        f"{complete_log_count} logs complete; {driven_count} disturbed under torque, {taut_count} with a taut tendon; "
        f"at most {tension:.1f} N left 0.3 s later"
    )
