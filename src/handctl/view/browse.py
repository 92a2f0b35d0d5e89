"""Opens a viewer and sends a log to it from the start: the first seconds are shown while the rest still comes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path

import rerun as rr

from handctl.view.blueprint import dashboard
from handctl.view.feed import recording, run_chunks
from handctl.view.subject import Subject
from handctl.view.viewer import Viewer, viewer

FIRST_NS = 2_000_000_000
"""What is sent first: enough to see the hand, few enough to be there at once."""
FLUSH_S = 5.0


@contextmanager
def browse(path: Path, subject: Subject, arguments: Sequence[str], environment: dict[str, str]) -> Iterator[Viewer]:
    """Open a viewer and send all of a log, which may be looked at meanwhile; it closes with the context.

    Args:
        path: a log.
        subject: its run.
        arguments: more arguments of the viewer.
        environment: for the viewer.

    Raises:
        LogError: the log is damaged; what came before the damage is shown.
        HandctlError: the viewer does not start.
    """
    with viewer(["--expect-data-soon", *arguments], environment) as running:
        stream = recording(subject)
        stream.connect_grpc(running.url, default_blueprint=dashboard(subject))
        try:
            chunks = takewhile(lambda _: running.process.poll() is None, run_chunks(path, subject, FIRST_NS))
            rr.send_chunks(chunks, recording=stream)
        finally:
            with suppress(RuntimeError):  # it was closed meanwhile
                stream.flush(timeout_sec=FLUSH_S)
            stream.disconnect()
        yield running
