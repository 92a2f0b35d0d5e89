"""Live view of a run in a separate process: the function that starts the process, and its main program.

Command: `python -m handctl.view.live_view LOG [ARGUMENT OF THE VIEWER ...]`.

The process of the live view only reads the log, and does not depend on the controller. The process
of the live view ends when the log ends, when the viewer is closed, or on SIGTERM. After the end of
the log or SIGTERM, the viewer remains open.
"""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from handctl.errors import HandctlError
from handctl.signal_handlers import TerminationFlag

NICE_INCREMENT = 10
"""Increment of the nice value, which gives the live view a lower priority than the controller."""


def start_live_view(log_path: Path, *viewer_arguments: str) -> "subprocess.Popen[bytes]":
    """Start a process that shows a log in a viewer while the log is being written.

    A failure of the started process or of the viewer has no effect on the controller. Because the
    controller's process imports this module, the module imports only packages that load fast.

    Args:
        log_path: path of the log. The log file may be created later.
        viewer_arguments: further command-line arguments of the viewer, such as --headless.
    """
    command = [sys.executable, "-m", "handctl.view.live_view", str(log_path), *viewer_arguments]
    quiet_environment = os.environ | {"RUST_LOG": "off"}
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        env=quiet_environment,
        start_new_session=True,
    )


def main() -> int:
    """Run the live view of the log that the first argument names, and return the exit code."""
    termination_flag = TerminationFlag()
    signal.signal(signal.SIGTERM, termination_flag)
    with suppress(OSError):
        os.nice(NICE_INCREMENT)
    log = Path(sys.argv[1])
    arguments = sys.argv[2:]
    try:
        from handctl.view.viewer import check_screen_exists

        if "--headless" not in arguments:
            check_screen_exists()
        from handctl.view.log_follower import follow_logs

        follow_logs([log], arguments, termination_flag)
    except HandctlError as error:
        # A HandctlError always has a printable message.
        print(f"handctl view: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
