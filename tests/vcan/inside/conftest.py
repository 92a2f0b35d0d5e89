"""The simulated hand as a process of its own on the other side of vcan."""

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
"""The guest has one core, and a look at a clock is a system call: plant, watchdogs and deadlines run slower."""
READY_S, END_S = 60.0, 20.0
STOOD_STILL = ("H03", "B02", "N02", "B17", "N08")
"""Rows by which a run ends if host or simulator are not run for a while, as they should."""


SIMULATOR = """
import ctypes, runpy, mujoco
mujoco.set_mjcb_time(ctypes.cast(ctypes.CDLL(None).drand48, ctypes.CFUNCTYPE(ctypes.c_double)))
runpy.run_module("firmware_sim", run_name="__main__", alter_sys=True)
"""
"""MuJoCo times its own stages with some forty looks at the clock a step, in the guest 1 ms. It takes a C function for
it: with any that is no system call the step is a hundred times faster. The result only feeds MuJoCo's profile."""


@contextlib.contextmanager
def serving(
    *options: str, told: Path | None = None, time_scale: float = TIME_SCALE
) -> Iterator["subprocess.Popen[str]"]:
    """``firmware_sim`` serving hand jamia on vcan0, with more options; it must end when told to.

    What it says of itself while it runs and in the end goes into the file ``told``.
    """
    words = ["--hand", "jamia", "--bus", "socketcan:vcan0", *scaled(time_scale), "--seed", "1", *options]
    with told.open("w") if told else contextlib.nullcontext() as stderr:
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
    """A simulated hand for all tests of a module, with the options that are its parameter."""
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
