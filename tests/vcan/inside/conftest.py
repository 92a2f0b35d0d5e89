"""Run the simulated hand as a process at the other end of a vcan interface."""

import contextlib
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runtime.processes import make_time_scale_options

TIME_SCALE = 0.15
"""Time scale of simulated hand, watchdogs and deadlines.

Time is slowed because the guest system has one core, and because a program in the guest needs a
system call to read a clock.
"""
READY_TIMEOUT_S, EXIT_TIMEOUT_S = 60.0, 20.0
STALL_FAULTS = ("H03", "B02", "N02", "B17", "N08")
"""Faults that the controller correctly reports if the host or the simulator does not run for a while.

Each fault in ``STALL_FAULTS`` ends the run.
"""


SIMULATOR_CODE = """
import ctypes, runpy, mujoco
mujoco.set_mjcb_time(ctypes.cast(ctypes.CDLL(None).drand48, ctypes.CFUNCTYPE(ctypes.c_double)))
runpy.run_module("firmware_sim", run_name="__main__", alter_sys=True)
"""
"""Program that runs the simulator with another clock for MuJoCo's profile of computing times.

In each simulation step, MuJoCo reads the clock about forty times. In the guest system, forty
readings of the usual clock take 1 ms. The other clock is a C function that needs no system call.
With the other clock, a simulation step is a hundred times faster. MuJoCo uses its clock only for
the profile.
"""


@contextlib.contextmanager
def run_simulator(
    *options: str, stderr_file: Path | None = None, time_scale: float = TIME_SCALE
) -> Iterator["subprocess.Popen[str]"]:
    """Run the simulator of the hand ``jamia`` on vcan0, and check that the simulator ends without an error.

    Args:
        options: further command-line arguments of the simulator.
        stderr_file: file for the standard error of the simulator.
        time_scale: time scale of the simulator.
    """
    words = [
        "--hand",
        "jamia",
        "--bus",
        "socketcan:vcan0",
        *make_time_scale_options(time_scale),
        "--seed",
        "1",
        *options,
    ]
    with stderr_file.open("w") if stderr_file else contextlib.nullcontext() as stderr:
        process = subprocess.Popen(
            [sys.executable, "-c", SIMULATOR_CODE, *words],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )
    try:
        wait_until_ready(process)
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.wait(EXIT_TIMEOUT_S) == 0
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def simulator(request: pytest.FixtureRequest) -> Iterator["subprocess.Popen[str]"]:
    """Run a simulated hand for all tests of a module.

    The parameter of the fixture contains the command-line options of the simulator.
    """
    with run_simulator(*getattr(request, "param", ())) as process:
        yield process


def wait_until_ready(process: "subprocess.Popen[str]") -> None:
    assert process.stdout is not None
    end = time.monotonic() + READY_TIMEOUT_S
    while select.select([process.stdout], [], [], max(0.0, end - time.monotonic()))[0]:
        line = process.stdout.readline()
        assert line, (
            f"firmware_sim ended with status {process.wait(EXIT_TIMEOUT_S)} before it served"
        )
        if line.startswith("firmware_sim: ready"):
            return
    pytest.fail(f"firmware_sim did not serve within {READY_TIMEOUT_S} s")
