"""Picture of the viewer's dashboard at one time of a run. The picture is drawn without a screen."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

from handctl.errors import HandctlError
from handctl.output_files import atomic_path
from handctl.view.scene.chunk_arrays import RUN_TIME_TIMELINE
from handctl.view.viewer import Viewer, running_viewer, software_vulkan

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient, ViewerState

PICTURE_SIZE_PX = "1600x900"
"""Width and height of the picture [pixels]."""
LOAD_TIMEOUT_S = 60.0
"""Longest wait until the viewer answers, and longest wait until the recording is loaded [s]."""
SCREENSHOT_PAUSE_S = 1.0
"""Pause between two screenshots that are compared [s]."""
NOTICE_DURATION_S = 5.0
"""Time from the start of the viewer during which notices cover the dashboard [s]."""
UNCHANGED_TIMEOUT_S = 10.0
"""Longest wait until two screenshots are equal [s]."""


def draw_recording(recording_path: Path, picture_time_s: float, picture_path: Path) -> list[str]:
    """Draw a PNG picture of the dashboard at one time of a Rerun recording.

    Args:
        recording_path: path of the Rerun recording, which also contains the layout of the dashboard.
        picture_time_s: time to show, since the start of the run [s].
        picture_path: path of the PNG file to write.

    Returns:
        problems that the views of the dashboard report, or an empty list.

    Raises:
        ConfigError: no Vulkan driver is installed.
        HandctlError: the viewer failed.
        OSError: the PNG file cannot be written.
    """
    with running_viewer(
        ["--headless", "--window-size", PICTURE_SIZE_PX, str(recording_path)], software_vulkan()
    ) as viewer_process:
        clear = time.monotonic() + NOTICE_DURATION_S
        client = connect_client(viewer_process)
        wait_until_loaded(client, RUN_TIME_TIMELINE, int(picture_time_s * 1e9))
        client.set_time(RUN_TIME_TIMELINE, duration=picture_time_s, play_state="paused")
        time.sleep(max(SCREENSHOT_PAUSE_S, clear - time.monotonic()))
        png = take_stable_screenshot(client)
        reports = problem_reports_of_view(client)
    with atomic_path(picture_path) as temporary_path:
        temporary_path.write_bytes(png)
    return reports


def take_stable_screenshot(client: "ViewerClient") -> bytes:
    """Take screenshots of the viewer until they no longer change, and return the last screenshot.

    On a busy machine, the viewer draws the views of the dashboard one after the other.
    """
    end = time.monotonic() + UNCHANGED_TIMEOUT_S
    screenshot_before = client.take_screenshot()
    while True:
        time.sleep(SCREENSHOT_PAUSE_S)
        screenshot = client.take_screenshot()
        if screenshot == screenshot_before or time.monotonic() > end:
            return screenshot
        screenshot_before = screenshot


def connect_client(viewer: Viewer) -> "ViewerClient":
    """Wait for a viewer that is starting, and return a client connected to the viewer."""
    from rerun.experimental import ViewerClient

    end = time.monotonic() + LOAD_TIMEOUT_S
    while True:
        try:
            client = ViewerClient.connect(viewer.url)
            client.get_state()
        except (RuntimeError, ConnectionError) as error:
            if viewer.process.poll() is not None or time.monotonic() > end:
                raise HandctlError(f"no answer from the viewer: {error}", "rerun", "") from error
            time.sleep(0.1)
        else:
            return client


def timeline_end(state: "ViewerState", timeline_name: str) -> int:
    """Return the end of a timeline, in the unit of the timeline.

    If the timeline has different ends in the recordings of the viewer, return the latest end. If
    the viewer has no data on the timeline, the result is -1.
    """
    lines = [
        line
        for recording in state.recordings
        for line in recording.timelines
        if line.name == timeline_name
    ]
    return max((line.end for line in lines if line.end is not None), default=-1)


def wait_until_loaded(client: "ViewerClient", timeline_name: str, until_ns: int = 0) -> None:
    """Wait until a viewer shows its views and has loaded a recording up to ``until_ns``.

    A viewer gets a recording and the layout before it gets the first data. Before the first data
    arrive, the viewer already reports that the loading has ended. For this reason, the function
    also checks that the timeline of the viewer reaches ``until_ns``.

    Args:
        client: client of the viewer.
        timeline_name: name of a timeline of the recording.
        until_ns: time up to which the recording must be loaded, in the unit of the timeline.

    Raises:
        HandctlError: the recording is not loaded after `LOAD_TIMEOUT_S`.
    """
    end = time.monotonic() + LOAD_TIMEOUT_S
    while time.monotonic() < end:
        state = client.get_state()
        if timeline_end(state, timeline_name) >= until_ns and state.views and not state.loading:
            return
        time.sleep(0.1)
    raise HandctlError(
        f"the viewer has not loaded the recording after {LOAD_TIMEOUT_S:g} s", "rerun", ""
    )


def problem_reports_of_view(client: "ViewerClient") -> list[str]:
    """Return the problems that the views of the dashboard report."""
    return [
        f"{view.name}: {report.severity}: {report.summary}"
        for view in client.get_state().views
        for report in view.reports
    ]
