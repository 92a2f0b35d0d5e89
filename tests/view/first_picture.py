"""Measure the time that `handctl view LOG` needs for its first picture: `python tests/view/first_picture.py LOG`.

The measured time begins with the start of this process, and ends when a viewer without a screen has
drawn a picture with data. The program prints the measured time as JSON. The JSON output
also contains the CPU times of handctl and of the viewer until the first picture.
"""

import json
import os
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import psutil

WINDOW_SIZE = "1600x900"


def main() -> None:
    """Open a log as `handctl view` does, and end after the first picture."""
    os.environ.setdefault("RUST_LOG", "error")  # handctl view sets this environment variable, too
    from handctl.cli.logs import view  # noqa: F401 (what the verb imports counts)
    from handctl.log.read.reader import RunLog
    from handctl.view.log_browser import browse_log
    from handctl.view.scene.run_info import RunInfo
    from handctl.view.viewer import software_vulkan

    path, event = Path(sys.argv[1]), threading.Event()
    with RunLog(path, verify_checksums=False) as log:
        run, scan = RunInfo.from_header(log.header, path.stem), log.scan
    threading.Thread(target=_time_first_picture, args=(event,), daemon=True).start()
    with browse_log(
        path, run, ["--headless", "--window-size", WINDOW_SIZE], software_vulkan(), scan
    ):
        event.wait()


def _time_first_picture(data_received: threading.Event) -> None:
    """Measure the time until the viewer of the present process has drawn a picture with data.

    Print the measured time [s], the CPU times of handctl and of the viewer [s], and the size of the
    picture [bytes]. Then close the viewer.
    """
    viewer = _find_viewer()
    client = _connect_client(viewer)
    while not _has_data(client):
        time.sleep(0.02)
    size = len(client.take_screenshot())
    seconds = time.time() - psutil.Process().create_time()
    cpu_times_s = [sum(process.cpu_times()[:2]) for process in (psutil.Process(), viewer)]
    print(
        json.dumps(
            {
                "seconds": seconds,
                "handctl_cpu_s": cpu_times_s[0],
                "viewer_cpu_s": cpu_times_s[1],
                "png_bytes": size,
            }
        )
    )
    viewer.terminate()
    data_received.set()


def _find_viewer() -> psutil.Process:
    while True:
        for child in psutil.Process().children():
            with suppress(psutil.Error):  # the viewer process has already ended
                if "--headless" in child.cmdline():
                    return child
        time.sleep(0.01)


def _connect_client(viewer_process: psutil.Process) -> "object":
    from rerun.experimental import ViewerClient

    while True:
        ports = [
            connection.laddr.port
            for connection in viewer_process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
        if ports:
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{ports[0]}/proxy")
        time.sleep(0.01)


def _has_data(client: "object") -> bool:
    state = client.get_state()  # type: ignore[attr-defined]
    ends = [
        line.end or 0
        for recording in state.recordings
        for line in recording.timelines
        if line.name == "run_time"
    ]
    return bool(state.views) and max(ends, default=0) > 0


if __name__ == "__main__":
    main()
