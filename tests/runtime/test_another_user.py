"""Test the protection against another user of the machine.

The folder for the sockets of handctl is private. A request to the controller counts as done only
after the controller has confirmed it. A test that needs a second user forks a process, and the
forked process switches to the second user. Without root rights, tests with a second user are
skipped.
"""

import json
import os
import select
import shutil
import signal
import socket
import stat
import tempfile
import threading
import time
from pathlib import Path

import pytest

from firmware_sim import socket_paths as simulated
from firmware_sim.bus.hub import BusHub
from firmware_sim.description.hand_description import SimulatorError
from handctl.cli.main import main
from handctl.errors import BusError, PowerError, UnconfirmedError
from handctl.programs.requests import describe_request, parse_request
from handctl.runtime.buses.local_bus import connect_to_hub
from handctl.runtime.confirmed_requests import request_action, send_with_confirmation
from handctl.runtime.mailbox import Mailbox, StatusWatcher
from handctl.runtime.socket_paths import mailbox_path, run_dir
from tests.runtime.processes import (
    LOCAL_BUS,
    end_process,
    modes_of_complete_log,
    process_result,
    run_handctl,
    start_handctl,
    wait_for_phase,
)

NOBODY_UID = 65534
SECOND_USER = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
UNCONFIRMED_TEXT = "no confirmation from the controller: switch the power off"


def call_as_user_nobody(function) -> str:
    """Call a function in a process of the user ``nobody``.

    Return the result of the function as text, or the name of the error that it raises.
    """
    out, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        answer = "failed"
        try:
            os.setgroups([])
            os.setresgid(NOBODY_UID, NOBODY_UID, NOBODY_UID)
            os.setresuid(NOBODY_UID, NOBODY_UID, NOBODY_UID)
            answer = str(function())
        except OSError as error:
            answer = type(error).__name__
        finally:
            os.write(write_end, answer.encode())
            os._exit(0)
    os.close(write_end)
    with os.fdopen(out) as pipe:
        answer = pipe.read()
    os.waitpid(child, 0)
    return answer


@pytest.fixture
def shared_tmp(monkeypatch):
    """Return a folder for temporary files in which every user is allowed to write, as in /tmp.

    The run directory (the folder for sockets) is inside the returned folder.
    """
    folder = Path(tempfile.mkdtemp(prefix="h-"))
    folder.chmod(0o1777)
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    monkeypatch.delenv("HANDCTL_RUN_DIR", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    yield folder
    shutil.rmtree(folder)


def folder_of_nobody(shared_tmp: Path) -> Path:
    return shared_tmp / f"handctl-{os.geteuid()}"


def check_refusals(expected_word: str) -> None:
    """Check that handctl and the simulator refuse the run directory, and that no controller confirms a request.

    Check that the reason of each refusal contains ``expected_word``.
    """
    for refused in (
        lambda: Mailbox("local:x"),
        lambda: StatusWatcher("local:x"),
        lambda: connect_to_hub("x"),
        run_dir,
    ):
        with pytest.raises(BusError, match=expected_word) as caught:
            refused()
        assert "\n" not in str(caught.value)
        assert "HANDCTL_RUN_DIR" in str(caught.value)
    with pytest.raises(UnconfirmedError, match=UNCONFIRMED_TEXT):
        request_action("local:x", "stop")
    for refused in (lambda: BusHub("x"), simulated.run_dir):
        with pytest.raises(SimulatorError, match=expected_word) as caught:
            refused()
        assert "\n" not in str(caught.value)


@SECOND_USER
@pytest.mark.parametrize("folder_mode", [0o777, 0o700])
@pytest.mark.parametrize("has_run_folder", [False, True])
def test_a_folder_that_another_user_made_is_refused(
    shared_tmp, folder_mode, has_run_folder, capsys
):
    folder = folder_of_nobody(shared_tmp)

    def create_folder():
        folder.mkdir()
        if has_run_folder:
            (folder / "handctl").mkdir()
            (folder / "handctl").chmod(folder_mode)
        folder.chmod(folder_mode)
        return "made"

    assert call_as_user_nobody(create_folder) == "made"
    assert folder.stat().st_uid == NOBODY_UID
    check_refusals("belongs to user nobody|belongs to another user")
    assert main(["stop", "--bus", "local:x"]) == 71
    assert main(["run", "--bus", "local:x"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert UNCONFIRMED_TEXT in lines[0]
    assert "belongs to user nobody" in lines[-1]


@SECOND_USER
def test_a_folder_above_that_another_user_owns_or_can_write_in_is_refused(shared_tmp, monkeypatch):
    """The owner of the parent folder could rename the private run directory, and create another folder in its place."""
    parent_folder = shared_tmp / "above"
    parent_folder.mkdir()
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(parent_folder / "run"))
    run_dir()
    parent_folder.chmod(0o777)
    check_refusals(r"above: is open to others \(mode 0777\)")
    parent_folder.chmod(0o755)
    os.chown(parent_folder, NOBODY_UID, NOBODY_UID)
    check_refusals("above: belongs to")


@pytest.mark.parametrize("has_run_folder", [False, True])
def test_a_folder_that_others_can_write_in_is_refused(shared_tmp, has_run_folder):
    folder = run_dir() if has_run_folder else run_dir().parent
    folder.chmod(0o777)
    check_refusals(r"is open to others \(mode 0777\)")
    folder.chmod(0o770)
    check_refusals(r"is open to others \(mode 0770\)")


@pytest.mark.parametrize("make_folder", [run_dir, simulated.run_dir])
def test_a_new_or_readable_folder_is_made_private(shared_tmp, make_folder):
    """If the parent folder of the run directory has the mode 0755, handctl makes the parent folder private, too.

    Earlier versions of handctl created the parent folder with the mode 0755.
    """
    folder = make_folder()
    assert folder == folder_of_nobody(shared_tmp) / "handctl"
    for path in (folder, folder.parent):
        assert stat.S_IMODE(path.stat().st_mode) == 0o700
        path.chmod(0o755)
    assert make_folder() == folder
    assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, folder.parent)] == [0o700, 0o700]


@pytest.mark.parametrize("has_run_folder", [False, True])
def test_a_link_is_refused(shared_tmp, has_run_folder):
    """handctl refuses a run directory that is a symbolic link, whatever the owner and the target of the link are."""
    target = shared_tmp / "elsewhere"
    target.mkdir(mode=0o700)
    if has_run_folder:
        folder_of_nobody(shared_tmp).mkdir(mode=0o700)
    link = (
        folder_of_nobody(shared_tmp) / "handctl" if has_run_folder else folder_of_nobody(shared_tmp)
    )
    link.symlink_to(target)
    check_refusals("is a link")


@SECOND_USER
def test_a_link_of_another_user_above_is_refused(shared_tmp, monkeypatch):
    (shared_tmp / "own").mkdir(mode=0o700)
    assert (
        call_as_user_nobody(lambda: (shared_tmp / "link").symlink_to(shared_tmp / "own")) == "None"
    )
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(shared_tmp / "link" / "run"))
    check_refusals("link: is a link")


@SECOND_USER
def test_a_stop_does_not_reach_another_user_s_socket_in_place_of_the_mailbox(
    shared_tmp, short_confirmation_wait
):
    """In this test, an attacker renames a controller's mailbox, and binds another socket to the old path.

    Without a protection, the attacker's socket would receive the requests for the hand.
    """
    box = Mailbox("local:x")
    folder = run_dir()
    renamed_mailbox = folder / "aside"
    mailbox = Path(box.path)
    received = []

    def take():
        mailbox.rename(renamed_mailbox)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.bind(str(mailbox))
            os.chmod(mailbox, 0o777)
            os.write(ready, b"x")
            select.select([over], [], [], 6.0)
            return link.recv(4096, socket.MSG_DONTWAIT).decode()

    assert call_as_user_nobody(lambda: mailbox.rename(renamed_mailbox)) == "PermissionError"
    assert call_as_user_nobody(
        lambda: socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).connect(str(mailbox))
    ) == ("PermissionError")
    for path in (folder, folder.parent):  # from here on, another user has access to the mailbox
        path.chmod(0o777)
    started, ready = os.pipe()
    over, finish = os.pipe()
    attacking_thread = threading.Thread(target=lambda: received.append(call_as_user_nobody(take)))
    attacking_thread.start()
    os.read(started, 1)
    assert mailbox.stat().st_uid == NOBODY_UID, "the socket of the other user replaces the mailbox"
    with pytest.raises(UnconfirmedError, match=UNCONFIRMED_TEXT):
        request_action("local:x", "stop")
    os.write(finish, b"x")
    attacking_thread.join()
    assert received == ["BlockingIOError"], "the other user received no message"
    for end_of_pipe in (started, ready, over, finish):
        os.close(end_of_pipe)
    box.close()


@SECOND_USER
def test_requests_and_status_lines_of_another_user_are_ignored(shared_tmp):
    """The controller ignores requests of other users even if the folder of the mailbox is open to them.

    With each datagram, Linux gives the receiver the user id of the sender.
    """
    box = Mailbox("local:x")
    watcher = StatusWatcher("local:x")
    for path in (watcher.path, Path(box.path)):
        path.chmod(0o777)
    for path in (run_dir(), run_dir().parent):
        path.chmod(0o777)

    def send(path, text):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            return out.sendto(text, str(path)) and "sent"

    assert call_as_user_nobody(lambda: send(box.path, b'{"do": "stop"}')) == "sent"
    assert call_as_user_nobody(lambda: send(watcher.path, b'{"mode": "DONE"}')) == "sent"
    assert watcher.next_status_line(0.1) is None
    assert box.read_requests() == ()
    send(box.path, b'{"do": "arm"}')
    assert box.read_requests() == ('{"do": "arm"}',), (
        "positive control: the request of this user is read"
    )
    box.socket.sendto(b'{"mode": "READY"}', str(watcher.path))
    assert watcher.next_status_line(0.1) == {"mode": "READY"}
    watcher.close()
    box.close()


@SECOND_USER
def test_a_hub_accepts_only_its_own_user(shared_tmp):
    hub = BusHub("x")
    folder = run_dir()
    for path in (folder / "x.bus", folder, folder.parent):
        path.chmod(0o777)

    def open_hub_connection():
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
            link.connect(str(folder / "x.bus"))
            return "joined"

    assert call_as_user_nobody(open_hub_connection) == "joined"
    hub.serve(hub.read_sockets())
    assert hub.client_count == 0
    for path in (folder.parent, folder):
        path.chmod(0o700)
    link = connect_to_hub("x")
    hub.serve(hub.read_sockets())
    assert hub.client_count == 1
    link.close()
    hub.close()


class AnsweringController:
    """Thread that serves the mailbox of a bus in place of a controller.

    The thread sends the same event texts as a controller.
    """

    def __init__(self, final_action: str = "DISARM -> DONE", text_before_silence: str = "") -> None:
        self.box = Mailbox(LOCAL_BUS)
        self.taken = []
        self._on = True
        self._end = final_action
        self._deaf = text_before_silence
        self.thread = threading.Thread(target=self._run)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self._on = False
        self.thread.join()
        self.box.close()

    def _run(self):
        mode = "ACTIVE"
        k = 0
        while self._on:
            k += 1
            events = [
                {"name": "request", "where": "", "text": describe_request(parse_request(text))}
                for text in self.box.read_requests()
            ]
            self.taken += [event["text"].split()[1] for event in events]
            line = {"k": k, "t_s": k * 0.002, "mode": mode, "phase": "", "events": events}
            if mode == "RELAX" and (
                self.box.watchers or self._deaf
            ):  # wait until a client has subscribed to the status of the controller
                mode = "" if self._deaf == "RELAX" else "DONE"
                line |= {"mode": mode, "events": [{"name": "mode", "where": "", "text": self._end}]}
            if mode == "ACTIVE" and "stop" in self.taken:
                mode = "RELAX"
            if mode:
                self.box.publish_status(line)
            if mode == "DONE":
                return
            time.sleep(0.002)


def test_stop_ends_when_the_controller_reports_every_drive_off(work_folder, capsys):
    with AnsweringController() as controller:
        assert main(["stop", "--bus", LOCAL_BUS, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "asked": "stop",
        "bus": LOCAL_BUS,
        "confirmed": True,
        "mode": "DONE",
    }
    assert controller.taken == ["stop"]


def test_stop_names_a_drive_that_stays_on(work_folder, capsys):
    with AnsweringController("DISARM -> DONE: REMOVE POWER: not confirmed disabled: index_motor"):
        assert main(["stop", "--bus", LOCAL_BUS]) == 71
    assert "REMOVE POWER: not confirmed disabled: index_motor" in capsys.readouterr().err


@pytest.fixture
def short_confirmation_wait(monkeypatch):
    """Let a request wait for its confirmation for at most 0.4 s."""
    monkeypatch.setattr("handctl.runtime.confirmed_requests.CONFIRMATION_TIMEOUT_S", 0.4)


def test_stop_is_unconfirmed_if_the_controller_falls_silent(
    work_folder, short_confirmation_wait, capsys
):
    with AnsweringController(text_before_silence="RELAX"):
        assert main(["stop", "--bus", LOCAL_BUS]) == 71
    assert UNCONFIRMED_TEXT in capsys.readouterr().err


def test_clear_ends_when_the_controller_has_taken_it(work_folder, capsys):
    with AnsweringController() as controller:
        assert main(["clear", "--bus", LOCAL_BUS]) == 0
    assert controller.taken == ["clear"]
    assert "has cleared its faults" in capsys.readouterr().out


def test_a_request_is_confirmed_although_all_watcher_slots_are_taken(work_folder):
    other_watchers = [StatusWatcher(LOCAL_BUS) for _ in range(6)]
    with AnsweringController() as controller:
        until = time.monotonic() + 1.0

        def occupy_watcher_slots():
            while time.monotonic() < until:
                for other_watcher in other_watchers:
                    other_watcher.request_status_line(0.0)

        occupying_thread = threading.Thread(target=occupy_watcher_slots)
        occupying_thread.start()
        watcher = StatusWatcher(LOCAL_BUS)
        for _ in range(20):
            assert send_with_confirmation(watcher, {"do": "arm"})[1] == []
        watcher.close()
        occupying_thread.join()
    assert controller.taken.count("arm") == 20
    for other_watcher in other_watchers:
        other_watcher.close()


def fill_mailbox(mailbox_path: Path) -> int:
    """Send datagrams to the mailbox at a path until the mailbox is full, and return the number of datagrams."""
    count = 0
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        try:
            while True:
                out.sendto(b'{"do": "arm"}', str(mailbox_path))
                count += 1
        except BlockingIOError:
            return count


@pytest.mark.parametrize("request_kind", ["stop", "cut", "clear"])
@pytest.mark.parametrize("mailbox_is_full", [False, True])
def test_an_unread_mailbox_confirms_nothing_and_blocks_no_client(
    work_folder, short_confirmation_wait, request_kind, mailbox_is_full
):
    box = Mailbox(LOCAL_BUS)
    if mailbox_is_full:
        assert fill_mailbox(box.path)
    start_time_s = time.monotonic()
    with pytest.raises(UnconfirmedError, match=UNCONFIRMED_TEXT) as caught:
        request_action(LOCAL_BUS, request_kind)
    assert time.monotonic() - start_time_s < 2.4
    assert isinstance(caught.value, PowerError)
    assert ("its mailbox is full" if mailbox_is_full else "the controller is silent") in str(
        caught.value
    )
    box.close()


@pytest.mark.realtime
def test_a_paused_controller_confirms_no_stop_and_a_flooded_one_stops(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    process = start_handctl(
        "run",
        *calibration_options,
        "--task",
        "long.toml",
        "--json",
        "--log",
        "run.mcap",
        *time_scale_options,
    )
    try:
        watcher = StatusWatcher(LOCAL_BUS)
        wait_for_phase("stay", watcher, process)
        watcher.close()
        process.send_signal(signal.SIGSTOP)
        for word in (("clear",), ("stop",)):
            done = run_handctl(*word, "--bus", LOCAL_BUS)
            assert (done.returncode, done.stdout) == (71, "")
            assert UNCONFIRMED_TEXT in done.stderr
        fill_mailbox(mailbox_path(LOCAL_BUS))
        assert run_handctl("stop", "--cut", "--bus", LOCAL_BUS).returncode == 71
        process.send_signal(signal.SIGCONT)
        assert process_result(process)[0] in (0, 1), (
            "the controller paused (H03), and reads the orders after the pause"
        )
    finally:
        process.send_signal(signal.SIGCONT)
        end_process(process)


@pytest.mark.realtime
def test_a_flooded_mailbox_still_takes_a_stop(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    process = start_handctl(
        "run",
        *calibration_options,
        "--task",
        "long.toml",
        "--json",
        "--log",
        "run.mcap",
        *time_scale_options,
    )
    ended_event = threading.Event()

    def flood_mailbox():
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            while not ended_event.is_set():
                try:
                    out.sendto(b'{"do": "arm"}', str(mailbox_path(LOCAL_BUS)))
                except OSError:
                    return

    flooding_thread = threading.Thread(target=flood_mailbox)
    try:
        watcher = StatusWatcher(LOCAL_BUS)
        wait_for_phase("stay", watcher, process)
        watcher.close()
        flooding_thread.start()
        done = run_handctl("stop", "--bus", LOCAL_BUS)
        assert done.returncode == 0, done.stderr
        assert process_result(process)[0] == 0
    finally:
        ended_event.set()
        end_process(process)
        flooding_thread.join()
    assert modes_of_complete_log(work_folder / "run.mcap")[-1] == "DISARM -> DONE"
