"""The demo on the real clock, at a time scale that this machine can hold."""

import re

import pytest

from handctl.cli.runs.demo import MIN_TIME_SCALE
from handctl.log.read.reader import RunLog
from tests.runtime.processes import modes_of_complete, result_of, start_handctl

pytestmark = [pytest.mark.realtime, pytest.mark.alone]


def test_the_demo_slows_time_until_this_machine_keeps_up(place, processes):
    """At 16 times real time it fails on any machine. The log of the failed run stays under another name."""
    words = ("--task", "short.toml", "--scene", "none", "--log", "run.mcap", "--time-scale", "16", "--json")
    processes.append(start_handctl("demo", *words))
    code, result, err = result_of(processes.pop())
    assert code == 0, err
    assert result["failure"] == ""
    assert MIN_TIME_SCALE <= result["time_scale"] < 16.0
    assert max(result["tracking_rmse_deg"].values()) < 1.0
    modes_of_complete(place / "run.mcap")
    assert "does not keep up with a simulated hand" in err
    tries = re.findall(r"once more at ([\d.]+) of real time", err)
    assert tries
    assert f"{result['time_scale']:g}" == tries[-1]
    logs = list(place.glob("run-at-16*.mcap"))
    assert logs
    with RunLog(logs[0]) as log:
        assert log.header.metadata["time_scale"] == "16"
