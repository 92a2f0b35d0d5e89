"""Real processes for the tests: a simulated hand, and handctl as another process."""

import datetime
import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.programs.calibration import Calibration, TendonCalibration
from handctl.runtime.mailbox import Watcher
from handctl.session.calibration import write_calibration

READY_S = 60.0
"""Longest start of a simulator [s]."""
END_S = 200.0
"""Longest run of a verb [s]."""
BUS = "local:t"
SCALE = 1.0
"""Time scale of simulator and controller.

The shared clock pauses where this machine is too slow.
"""
SERIAL = 0x4000
"""First serial number of the simulated drives. Each drive adds its number on the bus."""
HOMED = ("--homed", "--serial", f"{SERIAL:#x}")
"""Options of a simulated hand that a calibration of ``write_homed`` fits."""
GO = 'schema = 1\nname = "short"\n'
MOVE = '[[phase]]\nkind = "move"\nname = "{name}"\nangle_deg = {angle}\nduration_s = {duration}\n'
SHORT = GO + MOVE.format(name="bend", angle=25.0, duration=0.5) + MOVE.format(name="open", angle=0.0, duration=0.4)
LONG = GO + MOVE.format(name="bend", angle=40.0, duration=0.5) + MOVE.format(name="stay", angle=40.0, duration=60.0)


def scaled(scale: float) -> tuple[str, str]:
    """Return the options for a simulator and a controller with a time scale."""
    return "--time-scale", f"{scale:g}"


def start_hand(truth: Path, *words: str, bus: str = BUS) -> "subprocess.Popen[str]":
    """Start a simulated hand that serves a bus."""
    command = [sys.executable, "-m", "firmware_sim", "--bus", bus, *HOMED, "--truth", str(truth), *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout
    assert select.select([process.stdout], [], [], READY_S)[0], "no ready line"
    assert process.stdout.readline().startswith("firmware_sim: ready")
    return process


def start_handctl(*words: str) -> "subprocess.Popen[str]":
    """Start a verb of handctl in its own process."""
    command = [sys.executable, "-m", "handctl.cli", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def handctl(*words: str, timeout_s: float = END_S) -> "subprocess.CompletedProcess[str]":
    """Run a verb of handctl in its own process until it ends."""
    command = [sys.executable, "-m", "handctl.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s)


def end(process: "subprocess.Popen[str]") -> None:
    """End a process, if necessary by a kill, and close its pipes."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
    process.communicate()


def result_of(process: "subprocess.Popen[str]", timeout_s: float = END_S) -> tuple[int, dict[str, object], str]:
    """Wait for the end of a process and return its exit code, JSON output and standard error."""
    out, err = process.communicate(timeout=timeout_s)
    return process.returncode, json.loads(out) if out else {}, err


def wait_for(phase: str, watcher: Watcher, process: "subprocess.Popen[str]", timeout_s: float = 60.0) -> None:
    """Wait until a running controller is in a phase."""
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        assert process.poll() is None, process.communicate()
        line = watcher.fresh_line(0.2)
        if line is not None and line["phase"] == phase:
            return
    raise AssertionError(f"never in phase {phase}")


def sockets() -> list[str]:
    """List the folder for sockets."""
    return sorted(os.listdir(os.environ["HANDCTL_RUN_DIR"]))


def write_homed(path: Path, description: Hand) -> None:
    """Write a calibration for a hand that starts ``HOMED``: zero tares and zero offsets."""
    zero = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    calibration = Calibration(
        hand=description.name,
        identity=description.identity,
        made=datetime.datetime.now(datetime.UTC).isoformat(),
        tendon=dict.fromkeys(description.tendon_names, zero),
        drive={motor.name: f"{SERIAL + motor.node_id:#x}" for motor in description.motor},
    )
    write_calibration(path, calibration)


def modes_of_complete(log: Path) -> list[str]:
    """Check that a log is complete and return the texts of its mode changes."""
    with RunLog(log) as run:
        assert not run.warning
        assert run.end["reason"] == "done"
        return [event.event.text for event in run.events if event.event.name == "mode"]
