"""Test ``handctl jog --mode`` on simulated drives.

The simulated drives run in another process. The tests also cover the inputs that ``jog --mode``
refuses.
"""

import json

import pytest

from handctl.cli.main import main
from tests.cli.test_conformance import ENDPOINT_OPTIONS
from tests.drives.bench_process import run_simulated_drives
from tests.runtime.processes import run_handctl

JOG_OPTIONS = [
    "jog",
    "--bus",
    "local:j",
    "--torque-limit-Nm",
    "0.3",
    "--node",
    "33",
    "--for",
    "1.5",
]


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("protocol", "drive_mode", "protocol_options"),
    [
        pytest.param("mit", "velocity", [], id="mit"),
        pytest.param(
            "mit",
            "force-position",
            ["--option=current_fraction=0.1"],
            id="mit-force",
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            "mit", "torque", ["--speed-limit=50"], id="mit-torque", marks=pytest.mark.nightly
        ),
        pytest.param("odrive", "position", ENDPOINT_OPTIONS, id="odrive"),
        pytest.param(
            "odrive", "velocity", ENDPOINT_OPTIONS, id="odrive-velocity", marks=pytest.mark.nightly
        ),
        pytest.param("cia402", "position", [], id="cia402"),
        pytest.param("cia402", "velocity", [], id="cia402-velocity", marks=pytest.mark.nightly),
    ],
)
def test_a_drive_in_another_process_is_moved_and_left_off(protocol, drive_mode, protocol_options):
    setpoint = "0.1" if drive_mode == "torque" else "1.0"
    with run_simulated_drives("local:j", protocol, "--ids", "33"):
        words = [
            "--protocol",
            protocol,
            "--mode",
            drive_mode,
            "--setpoint",
            setpoint,
            "--yes",
            "--json",
            *protocol_options,
        ]
        done = run_handctl(*JOG_OPTIONS, *words)
        assert done.returncode == 0, done.stderr
        result = json.loads(done.stdout)
        assert (result["failure"], result["confirmed_off"]) == ("", True)
        if drive_mode != "torque":
            assert result["moved_rad"] == pytest.approx(
                1.0 if "position" in drive_mode else 1.5, abs=0.2
            )
            assert result["final_rad_s"] < 0.2
        process_result = run_handctl("scan", "--bus", "local:j", "--json")
    (node,) = json.loads(process_result.stdout)["buses"][0]["nodes"]
    assert node["error"] == ""


@pytest.mark.realtime
def test_a_limit_stops_a_drive_in_another_process(capsys):
    with run_simulated_drives("local:j", "mit", "--ids", "33"):
        words = [
            "--protocol",
            "mit",
            "--mode",
            "velocity",
            "--setpoint",
            "3",
            "--travel",
            "0.5",
            "--yes",
        ]
        assert main([*JOG_OPTIONS, *words]) == 1
    out = capsys.readouterr()
    assert "expected at most 0.5" in out.err
    assert "off, as reported by the drive" in out.out


@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        ("--mode velocity --setpoint nan --protocol mit", "--setpoint: nan; expected -5 to 5"),
        ("--mode position --setpoint 21 --protocol mit", "--setpoint: 21; expected -20 to 20"),
        ("--mode torque --setpoint 0.4 --protocol mit", "--setpoint: 0.4; expected -0.3 to 0.3"),
        ("--mode position --setpoint 1 --protocol mit --travel inf", "--travel: inf"),
        ("--mode position --setpoint 1 --protocol mit --speed-limit 0", "--speed-limit: 0"),
        (
            "--mode position --setpoint 1 --protocol moteus",
            "expected torque, or one of cia402, mit, odrive",
        ),
        (
            "--mode force-position --setpoint 1 --protocol odrive",
            "expected position, velocity or torque",
        ),
        ("--mode position --setpoint 1", "--protocol: nothing; expected a value with --mode"),
        ("--mode position --protocol mit", "--setpoint: nothing"),
        (
            "index --mode position --setpoint 1 --protocol mit",
            "no digit, because --mode moves one drive",
        ),
        ("index --tension 5", "expected --mode"),
        ("--mode position --setpoint 1 --protocol mit --option fd=1", "fd"),
        (
            "--mode position --setpoint 1 --protocol cia402 --option velocity_unit=m",
            "rev_min or count_s",
        ),
    ],
)
def test_wrong_input_is_one_line_and_opens_no_bus(
    command_words, expected_message, capsys, monkeypatch
):
    monkeypatch.setattr("handctl.cli.console.bench_drive.open_bus", None)
    assert main([*JOG_OPTIONS, *command_words.split(), "--yes"]) == 2
    text = capsys.readouterr().err
    assert expected_message in text
    assert text.count("\n") == 1


def test_a_dry_run_opens_no_bus(capsys, monkeypatch):
    monkeypatch.setattr("handctl.cli.console.bench_drive.open_bus", None)
    words = ["--mode", "velocity", "--setpoint", "2", "--protocol", "cia402", "--dry-run", "--json"]
    assert main([*JOG_OPTIONS, *words]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "mode": "velocity",
        "setpoint": 2.0,
        "torque_limit_N_m": 0.3,
    }
