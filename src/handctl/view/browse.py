"""Opens a viewer and sends a log to it from the start: the first seconds are shown while the rest still comes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from handctl.log.read.scan import Scan
from handctl.view.scene.subject import Subject
from handctl.view.viewer import Viewer, launched

if TYPE_CHECKING:
    from rerun.chunk import Chunk

FIRST_NS = 2_000_000_000
"""What is sent first: enough to see the hand, few enough to be there at once."""
FLUSH_S = 5.0


@contextmanager
def browse(
    path: Path, subject: Subject, arguments: Sequence[str], environment: dict[str, str], found: Scan | None = None
) -> Iterator[Viewer]:
    """Open a viewer and send all of a log, which may be looked at meanwhile; it closes with the context.

    Args:
        path: a log.
        subject: its run.
        arguments: more arguments of the viewer.
        environment: for the viewer.
        found: what the log holds, if that is known already.

    Raises:
        LogError: the log is damaged; what came before the damage is shown.
        HandctlError: the viewer does not start.
    """
    with launched(["--expect-data-soon", *arguments], environment) as launch:
        from handctl.view.feed import run_parts  # it imports Rerun, while the viewer starts on another core

        parts = run_parts(path, subject, FIRST_NS, found)
        first = list(islice(parts, 2))
        running = launch.ready()
        _send(running, subject, chain.from_iterable(chain(first, parts)))
        yield running


def _send(running: Viewer, subject: Subject, chunks: "Iterator[Chunk]") -> None:
    """Send all chunks, until there are no more or the viewer is closed."""
    import rerun as rr

    from handctl.view.feed import recording
    from handctl.view.scene.blueprint import dashboard

    stream = recording(subject)
    stream.connect_grpc(running.url, default_blueprint=dashboard(subject))
    try:
        rr.send_chunks(takewhile(lambda _: running.process.poll() is None, chunks), recording=stream)
    finally:
        with suppress(RuntimeError):  # it was closed meanwhile
            stream.flush(timeout_sec=FLUSH_S)
        stream.disconnect()
