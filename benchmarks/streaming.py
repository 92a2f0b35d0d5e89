"""Send streams of targets to a simulated hand in real time.

The benchmark measures the effects of misbehaving clients, the tracking error of a streamed motion,
and the latency.

``python benchmarks/streaming.py [clients|tracking|latency ...] [--only CLIENT ...] [--time-scale X]
[--bus BUS]``. Clients, controller and simulated hand run as separate processes. With
``--time-scale``, the clock of the simulated hand runs X times as fast as wall time. Latencies are
always measured with X = 1, in wall time.
"""

import argparse
import json
import math
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import handctl
from handctl.client import HandClient, TargetStream
from handctl.core.tick_types import HandMode
from handctl.hand.file.toml_text import toml_text
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.report.truth_record import TruthRecord, read_truth
from handctl.runtime.clocks.shared_clock import PAUSED_INDEX
from handctl.runtime.socket_paths import clock_path

STREAMED_DIGIT = "index"
STREAM_RATE_HZ = 100.0
SINE_MIDDLE_DEG = 30.0
SINE_AMPLITUDE_DEG = 20.0
READY_TIMEOUT_S = 120.0
GOOD_STREAM_DURATION_S = 0.5
"""Duration of the correct stream before and after a misbehaviour, on the clock of the simulated hand [s]."""
MISBEHAVIOUR_DURATION_S = 0.4
"""Duration of a misbehaviour, on the clock of the simulated hand [s]."""
TRACKED_DURATION_S = 4.0
"""Duration of the streamed motion, and of the same motion in a task [s].

Tracking errors in the first second of the motion are not counted.
"""
TRAJECTORY_KNOT_INTERVAL_S = 0.04
"""For comparison, a task repeats the streamed motion as a spline through given angles.

``TRAJECTORY_KNOT_INTERVAL_S`` is the time between two successive angles [s]. The spline differs
from the streamed sine by less than 0.001 deg.
"""
WAIT_AFTER_KILL_S = 2.0
"""Time for a hand to relax after its client was killed, on the clock of the simulated hand [s]."""
TARGET_REPEAT_COUNT = 5
"""Number of times that a repeating client sends each target."""
LATENCY_DURATION_S = 10.0
SHORT_LATENCY_DURATION_S = 2.0
"""Duration of the latency measurement with ``--quick`` [s].

Without ``--quick``, the latency measurement lasts ``LATENCY_DURATION_S``.
"""
BENCHMARK_PARTS = ("clients", "tracking", "latency")
SIMULATOR_ARGUMENTS = ["-m", "firmware_sim"]
"""Arguments of Python that start a simulated hand."""
INTERPOLATION_NAMES = ("linear", "minimum_jerk")
CommissionedHand = tuple[Path, tuple[str, ...]]
"""Calibration file of a simulated hand that is already commissioned, and options of the simulator of this hand."""


def sine_angle_deg(t: float) -> float:
    """Return the angle [deg] of the streamed motion at a time. The motion is a sine of 1 Hz."""
    return SINE_MIDDLE_DEG + SINE_AMPLITUDE_DEG * math.sin(2.0 * math.pi * t)


class MisbehavingClient:
    """A stream of targets for one digit. The caller can add wrong targets to the stream.

    The targets bypass the checks of ``TargetStream.send``.
    """

    def __init__(self, hand: HandClient, stream: TargetStream, time_scale: float) -> None:
        """Prepare to send targets through an open stream.

        Args:
            hand: client of the simulated hand.
            stream: open stream of the client.
            time_scale: ratio of the time of the simulated hand to wall time.
        """
        self.hand = hand
        self.stream = stream
        self.scale = time_scale
        self.began_s = time.monotonic()
        self.number = 0

    @property
    def t_s(self) -> float:
        """Return the time of the simulated hand since the beginning of the stream [s]."""
        return (time.monotonic() - self.began_s) * self.scale

    def send(
        self,
        target_value: float,
        sequence_number: int | None = None,
        age_s: float = 0.0,
        target_space: int = 1,
    ) -> None:
        """Send a target, with a wrong sequence number or a wrong time stamp if the caller gives one.

        ``age_s`` is the age of the target on the clock of the simulated hand [s].
        """
        self.number += sequence_number is None
        sent_ns = time.monotonic_ns() - round(1e9 * age_s / self.scale)
        values = np.full(target_space, target_value)
        self.stream._sender.send(
            self.number if sequence_number is None else sequence_number, sent_ns, values
        )

    def send_good_targets(self, duration_s: float) -> None:
        """Send the targets of the correct motion for the duration ``duration_s`` [s]."""
        for _ in self.periods(duration_s):
            self.send(sine_angle_deg(self.t_s + self.stream.horizon_s))

    def periods(self, duration_s: float) -> Iterator[int]:
        """Yield the index of each period of the stream, and sleep until the next period begins."""
        for i in range(round(duration_s * STREAM_RATE_HZ)):
            yield i
            self.stream.sleep()


def stream_while_paused(client: MisbehavingClient) -> None:
    """Stream the correct motion, while the parent process pauses or kills the process of this client."""
    print("pause", flush=True)
    client.send_good_targets(2.0 * MISBEHAVIOUR_DURATION_S)


def flood_with_targets(client: MisbehavingClient) -> None:
    """Send the correct motion, but with 10,000 targets per second."""
    end = client.t_s + MISBEHAVIOUR_DURATION_S
    while client.t_s < end:
        start_time_ns = time.monotonic_ns()
        client.send(sine_angle_deg(client.t_s + client.stream.horizon_s))
        while time.monotonic_ns() < start_time_ns + 100_000 / client.scale:
            pass


def send_constant(target_value: float) -> Any:
    """Return a client behaviour (a function) that always sends the same value instead of the correct targets."""

    def misbehave(client: MisbehavingClient) -> None:
        for _ in client.periods(MISBEHAVIOUR_DURATION_S):
            client.send(target_value)

    return misbehave


def send_late_targets(delay_s: float) -> Any:
    """Return a client behaviour (a function) that sends each target late.

    The time stamp of a late target is the time at which the target was due.
    """

    def misbehave(client: MisbehavingClient) -> None:
        for _ in client.periods(MISBEHAVIOUR_DURATION_S):
            client.send(
                sine_angle_deg(client.t_s + client.stream.horizon_s - delay_s), age_s=delay_s
            )

    return misbehave


def repeat_targets(client: MisbehavingClient) -> None:
    """Send each target five times with the same sequence number."""
    for _ in client.periods(MISBEHAVIOUR_DURATION_S):
        value = sine_angle_deg(client.t_s + client.stream.horizon_s)
        client.send(value)
        for _ in range(TARGET_REPEAT_COUNT - 1):
            client.send(value, sequence_number=client.number)


def swap_targets(client: MisbehavingClient) -> None:
    """Send the targets of two successive periods in the wrong order, again and again."""
    for i in client.periods(MISBEHAVIOUR_DURATION_S):
        if i % 2:
            client.number += 2
            value = sine_angle_deg(client.t_s + client.stream.horizon_s)
            client.send(value, sequence_number=client.number)
            client.send(value, sequence_number=client.number - 1, age_s=1.0 / STREAM_RATE_HZ)


def send_random_jumps(client: MisbehavingClient) -> None:
    """Send random angles, as a faulty policy does.

    Some of the random angles are beyond the range of the joints.
    """
    random_source = random.Random(0)
    for _ in client.periods(MISBEHAVIOUR_DURATION_S):
        client.send(random_source.uniform(-30.0, 130.0))


def exceed_tension_limit(client: MisbehavingClient) -> None:
    """Send a target tension far beyond the limit."""
    for _ in client.periods(MISBEHAVIOUR_DURATION_S):
        client.send(1000.0)


CLIENT_BEHAVIOURS: dict[str, tuple[str, Any]] = {
    "good": ("no misbehaviour", lambda client: client.send_good_targets(MISBEHAVIOUR_DURATION_S)),
    "paused-50": ("stopped for 50 ms", stream_while_paused),
    "paused-500": ("stopped for 500 ms", stream_while_paused),
    "flooding": ("10,000 targets a second", flood_with_targets),
    "nan": ("NaN in place of targets", send_constant(math.nan)),
    "1e308": ("1e308 in place of targets", send_constant(1e308)),
    "late-30": ("each target 30 ms late", send_late_targets(0.03)),
    "late-150": ("each target 150 ms late", send_late_targets(0.15)),
    "repeating": ("each target five times", repeat_targets),
    "overtaking": ("targets in pairs, in the wrong order", swap_targets),
    "jumping": ("random angles from -30 to 130 deg", send_random_jumps),
    "straining": ("1000 N, in a stream of tensions", exceed_tension_limit),
    "killed": ("killed", stream_while_paused),
    "killed-owner": ("killed, had started the controller", stream_while_paused),
}
"""Description of the misbehaviour of each client, and the function that sends the wrong targets.

If a client is killed, the run ends.
"""


def run_client(
    client_name: str, bus_name: str, time_scale: float, connect_options: list[str]
) -> None:
    """Stream targets with the behaviour of the client ``client_name``.

    Print the first and the last tick of the misbehaviour of this client, and how many of its
    targets the controller accepted and refused.
    """
    with handctl.connect("jamia", bus_name, *connect_options) as hand:
        hand.move({STREAMED_DIGIT: SINE_MIDDLE_DEG}, duration_s=0.5)
        space = "tension" if client_name == "straining" else "digit"
        names = (
            [hand.description.tendon_names[0]] if client_name == "straining" else [STREAMED_DIGIT]
        )
        with hand.stream(STREAM_RATE_HZ, space, names, interpolation="linear") as stream:
            client = MisbehavingClient(hand, stream, time_scale)
            if client_name != "straining":
                client.send_good_targets(GOOD_STREAM_DURATION_S)
            start = hand.observe().k
            CLIENT_BEHAVIOURS[client_name][1](client)
            observation = hand.observe()
            print(
                json.dumps({"from": start, "to": observation.k, **observation.stream._asdict()}),
                flush=True,
            )
            if client_name != "straining":
                client.send_good_targets(GOOD_STREAM_DURATION_S)


class HandProcess:
    """Simulated hand that runs in a separate process and stores its files in a folder.

    Attributes:
        work_folder: folder in which the simulated hand stores its files.
        log, truth: paths of the log and of the simulator's truth file.
        words: options of ``handctl run``.
    """

    def __init__(
        self,
        work_folder: Path,
        bus_name: str,
        time_scale: float,
        commissioned_hand: CommissionedHand | None,
    ) -> None:
        """Start the simulated hand. The arguments are those of the function ``hand_process``."""
        self.bus = bus_name
        self.scale = time_scale
        self.folder = work_folder
        self.log = work_folder / "run.mcap"
        self.truth = work_folder / "hand.truth"
        scaled = ["--time-scale", f"{time_scale:g}"]
        self.words = [
            "--calibration",
            str(commissioned_hand[0] if commissioned_hand else work_folder / "c.toml"),
            "--log",
            str(self.log),
            *scaled,
        ]
        command = [
            *SIMULATOR_ARGUMENTS,
            "--hand",
            "jamia",
            "--bus",
            bus_name,
            "--scene",
            "none",
            *scaled,
        ]
        command += commissioned_hand[1] if commissioned_hand else ()
        self._process = subprocess.Popen(
            [sys.executable, *command, "--truth", str(self.truth)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout
        assert select.select([self._process.stdout], [], [], READY_TIMEOUT_S)[0], (
            "no simulated hand"
        )

    def connect(self) -> HandClient:
        """Return a client for the simulated hand. The client is not connected yet.

        The client starts the controller when the caller opens the client.
        """
        return handctl.connect("jamia", self.bus, *self.words)

    def simulated_time_ns(self, monotonic_ns: int) -> int:
        """Convert a recent reading of CLOCK_MONOTONIC to the time of the simulated hand [ns].

        The clock of the simulated hand pauses while the computer is too slow.
        """
        paused_ns = int(np.fromfile(clock_path(self.bus), np.int64)[PAUSED_INDEX])
        return round((monotonic_ns - paused_ns) * self.scale)

    def close(self) -> None:
        """End the process of the simulated hand.

        Before the process ends, it writes the rest of the file with the true values of the
        simulator.
        """
        if self._process.poll() is None:
            self._process.terminate()
        self._process.communicate(timeout=READY_TIMEOUT_S)


@contextmanager
def hand_process(
    bus_name: str, time_scale: float, commissioned_hand: CommissionedHand | None = None
) -> Iterator[HandProcess]:
    """Run a simulated hand within a ``with`` block.

    Args:
        bus_name: bus of the hand.
        time_scale: ratio of the time of the simulated hand to wall time.
        commissioned_hand: calibration and options of a commissioned hand. None means that a new hand is
            commissioned first.
    """
    with tempfile.TemporaryDirectory(prefix="h-") as folder:
        process = HandProcess(Path(folder), bus_name, time_scale, commissioned_hand)
        try:
            yield process
        finally:
            process.close()


# Part 1: clients that misbehave


def measure_clients(
    client_names: list[str],
    bus_name: str,
    time_scale: float,
    commissioned_hand: CommissionedHand | None = None,
) -> dict[str, Any]:
    """Let clients stream to a hand, one after another. Return a row of the printed table for each client.

    A client that starts the controller itself gets a separate hand. When a client is killed, the
    controller ends the run of the hand. Therefore, the client that is killed runs after all other
    clients of the same hand.
    """
    shared_client_names = sorted(
        (name for name in client_names if name != "killed-owner"), key=lambda name: name == "killed"
    )
    client_groups = [shared_client_names, [name for name in client_names if name == "killed-owner"]]
    rows: dict[str, Any] = {}
    for group in filter(None, client_groups):
        with hand_process(bus_name, time_scale, commissioned_hand) as process:
            windows, start_ns = _run_clients(process, group)
            process.close()
            truth = read_truth(process.truth)
            with RunLog(process.log) as log:
                rows |= {
                    name: _client_row(log, truth, window, start_ns)
                    for name, window in windows.items()
                }
    return rows


def _run_clients(
    hand_process_run: HandProcess, client_names: list[str]
) -> tuple[dict[str, Any], int]:
    """Run several clients, one after another, on one simulated hand.

    For each client, return the first and the last tick of its misbehaviour, and the numbers of
    accepted and refused targets. Also return the start time of the run on the clock of the hand
    [ns].
    """
    if client_names == ["killed-owner"]:
        window, start_ns = _run_one_client(hand_process_run, client_names[0], None)
        return {client_names[0]: window}, start_ns
    windows: dict[str, Any] = {}
    hand = hand_process_run.connect().open()
    try:
        for name in client_names:
            windows[name], start_ns = _run_one_client(hand_process_run, name, hand)
    finally:
        try:
            hand.close()
        except handctl.DriveError:  # The stale stream of the killed client has ended the run.
            if "killed" not in windows:
                raise
    return windows, start_ns


def _run_one_client(
    hand_process_run: HandProcess, client_name: str, owning_client: HandClient | None
) -> tuple[dict[str, Any], int]:
    """Run one client in a separate process.

    For some clients, the function pauses or kills the process of the client.
    """
    words = hand_process_run.words if owning_client is None else []
    command = [
        sys.executable,
        __file__,
        "--client",
        client_name,
        hand_process_run.bus,
        f"{hand_process_run.scale:g}",
        *words,
    ]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout
    try:
        if CLIENT_BEHAVIOURS[client_name][1] is not stream_while_paused:
            output_text = child.communicate(timeout=READY_TIMEOUT_S)[0]
            assert child.returncode == 0, f"{client_name}: the client failed"
            return json.loads(output_text), run_start_ns(owning_client, hand_process_run)
        assert child.stdout.readline() == "pause\n", f"{client_name}: no stream"
        watcher = owning_client or handctl.connect("jamia", hand_process_run.bus).open()
        time.sleep(0.1 / hand_process_run.scale)
        window = {"from": watcher.observe().k, "to": None}
        start_ns = run_start_ns(watcher, hand_process_run)
        if client_name.startswith("killed"):
            child.kill()
            time.sleep(WAIT_AFTER_KILL_S / hand_process_run.scale)
            if owning_client is None:
                watcher.close()
            return window, start_ns
        child.send_signal(signal.SIGSTOP)
        time.sleep(float(client_name.partition("-")[2]) / 1e3 / hand_process_run.scale)
        child.send_signal(signal.SIGCONT)
        output_text = child.communicate(timeout=READY_TIMEOUT_S)[0]
        assert child.returncode == 0, f"{client_name}: the client failed"
        return json.loads(output_text), start_ns
    finally:
        child.kill()
        child.wait()


def run_start_ns(hand: HandClient | None, hand_process_run: HandProcess) -> int:
    """Return the start time of the run (t = 0) on the clock of the simulated hand [ns].

    The function computes the start time of the run from an observation. The computed start time is
    too late by the computing time of the tick, because an observation is published at the end of
    the tick. Therefore, the function computes the start time from many observations, and returns
    the earliest result. The earliest start time is still too late by the computing time of the
    fastest tick, about 0.1 ms.
    """
    assert hand is not None
    starts_ns = list[int]()
    for _ in range(50):
        observation = hand.observe(wait=True)
        starts_ns.append(
            hand_process_run.simulated_time_ns(observation.published_ns)
            - observation.t_ns
            - observation.late_ns
        )
    return min(starts_ns)


def _client_row(
    log: RunLog, truth: TruthRecord, misbehaviour: dict[str, Any], start_ns: int
) -> dict[str, Any]:
    """Return the table row of a client.

    The row contains the mode, the faults, the largest true tension and the largest true speeds
    during the misbehaviour of the client.
    """
    last_tick = int(log.k[-1]) if misbehaviour["to"] is None else misbehaviour["to"]
    is_inside = (log.k >= misbehaviour["from"]) & (log.k <= last_tick)
    inside_start_ns, last_ns = log.t_ns[is_inside][[0, -1]]
    rows = truth.values[
        (truth.t_ns >= inside_start_ns + start_ns) & (truth.t_ns <= last_ns + start_ns)
    ]
    tensions = [i for i, name in enumerate(truth.columns) if name.startswith("tension/")]
    rates = [i for i, name in enumerate(truth.columns) if name.startswith(f"dq/{STREAMED_DIGIT}")]
    events = [event.event for event in log.events if inside_start_ns <= event.t_ns <= last_ns]
    return {
        "mode": HandMode(int(log.mode[is_inside][-1])).name,
        "faults": [
            event.text for event in events if event.name == "fault" and event.level != "info"
        ],
        "modes": [event.text for event in events if event.name == "mode"],
        "told": [event.text for event in events if event.name == "stream"],
        "tension_N": float(rows[:, tensions].max()),
        "speed_deg_s": float(np.degrees(np.abs(rows[:, rates].mean(axis=1)).max())),
        "joint_speed_deg_s": float(np.degrees(np.abs(rows[:, rates]).max())),
        **{
            name: misbehaviour.get(name)
            for name in ("sent", "accepted", "clipped", "late", "refused")
        },
    }


# Part 2: tracking of a streamed motion


def measure_tracking(
    bus_name: str, time_scale: float, commissioned_hand: CommissionedHand | None = None
) -> dict[str, Any]:
    """Compare the tracking errors of two equal motions: a streamed sine, and a task that follows the same sine.

    A tracking error is the RMS of the difference between the true angle and the intended angle
    [deg]. The returned dictionary also contains the lateness of the ticks, because late ticks show
    that the computer was busy.
    """
    began_ns: dict[str, int] = {}
    with hand_process(bus_name, time_scale, commissioned_hand) as process:
        task = process.folder / "sine.toml"
        task.write_text(_sine_task(), "utf-8")
        with process.connect() as hand:
            for interpolation in INTERPOLATION_NAMES:
                hand.move({STREAMED_DIGIT: SINE_MIDDLE_DEG}, duration_s=0.5)
                with hand.stream(
                    STREAM_RATE_HZ, "digit", [STREAMED_DIGIT], interpolation
                ) as stream:
                    client = MisbehavingClient(hand, stream, time_scale)
                    began_ns[interpolation] = process.simulated_time_ns(round(client.began_s * 1e9))
                    client.send_good_targets(TRACKED_DURATION_S)
            start_ns = run_start_ns(hand, process)
            hand.grasp(task)
        process.close()
        truth = read_truth(process.truth)
        with RunLog(process.log) as log:
            began_ns["trajectory"] = start_ns + next(
                phase.t_ns for phase in log.phases if phase.name == "follow"
            )
            lateness_ms = float(np.percentile(log.late_ns, 99)) / 1e6
    errors = {
        name: _tracking_error(truth, motion_began_ns) for name, motion_began_ns in began_ns.items()
    }
    ratios = {f"{name}_ratio": errors[name] / errors["trajectory"] for name in INTERPOLATION_NAMES}
    return errors | ratios | {"tick_late_p99_ms": lateness_ms}


def _sine_task() -> str:
    """Return a task that has the same motion as the streamed sine."""
    times = np.arange(0.0, TRACKED_DURATION_S + 1e-9, TRAJECTORY_KNOT_INTERVAL_S).round(3).tolist()
    start_phase = {
        "kind": "move",
        "name": "stay",
        "angle_deg": {STREAMED_DIGIT: SINE_MIDDLE_DEG},
        "duration_s": 0.5,
    }
    angles = {STREAMED_DIGIT: [round(sine_angle_deg(t), 4) for t in times]}
    follow_phase = {"kind": "follow", "name": "follow", "time_s": times, "angle_deg": angles}
    return toml_text({"schema": 1, "name": "sine", "phase": [start_phase, follow_phase]})


def _tracking_error(truth: TruthRecord, motion_start_ns: int) -> float:
    """Return the RMS difference between true and intended angle [deg]. The first second of the motion is left out."""
    t = (truth.t_ns - motion_start_ns) / 1e9
    evaluation_mask = (t > 1.0) & (t < TRACKED_DURATION_S - 0.05)
    joints = [i for i, name in enumerate(truth.columns) if name.startswith(f"q/{STREAMED_DIGIT}")]
    true_angle = np.degrees(truth.values[evaluation_mask][:, joints]).mean(axis=1)
    return float(
        np.sqrt(
            np.mean(
                (
                    true_angle
                    - SINE_MIDDLE_DEG
                    - SINE_AMPLITUDE_DEG * np.sin(2.0 * math.pi * t[evaluation_mask])
                )
                ** 2
            )
        )
    )


# Part 3: latency of observations and targets


def measure_latency(bus_name: str, duration_s: float) -> dict[str, Any]:
    """Measure the delays of observations and targets.

    Return the percentiles p50 and p99 of the delays [ms]. The clock of the simulated hand runs as
    fast as wall time.
    """
    with hand_process(bus_name, 1.0) as process, process.connect() as hand:
        rows = {
            "tick to client, observations": _observation_ages_ms(hand, duration_s),
            "tick to client, status socket": _status_ages_ms(hand, duration_s),
            "goal to wire, stream of targets": _target_delays_ms(hand, duration_s),
            "goal to confirmation, request socket": _move_delays_ms(hand, duration_s),
        }
    return {
        name: {
            "count": len(delays),
            **{f"p{p}_ms": float(np.percentile(delays, p)) for p in (50, 99)},
        }
        for name, delays in rows.items()
    }


def _observation_ages_ms(hand: HandClient, duration_s: float) -> list[float]:
    """Return the age [ms] of each observation at the moment when the client receives the observation."""
    ages: list[float] = []
    end = time.monotonic() + duration_s
    for observation in hand.observations():
        ages.append(observation.age_s * 1e3)
        if time.monotonic() > end:
            return ages
    return ages


def _status_ages_ms(hand: HandClient, duration_s: float) -> list[float]:
    """Return the age [ms] of each status line at the moment when the client receives the status line.

    The controller sends 50 status lines a second.
    """
    ages: list[float] = []
    end = time.monotonic() + duration_s
    last_tick = -1
    while time.monotonic() < end:
        line = hand.state()
        now_ns = time.monotonic_ns()
        observation = hand.observe()
        reader = hand._open_reader()
        record = reader.read_record(reader.last_read_number - 1 - (observation.k - line["k"]))
        if record is not None and line["k"] != last_tick and int(record["k"]) == line["k"]:
            ages.append((now_ns - int(record["published_ns"])) / 1e6)
        last_tick = line["k"]
    return ages


def _target_delays_ms(hand: HandClient, duration_s: float) -> list[float]:
    """Measure the delay of each target of a client [ms].

    The delay begins when the client sends the target. The delay ends when the first tick that uses
    the target has sent its command frames.
    """
    delays: list[float] = []
    random_source = random.Random(0)
    hand.move({STREAMED_DIGIT: SINE_MIDDLE_DEG}, duration_s=0.5)
    with hand.stream(STREAM_RATE_HZ, "digit", [STREAMED_DIGIT]) as stream:
        start_time_s = time.monotonic()
        while (t := time.monotonic() - start_time_s) < duration_s:
            target = [sine_angle_deg(t + stream.horizon_s)]
            number = stream.sent
            sent_ns = time.monotonic_ns()
            stream.send(target)
            observation = hand.observe()
            while observation.stream.number < number:
                observation = hand.observe(wait=True)
            delays.append((observation.published_ns - sent_ns) / 1e6)
            time.sleep(random_source.uniform(0.7, 1.3) / STREAM_RATE_HZ)
    return delays


def _move_delays_ms(hand: HandClient, duration_s: float) -> list[float]:
    """Measure the time [ms] from the sending of each move request until the controller confirms the request."""
    delays: list[float] = []
    end = time.monotonic() + duration_s
    while time.monotonic() < end:
        start_time_s = time.monotonic()
        hand.move({STREAMED_DIGIT: SINE_MIDDLE_DEG + len(delays) % 2}, duration_s=0.2, wait=False)
        delays.append((time.monotonic() - start_time_s) * 1e3)
        time.sleep(0.02)
    return delays


# Output of the results


def print_results(result: dict[str, Any]) -> None:
    """Print the tables of the streaming benchmark as Markdown."""
    if "clients" in result:
        limit = f"true tension, trip limit {result['tension_trip_N']:g} N"
        counts = "targets accepted, clipped, late, refused"
        print(
            f"| client | {counts} | faults | mode | {limit} | true speed of the digit | of a joint |"
        )
        print("|---|---|---|---|---|---|---|")
        for name, row in result["clients"].items():
            numbers = [row[key] for key in ("accepted", "clipped", "late", "refused")]
            numbers_text = "-" if numbers[0] is None else ", ".join(map(str, numbers))
            faults = ", ".join(sorted({text.split()[0] for text in row["faults"]})) or "none"
            print(
                f"| {CLIENT_BEHAVIOURS[name][0]} | {numbers_text} | {faults} | {row['mode']} | "
                f"{row['tension_N']:.1f} N "
                f"| {row['speed_deg_s']:.0f} deg/s | {row['joint_speed_deg_s']:.0f} deg/s |"
            )
        print()
    if "tracking" in result:
        rows = result["tracking"]
        print("| motion | RMS of true minus intended angle | ratio |\n|---|---|---|")
        print(f"| trajectory | {rows['trajectory']:.3f} deg | 1 |")
        for name in INTERPOLATION_NAMES:
            print(f"| stream, {name} | {rows[name]:.3f} deg | {rows[f'{name}_ratio']:.2f} |")
        print()
    if "latency" in result:
        print("| way | number | p50 | p99 |\n|---|---|---|---|")
        for name, row in result["latency"].items():
            print(f"| {name} | {row['count']} | {row['p50_ms']:.2f} ms | {row['p99_ms']:.2f} ms |")


def main() -> None:
    """Run the selected parts of the streaming benchmark, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "part",
        nargs="*",
        help=f"parts of the benchmark: {', '.join(BENCHMARK_PARTS)} (default: all)",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=CLIENT_BEHAVIOURS,
        default=list(CLIENT_BEHAVIOURS),
        help="clients of the first part (default: all)",
    )
    parser.add_argument(
        "--time-scale",
        type=float,
        default=1.0,
        help="ratio of simulated time to wall time (default: 1). The latency is always measured with 1",
    )
    parser.add_argument(
        "--bus", default="local:streaming", help="bus: local:NAME or socketcan:INTERFACE"
    )
    parser.add_argument("--quick", action="store_true", help="measure the latency for a short time")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--client", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.client:
        name, bus, scale, *words = args.client
        run_client(name, bus, float(scale), words)
        return
    if unknown_parts := set(args.part) - set(BENCHMARK_PARTS):
        parser.error(
            f"no part {min(unknown_parts)!r}; expected some of {', '.join(BENCHMARK_PARTS)}"
        )
    part_names = args.part or BENCHMARK_PARTS
    with tempfile.TemporaryDirectory(prefix="h-") as short_folder:
        os.environ["HANDCTL_RUN_DIR"] = short_folder
        result: dict[str, Any] = {
            "tension_trip_N": min(tendon.tension_trip_N for tendon in load_hand("jamia").tendon)
        }
        if "clients" in part_names:
            result["clients"] = measure_clients(args.only, args.bus, args.time_scale)
        if "tracking" in part_names:
            result["tracking"] = measure_tracking(args.bus, args.time_scale)
        if "latency" in part_names:
            result["latency"] = measure_latency(
                args.bus, SHORT_LATENCY_DURATION_S if args.quick else LATENCY_DURATION_S
            )
    print(json.dumps(result, indent=2)) if args.json else print_results(result)


if __name__ == "__main__":
    main()
