"""Start real processes for tests: a simulated hand, and commands of handctl."""

import datetime
import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from handctl.core.calibration import Calibration, TendonCalibration
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.runtime.mailbox import StatusWatcher
from handctl.session.calibration import write_calibration

READY_TIMEOUT_S = 60.0
"""Longest permitted time for the start of a simulator [s]."""
COMMAND_TIMEOUT_S = 200.0
"""Longest permitted duration of a command of handctl [s]."""
LOCAL_BUS = "local:t"
TIME_SCALE = 1.0
"""Time scale of simulator and controller.

1 is real time. If the machine is too slow for the time scale, the shared clock of simulator and
controller pauses.
"""
SERIAL_NUMBER_BASE = 0x4000
"""Base of the serial numbers of simulated drives.

The serial number of a simulated drive is the base plus the node number of the drive.
"""
HOMED_HAND_OPTIONS = ("--homed", "--serial", f"{SERIAL_NUMBER_BASE:#x}")
"""Options of a simulated hand that match the calibration of ``write_homed_calibration``."""
TASK_HEAD = 'schema = 1\nname = "short"\n'
MOVE_PHASE = (
    '[[phase]]\nkind = "move"\nname = "{name}"\nangle_deg = {angle}\nduration_s = {duration}\n'
)
SHORT_TASK = (
    TASK_HEAD
    + MOVE_PHASE.format(name="bend", angle=25.0, duration=0.5)
    + MOVE_PHASE.format(name="open", angle=0.0, duration=0.4)
)
LONG_TASK = (
    TASK_HEAD
    + MOVE_PHASE.format(name="bend", angle=40.0, duration=0.5)
    + MOVE_PHASE.format(name="stay", angle=40.0, duration=60.0)
)


def make_time_scale_options(time_scale: float) -> tuple[str, str]:
    """Return the command-line options that give a time scale to a simulator or a controller."""
    return "--time-scale", f"{time_scale:g}"


def start_hand(
    truth_file: Path, *other_options: str, bus: str = LOCAL_BUS
) -> "subprocess.Popen[str]":
    """Start a simulated hand that serves a bus, and wait until it is ready."""
    command = [
        sys.executable,
        "-m",
        "firmware_sim",
        "--bus",
        bus,
        *HOMED_HAND_OPTIONS,
        "--truth",
        str(truth_file),
        *other_options,
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout
    assert select.select([process.stdout], [], [], READY_TIMEOUT_S)[0], "no ready line"
    assert process.stdout.readline().startswith("firmware_sim: ready")
    return process


def start_handctl(*command_words: str) -> "subprocess.Popen[str]":
    """Start a command of handctl in a process."""
    command = [sys.executable, "-m", "handctl.cli", *command_words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run_handctl(
    *command_words: str, timeout_s: float = COMMAND_TIMEOUT_S
) -> "subprocess.CompletedProcess[str]":
    """Run a command of handctl in a process until it ends."""
    command = [sys.executable, "-m", "handctl.cli", *command_words]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s)


def end_process(process: "subprocess.Popen[str]") -> None:
    """Terminate a process and close its pipes. If the process does not end by itself, kill it."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
    process.communicate()


def process_result(
    process: "subprocess.Popen[str]", timeout_s: float = COMMAND_TIMEOUT_S
) -> tuple[int, dict[str, object], str]:
    """Wait until a process ends, and return its exit code, its JSON output and its standard error."""
    out, err = process.communicate(timeout=timeout_s)
    return process.returncode, json.loads(out) if out else {}, err


def wait_for_phase(
    phase_name: str,
    watcher: StatusWatcher,
    process: "subprocess.Popen[str]",
    timeout_s: float = 60.0,
) -> None:
    """Wait until a running controller has reached a given phase of its task."""
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        assert process.poll() is None, process.communicate()
        line = watcher.request_status_line(0.2)
        if line is not None and line["phase"] == phase_name:
            return
    raise AssertionError(f"never in phase {phase_name}")


def socket_names() -> list[str]:
    """Return the names of all files in the folder for sockets."""
    return sorted(os.listdir(os.environ["HANDCTL_RUN_DIR"]))


def write_homed_calibration(calibration_file: Path, hand: Hand) -> None:
    """Write the calibration of a simulated hand that runs with ``HOMED_HAND_OPTIONS``.

    In the written calibration, the load-cell tares and the motor zeros are 0.
    """
    zero = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    calibration = Calibration(
        hand=hand.name,
        identity=hand.identity,
        made=datetime.datetime.now(datetime.UTC).isoformat(),
        tendon=dict.fromkeys(hand.tendon_names, zero),
        drive={motor.name: f"{SERIAL_NUMBER_BASE + motor.node_id:#x}" for motor in hand.motor},
    )
    write_calibration(calibration_file, calibration)


def modes_of_complete_log(log_path: Path) -> list[str]:
    """Check that a log is complete, and return the text of each mode change in the log."""
    with RunLog(log_path) as run:
        assert not run.warning
        assert run.end["reason"] == "done"
        return [event.event.text for event in run.events if event.event.name == "mode"]
