"""The process of the live view: how a controller starts it, and its main program.

``python -m handctl.view.live LOG [ARGUMENT OF THE VIEWER ...]``. It reads the log and nothing else; the controller
does not know of it. It ends with the log, when its viewer is closed, or on SIGTERM; the viewer stays open.
"""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from handctl.errors import HandctlError
from handctl.handlers import Stop

NICE = 10
"""So much less than the controller does this process want the processor."""


def start_live(log_path: Path, *arguments: str) -> "subprocess.Popen[bytes]":
    """Show a log in a viewer while it is being written.

    Whatever becomes of the new process or of the viewer, the controller does not notice. Imports nothing heavy, since
    the controller's process calls it.

    Args:
        log_path: the log; it may not exist yet.
        arguments: more arguments of the viewer, such as --headless.
    """
    command = [sys.executable, "-m", "handctl.view.live", str(log_path), *arguments]
    quiet = os.environ | {"RUST_LOG": "off"}
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=quiet, start_new_session=True
    )


def main() -> int:
    """Follow the log that the first argument names."""
    stop = Stop()
    signal.signal(signal.SIGTERM, stop)
    with suppress(OSError):
        os.nice(NICE)
    log, arguments = Path(sys.argv[1]), sys.argv[2:]
    try:
        from handctl.view.viewer import check_screen

        if "--headless" not in arguments:
            check_screen()
        from handctl.view.follow import follow

        follow(log, arguments, stop)
    except HandctlError as error:
        print(f"handctl view: {error}", file=sys.stderr)  # printable, as every HandctlError
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
