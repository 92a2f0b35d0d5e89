"""Test a client that dies or hangs while the hand holds a tension that this client has requested.

The client must regularly renew its lease: an expiring permission to command the hand. The hand must
relax when the lease of the lost client has ended. The test checks the tensions in the truth file of
the simulator.
"""

import re
import select
import signal
import subprocess
import sys
import time

import pytest

import handctl as library
from firmware_sim.truth_file import read_truth
from handctl import ConfigError, DriveError
from handctl.client.heartbeat import Heartbeat
from handctl.log.read.reader import RunLog
from handctl.runtime.mailbox import Mailbox
from tests.runtime.processes import LOCAL_BUS, READY_TIMEOUT_S

REALTIME_MARK = pytest.mark.realtime
LEASE_S = 0.6
HOLD_TENSION_N = 12.0
CLIENT_PROGRAM = f"""
import handctl, time
with handctl.connect("jamia", {LOCAL_BUS!r}, **{{options}}) as hand:
    hand.hold(index={HOLD_TENSION_N})
    hand.wait_for(phase="live")
    print("held", flush=True)
    time.sleep(100)
"""


def start_holding_client(**connect_options):
    """Start another client in a separate process.

    The started client requests a tension, and does nothing afterwards.
    """
    command = [sys.executable, "-c", CLIENT_PROGRAM.format(options=connect_options)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert select.select([process.stdout], [], [], READY_TIMEOUT_S)[0]
    assert process.stdout.readline() == "held\n"
    return process


def wait_for_run_end(client, timeout_s):
    """Wait until the run ends, and return the reason why it ended.

    The function waits for at most ``timeout_s`` seconds in the time of the hand.
    """
    start = client.observe().t_s
    try:
        while client.observe().t_s < start + timeout_s:
            time.sleep(0.02)
    except DriveError as error:
        return str(error)
    return "the run goes on"


@REALTIME_MARK
@pytest.mark.parametrize(
    "client_end",
    ["suspended", *[pytest.param(how, marks=pytest.mark.nightly) for how in ("killed", "hangs")]],
)
def test_a_lost_client_makes_the_hand_relax(
    work_folder, hand_truth_file, calibration_options, time_scale_options, client_end
):
    """Reproduce a defect: without a time limit, the hand kept the tension of a client that was lost."""
    time_scale = float(time_scale_options[1])
    client = library.connect(
        "jamia", LOCAL_BUS, "--calibration", "c.toml", "--log", "live.mcap", *time_scale_options
    ).open()
    try:
        other_client = start_holding_client(
            lease_s=LEASE_S, **({"watchdog_s": LEASE_S} if client_end == "hangs" else {})
        )
        try:
            if client_end != "hangs":
                time.sleep(3.0 * LEASE_S / time_scale)
                assert client.observe(wait=True).named("tension_N")[
                    "index_tendon"
                ] == pytest.approx(HOLD_TENSION_N, abs=2.0)
                other_client.send_signal(
                    signal.SIGKILL if client_end == "killed" else signal.SIGSTOP
                )
            last_text = wait_for_run_end(client, 8.0 * LEASE_S)
        finally:
            other_client.kill()
            other_client.communicate()
    finally:
        client.close()
    assert re.search(r"client client-\d+-\d+ has been silent for 1\.\d+ s", last_text)
    assert client.result["failure"] in last_text
    with RunLog(work_folder / "live.mcap") as log:
        assert not log.warning
        assert [row.event.level for row in log.events if row.event.name == "lease"] == [
            "warn",
            "error",
        ]
        assert not [
            row for row in log.events if row.event.name == "request" and "alive" in row.event.text
        ]
    tension = read_truth(hand_truth_file).column("tension/index_tendon")
    assert tension.max() > HOLD_TENSION_N - 3.0
    assert tension[-10:].max() < 6.0


@REALTIME_MARK
@pytest.mark.nightly
def test_a_program_that_waits_keeps_its_hold(
    work_folder, hand_truth_file, calibration_options, time_scale_options
):
    """While a program waits, a thread of its client renews the lease (an expiring permission to command the hand).

    A client without a lease sends no signs of life (requests that renew a lease) to the controller.
    """
    time_scale = float(time_scale_options[1])
    options = ("--calibration", "c.toml", "--log", "live.mcap", *time_scale_options)
    with library.connect("jamia", LOCAL_BUS, *options, lease_s=LEASE_S) as client:
        client.hold(index=HOLD_TENSION_N)
        time.sleep(4.0 * LEASE_S / time_scale)
        assert client.observe(wait=True).mode == "ACTIVE"
        client.hold()
        with library.connect("jamia", LOCAL_BUS, lease_s=None) as other_client:
            other_client.take_over()
            other_client.hold(index=HOLD_TENSION_N)
            time.sleep(4.0 * LEASE_S / time_scale)
            assert client.observe(wait=True).mode == "ACTIVE"
    assert client.result["failure"] == ""


@pytest.mark.parametrize(
    ("request_options", "expected_message"),
    [
        ({"lease_s": 0.1}, r"lease_s: 0.1; expected 0.2 to 3600 s, or None"),
        ({"lease_s": "2"}, r"lease_s: '2'; expected"),
        ({"lease_s": float("nan")}, r"lease_s: nan; expected"),
        ({"watchdog_s": True}, r"watchdog_s: True; expected"),
        ({"lease_s": None, "watchdog_s": 1.0}, r"watchdog_s: no lease; expected lease_s"),
    ],
)
def test_a_wrong_lease_is_one_line(request_options, expected_message):
    with pytest.raises(ConfigError, match=expected_message):
        library.connect("jamia", LOCAL_BUS, **request_options)


def test_a_watchdog_stops_the_signs_of_life(work_folder):
    """If a program does not call its client for too long, a watchdog in the client stops the signs of life.

    A sign of life is a request that renews the client's lease. When the program calls the client
    again, the client sends signs of life again.
    """
    box = Mailbox("local:beats")
    heartbeat_sender = Heartbeat("local:beats", "one", 0.01, 0.15)

    def count(seconds):
        end, number = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            number += len(box.read_requests())
            time.sleep(0.005)
        return number

    try:
        assert count(0.1) > 0
        count(0.3)
        assert count(0.2) == 0
        heartbeat_sender.record_call_time()
        assert count(0.1) > 0
    finally:
        heartbeat_sender.end()
        box.close()
    assert not heartbeat_sender._thread.is_alive()
