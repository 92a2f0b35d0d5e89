"""``handctl conformance`` against drives in another process: what it says, what it leaves behind, how it ends."""

import json

import pytest

from handctl.cli.main import main
from tests.drives.bench_process import drives

WORDS = ["conformance", "--bus", "local:c", "--torque-limit-Nm", "0.1"]
ENDPOINTS = [f"--option=endpoint_{key}={number}" for number, key in enumerate(
    ("enable_watchdog", "watchdog_timeout", "torque_max", "torque_min"), 201)]  # fmt: skip


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("protocol", "more"),
    [
        pytest.param("mit", [], id="mit"),
        pytest.param("odrive", ENDPOINTS, id="odrive", marks=pytest.mark.nightly),
        pytest.param("cia402", [], id="cia402", marks=pytest.mark.nightly),
    ],
)
def test_a_good_drive_in_another_process_passes(capsys, protocol, more):
    with drives("local:c", protocol, "--ids", "33"):
        code = main([*WORDS, "--drive", protocol, "--node", "33", "--yes", "--json", *more])
        told = json.loads(capsys.readouterr().out)
        assert [check for check in told["checks"] if check["verdict"] == "failed"] == []
        assert (code, told["confirmed_off"]) == (0, True)
        assert main(["scan", "--bus", "local:c", "--json"]) == 0
    (node,) = json.loads(capsys.readouterr().out)["buses"][0]["nodes"]
    if protocol == "mit":
        assert node["settings"]["torque_max_N_m"] == 10.0, "the torque range is given back"
        assert node["state"] == "disabled"


@pytest.mark.realtime
def test_a_broken_drive_fails_and_its_line_says_why(capsys):
    with drives("local:c", "mit", "--ids", "2", "--broken", "sign"):
        assert main([*WORDS, "--drive", "mit", "--node", "2", "--yes"]) == 1
    lines = capsys.readouterr().out.splitlines()
    (line,) = (line for line in lines if line.startswith("FAILED"))
    assert "the wrong way" in line
    assert lines[-1].split(", ")[1] == "1 failed"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--drive", "mit", "--node", "2"], "mit 2 on local:c turns, with at most 0.1 N m; expected --yes"),
        (["--drive", "odrive", "--node", "63", "--yes"], "1 to 62"),
        (["--drive", "mit", "--node", "200", "--yes"], "1 to 127"),
        (["--drive", "mit", "--node", "2", "--yes", "--torque-limit-Nm", "nan"], "0.001 to 50"),
        (["--drive", "mit", "--node", "2", "--yes", "--option", "gear=2"], "unknown key"),
        (["--drive", "mit", "--node", "2", "--yes", "--option", "gear"], "KEY=VALUE"),
    ],
)
def test_what_cannot_be_checked_is_refused_before_a_bus_is_opened(capsys, words, said):
    assert main([*WORDS, *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_drive_that_is_not_there_is_said(capsys):
    with drives("local:c", "odrive", "--ids", "3"):
        assert main([*WORDS, "--drive", "odrive", "--node", "4", "--yes"]) == 1
    assert "no odrive 4; there is odrive 3" in capsys.readouterr().err
