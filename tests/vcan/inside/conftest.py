"""The simulated hand as a process on the other side of vcan."""

import contextlib
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runtime.processes import scaled

TIME_SCALE = 0.15
"""Pace of plant, watchdogs and deadlines. The guest has one core, and reading a clock is a system call."""
READY_S, END_S = 60.0, 20.0
STALL_FAULTS = ("H03", "B02", "N02", "B17", "N08")
"""Faults that end a run, as they should, if host or simulator do not run for a while."""


SIMULATOR = """
import ctypes, runpy, mujoco
mujoco.set_mjcb_time(ctypes.cast(ctypes.CDLL(None).drand48, ctypes.CFUNCTYPE(ctypes.c_double)))
runpy.run_module("firmware_sim", run_name="__main__", alter_sys=True)
"""
"""Program with another clock for MuJoCo's profile.

MuJoCo reads the clock some forty times in a step, which takes 1 ms in the guest. A C function
without a system call makes the step a hundred times faster. The result only feeds MuJoCo's profile.
"""


@contextlib.contextmanager
def serving(
    *options: str, stderr_file: Path | None = None, time_scale: float = TIME_SCALE
) -> Iterator["subprocess.Popen[str]"]:
    """Serve hand jamia on vcan0 by ``firmware_sim``, and check that the process ends in an orderly way.

    Args:
        options: additional arguments.
        stderr_file: file for the output on stderr.
        time_scale: pace of the plant.
    """
    words = ["--hand", "jamia", "--bus", "socketcan:vcan0", *scaled(time_scale), "--seed", "1", *options]
    with stderr_file.open("w") if stderr_file else contextlib.nullcontext() as stderr:
        process = subprocess.Popen(
            [sys.executable, "-c", SIMULATOR, *words], stdout=subprocess.PIPE, stderr=stderr, text=True
        )
    try:
        wait_until_ready(process)
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.wait(END_S) == 0
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def simulator(request: pytest.FixtureRequest) -> Iterator["subprocess.Popen[str]"]:
    """Serve a simulated hand for all tests of a module, with the options of its parameter."""
    with serving(*getattr(request, "param", ())) as process:
        yield process


def wait_until_ready(process: "subprocess.Popen[str]") -> None:
    assert process.stdout is not None
    end = time.monotonic() + READY_S
    while select.select([process.stdout], [], [], max(0.0, end - time.monotonic()))[0]:
        line = process.stdout.readline()
        assert line, f"firmware_sim ended with status {process.wait(END_S)} before it served"
        if line.startswith("firmware_sim: ready"):
            return
    pytest.fail(f"firmware_sim did not serve within {READY_S} s")
