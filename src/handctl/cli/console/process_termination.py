"""Orderly end of a command after a signal or an unexpected exception.

While no hand runs, a signal raises an exception in the command. After the exception, the command
closes its files, child processes and sockets. While a hand runs, the control loop handles the
signals instead, see ``runtime.loop.StopSignals``.
"""

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType

from handctl.printing import escaped_streams
from handctl.session.exit_codes import ExitCode
from handctl.signal_handlers import installed_handler


class TerminationRequested(KeyboardInterrupt):
    """Exception that is raised in a command when this process receives SIGTERM or SIGHUP.

    The system sends SIGHUP when a terminal is closed.
    """


def _raise_terminated(number: int, frame: FrameType | None) -> None:
    raise TerminationRequested


@contextmanager
def terminate_on_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does.

    If the command was started with ``nohup``, SIGHUP stays ignored.
    """
    termination_signals = [
        number
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) == signal.SIG_DFL
    ]
    with installed_handler(_raise_terminated, *termination_signals):
        yield


def install_excepthook() -> None:
    """End the process with a traceback and ``ExitCode.INTERNAL`` after an unexpected exception.

    All other exit handlers run first and close the resources of the command. The exit code is set
    after all other exit handlers have run.
    """
    bugs: list[BaseException] = []

    def print_traceback(
        error_type: type[BaseException], exception: BaseException, trace: TracebackType | None
    ) -> None:
        with escaped_streams():
            sys.__excepthook__(error_type, exception, trace)
            print(
                "handctl: this is a bug in handctl; the traceback above shows the place",
                file=sys.stderr,
            )
        bugs.append(exception)

    def end_process() -> None:
        if bugs:
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError):
                    stream.flush()
            os._exit(ExitCode.INTERNAL)

    atexit.register(end_process)
    sys.excepthook = print_traceback
