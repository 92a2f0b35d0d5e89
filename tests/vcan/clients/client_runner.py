"""Run a client program in its own Python environment, with simulated drives on vcan0.

The command is ``python -m tests.vcan.clients.client_runner PYTHON MODULE DRIVE_WORDS...``. The exit
status of ``client_runner`` is that of the client program. A test runs ``client_runner`` in a
virtual machine that has the interface vcan0.
"""

import subprocess
import sys

from tests.drives.bench_process import run_simulated_drives

CLIENT_TIMEOUT_S = 240.0


def main(client_python_path: str, client_module: str, *drive_options: str) -> int:
    with run_simulated_drives("socketcan:vcan0", *drive_options):
        command = [client_python_path, "-m", client_module]
        return subprocess.run(command, check=False, timeout=CLIENT_TIMEOUT_S).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
