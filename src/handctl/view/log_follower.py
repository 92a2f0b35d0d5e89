"""Live display of one or several runs, which reads the growing logs and sends new chunks to a viewer."""

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path

import rerun as rr

from handctl.errors import LogError
from handctl.log.read.reader import RunLog
from handctl.signal_handlers import TerminationFlag
from handctl.view.log_tail import LogTail
from handctl.view.rerun_conversion import chunks_of_log, new_recording
from handctl.view.scene.blueprint import dashboard_layout
from handctl.view.scene.entity_styles import style_chunks
from handctl.view.scene.geometry import mesh_chunks
from handctl.view.scene.run_info import RunInfo
from handctl.view.scene.topic_converters import TopicConverters
from handctl.view.viewer import Viewer, check_screen_exists, software_vulkan, start_viewer

LOG_CHECK_PERIOD_S = 0.2
"""Interval between checks for new data in the log [s]."""
FLUSH_TIMEOUT_S = 5.0
"""Longest wait until the viewer has received all sent data [s]."""
LOG_FILE_TIMEOUT_S = 30.0
"""Longest wait until the log file exists and has a header [s]."""
NO_GROWTH_TIMEOUT_S = 15.0
"""Time without growth of the log after which the recording process is assumed to have died [s]."""


class LogFollower:
    """Follower of a growing log, which sends new chunks of the log to a viewer."""

    def __init__(self, log: Path, run: RunInfo, url: str) -> None:
        """Connect to a viewer, and send the static chunks of the run.

        Args:
            log: path of the log file, which must already contain a header.
            run: data about the run and the hand of the log.
            url: address of the viewer.
        """
        self._run = run
        self._converters = TopicConverters(run)
        self._tail = LogTail(log)
        self._folder = tempfile.TemporaryDirectory(prefix="handctl-follow-")
        self._stream = new_recording(run)
        self._stream.connect_grpc(url, default_blueprint=dashboard_layout(run, is_live=True))
        rr.send_chunks(chain(style_chunks(run), mesh_chunks(run)), recording=self._stream)

    def send_new_chunks(self) -> bool:
        """Send the new chunks of the log to the viewer. Return False if the log has not grown.

        Raises:
            LogError: the log is damaged.
        """
        partial_log = Path(self._folder.name) / "part.mcap"
        new_chunk_count = self._tail.write_new_chunks(partial_log)
        if new_chunk_count is None:
            return False
        chunks = chunks_of_log(partial_log, self._converters, self._run.name, new_chunk_count)
        rr.send_chunks(chunks, recording=self._stream)
        self._wait_until_viewer_has_data()
        return True

    def _wait_until_viewer_has_data(self) -> None:
        """Wait until the viewer has received all data.

        If the user has closed the viewer, do not wait.
        """
        with suppress(RuntimeError):
            self._stream.flush(timeout_sec=FLUSH_TIMEOUT_S)

    @property
    def has_log_ended(self) -> bool:
        """Return True if the log is complete and has been sent to the end."""
        return self._tail.has_log_ended

    def close(self) -> None:
        """Disconnect from the viewer, which remains open."""
        self._wait_until_viewer_has_data()
        self._stream.disconnect()
        self._folder.cleanup()


def follow_logs(
    logs: Sequence[Path], viewer_arguments: Sequence[str] = (), stop: TerminationFlag | None = None
) -> None:
    """Open a viewer, and show growing logs until all logs end.

    The viewer lists each log as a recording.

    Args:
        logs: paths of the logs. The log files may be created later.
        viewer_arguments: further command-line arguments of the viewer.
        stop: flag that is set to end the display early.

    Raises:
        LogError: a log does not appear in time or is damaged.
        ConfigError: the desktop session has no screen on which a viewer could open.
        HandctlError: the viewer does not start.
    """
    is_headless = "--headless" in viewer_arguments
    if not is_headless:
        check_screen_exists()
    stop = stop or TerminationFlag()
    runs = [run for log in logs if (run := _wait_for_header(log, stop)) is not None]
    if len(runs) < len(logs):
        return
    viewer_process = start_viewer(
        ["--expect-data-soon", *viewer_arguments], software_vulkan() if is_headless else {}
    )
    followers: list[LogFollower] = []
    try:
        for log, run in zip(logs, runs, strict=True):
            followers.append(LogFollower(log, run, viewer_process.url))
        _follow_until_end(followers, viewer_process, stop)
        for follower in followers:
            follower.send_new_chunks()
    except KeyboardInterrupt:
        return
    finally:
        for follower in followers:
            follower.close()


def _follow_until_end(
    followers: Sequence[LogFollower], running_viewer: Viewer, stop: TerminationFlag
) -> None:
    """Send new chunks until each log ends or stops growing.

    The loop also ends after a stop request, or when the user closes the viewer.
    """
    last_chunk_times = dict.fromkeys(followers, time.monotonic())
    while last_chunk_times and not stop.requested and running_viewer.process.poll() is None:
        start = time.monotonic()
        for follower, last_chunk_time in list(last_chunk_times.items()):
            if follower.has_log_ended:
                del last_chunk_times[follower]
            elif follower.send_new_chunks():
                last_chunk_times[follower] = start
            elif start - last_chunk_time > NO_GROWTH_TIMEOUT_S:
                del last_chunk_times[follower]
        # After a slow transfer of chunks, the pause before the next transfer is shorter. Even the
        # shortest pause leaves processor time to other programs.
        time.sleep(max(LOG_CHECK_PERIOD_S - (time.monotonic() - start), LOG_CHECK_PERIOD_S / 4))


def _wait_for_header(log: Path, stop: TerminationFlag) -> RunInfo | None:
    """Wait for the header of a log, and return the data about the run.

    After a stop request, return None.
    """
    end = time.monotonic() + LOG_FILE_TIMEOUT_S
    while not stop.requested:
        try:
            with RunLog(log) as opened_log:
                return RunInfo.from_header(opened_log.header, log.stem)
        except LogError:
            if time.monotonic() > end:
                raise
        time.sleep(LOG_CHECK_PERIOD_S)
    return None
