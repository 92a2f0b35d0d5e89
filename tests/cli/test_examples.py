"""Test that the example at the end of the help of each command works in a shell, exactly as printed."""

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
from handctl.cli.parsing.parser import RUN_COMMAND_EXAMPLE
from tests.runtime.processes import TIME_SCALE

EXAMPLE_BY_COMMAND = {
    words: example
    for folder in VERBS_BY_FOLDER
    for words, example in importlib.import_module(
        f"handctl.cli.{folder}.arguments"
    ).COMMAND_EXAMPLES.items()
}
DIAGNOSTIC_COMMANDS = {"doctor", "bus doctor"}
"""Commands that exit with code 1 if they find a defect of the machine that runs the test."""
EXAMPLES_WITHOUT_OTHER_PROCESS = sorted(
    words for words, example in EXAMPLE_BY_COMMAND.items() if not example.parallel_commands
)
EXAMPLES_WITH_SIMULATOR = sorted(
    words
    for words, example in EXAMPLE_BY_COMMAND.items()
    if example.parallel_commands and RUN_COMMAND_EXAMPLE not in example.parallel_commands
)
EXAMPLES_WITH_RUNNING_HAND = sorted(
    words
    for words, example in EXAMPLE_BY_COMMAND.items()
    if RUN_COMMAND_EXAMPLE in example.parallel_commands
)
READY_TIMEOUT_S = 60.0
"""Longest permitted time from the start of simulator and controller until they are ready [s], including compilation."""


@pytest.fixture(scope="module")
def run_in_shell():
    """Yield a function that runs a command line in an empty folder, with the handctl of this Python environment."""
    folder, sockets = (Path(tempfile.mkdtemp(prefix="h-")) for _ in range(2))
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = os.environ | {"PATH": path, "HANDCTL_RUN_DIR": str(sockets)}
    yield lambda line, start=subprocess.run, **how: start(line, env=environment, cwd=folder, **how)
    for path in (folder, sockets):
        shutil.rmtree(path, ignore_errors=True)


def run_example(run_in_shell, command_words):
    """Yield a function that runs a command line in an empty folder, with this environment's handctl."""
    how = {"shell": True, "capture_output": True, "text": True, "timeout": 280, "check": False}
    process_result = run_in_shell(EXAMPLE_BY_COMMAND[command_words].command_line, **how)
    assert process_result.returncode in ({0, 1} if command_words in DIAGNOSTIC_COMMANDS else {0}), (
        process_result.stderr
    )
    assert process_result.stdout.strip()
    assert "Traceback" not in process_result.stderr


@pytest.mark.parametrize("command_words", EXAMPLES_WITHOUT_OTHER_PROCESS)
def test_an_example_works_in_one_terminal(run_in_shell, command_words):
    run_example(run_in_shell, command_words)


@pytest.fixture
def start_in_background(run_in_shell):
    """Yield a function that starts a command and returns before the command ends.

    The function starts the command as a user does in another terminal. After the test, the fixture
    ends all commands that the function has started.
    """
    children = []

    def start_command(command_line):
        keywords = {
            "stdout": subprocess.DEVNULL,
            "stderr": subprocess.DEVNULL,
            "stdin": subprocess.DEVNULL,
        }
        children.append(run_in_shell(command_line.split(), subprocess.Popen, **keywords))

    yield start_command
    for child in reversed(children):
        child.terminate()
        child.wait(30)


def repeat_until_success(run_in_shell, command_line):
    """Repeat a command until it succeeds."""
    end = time.monotonic() + READY_TIMEOUT_S
    while (
        process_result := run_in_shell(
            command_line.split(), capture_output=True, text=True, check=False
        )
    ).returncode:
        assert time.monotonic() < end, process_result.stderr
        time.sleep(0.3)


@pytest.mark.realtime
def test_examples_work_beside_a_simulator_and_a_running_hand(
    run_in_shell, start_in_background, time_scale_of_attempt
):
    simulator, run = EXAMPLE_BY_COMMAND["stop"].parallel_commands
    start_in_background(f"{simulator} --time-scale {TIME_SCALE * time_scale_of_attempt:g}")
    repeat_until_success(run_in_shell, "handctl fault kinds --bus local:demo")
    for words in EXAMPLES_WITH_SIMULATOR:
        if words != "fault inject":  # the injected fault would disturb the run of this example
            run_example(run_in_shell, words)
    for words in sorted(
        EXAMPLES_WITH_RUNNING_HAND, key=lambda example_name: example_name == "stop"
    ):  # the command ``stop`` is the last one
        if words == EXAMPLES_WITH_RUNNING_HAND[0]:
            start_in_background(run)
            repeat_until_success(
                run_in_shell, "handctl gains set motion.force_N=11 --bus local:demo"
            )  # the controller refuses ``gains set`` until the hand is commissioned
        run_example(run_in_shell, words)
    run_example(run_in_shell, "fault inject")
