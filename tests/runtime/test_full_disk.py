"""Test a run whose disk becomes full.

The controller reports the full disk at once, and continues to control the hand. The part of the log
that was written before the disk became full can be read.
"""

import contextlib
import os
import select
import subprocess
import time

import pytest

from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.replay.log_execution import execute_log
from handctl.runtime.mailbox import StatusWatcher
from tests.runtime.processes import (
    LOCAL_BUS,
    end_process,
    run_handctl,
    start_hand,
    start_handctl,
    wait_for_phase,
    write_homed_calibration,
)

pytestmark = [pytest.mark.realtime, pytest.mark.alone]
DISK_SIZE = "96m"
"""Size of the disk.

The recorder ends a log while the disk still has some free space. The disk of this test must be
larger than the free space that the recorder leaves.
"""


@pytest.fixture
def work_folder(work_folder):
    write_homed_calibration(work_folder / "c.toml", load_hand("jamia"))
    return work_folder


@pytest.fixture
def small_disk(work_folder):
    """Mount a small disk, and return its folder."""
    disk_folder = work_folder / "disk"
    disk_folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_SIZE}", "tmpfs", str(disk_folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("cannot mount a tmpfs here")
    yield disk_folder
    subprocess.run(["umount", str(disk_folder)], check=True)


def fill_disk(file_path):
    """Fill the disk completely with a file."""
    with file_path.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1 << 20))
    with file_path.open("ab", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))


def seconds_until_output(process, awaited_word, timeout_s=20.0):
    """Wait until a run prints a given word to standard error.

    Return the duration of the wait [s].
    """
    start = time.monotonic()
    output = b""
    while time.monotonic() - start < timeout_s:
        if select.select([process.stderr], [], [], 0.1)[0]:
            output += os.read(process.stderr.fileno(), 1 << 16)
            if awaited_word in output:
                return time.monotonic() - start
    raise AssertionError(output.decode())


def test_a_full_disk_is_reported_and_the_hand_continues_to_hold(
    work_folder, small_disk, time_scale_options
):
    simulated_hand_process = start_hand(
        work_folder / "hand.truth", "--hand", "jamia", *time_scale_options
    )
    words = (
        "--hand",
        "jamia",
        "--bus",
        LOCAL_BUS,
        "--calibration",
        "c.toml",
        "--task",
        "long.toml",
        *time_scale_options,
    )
    process = start_handctl("run", *words, "--log", str(small_disk / "run.mcap"))
    watcher = StatusWatcher(LOCAL_BUS)
    try:
        wait_for_phase("stay", watcher, process)
        tick_of_full_disk = watcher.request_status_line(2.0)["k"]
        fill_disk(small_disk / "other")
        assert seconds_until_output(process, b"H08 the disk is full") < 2.5, (
            "the recorder checks the disk every second"
        )
        status_after = None
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            status_after = watcher.request_status_line(0.2) or status_after
        assert status_after["k"] > tick_of_full_disk
        assert (status_after["mode"], status_after["phase"]) == ("ACTIVE", "stay"), (
            "a warning does not stop the hand"
        )
        assert min(status_after["tension_N"]) > 4.0
        assert run_handctl("stop", "--bus", LOCAL_BUS).returncode == 0
        _, err = process.communicate(timeout=30.0)
    finally:
        watcher.close()
        end_process(process)
        end_process(simulated_hand_process)
    assert process.returncode == 0, err
    with RunLog(small_disk / "run.mcap") as log:
        assert not log.warning
        assert log.end["reason"] in ("disk full", "write failed: No space left on device")
        assert execute_log(log).differing_ticks == 0, (
            "missing ticks were skipped by a slow host, and not lost by the recorder"
        )
        assert int(log.k[-1]) >= tick_of_full_disk - 200, (
            "only ticks in the pipe and in the last chunk are missing"
        )
        assert len(list(log.ticks())) == len(log)
