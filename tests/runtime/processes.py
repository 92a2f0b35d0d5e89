"""Real processes for the tests: a simulated hand, and handctl in another process."""

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

READY_S, END_S = 60.0, 200.0
BUS = "local:t"
SCALE = 0.25
SERIAL = 0x4000
"""Serial numbers of the simulated drives begin here; each drive adds its number on the bus."""
HOMED = ("--homed", "--serial", f"{SERIAL:#x}")
"""Words for a simulated hand, for which a calibration of ``write_homed`` is right."""
GO = 'schema = 1\nname = "short"\n'
MOVE = '[[phase]]\nkind = "move"\nname = "{name}"\nangle_deg = {angle}\nduration_s = {duration}\n'
SHORT = GO + MOVE.format(name="bend", angle=25.0, duration=0.5) + MOVE.format(name="open", angle=0.0, duration=0.4)
LONG = GO + MOVE.format(name="bend", angle=40.0, duration=0.5) + MOVE.format(name="stay", angle=40.0, duration=60.0)


def scaled(scale: float) -> tuple[str, str]:
    """Words for a simulator and a controller that share a slowed time."""
    return "--time-scale", f"{scale:g}"


def start_hand(truth: Path, *words: str) -> "subprocess.Popen[str]":
    """A simulated hand that serves ``local:t``."""
    command = [sys.executable, "-m", "firmware_sim", "--bus", BUS, *HOMED, "--truth", str(truth), *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout
    assert select.select([process.stdout], [], [], READY_S)[0], "no ready line"
    assert process.stdout.readline().startswith("firmware_sim: ready")
    return process


def start_handctl(*words: str) -> "subprocess.Popen[str]":
    """A verb of handctl in its own process."""
    command = [sys.executable, "-m", "handctl.cli", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def handctl(*words: str, timeout_s: float = END_S) -> "subprocess.CompletedProcess[str]":
    """A verb of handctl until it ends."""
    command = [sys.executable, "-m", "handctl.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s)


def end(process: "subprocess.Popen[str]") -> None:
    """Kill what still runs, and take its pipes down."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
    process.communicate()


def said(process: "subprocess.Popen[str]", timeout_s: float = END_S) -> tuple[int, dict[str, object], str]:
    """Exit code, JSON and standard error of a process that ends by itself."""
    out, err = process.communicate(timeout=timeout_s)
    return process.returncode, json.loads(out) if out else {}, err


def wait_for(phase: str, watcher: Watcher, process: "subprocess.Popen[str]", timeout_s: float = 60.0) -> None:
    """Wait until the hand of a running controller is in a phase."""
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        assert process.poll() is None, process.communicate()
        line = watcher.fresh_line(0.2)
        if line is not None and line["phase"] == phase:
            return
    raise AssertionError(f"never in phase {phase}")


def sockets() -> list[str]:
    """What lies in the folder for sockets."""
    return sorted(os.listdir(os.environ["HANDCTL_RUN_DIR"]))


def write_homed(path: Path, description: Hand) -> None:
    """Write a calibration of this minute for the hand of ``HOMED`` words: nothing to tare, nothing to zero."""
    nothing = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    calibration = Calibration(
        hand=description.name,
        identity=description.identity,
        made=datetime.datetime.now(datetime.UTC).isoformat(),
        tendon=dict.fromkeys(description.tendon_names, nothing),
        drive={motor.name: f"{SERIAL + motor.node_id:#x}" for motor in description.motor},
    )
    write_calibration(path, calibration)


def ended_well(log: Path) -> list[str]:
    """The modes that a whole log tells."""
    with RunLog(log) as run:
        assert not run.warning
        assert run.end["reason"] == "done"
        return [event.event.text for event in run.events if event.event.name == "mode"]
