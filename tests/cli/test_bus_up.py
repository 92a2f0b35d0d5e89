"""Test ``handctl bus up``: its commands for each kind of bus interface, and the inputs that it refuses."""

import json
import os

import pytest

from handctl.cli.checks import bus_up
from handctl.cli.main import main
from handctl.runtime.buses.interface_setup import interface_setup_commands

MEGABIT_PER_S = 1_000_000


def command_texts(*command_words) -> list[str]:
    return [" ".join(command) for command in interface_setup_commands(*command_words)]


def test_the_commands_of_a_real_interface():
    assert command_texts("can0", MEGABIT_PER_S, None, True) == [
        "ip link set can0 down",
        "ip link set can0 type can bitrate 1000000 restart-ms 100",
        "ip link set can0 txqueuelen 128",
        "ip link set can0 up",
    ]
    assert command_texts("can0", MEGABIT_PER_S, 5 * MEGABIT_PER_S, True)[1] == (
        "ip link set can0 type can bitrate 1000000 dbitrate 5000000 fd on restart-ms 100"
    )


@pytest.mark.parametrize(
    ("interface_exists", "first_command"),
    [(True, "ip link set vcan0 down"), (False, "ip link add vcan0 type vcan")],
)
def test_the_commands_of_a_virtual_interface(interface_exists, first_command):
    assert command_texts("vcan0", MEGABIT_PER_S, 5 * MEGABIT_PER_S, interface_exists) == [
        first_command, "ip link set vcan0 mtu 72", "ip link set vcan0 txqueuelen 128", "ip link set vcan0 up",
    ]  # fmt: skip


def test_without_yes_nothing_runs(capsys, monkeypatch):
    monkeypatch.setattr(
        bus_up.subprocess, "run", lambda *words, **options: pytest.fail("a command ran")
    )
    assert main(["bus", "up", "--bus", "socketcan:vcan77", "--bitrate", "500000"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "sudo ip link add vcan77 type vcan", "sudo ip link set vcan77 txqueuelen 128", "sudo ip link set vcan77 up",
    ]  # fmt: skip


def test_a_hand_gives_the_bit_rates(capsys, monkeypatch):
    monkeypatch.setattr(bus_up, "interface_names", lambda: ("can0",))
    assert main(["bus", "up", "--hand", "jamia", "--bus", "socketcan:can0", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["done"] is False
    assert result["commands"][1][:8] == [
        "ip",
        "link",
        "set",
        "can0",
        "type",
        "can",
        "bitrate",
        "1000000",
    ]


def test_with_yes_root_runs_them_in_order(capsys, monkeypatch):
    result = []

    class SucceededProcess:
        returncode, stdout, stderr = 0, "", ""

    def record_command(command_line, **options):
        result.append(" ".join(command_line))
        return SucceededProcess()

    monkeypatch.setattr(bus_up.os, "geteuid", lambda: 0)
    monkeypatch.setattr(bus_up.subprocess, "run", record_command)
    assert main(["bus", "up", "--bus", "socketcan:vcan77", "--yes"]) == 0
    assert result == capsys.readouterr().out.splitlines()
    assert len(result) == 3


def test_a_command_that_fails_ends_the_verb_with_its_reason(capsys, monkeypatch):
    class FailedProcess:
        returncode, stdout, stderr = 2, "", "RTNETLINK answers: Operation not supported\n"

    monkeypatch.setattr(bus_up.os, "geteuid", lambda: 0)
    monkeypatch.setattr(bus_up.subprocess, "run", lambda command, **options: FailedProcess())
    assert main(["bus", "up", "--bus", "socketcan:vcan77", "--yes"]) == 1
    error = capsys.readouterr().err
    assert "Operation not supported" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("command_words", "exit_code", "expected_message"),
    [
        ([], 2, "--bus"),
        (["--bus", "local:x"], 1, "socketcan:NAME"),
        (["--bus", "socketcan:can77"], 1, "no such interface"),
    ],
)
def test_interface_that_cannot_be_set_up_is_refused_in_one_line(
    capsys, command_words, exit_code, expected_message
):
    assert main(["bus", "up", *command_words]) == exit_code
    error = capsys.readouterr().err
    assert expected_message in error
    assert error.count("\n") == 1


def test_only_root_may_run_them(capsys, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert main(["bus", "up", "--bus", "socketcan:vcan77", "--yes"]) == 1
    assert "only root" in capsys.readouterr().err
