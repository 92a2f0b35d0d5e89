"""Process of the live view: its start by a controller, and its main program.

Command: `python -m handctl.view.live_view LOG [ARGUMENT OF THE VIEWER ...]`.

The process only reads the log and is independent of the controller. The process ends when the log
ends, when the viewer is closed, or on SIGTERM. The viewer remains open.
"""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from handctl.errors import HandctlError
from handctl.handlers import TerminationFlag

NICE = 10
"""Scheduling priority, below that of the controller."""


def start_live(log_path: Path, *arguments: str) -> "subprocess.Popen[bytes]":
    """Start a process that shows a log in a viewer while the log is being written.

    A failure of the process or of the viewer has no effect on the controller. This module imports
    only light packages, because the controller's process imports it.

    Args:
        log_path: path of the log. The file may be created later.
        arguments: further arguments of the viewer, such as --headless.
    """
    command = [sys.executable, "-m", "handctl.view.live_view", str(log_path), *arguments]
    quiet = os.environ | {"RUST_LOG": "off"}
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env=quiet,
        start_new_session=True,
    )


def main() -> int:
    """Run the live view of the log in the first argument."""
    stop = TerminationFlag()
    signal.signal(signal.SIGTERM, stop)
    with suppress(OSError):
        os.nice(NICE)
    log = Path(sys.argv[1])
    arguments = sys.argv[2:]
    try:
        from handctl.view.viewer import check_screen

        if "--headless" not in arguments:
            check_screen()
        from handctl.view.follow import follow

        follow(log, arguments, stop)
    except HandctlError as error:
        print(f"handctl view: {error}", file=sys.stderr)  # every HandctlError is printable
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
