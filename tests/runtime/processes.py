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
from handctl.hand.toml_text import toml_text
from handctl.log.reader import RunLog
from handctl.runtime.mailbox import Watcher

READY_S, END_S = 60.0, 200.0
BUS = "local:t"
SCALE = 0.4
SERIAL = 0x5349_4D00
"""Of a simulated MIT drive, to which its number on the bus is added."""
GO = 'schema = 1\nname = "short"\n'
MOVE = '[[phase]]\nkind = "move"\nname = "{name}"\nangle_deg = {angle}\nduration_s = {duration}\n'
SHORT = GO + MOVE.format(name="bend", angle=25.0, duration=0.5) + MOVE.format(name="open", angle=0.0, duration=0.4)
LONG = GO + MOVE.format(name="bend", angle=40.0, duration=0.5) + MOVE.format(name="stay", angle=40.0, duration=60.0)


def scaled(scale: float) -> tuple[str, str]:
    """Words for a simulator and a controller that share a slowed time."""
    return "--time-scale", f"{scale:g}"


def start_hand(truth: Path, *words: str) -> "subprocess.Popen[str]":
    """A simulated hand that serves ``local:t``."""
    command = [sys.executable, "-m", "firmware_sim", "--bus", BUS, "--homed", "--truth", str(truth), *words]
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
        line = watcher.next(0.2)
        if line is not None and line["phase"] == phase:
            return
    raise AssertionError(f"never in phase {phase}")


def sockets() -> list[str]:
    """What lies in the folder for sockets."""
    return sorted(os.listdir(os.environ["HANDCTL_RUN_DIR"]))


def write_calibration(path: Path, description: Hand) -> None:
    """A calibration of this minute for a hand that starts homed: nothing to tare, nothing to zero."""
    made = datetime.datetime.now(datetime.UTC).isoformat()
    nothing = {"tare_N": 0.0, "zero_rad": 0.0, "answer_N": 3.0, "crosstalk_N": 0.0}
    head = {"schema": 1, "hand": description.name, "identity": description.identity, "made": made}
    tables = "".join(f"\n[tendon.{name}]\n{toml_text(nothing)}" for name in description.tendon_names)
    if all(motor.protocol == "mit" for motor in description.motor):
        tables += "\n[drive]\n" + toml_text({m.name: f"{SERIAL + m.node_id:#x}" for m in description.motor})
    path.write_text(toml_text(head) + tables)


def ended_well(log: Path) -> list[str]:
    """The modes that a whole log tells."""
    with RunLog(log) as run:
        assert not run.warning
        assert run.end["reason"] == "done"
        return [event.event.text for event in run.events if event.event.name == "mode"]
