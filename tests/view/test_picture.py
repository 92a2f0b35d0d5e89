"""Test the pictures that the viewer Rerun draws without a screen."""

import io
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from PIL import Image

from handctl.cli.main import main
from handctl.view.dashboard_picture import (
    connect_client,
    problem_reports_of_view,
    wait_until_loaded,
)
from handctl.view.scene import palette
from handctl.view.viewer import Viewer, running_viewer

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

pytestmark = pytest.mark.timeout(120)


def pixels_of_png(png_bytes: bytes) -> NDArray[np.int16]:
    """Return the pixels of a PNG picture (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(png_bytes)).convert("RGB"), np.int16)


def colour_fraction(pixels: NDArray[np.int16], colour: palette.Colour) -> float:
    """Return the fraction of pixels whose hue is near the hue of ``colour``, at any brightness."""
    brightness = np.linalg.norm(pixels, axis=2)
    cosine = pixels @ np.array(colour) / np.maximum(brightness * np.linalg.norm(colour), 1e-9)
    return float(((cosine > 0.995) & (brightness > 80)).mean())


def test_the_dashboard_shows_the_hand_its_forces_and_its_lines(
    jamia_log_path: Path,
    tmp_path: Path,
    vulkan_environment: dict[str, str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    picture_path = tmp_path / "run.png"
    assert main(["view", str(jamia_log_path), "--picture", str(picture_path), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["reports"] == []
    assert output["at_s"] == pytest.approx(0.575 * 3.0, abs=0.02)
    image = pixels_of_png(picture_path.read_bytes())
    assert image.shape == (900, 1600, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 2000
    hand, plots = image[70:500, :640], image[60:680, 650:]
    for index in range(4):
        assert colour_fraction(hand, palette.digit_colour(index)) > 0.003, (
            f"digit {index} is not in the picture"
        )
    assert colour_fraction(plots, palette.LIMIT_COLOUR) == 0.0, "a distant limit"
    assert colour_fraction(image[680:860, 650:], palette.PHASE_COLOURS["hold"]) > 0.02


@pytest.fixture(scope="module")
def viewer_without_layout(
    jamia_log_path: Path, vulkan_environment: dict[str, str]
) -> Iterator["tuple[Viewer, ViewerClient]"]:
    """Open the log file directly in a viewer, as `rerun LOG` does, without the layout of handctl."""
    with running_viewer(
        ["--headless", "--window-size", "1200x800", str(jamia_log_path)], vulkan_environment
    ) as running:
        client = connect_client(running)
        wait_until_loaded(client, "message_log_time")
        yield running, client


def test_a_bare_log_opens_with_a_hand_that_moves(
    viewer_without_layout: "tuple[Viewer, ViewerClient]",
) -> None:
    _, client = viewer_without_layout
    state = client.get_state()
    (hand,) = (view for view in state.views if view.view_class == "3D")
    screenshots = []
    for at_s in (0.1, 1.5):
        client.set_time("message_log_time", timestamp=at_s, play_state="paused")
        time.sleep(0.7)
        screenshots.append(pixels_of_png(client.take_screenshot(view_id=hand.view_id)))
    assert problem_reports_of_view(client) == []
    changed_pixel_fraction = (np.abs(screenshots[0] - screenshots[1]).max(axis=2) > 30).mean()
    assert 0.005 < changed_pixel_fraction < 0.5
    assert {"TimeSeries", "TextLog", "3D"} <= {view.view_class for view in state.views}


def test_the_viewer_listens_on_this_machine_only(
    viewer_without_layout: "tuple[Viewer, ViewerClient]",
) -> None:
    running, _ = viewer_without_layout
    connections = psutil.Process(running.process.pid).net_connections()
    assert any(connection.status == psutil.CONN_LISTEN for connection in connections)
    assert {connection.laddr.ip for connection in connections} == {"127.0.0.1"}
    assert {connection.raddr.ip for connection in connections if connection.raddr} <= {"127.0.0.1"}


def test_viewer_ignores_streams_of_other_programs(
    viewer_without_layout: "tuple[Viewer, ViewerClient]",
) -> None:
    """Reproduce a defect: a new viewer showed the data of another program instead of its own views.

    Another program can still send data to the default port of Rerun. For this reason, the new viewer
    must use another port.
    """
    running, client = viewer_without_layout
    assert not running.url.endswith(":9876/proxy"), (
        "the viewer does not use the default port of Rerun"
    )
    (recording,) = client.get_state().recordings
    assert "handctl" not in str(recording.store_id), "the picture is no recording of a follower"


def test_a_recording_without_its_times_is_not_loaded_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine, a viewer reports a recording and its views before the data of the recording arrive."""
    from rerun.experimental import Recording, StoreId, Timeline, View, ViewerState

    def state(*timelines: Timeline) -> ViewerState:
        store = StoreId("run")
        shown_recording = Recording(store, "", list(timelines), None, None)
        return ViewerState(
            "", store, [shown_recording], [View("1", "3D", "hand", "/", True, [])], [], None, None
        )

    def timeline_until(end_ns: int | None) -> Timeline:
        return Timeline("run_time", "duration", 0, end_ns)

    elsewhere = Timeline("log_time", "timestamp", 0, 90)
    remaining_viewer_states = iter(
        [
            state(),
            state(timeline_until(None)),
            state(elsewhere),
            state(timeline_until(49)),
            state(timeline_until(50)),
        ]
    )

    class FakeViewerClient:
        def get_state(self) -> ViewerState:
            return next(remaining_viewer_states)

    monkeypatch.setattr(time, "sleep", lambda _: None)
    wait_until_loaded(FakeViewerClient(), "run_time", 50)  # type: ignore[arg-type] # stands in for a client
    assert next(remaining_viewer_states, None) is None
