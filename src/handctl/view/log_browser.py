"""Display of one or several logs in a viewer.

The first seconds of the run are visible before the whole log has been sent.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from handctl.log.read.record_scan import RecordScan
from handctl.view.scene.run_info import RunInfo
from handctl.view.viewer import Viewer, launched_viewer

if TYPE_CHECKING:
    from rerun.chunk import Chunk

FIRST_SLICE_DURATION_NS = 2_000_000_000
"""Length of the part of the run that is sent first [ns].

The first part of the run is short, so that the hand appears in the viewer at once.
"""
FLUSH_TIMEOUT_S = 5.0
"""Longest wait until the viewer has received the last data [s]."""


@contextmanager
def browse_log(
    path: Path,
    run: RunInfo,
    viewer_arguments: Sequence[str],
    environment: dict[str, str],
    record_scan: RecordScan | None = None,
    further_runs: Sequence[tuple[Path, RunInfo]] = (),
) -> Iterator[Viewer]:
    """Open a viewer, and send whole logs to the viewer.

    At the end of the context, the viewer is closed.

    Args:
        path: path of the log.
        run: data about the run and the hand of the log.
        viewer_arguments: further arguments of the viewer.
        environment: environment variables for the viewer.
        record_scan: list of the log's records, if the records have been scanned already.
        further_runs: paths of further logs, and data about their runs. The viewer lists each log as
            a recording.

    Yields:
        the viewer, after all logs were sent.

    Raises:
        LogError: the log is damaged. If the log is damaged, the viewer shows the part before the
            damage.
        HandctlError: the viewer does not start.
    """
    # The viewer starts on another processor core while this process imports Rerun and converts the
    # first part of the log.
    with launched_viewer(["--expect-data-soon", *viewer_arguments], environment) as starting_viewer:
        from handctl.view.rerun_conversion import (
            chunks_of_run_by_part,
        )  # Rerun is imported while the viewer starts

        chunk_lists = chunks_of_run_by_part(path, run, FIRST_SLICE_DURATION_NS, record_scan)
        first_parts = list(islice(chunk_lists, 2))
        viewer_process = starting_viewer.wait_until_ready()
        _send_chunks(viewer_process, run, chain.from_iterable(chain(first_parts, chunk_lists)))
        for further_path, further_run in further_runs:
            chunk_lists = chunks_of_run_by_part(further_path, further_run, FIRST_SLICE_DURATION_NS)
            _send_chunks(viewer_process, further_run, chain.from_iterable(chunk_lists))
        yield viewer_process


def _send_chunks(running_viewer: Viewer, run: RunInfo, chunks: "Iterator[Chunk]") -> None:
    """Send chunks of Rerun data to a viewer, until all chunks are sent or the viewer is closed."""
    import rerun as rr

    from handctl.view.rerun_conversion import new_recording
    from handctl.view.scene.blueprint import dashboard_layout

    stream = new_recording(run)
    stream.connect_grpc(running_viewer.url, default_blueprint=dashboard_layout(run))
    try:
        rr.send_chunks(
            takewhile(lambda _: running_viewer.process.poll() is None, chunks), recording=stream
        )
    finally:
        with suppress(RuntimeError):  # the user has closed the viewer
            stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
        stream.disconnect()
