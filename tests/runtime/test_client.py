"""Test the Python client of a running hand: its requests, the replies, the errors, and the end of a run."""

import json
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest

import handctl as library
from handctl import BusError, ConfigError, DriveError, PowerError
from handctl.client import HandClient
from handctl.runtime.mailbox import StatusWatcher, is_running
from tests.runtime.processes import (
    LOCAL_BUS,
    modes_of_complete_log,
    run_handctl,
    start_handctl,
    wait_for_phase,
)

REALTIME_MARK = pytest.mark.realtime
CLIENT_PROGRAM = """
import handctl, time
with handctl.connect("jamia", "local:t", *{words}):
    print("live", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def unserved_client(work_folder):
    """Return a Python client for a bus on which no controller runs."""
    client = HandClient("local:nobody")
    yield client
    client.close()


@pytest.mark.parametrize("angle", [3, np.float32(3), np.float64(3), np.int64(3), Fraction(3)])
def test_every_numeric_type_is_accepted(unserved_client, angle, monkeypatch):
    requests = []
    monkeypatch.setattr(unserved_client, "_set_goal", requests.append)
    unserved_client.move(index=angle, duration_s=angle, wait=False)
    unserved_client.hold(index=angle, rate_N_per_s=angle)
    assert requests[0] == {"do": "move", "angle_deg": {"index": 3.0}, "duration_s": 3.0}
    assert requests[1] == {"do": "hold", "tension_N": {"index": 3.0}, "rate_N_per_s": 3.0}


@pytest.mark.parametrize(
    "invalid_angle", [float("nan"), 10**400, "3", True, np.True_, None, np.array([3.0, 4.0]), 1e9]
)
def test_an_invalid_angle_is_refused_before_it_is_sent(unserved_client, invalid_angle):
    """The client refuses an invalid angle before it sends a request.

    If the client sent invalid angles, the controller would refuse the requests. After three refused
    requests within a second, the controller would relax the hand.
    """
    with pytest.raises(ConfigError, match=r"move: angle_deg.index: .*; expected"):
        unserved_client.move(index=invalid_angle)


def status_with_events(*event_texts):
    return {
        "t_s": 1.5,
        "mode": "ACTIVE",
        "events": [{"name": "request", "text": text} for text in event_texts],
    }


@pytest.mark.parametrize(
    "foreign_reply", ["refused: no digit 'x'", "request: Invalid JSON", "move index 3"]
)
def test_replies_to_other_programs_are_ignored(unserved_client, monkeypatch, foreign_reply):
    """Reproduce a defect: if two programs used one hand, a program reported the other program's refused requests."""
    sent = []
    monkeypatch.setattr(
        unserved_client._watcher, "send", lambda data, timeout: sent.append(json.loads(data))
    )
    monkeypatch.setattr(
        unserved_client, "_wait_until_following", lambda timeout: status_with_events()
    )

    def fake_status_lines(timeout):
        yield status_with_events("asked: move by somebody", foreign_reply)
        yield status_with_events(
            foreign_reply,
            f"asked: move by {sent[-1]['by']}",
            reply,
            "asked: move by somebody",
            foreign_reply,
        )

    monkeypatch.setattr(unserved_client._watcher, "status_lines", fake_status_lines)
    reply = "move index 3"
    unserved_client.move(index=3, wait=False)
    reply = "refused: the hand is not ready yet"
    with pytest.raises(ConfigError, match="the hand is not ready yet"):
        unserved_client.move(index=3, wait=False)
    assert len({request["by"] for request in sent}) == 2
    unserved_client._has_commanded = False


def test_a_goal_without_a_digit_is_refused(unserved_client):
    with pytest.raises(ConfigError, match="move: no digit; expected"):
        unserved_client.move()


def test_a_hold_without_a_tension_brings_the_hand_to_rest(unserved_client, monkeypatch):
    requests = []
    monkeypatch.setattr(unserved_client, "_set_goal", requests.append)
    unserved_client.hold()
    unserved_client.hold({})
    assert requests == [{"do": "stay"}] * 2


def test_digits_may_come_as_a_mapping(unserved_client, monkeypatch):
    """Reproduce a defect.

    If a user passed a mapping of digits to ``move`` or ``hold`` as the first argument, the client
    used the mapping as the duration of the motion, and raised the error "no digit".
    """
    requests = []
    monkeypatch.setattr(unserved_client, "_set_goal", requests.append)
    unserved_client.move({"index": 10}, thumb=5, wait=False)
    unserved_client.hold({"index": 10})
    goals = [request.get("angle_deg", request.get("tension_N")) for request in requests]
    assert goals == [{"index": 10.0, "thumb": 5.0}, {"index": 10.0}]
    for do in (unserved_client.move, unserved_client.hold):
        with pytest.raises(
            ConfigError, match=r"(move|hold): 2.0; expected digits by name, as in index=30"
        ):
            do(2.0)
        with pytest.raises(
            ConfigError, match="index is given twice; expected one value for each digit"
        ):
            do({"index": 1}, index=2)
    with pytest.raises(ConfigError, match="no digit; expected one at least"):
        unserved_client.move({})


def test_an_unknown_space_of_a_stream_names_all_spaces(unserved_client):
    """Reproduce a defect: the error message about an invalid option ``space`` did not list the value ``fingertip``."""
    expected_message = (
        "stream.space: 'torque'; expected joint or digit or tension or tip_force or fingertip"
    )
    with pytest.raises(ConfigError, match=expected_message):
        unserved_client.stream(100, space="torque")


def test_the_names_of_a_stream_are_a_list(unserved_client):
    """Reproduce a defect: if a user gave one digit name instead of a list, the client took each letter as a name.

    For the digit name ``index``, the user got the error message "no digit 'i'".
    """
    with pytest.raises(
        ConfigError, match=r"stream.names: 'index'; expected a list, as in \['index'\]"
    ):
        unserved_client.stream(50, "digit", "index")


def test_a_silent_controller_is_one_line(unserved_client):
    with pytest.raises(BusError, match="the controller is silent"):
        unserved_client.state(-1.0)
    unserved_client.close()
    for ask in (
        unserved_client.state,
        lambda: unserved_client.move(index=3),
        lambda: unserved_client.wait("live", 1.0),
    ):
        with pytest.raises(BusError, match="this client is closed"):
            ask()


@pytest.mark.parametrize("bus", ["bogus", [], ""])
def test_an_invalid_bus_starts_no_controller(work_folder, bus):
    with pytest.raises(ConfigError, match="bus"):
        library.connect("jamia", bus)


def test_a_path_too_long_for_a_socket_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / ("x" * 120)))
    with pytest.raises(BusError, match="HANDCTL_RUN_DIR"):
        library.connect("jamia", LOCAL_BUS)


def test_dir_lists_the_public_names():
    assert set(library.__all__) <= set(dir(library))
    with pytest.raises(AttributeError, match="module 'handctl' has no attribute 'conect'"):
        library.conect  # noqa: B018


def wait_until(is_condition_met, timeout_s=60.0):
    end = time.monotonic() + timeout_s
    while not is_condition_met() and time.monotonic() < end:
        time.sleep(0.02)
    assert is_condition_met()


@REALTIME_MARK
def test_connect_reports_why_the_controller_ends(work_folder, capfd):
    with pytest.raises(
        DriveError, match="the controller ended: local:nobody: no simulator serves this bus"
    ):
        library.connect("jamia", "local:nobody").__enter__()
    assert "no simulator serves this bus" in capfd.readouterr().err


def test_arguments_for_a_controller_that_already_runs_are_refused(work_folder, monkeypatch):
    monkeypatch.setattr("handctl.client.hand.is_running", lambda bus: True)
    with pytest.raises(ConfigError, match=r"already runs.*--log x\.mcap.*handctl stop"):
        library.connect("jamia", LOCAL_BUS, "--yes", "--log", "x.mcap")
    library.connect("jamia", LOCAL_BUS, "--yes").close()


@REALTIME_MARK
def test_a_program_moves_holds_and_reads_the_state(
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
        client.move(duration_s=0.4, wait=False, index=30.0)
        client.wait("live", 5.0)
        angle_deg = 0.0
        for _ in range(200):
            angle_deg = float(np.degrees(client.state()["q_rad"][0]))
            if angle_deg > 28.0:
                break
        assert angle_deg == pytest.approx(30.0, abs=2.0)
        with pytest.raises(
            ConfigError, match="no digit 'indx', expected one of index, middle, ring, thumb"
        ):
            client.move(indx=30.0)
        with pytest.raises(ConfigError, match="move: duration_s: -1"):
            client.move(duration_s=-1.0, index=30.0)
        before_s = client.state()["t_s"]
        client.move(duration_s=0.5, index=30.0)
        assert client.state()["t_s"] >= before_s + 0.5, (
            "the duration is in the slower time of the hand"
        )
        with library.connect("jamia", LOCAL_BUS) as other_client:
            assert other_client.state()["phase"] == "live"
        assert client.state()["mode"] == "ACTIVE", "a client without requests does not end the run"
        client.hold(thumb=12.0)
        for _ in range(200):
            state = client.state()
            if abs(state["tension_N"][3] - 12.0) < 1.0:
                break
        assert state["tension_N"][3] == pytest.approx(12.0, abs=1.5)
        assert state["mode"] == "ACTIVE"
    assert client.child.returncode == 0
    assert client.result["log"] == "live.mcap"
    modes_of_complete_log(work_folder / "live.mcap")


@REALTIME_MARK
def test_a_stopped_run_and_a_closed_client_are_named(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    """Reproduce a defect: the error message about a stopped run quoted an unrelated notice of the controller.

    Earlier defect: a client that was used after its ``with`` block raised the error "mmap closed or
    invalid".
    """
    with library.connect(
        "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
    ) as client:
        with library.connect("jamia", LOCAL_BUS) as other_client:
            ticks = other_client.observations()
            next(ticks)
        # Earlier defect: a program that asked for another hand than the running one got a client of
        # the running hand, without any error.
        with (
            pytest.raises(
                ConfigError, match=r"controls jamia; expected hand='jamia', or the bus of"
            ),
            library.connect("t42", LOCAL_BUS),
        ):
            pass
        for client_method in (
            other_client.observe,
            lambda: next(ticks),
            lambda: next(other_client.observations()),
        ):
            with pytest.raises(BusError, match="this client is closed"):
                client_method()
        assert run_handctl("stop", "--bus", LOCAL_BUS).returncode == 0
        for client_method in (lambda: client.move(index=10.0), client.observe):
            with pytest.raises(DriveError, match="the controller ended: it was stopped"):
                client_method()
    for client_method in (lambda: client.move(index=10.0), client.observe, client.state):
        with pytest.raises(BusError, match="this client is closed"):
            client_method()


@REALTIME_MARK
def test_every_thread_gets_the_end_of_the_run(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    """Reproduce a defect: threads that shared a client raised "Bad file descriptor" and "flush of closed file".

    At the end of the run, all threads that share a client read the output of the controller.
    """
    client = library.connect(
        "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
    ).open()
    calls = [client.state, lambda: client.observe(wait=True), client.state] * 2
    calls.append(lambda: client.move(index=10.0, duration_s=0.2))

    def repeat_until_exception(client_method):
        while True:
            client_method()

    with ThreadPoolExecutor(len(calls)) as threads:
        running = [threads.submit(repeat_until_exception, client_method) for client_method in calls]
        assert run_handctl("stop", "--bus", LOCAL_BUS).returncode == 0
        exceptions = [future.exception(60.0) for future in running]
    # The controller refuses a goal that arrives while the hand relaxes. A refused goal is an error
    # of the caller.
    expected_errors = {
        DriveError: "the controller ended: it was stopped|the hand no longer accepts goals",
        ConfigError: "the hand is letting go",
    }
    for error in exceptions:
        assert re.search(expected_errors[type(error)], str(error))
    client.close()
    assert client.result["failure"] == ""


@REALTIME_MARK
def test_a_fault_is_reported_by_name(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    client = library.connect(
        "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
    )
    with client:
        assert (
            run_handctl(
                "fault", "inject", "--bus", LOCAL_BUS, "snap tendon=index_tendon"
            ).returncode
            == 0
        )
        with pytest.raises(DriveError, match="the controller ended: fault "):
            client.move(index=60.0, duration_s=5.0)
        with pytest.raises(DriveError, match="the controller ended: fault "):
            client.state()
    assert client.result["failure"].startswith("fault ")


@REALTIME_MARK
def test_a_fault_between_two_calls_is_reported_at_the_end(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    client = library.connect(
        "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
    )
    client.wait("live", 60.0)
    assert (
        run_handctl("fault", "inject", "--bus", LOCAL_BUS, "off node=index_motor").returncode == 0
    )
    wait_until(lambda: not is_running(LOCAL_BUS))
    with pytest.raises(
        PowerError, match=r"fault .*; REMOVE POWER: not confirmed disabled: index_motor"
    ):
        client.close()


@REALTIME_MARK
def test_a_task_of_another_program_goes_on(
    work_folder,
    hand_truth_file,
    calibration_options,
    started_processes,
    monkeypatch,
    time_scale_options,
):
    monkeypatch.setattr("handctl.client.hand.ATTACH_TIMEOUT_S", 1.0)
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
    started_processes.append(process)
    watcher = StatusWatcher(LOCAL_BUS)
    wait_for_phase("stay", watcher, process)
    watcher.close()
    with (
        pytest.raises(DriveError, match=r"not in phase 'live' after 1 s: phase 'stay'"),
        library.connect("jamia", LOCAL_BUS),
    ):
        pass
    time.sleep(1.0)
    assert process.poll() is None
    assert is_running(LOCAL_BUS)


def start_program(processes, *connect_options):
    """Start a program that connects to the hand and stays connected for a minute."""
    code = CLIENT_PROGRAM.format(words=connect_options)
    program = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    processes.append(program)
    return program


@REALTIME_MARK
def test_ctrl_c_while_it_starts_leaves_no_controller(
    work_folder, hand_truth_file, started_processes, time_scale_options
):
    program = start_program(started_processes, "--log", "live.mcap", *time_scale_options)
    wait_until(lambda: is_running(LOCAL_BUS))
    program.send_signal(signal.SIGINT)
    _, err = program.communicate(timeout=60.0)
    assert "KeyboardInterrupt" in err
    assert not is_running(LOCAL_BUS)
    time.sleep(2.0)
    assert not is_running(LOCAL_BUS), "the controller does not continue after commissioning"


@REALTIME_MARK
def test_a_program_that_is_killed_leaves_no_armed_hand(
    work_folder, hand_truth_file, calibration_options, started_processes, time_scale_options
):
    program = start_program(
        started_processes, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
    )
    assert program.stdout.readline() == "live\n"
    program.kill()
    program.wait()
    wait_until(lambda: not is_running(LOCAL_BUS), 20.0)
    assert modes_of_complete_log(work_folder / "live.mcap")[-3:] == [
        "ACTIVE -> RELAX",
        "RELAX -> DISARM",
        "DISARM -> DONE",
    ]
