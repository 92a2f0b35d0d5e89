"""Test that pytest detects a stall of the machine.

If a test on the real clock fails, pytest repeats this test only if the machine stalled.
"""

import os
import signal
import time

import pytest

from tests.computer_pause_meter import ComputerPauseMeter

pytestmark = [pytest.mark.realtime, pytest.mark.alone]
REPEATED_TEST = """
import os, signal, time
import pytest
from tests.conftest import TIME_SCALE_PER_REPEAT

STALLED_TRIES = []

@pytest.mark.realtime
@pytest.mark.parametrize("stalled", [True, False])
def test_each_repeat_runs_in_slower_time(stalled, request, time_scale_of_attempt):
    STALLED_TRIES.append(stalled)
    expected = TIME_SCALE_PER_REPEAT ** (STALLED_TRIES.count(stalled) - 1)
    assert time_scale_of_attempt == pytest.approx(expected), "each try in slower time"
    repeats = request.config.pluginmanager.get_plugin("repeats")
    if stalled:
        os.kill(repeats.pause_meter.pids[0], signal.SIGSTOP)
        time.sleep(0.05)
        os.kill(repeats.pause_meter.pids[0], signal.SIGCONT)
        time.sleep(0.05)
    assert STALLED_TRIES.count(stalled) == 3
"""


def test_a_stall_of_one_core_is_seen_once() -> None:
    pause_meter = ComputerPauseMeter()
    try:
        start = time.monotonic()
        os.kill(pause_meter.pids[-1], signal.SIGSTOP)
        time.sleep(0.05)
        os.kill(pause_meter.pids[-1], signal.SIGCONT)
        longest = 0.0
        while not longest and time.monotonic() < start + 10.0:
            longest = pause_meter.longest_stall_since(start)
        assert 0.03 < longest < 10.0
        assert pause_meter.longest_stall_since(time.monotonic()) == 0.0
    finally:
        pause_meter.close()
    assert not any(os.path.exists(f"/proc/{pid}") for pid in pause_meter.pids)


def test_a_test_is_repeated_only_after_a_stall(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytester.makepyfile(test_clock=REPEATED_TEST)
    pytester.makeconftest("from tests.conftest import *")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(("", os.getcwd())))
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-o", "markers=realtime")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            "*test_clock.py::test_each_repeat_runs_in_slower_time?True?",
            "*1 failed, 1 passed, 2 rerun*",
        ]
    )
