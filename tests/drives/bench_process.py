"""Run simulated drives with ``python -m firmware_sim drive``, as a separate process."""

import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

READY_TIMEOUT_S = 60.0


@contextmanager
def run_simulated_drives(bus_name: str, *drive_options: str) -> Iterator["subprocess.Popen[str]"]:
    """Run simulated drives on a bus until the ``with`` block ends, and then check the exit code of their process.

    Args:
        bus_name: specification of the bus on the command line.
        drive_options: protocol and options of the drives on the command line.
    """
    command = [sys.executable, "-m", "firmware_sim", "drive", *drive_options, "--bus", bus_name]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout
        assert select.select([process.stdout], [], [], READY_TIMEOUT_S)[0], "no ready line"
        assert process.stdout.readline().startswith("firmware_sim: ready")
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.communicate()
