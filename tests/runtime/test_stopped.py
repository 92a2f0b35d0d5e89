"""A controller that stands still, that has company, or that is told to end: the drives let go, the log is whole."""

import os
import random
import signal
import time

import pytest

from tests.runtime.processes import BUS, end, handctl, start_hand, start_handctl
from tests.runtime.test_killed import (
    LETTING_GO_S,
    SCALE,
    WATCHDOG_S,
    Listener,
    place,  # noqa: F401 (a fixture)
    tensions_after,
    whole_log,
)

pytestmark = pytest.mark.realtime
TIMES = 100 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 2
WORDS = ("--hand", "jamia", "--bus", BUS, "--calibration", "c.toml", "--task", "long.toml", "--json")


def heard(process, listener):
    """Wait for the first SYNC of a run."""
    until = time.monotonic() + 60.0
    while not listener.seen:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.001)


def interrupted(folder, number, delay_s, how):
    """A run that is stopped some time after its first SYNC; when [ns, scaled], how it ended, and its log's warning."""
    listener, log = Listener(), folder / f"{number}.mcap"
    process = start_handctl("run", *WORDS, "--log", str(log), "--time-scale", str(SCALE))
    try:
        heard(process, listener)
        time.sleep(delay_s)
        process.send_signal(how)
        at_ns = int(time.monotonic_ns() * SCALE)
        time.sleep((WATCHDOG_S + LETTING_GO_S) / SCALE)
        process.send_signal(signal.SIGCONT)
        time.sleep(0.5)
    finally:
        end(process)
    return at_ns, process.returncode, whole_log(log)


def test_a_controller_that_stood_still_does_not_go_on(place):  # noqa: F811
    chance, pulling = random.Random(11), 0
    for number in range(TIMES):
        file = place / f"{number}.truth"
        simulated = start_hand(file, "--hand", "jamia", "--time-scale", str(SCALE))
        try:
            at_ns, code, warning = interrupted(place, number, chance.uniform(1.0, 2.5), signal.SIGSTOP)
        finally:
            end(simulated)
        before, after = tensions_after(file, at_ns)
        pulling += before > 8.0
        assert (warning, after < 5.0) == ("", True), number
        assert code in (0, 1, -signal.SIGTERM), "no internal error"
    assert pulling, "at least one was stopped while it pulled"


def test_a_second_controller_is_refused_and_the_first_goes_on(place):  # noqa: F811
    simulated = start_hand(place / "hand.truth", "--hand", "jamia", "--time-scale", str(SCALE))
    listener = Listener()
    first = start_handctl("run", *WORDS, "--log", "first.mcap", "--time-scale", str(SCALE))
    try:
        heard(first, listener)
        second = handctl("run", *WORDS, "--log", "second.mcap", "--time-scale", str(SCALE))
        assert second.returncode == 1
        assert "another controller runs here" in second.stderr
        assert second.stderr.count("\n") == 1
        before = listener.seen
        time.sleep(0.5)
        assert first.poll() is None
        assert listener.seen > before, "the first still has the bus"
        first.send_signal(signal.SIGTERM)
        assert first.wait(30.0) == 0
    finally:
        end(first)
        end(simulated)
    assert whole_log(place / "first.mcap") == ""
    assert not (place / "second.mcap").exists()
