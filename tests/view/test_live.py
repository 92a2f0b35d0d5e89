"""Test the live view: a process beside the controller shows the log while the log grows."""

import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil
import pytest

from handctl.log.tick_packing import pack_tick_record
from handctl.log.write.recorder import Recorder
from handctl.view.dashboard_picture import timeline_end
from handctl.view.live_view import start_live_view
from handctl.view.scene.chunk_arrays import RUN_TIME_TIMELINE

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

pytestmark = pytest.mark.timeout(120)
VIEWER_TIMEOUT_S = 40.0


def viewer_url(live_view_process: "subprocess.Popen[bytes]") -> str:
    """Return the address of the viewer that a process of the live view has started."""
    deadline_s = time.monotonic() + VIEWER_TIMEOUT_S
    while time.monotonic() < deadline_s:
        assert live_view_process.poll() is None, (
            f"the follower ended with {live_view_process.returncode}"
        )
        with suppress(psutil.NoSuchProcess, FileNotFoundError):  # the child has possibly ended
            for child in psutil.Process(live_view_process.pid).children():
                for connection in child.net_connections():
                    if connection.status == psutil.CONN_LISTEN:
                        return f"rerun+http://127.0.0.1:{connection.laddr.port}/proxy"
        time.sleep(0.1)
    raise AssertionError("no viewer")


def latest_received_ns(client: "ViewerClient") -> int:
    """Return the time of the latest data that the viewer has received, in the time of the run [ns]."""
    return timeline_end(client.get_state(), RUN_TIME_TIMELINE)


def wait_for_time(client: "ViewerClient", t_ns: int) -> int:
    deadline_s = time.monotonic() + VIEWER_TIMEOUT_S
    while latest_received_ns(client) < t_ns and time.monotonic() < deadline_s:
        time.sleep(0.1)
    return latest_received_ns(client)


def test_a_growing_log_arrives_in_the_viewer(
    tmp_path: Path, vulkan_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import synthetic_run
    from rerun.experimental import ViewerClient

    for name, value in vulkan_environment.items():
        monkeypatch.setenv(name, value)
    path, run = (
        tmp_path / "run.mcap",
        synthetic_run.synthetic_header(rate_hz=100, deterministic=False, offset_ns=10**18),
    )
    live_view_process = start_live_view(path, "--headless", "--window-size", "800x600")
    recorder, ticks = Recorder.start(path, run), list(synthetic_run.SyntheticRunTicks(run, 4.0))
    viewers: list[psutil.Process] = []
    try:
        for tick_in, out in ticks[:200]:
            recorder.send_record(pack_tick_record(tick_in, out))
        client = ViewerClient.connect(viewer_url(live_view_process))
        viewers = psutil.Process(live_view_process.pid).children()
        assert wait_for_time(client, 1_000_000_000) >= 1_000_000_000
        assert latest_received_ns(client) <= ticks[199][0].t_ns
        for tick_in, out in ticks[200:]:
            recorder.send_record(pack_tick_record(tick_in, out))
        recorder.close("finished")
        assert wait_for_time(client, ticks[-1][0].t_ns) == ticks[-1][0].t_ns
        assert live_view_process.wait(VIEWER_TIMEOUT_S) == 0
        assert viewers[0].is_running()
        assert [view.reports for view in client.get_state().views if view.reports] == []
    finally:
        live_view_process.kill()
        for process in viewers:
            process.kill()


def test_live_view_ends_with_its_viewer(
    tmp_path: Path, vulkan_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import synthetic_run
    from rerun.experimental import ViewerClient

    for name, value in vulkan_environment.items():
        monkeypatch.setenv(name, value)
    path, run = tmp_path / "run.mcap", synthetic_run.synthetic_header(rate_hz=100)
    recorder = Recorder.start(path, run)
    live_view_process = start_live_view(path, "--headless", "--window-size", "400x300")
    try:
        for tick_in, out in synthetic_run.SyntheticRunTicks(run, 1.0):
            recorder.send_record(pack_tick_record(tick_in, out))
        assert wait_for_time(ViewerClient.connect(viewer_url(live_view_process)), 1) > 0, (
            "the follower is connected to its viewer"
        )
        (window,) = psutil.Process(live_view_process.pid).children()
        window.kill()
        assert live_view_process.wait(VIEWER_TIMEOUT_S) == 0
    finally:
        live_view_process.kill()
        recorder.close("finished")


FOLLOW_TWO_LOGS_SCRIPT = """
import sys
from pathlib import Path
from handctl.view.log_follower import follow_logs
follow_logs([Path(name) for name in sys.argv[1:]], ["--headless", "--window-size", "400x300"])
"""


def test_two_growing_logs_arrive_in_one_viewer(
    tmp_path: Path, vulkan_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two hands run at the same time, and one viewer shows both runs."""
    import synthetic_run
    from rerun.experimental import ViewerClient

    for name, value in vulkan_environment.items():
        monkeypatch.setenv(name, value)
    hand_by_log = {tmp_path / "left.mcap": "jamia", tmp_path / "right.mcap": "t42"}
    headers = [synthetic_run.synthetic_header(hand, rate_hz=100) for hand in hand_by_log.values()]
    recorders = [
        Recorder.start(path, header) for path, header in zip(hand_by_log, headers, strict=True)
    ]
    live_view_process = subprocess.Popen(
        [sys.executable, "-c", FOLLOW_TWO_LOGS_SCRIPT, *map(str, hand_by_log)]
    )
    viewers: list[psutil.Process] = []
    try:
        for recorder, header in zip(recorders, headers, strict=True):
            for tick_in, out in synthetic_run.SyntheticRunTicks(header, 1.0):
                recorder.send_record(pack_tick_record(tick_in, out))
        client = ViewerClient.connect(viewer_url(live_view_process))
        viewers = psutil.Process(live_view_process.pid).children()
        for recorder in recorders:
            recorder.close("finished")
        assert live_view_process.wait(VIEWER_TIMEOUT_S) == 0
        recordings = client.get_state().recordings
        assert sorted(str(recording.store_id) for recording in recordings) == [
            "Recording:handctl_jamia:left",
            "Recording:handctl_t42:right",
        ]
        for recording in recordings:
            assert max(line.end for line in recording.timelines) >= 900_000_000
    finally:
        live_view_process.kill()
        for process in viewers:
            process.kill()


def test_sigterm_ends_the_wait_for_a_log(tmp_path: Path) -> None:
    live_view_process = start_live_view(tmp_path / "never.mcap", "--headless")
    time.sleep(2.0)
    assert live_view_process.poll() is None
    live_view_process.terminate()
    assert live_view_process.wait(VIEWER_TIMEOUT_S) == 0


def test_the_controllers_process_imports_nothing_of_the_viewer() -> None:
    code = "import sys, handctl.view.live_view; print(sorted({'rerun', 'pyarrow', 'numpy'} & set(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert result.stdout.strip() == "[]"
