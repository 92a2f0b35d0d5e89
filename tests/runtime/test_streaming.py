"""Test how programs use a hand in real time.

The tests cover streams, observations, several clients, and clients that fail.
"""

import re
import select
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import handctl as library
from handctl import ConfigError, DriveError
from handctl.hand.hand_loading import load_hand
from handctl.runtime.mailbox import MAX_WATCHERS, SUBSCRIBE_REQUEST, Mailbox, StatusWatcher
from tests.runtime.processes import (
    LOCAL_BUS,
    READY_TIMEOUT_S,
    modes_of_complete_log,
    run_handctl,
    start_handctl,
)

REALTIME_MARK = pytest.mark.realtime
PAGE_TEXT = (Path(__file__).parents[2] / "docs" / "how-to" / "python.md").read_text()


@pytest.fixture
def connected_client(work_folder, hand_truth_file, calibration_options, time_scale_options):
    """Return a client that has started the controller of a simulated hand."""
    with library.connect(
        "jamia",
        f"main={LOCAL_BUS}",
        "--calibration",
        "c.toml",
        "--log",
        "live.mcap",
        *time_scale_options,
    ) as client:
        yield client


@REALTIME_MARK
def test_a_stream_is_followed_observed_logged_and_repeated(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    with library.connect(
        "jamia",
        f"main={LOCAL_BUS}",
        "--calibration",
        "c.toml",
        "--log",
        "live.mcap",
        *time_scale_options,
    ) as client:
        client.move(index=30.0)
        observed_ticks, ready = [], threading.Event()

        def watch():
            with library.connect("jamia", LOCAL_BUS) as other_client:
                for observation in other_client.observations():
                    ready.set()
                    observed_ticks.append(
                        (
                            observation.k,
                            observation.q_deg[:3].mean(),
                            np.degrees(observation.q_goal_rad[0]),
                        )
                    )
                    if len(observed_ticks) == 1000:
                        return

        watcher = threading.Thread(target=watch)
        watcher.start()
        assert ready.wait(20.0)
        with client.stream(rate_Hz=100, space="digit", names=["index"]) as stream:
            for i in range(200):
                stream.send({"index": 30.0 + 15.0 * np.sin(2 * np.pi * i / 100)})
                stream.sleep()
            status = stream.status
        watcher.join(30.0)
        assert status.accepted == stream.sent > 190
        assert (status.refused, status.late, status.clipped) == (0, 0, 0)
        ticks = np.array([k for k, *_ in observed_ticks])
        assert (np.diff(ticks) == 1).mean() > 0.99, "every tick, in order"
        q, goal = np.array([row[1:] for row in observed_ticks]).T
        assert np.ptp(q) > 20.0
        assert np.sqrt(np.mean((q - goal)[100:] ** 2)) < 1.0
        with pytest.raises(DriveError, match="this stream is closed"):
            stream.send([1.0])
    assert client.result["failure"] == ""
    modes_of_complete_log(work_folder / "live.mcap")
    repeated_process_result = run_handctl("replay", "execute", "live.mcap")
    assert repeated_process_result.returncode == 0
    assert " 0 differ" in repeated_process_result.stdout


@REALTIME_MARK
def test_a_move_ends_with_an_error_if_another_client_takes_over(connected_client):
    """Reproduce a defect: if another client stopped a move, the move counted as complete.

    The method ``move``, which waits for the end of the move, returned without an error.
    """
    ended = []

    def move():
        try:
            connected_client.move(index=30.0, duration_s=5.0)
        except library.HandctlError as error:
            ended.append(str(error))

    move_thread = threading.Thread(target=move)
    move_thread.start()
    with library.connect("jamia", LOCAL_BUS) as other_client:
        assert other_client.wait_for(phase="live").mode == "ACTIVE"
        time.sleep(0.5)
        other_client.take_over()
        move_thread.join(5.0)
        assert ended == [
            f"bus {LOCAL_BUS}: {other_client.name} has taken over the hand; expected take_over"
        ]


@REALTIME_MARK
def test_only_one_of_several_clients_commands_the_hand(connected_client):
    """Reproduce a defect: when one of several clients disconnected, the hand stopped.

    Another defect: two threads of one client did not get the results of their moves.
    """
    connected_client.move(index=10.0, duration_s=0.3)
    with library.connect("jamia", LOCAL_BUS) as other_client:
        assert other_client.observe().mode == "ACTIVE"
        with pytest.raises(
            ConfigError, match=f"{connected_client.name} commands this hand, expected take_over"
        ):
            other_client.move(thumb=5.0)
        other_client.take_over()
        other_client.move(thumb=5.0, duration_s=0.3)
        with pytest.raises(ConfigError, match=f"{other_client.name} commands this hand"):
            connected_client.hold(thumb=8.0)
    connected_client.move(thumb=0.0, duration_s=0.3)
    assert connected_client.observe().mode == "ACTIVE", (
        "the hand continues without the other client"
    )
    errors = []

    def move(**angles):
        try:
            connected_client.move(duration_s=0.3, **angles)
        except library.HandctlError as error:
            errors.append(error)

    threads = [
        threading.Thread(target=move, kwargs={name: 10.0}) for name in ("index", "middle", "ring")
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert connected_client.observe(wait=True).q_deg[:9] == pytest.approx(10.0, abs=3.0)
    with pytest.raises(ConfigError, match="wait_for: no digit 'pinky'; expected one of"):
        connected_client.wait_for(contact="pinky")
    with pytest.raises(DriveError, match=r"condition not met after 0.1 s"):
        connected_client.wait_for(contact="index", timeout_s=0.1)
    assert connected_client.wait_for(phase="live").phase == "live"


def test_every_watcher_gets_its_lines(work_folder):
    """Every client that has subscribed to the status (a watcher) gets status lines.

    Earlier defect: when a fifth watcher subscribed, the first watcher got no more status lines.
    """
    box = Mailbox("local:many")
    watchers = [StatusWatcher("local:many") for _ in range(MAX_WATCHERS + 3)]
    for watcher in watchers:
        watcher.send(SUBSCRIBE_REQUEST, 1.0)
        box.read_requests()
    box.publish_status({"k": 1})
    has_status_line = [watcher.next_status_line(0.0) is not None for watcher in watchers]
    assert all(has_status_line[:MAX_WATCHERS])
    for watcher in watchers[MAX_WATCHERS:]:
        watcher.send(SUBSCRIBE_REQUEST, 1.0)
        box.read_requests()
        box.publish_status({"k": 2})
        assert watcher.next_status_line(0.0) == {"k": 2}, (
            "a further watcher gets a line after a request"
        )
    for watcher_or_box in (*watchers, box):
        watcher_or_box.close()


@pytest.fixture
def fake_stream(work_folder):
    """Return a fake target stream, and the list of the targets that the stream sends.

    A target consists of two joint angles. The caller gives the angles in rad, and the stream sends
    the angles in deg.
    """
    from handctl.client.stream import TargetStream

    class FakeTargetSender:
        def send(self, index, sent_ns, values):
            sent_targets_deg.append(values.tolist())
            return True

        def close(self):
            pass

    sent_targets_deg = []
    stream_request = {
        "stream": "1-1",
        "names": ["index_j1", "thumb_j1"],
        "rate_Hz": 100.0,
        "space": "joint",
    }
    owner = SimpleNamespace(description=load_hand("jamia"))
    return TargetStream(
        owner, FakeTargetSender(), stream_request, "rad", 0.012, 1.0
    ), sent_targets_deg


def test_values_are_checked_before_they_are_sent(fake_stream):
    stream, sent = fake_stream
    stream.send([0.0, np.pi])
    stream.send({"index_j1": np.pi / 2})
    assert sent == [[0.0, pytest.approx(180.0)], [pytest.approx(90.0), pytest.approx(180.0)]]
    for values, text in (
        ([1.0], r"send: values of shape \(1,\); expected 2 values"),
        ({"c": 1.0}, "send: no 'c' in this stream; expected some of index_j1, thumb_j1"),
        ([1.0, np.nan], "send: thumb_j1 is not finite; expected a finite number"),
        ([np.inf, 0.0], "index_j1 is not finite"),
        ("index=3", "send: 'index=3'; expected numbers"),
        (["a", "b"], r"send: \['a', 'b'\]; expected numbers"),
        ({"index_j1": "a"}, "send: 'a'; expected numbers"),
        ({"index_j1": [1.0, 2.0]}, "send: 2 values for index_j1; expected one number"),
    ):
        with pytest.raises(ConfigError, match=text):
            stream.send(values)


def test_a_program_may_reuse_the_array_of_a_target(fake_stream):
    """Reproduce a defect: a joint got a target that the program had never sent.

    The last call of the stream contained no target for the joint. The stream had stored the
    program's array without a copy, and the program later changed its array.
    """
    stream, sent = fake_stream
    angles = np.array([0.1, 0.2])
    stream.send(angles)
    angles[:] = 9.0
    stream.send({"index_j1": 0.3})
    assert np.radians(sent[-1]) == pytest.approx([0.3, 0.2])


@pytest.mark.realtime
@pytest.mark.alone
@pytest.mark.parametrize("example", range(3))
def test_the_programs_of_the_page_run(work_folder, started_processes, time_scale_options, example):
    programs = re.findall(r"^```python[^\n]*\n(.*?)^```$", PAGE_TEXT, re.MULTILINE | re.DOTALL)
    assert len(programs) == 3
    simulator = start_handctl("sim", "--hand", "jamia", "--bus", "local:lab", *time_scale_options)
    started_processes.append(simulator)
    assert select.select([simulator.stdout], [], [], READY_TIMEOUT_S)[0]
    (work_folder / "example.py").write_text(programs[example])
    result = subprocess.run(
        [sys.executable, "example.py"], capture_output=True, text=True, timeout=300.0
    )
    assert result.returncode == 0, result.stderr[-2000:]
    assert result.stdout
