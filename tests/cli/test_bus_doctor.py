"""Test ``handctl bus doctor``.

The command ``bus doctor`` reports problems of a bus and its nodes. For each problem, ``bus doctor``
also prints a command that repairs the problem.
"""

import json

import pytest

from handctl.cli.main import main
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from tests.drives.bench_process import run_simulated_drives


def test_bus_doctor_measures_the_nodes_of_a_local_bus(capsys):
    with run_simulated_drives("local:d", "mit", "--ids", "1,2"):
        main(["bus", "doctor", "--bus", "local:d", "--json"])
        (bus,) = json.loads(capsys.readouterr().out)["buses"]
    assert [(node["node_id"], node["answers"]) for node in bus["nodes"]] == [(1, 20), (2, 20)]
    assert all(0.0 < node["shortest"] <= node["median"] <= node["longest"] for node in bus["nodes"])
    assert bus["findings"][0] == {"what": "can be opened", "good": True, "fix": ""}


def test_motors_of_the_hand_that_do_not_answer_are_named(capsys):
    with run_simulated_drives("local:d", "mit", "--ids", "1,2"):
        assert main(["bus", "doctor", "--hand", "jamia", "--bus", "local:d"]) == 1
    out = capsys.readouterr().out
    assert "ring_motor (mit 3) does not answer" in out
    assert "index_motor" not in out


@pytest.mark.parametrize(
    ("command_words", "expected_finding"),
    [
        (["--bus", "local:nobody"], "type: handctl sim --bus local:nobody"),
        (["--bus", "virtual:x"], "120 ohm"),
    ],
)
def test_missing_interface_finding_has_the_set_up_command(capsys, command_words, expected_finding):
    assert main(["bus", "doctor", *command_words]) == 1
    assert expected_finding in capsys.readouterr().out


def test_an_odrive_with_firmware_05_is_found(capsys):
    """Reproduce a defect: ``bus doctor`` searched for ODrives by asking for their firmware version.

    An ODrive with firmware 0.5 does not answer a request for its firmware version, so ``bus
    doctor`` reported this ODrive as missing.
    """
    with run_simulated_drives("local:d", "odrive", "--ids", "3", "--firmware", "0.5"):
        assert main(["bus", "doctor", "--bus", "local:d"]) == 0
    assert "odrive 3 answers 20 of 20" in capsys.readouterr().out


@pytest.mark.parametrize("protocol", VERIFIABLE_PROTOCOLS)
def test_two_drives_with_one_number_are_found(capsys, protocol):
    with run_simulated_drives("local:d", protocol, "--ids", "33", "--broken", "twin"):
        assert main(["bus", "doctor", "--bus", "local:d"]) == 1
    assert f"--  {protocol} 33: two drives answer" in capsys.readouterr().out


def test_a_fault_can_be_injected_into_running_drives(capsys):
    with run_simulated_drives("local:d", "mit", "--ids", "1,2"):
        assert main(["fault", "kinds", "--bus", "local:d"]) == 0
        assert "mit1, mit2" in capsys.readouterr().out
        assert main(["fault", "inject", "off node=2", "--bus", "local:d"]) == 0
        main(["bus", "doctor", "--bus", "local:d", "--json"])
    (bus,) = json.loads(capsys.readouterr().out.split("\n", 2)[2])["buses"]
    assert [node["node_id"] for node in bus["nodes"]] == [1]


def test_bus_doctor_without_a_bus_is_bad_input(capsys):
    assert main(["bus", "doctor"]) == 2
    assert "--bus" in capsys.readouterr().err
