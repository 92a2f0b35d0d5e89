"""How a verb ends that does not end by itself: by a signal, or by a bug.

Where no hand runs a signal unwinds the verb, so that files, children and sockets are put away; while a hand runs the
loop has the signals: see ``runtime.loop.StopSignals``.
"""

import atexit
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType

from handctl.handlers import handling
from handctl.printing import escaped_streams
from handctl.session.exit_codes import Exit


class Terminated(KeyboardInterrupt):
    """SIGTERM, or SIGHUP of a terminal that has gone."""


def _end(number: int, frame: FrameType | None) -> None:
    raise Terminated


@contextmanager
def terminate_on_signals() -> Iterator[None]:
    """Have SIGTERM and SIGHUP end what runs as Ctrl-C does; what ``nohup`` has told to be ignored stays so."""
    ending = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    with handling(_end, *ending):
        yield


def install_excepthook() -> None:
    """Have an exception that nobody expected end this process with its traceback and ``Exit.INTERNAL``.

    Everything is put away as ever: the code is set last, when all else that waits for the end has been called.
    """
    bugs: list[BaseException] = []

    def show(error_type: type[BaseException], bug: BaseException, trace: TracebackType | None) -> None:
        with escaped_streams():
            sys.__excepthook__(error_type, bug, trace)
            print("handctl: this is a bug in handctl; what stands above tells where", file=sys.stderr)
        bugs.append(bug)

    def end() -> None:
        if bugs:
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError):
                    stream.flush()
            os._exit(Exit.INTERNAL)

    atexit.register(end)
    sys.excepthook = show
