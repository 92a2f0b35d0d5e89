"""The example at the end of each command's help works when it is pasted into a shell."""

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from handctl.cli.main import VERBS_BY_FOLDER
from handctl.cli.parsing.parser import RUNNING_HAND
from tests.runtime.processes import SCALE

EXAMPLES = {
    words: example
    for folder in VERBS_BY_FOLDER
    for words, example in importlib.import_module(
        f"handctl.cli.{folder}.arguments"
    ).EXAMPLES.items()
}
FINDINGS = {"doctor", "bus doctor"}
"""Commands whose exit code may be 1, because they find a defect of the test's machine."""
ALONE = sorted(words for words, example in EXAMPLES.items() if not example.parallel_commands)
BESIDE_A_SIMULATOR = sorted(
    words
    for words, example in EXAMPLES.items()
    if example.parallel_commands and RUNNING_HAND not in example.parallel_commands
)
BESIDE_A_RUN = sorted(
    words for words, example in EXAMPLES.items() if RUNNING_HAND in example.parallel_commands
)
READY_S = 60.0
"""Longest time in which a simulator and a controller start [s], including compilation."""


@pytest.fixture(scope="module")
def terminal():
    """Yield a function that runs a command line in one folder, with the handctl of this environment."""
    folder, sockets = (Path(tempfile.mkdtemp(prefix="h-")) for _ in range(2))
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = os.environ | {"PATH": path, "HANDCTL_RUN_DIR": str(sockets)}
    yield lambda line, start=subprocess.run, **how: start(line, env=environment, cwd=folder, **how)
    for path in (folder, sockets):
        shutil.rmtree(path, ignore_errors=True)


def paste(terminal, words):
    """Run the example of a command in a shell, and check that it worked."""
    how = {"shell": True, "capture_output": True, "text": True, "timeout": 280, "check": False}
    ended = terminal(EXAMPLES[words].command_line, **how)
    assert ended.returncode in ({0, 1} if words in FINDINGS else {0}), ended.stderr
    assert ended.stdout.strip()
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("words", ALONE)
def test_an_example_works_in_one_terminal(terminal, words):
    paste(terminal, words)


@pytest.fixture
def start_others(terminal):
    """Yield a function that starts a command as in another terminal. The commands are ended after the test."""
    children = []

    def start(command):
        keywords = {
            "stdout": subprocess.DEVNULL,
            "stderr": subprocess.DEVNULL,
            "stdin": subprocess.DEVNULL,
        }
        children.append(terminal(command.split(), subprocess.Popen, **keywords))

    yield start
    for child in reversed(children):
        child.terminate()
        child.wait(30)


def wait_for(terminal, command):
    """Repeat a command until it succeeds."""
    end = time.monotonic() + READY_S
    while (
        ended := terminal(command.split(), capture_output=True, text=True, check=False)
    ).returncode:
        assert time.monotonic() < end, ended.stderr
        time.sleep(0.3)


@pytest.mark.realtime
def test_examples_work_beside_a_simulator_and_a_running_hand(terminal, start_others, slower):
    simulator, run = EXAMPLES["stop"].parallel_commands
    start_others(f"{simulator} --time-scale {SCALE * slower:g}")
    wait_for(terminal, "handctl fault kinds --bus local:demo")
    for words in BESIDE_A_SIMULATOR:
        if words != "fault inject":  # its fault would disturb the run
            paste(terminal, words)
    for words in sorted(BESIDE_A_RUN, key=lambda one: one == "stop"):  # ``stop`` is last
        if words == BESIDE_A_RUN[0]:
            start_others(run)
            wait_for(
                terminal, "handctl gains set motion.force_N=11 --bus local:demo"
            )  # refused until commissioned
        paste(terminal, words)
    paste(terminal, "fault inject")
