"""A picture of the dashboard at one moment of a run, drawn without a screen."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

from handctl.errors import HandctlError
from handctl.output import whole
from handctl.view.scene.arrow import TIMELINE
from handctl.view.viewer import Viewer, software_vulkan, viewer

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient, ViewerState

SIZE = "1600x900"
LOAD_S, SETTLE_S = 60.0, 1.0
TOAST_S = 5.0
"""So long after its start the viewer still shows notices over the picture."""
STILL_S = 10.0
"""A picture that has not come to rest by then is taken as it is."""


def draw(rrd: Path, at_s: float, out: Path) -> list[str]:
    """Write a PNG of a recording.

    Args:
        rrd: recording with its layout.
        at_s: moment, since the start of the run [s].
        out: the PNG.

    Returns:
        What the views could not show; empty if all is well.

    Raises:
        ConfigError: there is no Vulkan driver.
        HandctlError: the viewer did not do it.
        OSError: the picture cannot be written.
    """
    with viewer(["--headless", "--window-size", SIZE, str(rrd)], software_vulkan()) as running:
        clear = time.monotonic() + TOAST_S
        client = connected(running)
        wait_loaded(client, TIMELINE, int(at_s * 1e9))
        client.set_time(TIMELINE, duration=at_s, play_state="paused")
        time.sleep(max(SETTLE_S, clear - time.monotonic()))
        png = still(client)
        reports = view_reports(client)
    with whole(out) as part:
        part.write_bytes(png)
    return reports


def still(client: "ViewerClient") -> bytes:
    """The picture once it has stopped changing: on a busy machine views are drawn one after the other."""
    end = time.monotonic() + STILL_S
    before = client.take_screenshot()
    while True:
        time.sleep(SETTLE_S)
        now = client.take_screenshot()
        if now == before or time.monotonic() > end:
            return now
        before = now


def connected(running: Viewer) -> "ViewerClient":
    """A client of a viewer that is still starting."""
    from rerun.experimental import ViewerClient

    end = time.monotonic() + LOAD_S
    while True:
        try:
            client = ViewerClient.connect(running.url)
            client.get_state()
        except (RuntimeError, ConnectionError) as error:
            if running.process.poll() is not None or time.monotonic() > end:
                raise HandctlError(f"no answer from the viewer: {error}", "rerun", "") from error
            time.sleep(0.1)
        else:
            return client


def reached(state: "ViewerState", timeline: str) -> int:
    """How far a timeline of a viewer's recordings goes, in its unit; -1 without data."""
    lines = [line for one in state.recordings for line in one.timelines if line.name == timeline]
    return max((line.end for line in lines if line.end is not None), default=-1)


def wait_loaded(client: "ViewerClient", timeline: str, until: int = 0) -> None:
    """Wait until the views are there, and a recording up to some moment.

    A viewer knows a recording and its layout before the first of its data, and says then that nothing is loading.

    Args:
        client: of the viewer.
        timeline: a timeline of the recording.
        until: what the timeline must reach, in its unit.

    Raises:
        HandctlError: it takes too long.
    """
    end = time.monotonic() + LOAD_S
    while time.monotonic() < end:
        state = client.get_state()
        if reached(state, timeline) >= until and state.views and not state.loading:
            return
        time.sleep(0.1)
    raise HandctlError(f"the viewer has not loaded the recording after {LOAD_S:g} s", "rerun", "")


def view_reports(client: "ViewerClient") -> list[str]:
    """What the views of the dashboard could not show."""
    return [
        f"{view.name}: {report.severity}: {report.summary}"
        for view in client.get_state().views
        for report in view.reports
    ]
