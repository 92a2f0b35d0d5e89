"""Test the mailbox, the socket for requests to a controller.

Requests arrive at the controller in order and never block their sender. A bus can have only one
controller at a time. Clients that have subscribed (watchers) get status lines.
"""

import json
import os
import socket
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.errors import BusError
from handctl.runtime import mailbox
from handctl.runtime.confirmed_requests import send_with_confirmation
from handctl.runtime.mailbox import (
    MAX_REQUEST_BYTES,
    MAX_REQUESTS_PER_TICK,
    Mailbox,
    StatusWatcher,
    bus_lock,
    is_running,
)
from handctl.runtime.socket_paths import local_bus_path, mailbox_path, run_dir, truth_path
from tests.drives.protocol_bench import hand_file, move_to_second_bus


@pytest.fixture(autouse=True)
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "run"))
    return tmp_path / "run"


def send_request(bus_name: str, request_text: str) -> None:
    """Send a request to the mailbox of a bus without waiting for a reply, as any program of the same user can."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.sendto(request_text.encode(), str(mailbox_path(bus_name)))


def test_requests_come_in_order_and_once() -> None:
    bus_mailbox = Mailbox("local:x")
    for text in ("one", "two", '{"do": "stop"}'):
        send_request("local:x", text)
    assert bus_mailbox.read_requests() == ("one", "two", '{"do": "stop"}')
    assert bus_mailbox.read_requests() == ()
    bus_mailbox.close()


def test_a_flood_of_requests_is_read_in_parts() -> None:
    bus_mailbox = Mailbox("local:x")
    sent = 0
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        try:
            for sent in range(1000):
                out.sendto(str(sent).encode(), str(bus_mailbox.path))
        except BlockingIOError:
            pass
    received_requests: list[str] = []
    while some_requests := bus_mailbox.read_requests():
        assert len(some_requests) <= MAX_REQUESTS_PER_TICK
        received_requests += some_requests
    assert received_requests == [str(i) for i in range(len(received_requests))]
    assert len(received_requests) >= min(sent, 10)
    bus_mailbox.close()


def test_long_empty_and_binary_datagrams_are_text_of_bounded_length() -> None:
    bus_mailbox = Mailbox("local:x")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        for data in (b"x" * 20_000, b"", b"\xff\xfe\x00"):
            out.sendto(data, str(bus_mailbox.path))
    long_text, empty_datagram, binary = bus_mailbox.read_requests()
    assert long_text == "x" * MAX_REQUEST_BYTES
    assert empty_datagram == ""
    binary.encode()
    bus_mailbox.close()


def test_a_second_controller_is_refused_and_disturbs_nothing() -> None:
    bus_mailbox = Mailbox("local:x")
    for _ in range(2):
        with pytest.raises(BusError, match="another controller runs here"):
            Mailbox("local:x")
    other_mailbox = Mailbox("local:y")
    send_request("local:x", "still there")
    assert bus_mailbox.read_requests() == ("still there",)
    bus_mailbox.close()
    repeated_mailbox = Mailbox("local:x")
    repeated_mailbox.close()
    other_mailbox.close()


@pytest.mark.parametrize("failing_stage", ["unlink", "credentials", "bind"])
def test_a_mailbox_that_fails_leaves_no_lock_and_no_socket(
    failing_stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect: a failed start of the mailbox did not release its lock.

    Because of the lock, a second start in the same process was refused.
    """
    path = mailbox_path("local:x")
    open_files_before = set(os.listdir("/proc/self/fd"))
    with monkeypatch.context() as patch:
        if failing_stage == "unlink":
            path.mkdir()
        elif failing_stage == "bind":
            patch.setattr(Path, "unlink", lambda self, missing_ok: None)
            path.touch()
        else:
            patch.setattr(mailbox, "request_sender_credentials", lambda socket: os.listdir("/no"))
        with pytest.raises(BusError, match="cannot receive requests"):
            Mailbox("local:x")
    assert set(os.listdir("/proc/self/fd")) == open_files_before
    if failing_stage == "unlink":
        path.rmdir()
    Mailbox("local:x").close()


def test_a_further_bus_of_a_hand_is_locked_like_the_first() -> None:
    with bus_lock("local:x"):
        for other_lock in (bus_lock("local:x"), bus_lock("local:x")):
            with pytest.raises(BusError, match="another controller runs here"), other_lock:
                pass
        with pytest.raises(BusError, match="another controller runs here"):
            Mailbox("local:x")
    with bus_lock("local:x"):
        pass


def test_a_hand_whose_second_bus_has_a_controller_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    hand = move_to_second_bus(hand_file(tmp_path, ["mit"]))
    bus_mailbox = Mailbox("local:y")
    words = ["--hand", str(hand), "--bus", "main=local:x", "--bus", "second=local:y"]
    assert main(["commission", *words, "--json"]) == 1
    assert "bus local:y: another controller runs here" in capsys.readouterr().err
    bus_mailbox.close()
    assert main(["commission", *words, "--json"]) == 1
    assert "local:x: no simulator serves this bus" in capsys.readouterr().err


def test_a_killed_controller_leaves_no_lock(run_folder: Path) -> None:
    """After a controller was killed, its socket file still exists.

    Nevertheless, the next controller can open a mailbox with the same name.
    """
    code = "import time; from handctl.runtime.mailbox import Mailbox as M; m = M('local:x'); print(1, flush=1)"
    code += "; time.sleep(60)"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert child.stdout is not None
    assert child.stdout.readline()
    with pytest.raises(BusError):
        Mailbox("local:x")
    child.kill()
    child.wait()
    child.stdout.close()
    assert mailbox_path("local:x").exists()
    bus_mailbox = Mailbox("local:x")
    send_request("local:x", "hello")
    assert bus_mailbox.read_requests() == ("hello",)
    bus_mailbox.close()
    assert not mailbox_path("local:x").exists()


def test_only_one_of_many_controllers_started_at_once_runs(run_folder: Path) -> None:
    code = """
import sys, time
from handctl.errors import BusError
from handctl.runtime.mailbox import Mailbox
start = float(sys.argv[1])
while time.monotonic() < start: pass
try:
    bus_mailbox = Mailbox("local:x")
except BusError:
    print("refused", flush=True)
else:
    print("runs", flush=True)
    sys.stdin.read()
"""
    start = time.monotonic() + 1.5
    command = [sys.executable, "-c", code, str(start)]
    children = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    words = [child.stdout.readline().strip() for child in children if child.stdout]
    for child in children:
        child.communicate("")
    assert sorted(words) == ["refused"] * 3 + ["runs"]


def test_a_request_without_a_controller_is_one_line() -> None:
    watcher = StatusWatcher("local:x")
    with pytest.raises(BusError, match="no controller answers") as caught:
        send_with_confirmation(watcher, {"do": "arm"})
    assert "local:x" in str(caught.value)
    bus_mailbox = Mailbox("local:x")
    bus_mailbox.close()
    with pytest.raises(BusError, match="no controller answers"):
        send_with_confirmation(watcher, {"do": "arm"})
    watcher.close()


def test_a_folder_that_cannot_hold_sockets_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    for folder in (blocked / "below", tmp_path / ("x" * 120)):
        monkeypatch.setenv("HANDCTL_RUN_DIR", str(folder))
        with pytest.raises(BusError, match="HANDCTL_RUN_DIR") as caught:
            Mailbox("local:x")
        assert "\n" not in str(caught.value)


def test_only_this_user_can_access_the_folder(run_folder: Path) -> None:
    bus_mailbox = Mailbox("local:x")
    assert stat.S_IMODE(run_folder.stat().st_mode) == 0o700
    bus_mailbox.close()


def test_watchers_get_each_published_line_once() -> None:
    bus_mailbox = Mailbox("local:x")
    ends = []
    for name in ("a", "b"):
        end = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        end.bind(str(run_dir() / name))
        end.setblocking(False)
        ends.append(end)
    for _ in range(6):
        ends[0].sendto(b'{"do": "watch"}', str(bus_mailbox.path))
    ends[1].sendto(b'{"do": "watch"}', str(bus_mailbox.path))
    ends[0].sendto(b'{"do": "watch"}', str(bus_mailbox.path))
    assert bus_mailbox.read_requests() == (), "a watch request is no request to the controller"
    bus_mailbox.publish_status({"k": 1})
    for end in ends:
        assert json.loads(end.recv(1000)) == {"k": 1}
        with pytest.raises(BlockingIOError):
            end.recv(1000)
    ends[0].close()
    bus_mailbox.publish_status({"k": 2})
    assert json.loads(ends[1].recv(1000)) == {"k": 2}
    ends[1].close()
    bus_mailbox.publish_status({"k": 3})
    assert bus_mailbox.watchers == []
    bus_mailbox.close()


def test_a_program_may_watch_two_controllers() -> None:
    mailboxes = [Mailbox("local:x"), Mailbox("local:y")]
    watchers = [StatusWatcher("local:x"), StatusWatcher("local:y")]
    for bus_mailbox, watcher in zip(mailboxes, watchers, strict=True):
        watcher.request_status_line(0.0)
        bus_mailbox.read_requests()
        bus_mailbox.publish_status({"name": watcher.name})
    assert [watcher.next_status_line(1.0) for watcher in watchers] == [
        {"name": "local:x"},
        {"name": "local:y"},
    ]
    for watcher_or_mailbox in (*watchers, *mailboxes):
        watcher_or_mailbox.close()


def test_the_socket_of_a_killed_controller_does_not_count_as_running(run_folder: Path) -> None:
    assert not is_running("local:x")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as abandoned_socket:
        abandoned_socket.bind(str(mailbox_path("local:x")))
    assert mailbox_path("local:x").exists()
    assert not is_running("local:x")
    bus_mailbox = Mailbox("local:x")
    assert is_running("local:x")
    assert bus_mailbox.read_requests() == (), "a search for controllers is no request"
    bus_mailbox.close()


def test_a_watcher_that_does_not_read_never_blocks_the_controller() -> None:
    bus_mailbox = Mailbox("local:x")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(run_dir() / "a"))
        end.sendto(b'{"do": "watch"}', str(bus_mailbox.path))
        bus_mailbox.read_requests()
        start_time_s = time.monotonic()
        for k in range(500):
            bus_mailbox.publish_status({"k": k, "text": "x" * 500})
        assert time.monotonic() - start_time_s < 2.0
    bus_mailbox.close()


def test_a_watcher_gets_only_lines_published_after_it_starts() -> None:
    watcher = StatusWatcher("local:x")
    assert watcher.request_status_line(0.01) is None, "no controller runs"
    bus_mailbox = Mailbox("local:x")
    assert watcher.request_status_line(0.01) is None
    bus_mailbox.read_requests()
    bus_mailbox.publish_status({"k": 1})
    bus_mailbox.publish_status({"k": 2})
    assert watcher.request_status_line(0.01) is None, "earlier lines are discarded"
    watcher.close()
    assert not watcher.path.exists()
    bus_mailbox.close()


def test_paths_differ_for_each_bus_and_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    specs = ["local:x", "local:y", "socketcan:can0", "slcan:/dev/ttyACM0"]
    paths = {path(spec) for spec in specs for path in (mailbox_path, truth_path)} | {
        local_bus_path("x")
    }
    assert len(paths) == 9
    assert all(path.parent == run_dir() for path in paths), "all sockets are in the run folder"
    monkeypatch.delenv("HANDCTL_RUN_DIR")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert run_dir() == tmp_path / "handctl"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run_dir() == tmp_path / f"handctl-{os.getuid()}" / "handctl"
